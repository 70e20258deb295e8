//! Coefficients as functions of the position.

use std::borrow::Cow;
use std::ops::Range;

use ndarray::{Array2, ArrayViewMut3};
use thiserror::Error;

use crate::{PixelRegion, Position};

/// Coefficient fields `a_k(x)`: a vector of `component_count()` values at any position of the field.
///
/// Object-safe; implementations are evaluated from many threads at once, and must return the same values whatever the
/// thread, the region or the range of components asked for.
pub trait CoefficientField: std::fmt::Debug + Send + Sync {
    /// The number of coefficients `K`.
    fn component_count(&self) -> usize;

    /// Writes all `K` coefficients at `position`.
    ///
    /// # Errors
    /// [`FieldError`] where the field has no value.
    ///
    /// # Panics
    /// May panic when `coefficients.len() != self.component_count()`.
    fn evaluate_into(&self, position: Position, coefficients: &mut [f64]) -> Result<(), FieldError>;

    /// Writes the coefficients of a range of components at every pixel of a region, `[component, y, x]`.
    ///
    /// The provided method evaluates pixel by pixel.
    ///
    /// # Errors
    /// [`FieldError`] where the field has no value.
    ///
    /// # Panics
    /// May panic when `values` is not of shape `[components.len(), ny, nx]`.
    fn evaluate_region_into(
        &self,
        region: PixelRegion,
        components: Range<usize>,
        mut values: ArrayViewMut3<'_, f64>,
    ) -> Result<(), FieldError> {
        let mut all = vec![0.0; self.component_count()];
        for row in 0..region.shape().ny() {
            for column in 0..region.shape().nx() {
                self.evaluate_into(region.position(column, row), &mut all)?;
                for (plane, component) in components.clone().enumerate() {
                    values[[plane, row, column]] = all[component];
                }
            }
        }
        Ok(())
    }

    /// The values `v` `[node, component]` that the field combines: `a_k(x) = sum_n w_n(x) v_nk`, with the weights of
    /// [`weights_along_row`](Self::weights_along_row).
    ///
    /// The provided method returns the unit matrix, so that the weights are the coefficients themselves.
    fn node_values(&self) -> Cow<'_, Array2<f64>> {
        Cow::Owned(Array2::eye(self.component_count()))
    }

    /// The x and the y coordinates of the lines between which every weight is bilinear (or constant), where the field has such cells, both
    /// ascending. A pixel on a line belongs to the cell above it, and runs of the rows between two lines are those of both. Convolution
    /// evaluates the weights of the first and the last row between two lines, and cuts its tiles at lines.
    fn grid_lines(&self) -> Option<[Vec<f64>; 2]> {
        None
    }

    /// Visits the weights of the nodes along a row of pixels, `length` pixels from `(x, y)` on, in runs along which every weight
    /// is linear in x. The runs follow each other without a gap; how they are cut may depend on the row asked for.
    ///
    /// A field that names few nodes a run and has long runs makes convolution fast. The provided method visits pixel by pixel.
    ///
    /// # Errors
    /// [`FieldError`] at the first pixel where the field has no value, when all pixels before it have been visited.
    fn weights_along_row(
        &self,
        (x, y): (i64, i64),
        length: usize,
        visit: &mut dyn FnMut(RowRun<'_>),
    ) -> Result<(), FieldError> {
        let mut coefficients = vec![0.0; self.component_count()];
        let mut weights = Vec::with_capacity(coefficients.len());
        for column in 0..length {
            self.evaluate_into(Position::of_pixel(x + column as i64, y), &mut coefficients)?;
            weights.clear();
            weights.extend(coefficients.iter().copied().enumerate());
            visit(RowRun::of_pixel(&weights));
        }
        Ok(())
    }
}

/// Neighbouring pixels of a row along which the weights of a field's nodes are linear in x.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RowRun<'a> {
    /// The number of pixels, at least 1.
    pub length: usize,
    /// `(node, weight)` at the first pixel; no node appears twice.
    pub first: &'a [(usize, f64)],
    /// `(node, weight)` at the last pixel; no node appears twice.
    pub last: &'a [(usize, f64)],
}

impl<'a> RowRun<'a> {
    /// A run of a single pixel.
    pub fn of_pixel(weights: &'a [(usize, f64)]) -> Self {
        Self {
            length: 1,
            first: weights,
            last: weights,
        }
    }
}

/// Why a field has no value at a position.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum FieldError {
    /// The position lies outside the samples' convex hull and the policy is to refuse.
    #[error(
        "position {position} lies outside the area that the samples cover: choose an outside policy (nearest, extend) or \
         add samples there"
    )]
    OutsideSamples {
        /// The position asked for.
        position: Position,
    },
    /// The interpolated PSF holds no light, so that it cannot be given unit flux.
    #[error("the PSF at {position} has flux {flux}: it cannot be normalised to unit flux")]
    NonPositiveFlux {
        /// The position asked for.
        position: Position,
        /// The PSF's flux there.
        flux: f64,
    },
    /// An error of a field implemented elsewhere.
    #[error("the coefficient field failed at {position}")]
    External {
        /// The position asked for.
        position: Position,
        /// What happened.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}
