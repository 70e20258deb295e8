//! What each setting of a model costs in accuracy.

use ndarray::Array2;
use psf_basis::RankSelection;
use psf_optics::Telescope;
use psf_sample::{SamplingMethod, UniformSampling};
use psf_types::{NoProgress, Position, PsfSamples};
use serde::Serialize;

use super::ErrorSummary;
use crate::{FitOptions, PsfieldError, fit};

/// A model of some samples and some components against the truth, by the exact sum: no engine takes part.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct BudgetRow {
    /// Uniform samples along each axis.
    pub samples_across: usize,
    /// Components kept, the mean not counted.
    pub rank: usize,
    /// How the rank was chosen.
    pub rank_selection: String,
    /// Largest truncation error over the samples, relative L2.
    pub truncation_error: f64,
    /// How far its PSFs are from the true ones.
    pub summary: ErrorSummary,
}

impl BudgetRow {
    /// Models of the telescope from fewer and fewer samples, and of `samples` with fewer components.
    ///
    /// # Errors
    /// [`PsfieldError`] of sampling, fit and model.
    pub(super) fn measure_all(
        telescope: &Telescope,
        samples: &PsfSamples,
        samples_across: usize,
        positions: &[Position],
        truth: &[Array2<f64>],
    ) -> Result<Vec<Self>, PsfieldError> {
        let measure = |samples: &PsfSamples, across: usize, rank: RankSelection| {
            let options = FitOptions {
                rank,
                ..FitOptions::default()
            };
            let fitted = fit(samples.clone(), &options)?;
            let report = fitted.report()?;
            let model = fitted.into_model()?;
            Ok::<_, PsfieldError>(Self {
                samples_across: across,
                rank: report.rank,
                rank_selection: rank.to_string(),
                truncation_error: report.max_error,
                summary: ErrorSummary::of_model(&model, positions, truth)?,
            })
        };
        let mut rows = Vec::new();
        for rank in [
            RankSelection::Elbow,
            RankSelection::Error(1e-2),
            RankSelection::Error(1e-3),
            RankSelection::Auto,
        ] {
            rows.push(measure(samples, samples_across, rank)?);
        }
        let mut across = samples_across.div_ceil(2);
        while across >= FEWEST_ACROSS {
            let fewer = UniformSampling::new(across, across)?
                .sample(telescope, &NoProgress)?
                .samples;
            rows.push(measure(&fewer, across, RankSelection::Auto)?);
            across = across.div_ceil(2);
        }
        Ok(rows)
    }
}

/// Samples along each axis below which a field is not worth showing.
const FEWEST_ACROSS: usize = 5;
