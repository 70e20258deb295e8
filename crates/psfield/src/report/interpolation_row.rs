//! What the interpolation of the coefficients costs, apart from the engine.

use ndarray::Array2;
use psf_types::{Interpolation, Position, PsfModelRecord};
use serde::Serialize;

use super::ErrorSummary;
use crate::{PsfieldError, model_of};

/// The model's PSFs, by the exact sum over its components, against the true ones, with one of the interpolators.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct InterpolationRow {
    /// The interpolator.
    pub interpolation: Interpolation,
    /// Whether it is the one that the images were made with.
    pub in_use: bool,
    /// How far its PSFs are from the true ones.
    pub summary: ErrorSummary,
}

impl InterpolationRow {
    /// Measures the same components and coefficients with an interpolator.
    ///
    /// # Errors
    /// Those of the interpolator, of the model and its field.
    pub(super) fn measure(
        record: &PsfModelRecord,
        interpolation: Interpolation,
        positions: &[Position],
        truth: &[Array2<f64>],
    ) -> Result<Self, PsfieldError> {
        let model = model_of(PsfModelRecord::new(
            record.basis().clone(),
            record.coefficients().clone(),
            interpolation,
            record.outside(),
            record.normalisation(),
        )?)?;
        Ok(Self {
            interpolation,
            in_use: interpolation == record.interpolation(),
            summary: ErrorSummary::of_model(&model, positions, truth)?,
        })
    }
}
