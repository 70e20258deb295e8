//! What the objects say together.

use ndarray::Array2;
use psf_types::{Position, PsfModel};
use rayon::prelude::*;
use serde::Serialize;

use super::{ObjectRow, Spread};
use crate::PsfieldError;

/// The differences of simulated from true objects.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ErrorSummary {
    /// Objects.
    pub objects: usize,
    /// Those that could not be measured in both images; they count in none of the differences of shape.
    pub failed: usize,
    /// Of `e = sqrt(1 - b^2 / a^2)`.
    pub ellipticity: Option<Spread>,
    /// Of the distortion's `e1`.
    pub e1: Option<Spread>,
    /// Of the distortion's `e2`.
    pub e2: Option<Spread>,
    /// Of the FWHM, in pixels.
    pub fwhm_px: Option<Spread>,
    /// Mean absolute error over the window's mean.
    pub mae_over_mean: Option<Spread>,
    /// Mean squared error, in squared units of the image.
    pub mse: Option<Spread>,
    /// Relative L2 error.
    pub relative_l2: Option<Spread>,
    /// Largest error over the peak.
    pub max_over_peak: Option<Spread>,
}

impl ErrorSummary {
    /// Of a model's PSFs, by the exact sum over its components, beside the true ones.
    ///
    /// # Errors
    /// [`PsfieldError`] where the model has no PSF.
    pub(super) fn of_model(
        model: &PsfModel,
        positions: &[Position],
        truth: &[Array2<f64>],
    ) -> Result<Self, PsfieldError> {
        let rows: Vec<ObjectRow> = positions
            .par_iter()
            .zip(truth)
            .map(|(&at, truth)| {
                let psf = model.psf_at(at)?;
                Ok(ObjectRow::measure(at, psf.values(), truth.view()))
            })
            .collect::<Result<_, PsfieldError>>()?;
        Ok(Self::of(&rows))
    }

    /// Of some objects.
    pub fn of(rows: &[ObjectRow]) -> Self {
        let spread = |of: fn(&ObjectRow) -> Option<f64>| Spread::of(rows.iter().filter_map(of));
        Self {
            objects: rows.len(),
            failed: rows
                .iter()
                .filter(|r| r.ellipticity_difference().is_none())
                .count(),
            ellipticity: spread(ObjectRow::ellipticity_difference),
            e1: spread(ObjectRow::e1_difference),
            e2: spread(ObjectRow::e2_difference),
            fwhm_px: spread(ObjectRow::fwhm_difference_px),
            mae_over_mean: spread(|r| r.mae_over_mean),
            mse: spread(|r| r.mse),
            relative_l2: spread(|r| r.relative_l2),
            max_over_peak: spread(|r| r.max_over_peak),
        }
    }
}
