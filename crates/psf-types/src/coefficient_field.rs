//! Coefficients as functions of the position.

use std::ops::Range;

use ndarray::ArrayViewMut3;
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
