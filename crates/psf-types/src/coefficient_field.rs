//! Fields of coefficients over the frame, their weights at nodes, and the cells in which they are bilinear.

use std::borrow::Cow;
use std::ops::Range;

use ndarray::{Array2, ArrayView1, ArrayViewMut2, ArrayViewMut3};
use thiserror::Error;

use crate::frame::{FrameShape, PixelRegion, Position};

/// Coefficient fields `a_k(x)`: a vector of `component_count()` values at any position of the
/// field.
///
/// Object-safe. Many threads may evaluate one field at the same time. The values must not depend on
/// the thread, the requested region or the requested range of components.
pub trait CoefficientField: std::fmt::Debug + Send + Sync {
    /// The number of coefficients `K`.
    fn component_count(&self) -> usize;

    /// Writes all `K` coefficients at `position`.
    ///
    /// # Errors
    /// [`FieldError`] if the field has no value there.
    ///
    /// # Panics
    /// May panic when `coefficients.len() != self.component_count()`.
    fn evaluate_into(&self, position: Position, coefficients: &mut [f64]) -> Result<(), FieldError>;

    /// Writes all coefficients at several positions, `[position, component]`. Where the field has no
    /// value, they are NaN.
    ///
    /// The default implementation evaluates one position after the other.
    ///
    /// # Panics
    /// May panic when `values` is not of shape `[positions.len(), self.component_count()]`.
    fn evaluate_each_into(&self, positions: &[Position], mut values: ArrayViewMut2<'_, f64>) {
        let mut all = vec![0.0; self.component_count()];
        for (&position, mut row) in positions.iter().zip(values.outer_iter_mut()) {
            match self.evaluate_into(position, &mut all) {
                Ok(()) => row.assign(&ArrayView1::from(&all)),
                Err(_) => row.fill(f64::NAN),
            }
        }
    }

    /// Writes the coefficients of a range of components at every pixel of a region,
    /// `[component, y, x]`.
    ///
    /// The default implementation evaluates pixel by pixel.
    ///
    /// # Errors
    /// [`FieldError`] if the field has no value at a pixel.
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

    /// The field as a weighted sum of values at nodes, if the weights at each position are few. None for
    /// any other field.
    fn weighted_nodes(&self) -> Option<&dyn WeightedNodes> {
        None
    }

    /// Coefficients `[position, component]` at some positions, which show how the PSFs of a frame look.
    /// Positions without a value are left out.
    ///
    /// The default implementation takes 25 positions that are spread over the frame or, if its shape is
    /// not known, pixel (0, 0).
    fn some_coefficients(&self, frame: Option<FrameShape>) -> Array2<f64> {
        const ALONG_AXIS: i64 = 5;
        let place = |i: i64, pixels: usize| i * (pixels as i64 - 1) / (ALONG_AXIS - 1);
        let at: Vec<Position> = match frame {
            Some(shape) => (0..ALONG_AXIS * ALONG_AXIS)
                .map(|i| {
                    (
                        place(i % ALONG_AXIS, shape.nx()),
                        place(i / ALONG_AXIS, shape.ny()),
                    )
                })
                .map(|(x, y)| Position::of_pixel(x, y))
                .collect(),
            None => vec![Position::of_pixel(0, 0)],
        };
        let (mut values, mut found) = (vec![0.0; self.component_count()], Vec::new());
        for position in at {
            if self.evaluate_into(position, &mut values).is_ok() {
                found.extend_from_slice(&values);
            }
        }
        let count = found.len() / values.len().max(1);
        Array2::from_shape_vec((count, values.len()), found).expect("all coefficients of each position")
    }

    /// The division of a region into cells in which the coefficients are bilinear, up to an error.
    ///
    /// Convolution is fast for a field with large cells. The default implementation returns
    /// [`BilinearCells::Unknown`] with a scale of 64 pixels, and slow: convolution finds the cells by checks
    /// at points. A field with smaller details should return a smaller scale, or
    /// [`BilinearCells::every_row`].
    fn bilinear_cells(&self, _region: PixelRegion, _error: ErrorLimit<'_>) -> BilinearCells {
        BilinearCells::Unknown {
            scale: 64.0,
            slow: true,
        }
    }
}

/// A field that is a weighted sum of values at nodes: `a_k(x) = sum_n w_n(x) v_nk`. A node is a sample
/// or, for example, a term of a polynomial.
pub trait WeightedNodes {
    /// The values `v` `[node, component]`.
    fn node_values(&self) -> Cow<'_, Array2<f64>>;

    /// Writes the weights `w_n` of the nodes at a position, in place of what `weights` holds: pairs of
    /// a node and its weight. No node appears twice.
    ///
    /// # Errors
    /// [`FieldError`] if the field has no value there.
    fn weights_into(&self, position: Position, weights: &mut Vec<(usize, f64)>) -> Result<(), FieldError>;

