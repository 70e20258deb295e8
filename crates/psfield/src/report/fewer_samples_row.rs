//! What fewer samples cost.

use ndarray::Array2;
use psf_optics::Telescope;
use psf_sample::{SamplingMethod, UniformSampling};
use psf_types::{NoProgress, Position};
use serde::Serialize;

use super::ErrorSummary;
use crate::{FitOptions, PsfieldError, fit};

/// A model of fewer samples against the truth, by the exact sum: no engine takes part.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct FewerSamplesRow {
    /// Uniform samples along each axis.
    pub samples_across: usize,
    /// Components kept, the mean not counted.
    pub rank: usize,
    /// Largest truncation error over the samples, relative L2.
    pub truncation_error: f64,
    /// How far its PSFs are from the true ones.
    pub summary: ErrorSummary,
}

impl FewerSamplesRow {
    /// Models of the telescope with half the samples along each axis, a quarter, and so on.
    ///
    /// # Errors
    /// [`PsfieldError`] of sampling, fit and model.
    pub(super) fn measure_all(
        telescope: &Telescope,
        most_across: usize,
        positions: &[Position],
        truth: &[Array2<f64>],
    ) -> Result<Vec<Self>, PsfieldError> {
        let mut rows = Vec::new();
        let mut across = most_across.div_ceil(2);
        while across >= FEWEST_ACROSS {
            let samples = UniformSampling::new(across, across)?
                .sample(telescope, &NoProgress)?
                .samples;
            let fitted = fit(samples, &FitOptions::default())?;
            let report = fitted.report()?;
            let model = fitted.into_model()?;
            rows.push(Self {
                samples_across: across,
                rank: report.rank,
                truncation_error: report.max_error,
                summary: ErrorSummary::of_model(&model, positions, truth)?,
            });
            across = across.div_ceil(2);
        }
        Ok(rows)
    }
}

/// Samples along each axis below which a field is not worth showing.
const FEWEST_ACROSS: usize = 5;
