//! What fewer samples and fewer components cost.

use ndarray::Array2;
use psf_optics::Telescope;
use psf_sample::{SamplingMethod, UniformSampling};
use psf_types::{NoProgress, Position};
use serde::Serialize;

use super::ErrorSummary;
use super::document::Table;
use super::object_figures::{error_cells, error_table};
use crate::readable::short;
use crate::{Fit, FitOptions, PsfieldError, fit};

/// A model against the truth, by the exact sum: no engine takes part.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ModelRow {
    /// Uniform samples along each axis.
    pub samples_across: usize,
    /// Components kept, the mean not counted.
    pub rank: usize,
    /// Largest truncation error over the samples, relative L2.
    pub truncation_error: f64,
    /// How far its PSFs are from the true ones.
    pub summary: ErrorSummary,
}

impl ModelRow {
    /// Models of the telescope with half the samples along each axis, a quarter, and so on.
    ///
    /// # Errors
    /// [`PsfieldError`] of sampling, fit and model.
    pub(super) fn of_fewer_samples(
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
            rows.push(Self::measure(fitted, across, positions, truth)?);
            across = across.div_ceil(2);
        }
        Ok(rows)
    }

    /// A model, and its first components alone: half as many, a quarter, and so on.
    ///
    /// # Errors
    /// [`PsfieldError`] of the model.
    pub(super) fn of_fewer_components(
        fitted: &Fit,
        across: usize,
        positions: &[Position],
        truth: &[Array2<f64>],
    ) -> Result<Vec<Self>, PsfieldError> {
        let mut rows = Vec::new();
        let mut rank = fitted.record().basis().rank();
        while rank >= FEWEST_COMPONENTS {
            rows.push(Self::measure(fitted.truncated(rank)?, across, positions, truth)?);
            rank = rank.div_ceil(2);
        }
        Ok(rows)
    }

    pub(super) fn table(caption: &str, rows: &[Self]) -> Table {
        let mut table = error_table(caption, &["samples", "components", "truncation"]);
        for row in rows {
            let mut cells = vec![
                format!("{0} x {0}", row.samples_across),
                row.rank.to_string(),
                short(Some(row.truncation_error)),
            ];
            cells.extend(error_cells(&row.summary));
            table.rows.push(cells);
        }
        table
    }

    fn measure(
        fitted: Fit,
        samples_across: usize,
        positions: &[Position],
        truth: &[Array2<f64>],
    ) -> Result<Self, PsfieldError> {
        let (rank, truncation_error) = (fitted.record().basis().rank(), fitted.max_error());
        let model = fitted.into_model()?;
        Ok(Self {
            samples_across,
            rank,
            truncation_error,
            summary: ErrorSummary::of_model(&model, positions, truth)?,
        })
    }
}

/// Samples along each axis below which a field is not worth showing.
const FEWEST_ACROSS: usize = 5;
/// Components below which a basis is not worth showing.
const FEWEST_COMPONENTS: usize = 3;