    /// Visits the weights of the nodes along a row of `length` pixels that begins at `(x, y)`. The
    /// row is cut into runs along which every weight is linear in x. The runs follow each other
    /// without a gap. The cuts may differ from row to row.
    ///
    /// Convolution is fast for a field with few nodes per run and long runs. The default
    /// implementation visits pixel by pixel.
    ///
    /// # Errors
    /// [`FieldError`] at the first pixel where the field has no value, after all pixels before it
    /// have been visited.
    fn weights_along_row(
        &self,
        (x, y): (i64, i64),
        length: usize,
        visit: &mut dyn FnMut(RowRun<'_>),
    ) -> Result<(), FieldError> {
        let mut weights = Vec::new();
        for column in 0..length {
            weights.clear();
            self.weights_into(Position::of_pixel(x + column as i64, y), &mut weights)?;
            visit(RowRun::of_pixel(&weights));
        }
        Ok(())
    }
}

/// The largest error of coefficients that is allowed. The size of an error `d` is
/// `sqrt(sum_k d_k^2 + (sum_k flux_k d_k)^2)`.
///
/// If PSFs are scaled to unit flux, an error of their flux changes all of the PSF. Then this error
/// counts in addition to the error of the coefficients.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ErrorLimit<'a> {
    /// The largest size.
    pub size: f64,
    /// A multiple of each component's flux. Empty if the flux does not count in addition.
    pub flux: &'a [f64],
}

impl ErrorLimit<'_> {
    /// No error is allowed.
    pub const ZERO: ErrorLimit<'static> = ErrorLimit { size: 0.0, flux: &[] };

    /// The scalar product that belongs to the size of errors.
    pub fn product(&self, a: &[f64], b: &[f64]) -> f64 {
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        dot(a, b) + dot(self.flux, a) * dot(self.flux, b)
    }
}

/// The cells of a region ([`CoefficientField::bilinear_cells`]). A pixel on a line belongs to the cell
/// with the larger coordinates.
#[derive(Debug, Clone, PartialEq)]
pub enum BilinearCells {
    /// Cells between lines at these coordinates, both ascending. Coefficients are continuous, and in
    /// the cells they differ from a bilinear function by at most `error`.
    Lines {
        /// The x coordinates of vertical lines.
        x: Vec<f64>,
        /// The y coordinates of horizontal lines.
        y: Vec<f64>,
        /// The largest size of errors, at most the [`ErrorLimit`].
        error: f64,
    },
    /// Rectangles that cover the region and do not overlap. Each has its sides along x and along y.
    /// In each of them, every weight is bilinear. Coefficients are continuous from one to the next.
    Rectangles(Vec<[(f64, f64); 2]>),
    /// Between lines at these y coordinates (ascending), all rows have runs ([`RowRun`]) of equal
    /// lengths. Each weight is bilinear in the cells that the runs of the first and the last row
    /// form. Without [`WeightedNodes`], each pixel is a run of its own.
    Bands(Vec<f64>),
    /// The field has a kink in the region. Smaller regions may have cells.
    Divide,
    /// The field does not know its cells. They must be found by checks at points.
    Unknown {
        /// The distance in pixels over which coefficients may bend and bend back. Checks that are farther
        /// apart could miss that.
        scale: f64,
        /// Coefficients take long to evaluate, so that convolution makes a table of them first
        /// ([`FieldTable`](crate::FieldTable)).
        slow: bool,
    },
}

impl BilinearCells {
    /// Rows whose runs have nothing in common.
    pub fn every_row(region: PixelRegion) -> Self {
        let rows = 0..region.shape().ny() as i64;
        Self::Bands(rows.map(|row| (region.y0() + row) as f64).collect())
    }
}

/// Neighbouring pixels of a row along which the weights of a field's nodes are linear in x. A node
/// that is not listed at a pixel has weight 0 there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RowRun<'a> {
    /// The number of pixels, at least 1.
    pub length: usize,
    /// `(node, weight)` at the first pixel. No node appears twice.
    pub first: &'a [(usize, f64)],
    /// `(node, weight)` at the last pixel. No node appears twice.
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

/// The reason why a field has no value at a position.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum FieldError {
    /// The position lies outside the area that the samples cover, and the outside policy is
    /// `Error`.
    #[error(
        "position {position} lies outside the area that the samples cover: choose an outside policy (nearest, extend) or \
         add samples there"
    )]
    OutsideSamples {
        /// The requested position.
        position: Position,
    },
    /// The flux of the interpolated PSF is not positive and finite, so the PSF cannot be scaled to
    /// unit flux.
    #[error("the PSF at {position} has flux {flux}, which cannot be scaled to 1: check the samples near it")]
    NonPositiveFlux {
        /// The requested position.
        position: Position,
        /// The PSF's flux there.
        flux: f64,
    },
    /// Any other error of a coefficient field, or a PSF with values that are not finite.
    #[error("the PSF at {position} cannot be computed")]
    External {
        /// The requested position.
        position: Position,
        /// The underlying error.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}
