//! Measures the PSFs of models other than that of the report: with fewer samples, with fewer
//! components, or with other interpolators. The fast engine is not used, so that its error is not
//! included.

use psf_optics::Telescope;
use psf_sample::{SamplingMethod, UniformSampling};
use psf_types::{Interpolation, NoProgress, PsfModel, PsfModelRecord};
use psfield::FitOptions;
use psfield::fit::{Fit, fit, model_of};
use rayon::prelude::*;
use serde::Serialize;

use crate::LabError;
use crate::report::document::{Table, short};
use crate::report::object_figures::error_table;
use crate::report::scenes::Scenes;
use crate::report::{ErrorSummary, ObjectRow};

/// Errors of a model's PSFs. The PSFs are exact sums over the model's components, so the errors do
/// not include the error of the fast engine.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ModelRow {
    /// Number of samples along each axis of a regular grid.
    pub samples_across: usize,
    /// Number of components kept, the mean not counted.
    pub rank: usize,
    /// Largest truncation error over the samples, relative L2: the largest change of a sample when
    /// only these components are kept.
    pub truncation_error: f64,
    /// Errors of the model's PSFs.
    pub summary: ErrorSummary,
}

impl ModelRow {
    /// Fits models to half of `most_across` samples of the telescope along each axis, to a quarter,
    /// and so on, and measures each.
    ///
    /// # Errors
    /// [`LabError`] if the sampling, a fit or a model fails.
    pub(super) fn of_fewer_samples(
        telescope: &Telescope,
        most_across: usize,
        scenes: &Scenes,
    ) -> Result<Vec<Self>, LabError> {
        let mut rows = Vec::new();
        let mut across = most_across.div_ceil(2);
        while across >= MIN_SAMPLES_ACROSS {
            let samples = UniformSampling::new(across, across)?
                .sample(telescope, &NoProgress)?
                .samples;
            let fitted = fit(samples, &FitOptions::default())?;
            rows.push(Self::measure(fitted, across, scenes)?);
            across = across.div_ceil(2);
        }
        Ok(rows)
    }

    /// Measures a model with all its components, with half of them, with a quarter, and so on. The
    /// model was fitted to `across` samples along each axis.
    ///
    /// # Errors
    /// [`LabError`] if a truncated model cannot be made or evaluated.
    pub(super) fn of_fewer_components(
        fitted: &Fit,
        across: usize,
        scenes: &Scenes,
    ) -> Result<Vec<Self>, LabError> {
        let mut rows = Vec::new();
        let mut rank = fitted.record().basis().rank();
        while rank >= FEWEST_COMPONENTS {
            rows.push(Self::measure(fitted.truncated(rank)?, across, scenes)?);
            rank = rank.div_ceil(2);
        }
        Ok(rows)
    }

    pub(super) fn table(caption: &str, rows: &[Self]) -> Table {
        let rows = rows.iter().map(|row| {
            let first = vec![
                format!("{0} x {0}", row.samples_across),
                row.rank.to_string(),
                short(Some(row.truncation_error)),
            ];
            (first, &row.summary)
        });
        error_table(caption, &["samples", "components", "truncation error"], rows)
    }

    fn measure(fitted: Fit, samples_across: usize, scenes: &Scenes) -> Result<Self, LabError> {
        let (rank, truncation_error) = (fitted.record().basis().rank(), fitted.max_error());
        let model = fitted.into_model()?;
        Ok(Self {
            samples_across,
            rank,
            truncation_error,
            summary: errors(&model, scenes)?,
        })
    }
}

/// Compares a model's PSFs at the positions of the objects with the true PSFs. The model's PSFs are
/// exact sums over its components.
fn errors(model: &PsfModel, scenes: &Scenes) -> Result<ErrorSummary, LabError> {
    let objects = scenes.positions.par_iter().zip(&scenes.star_truth);
    let rows = objects.map(|(&at, truth)| {
        let psf = model.psf_at(at)?;
        Ok(ObjectRow::measure(
            at,
            psf.values(),
            truth.view(),
            psf.grid().oversampling(),
        ))
    });
    Ok(ErrorSummary::of(&rows.collect::<Result<Vec<_>, LabError>>()?))
}

/// The report has no models with fewer samples along each axis than this number.
const MIN_SAMPLES_ACROSS: usize = 5;
/// The report has no models with fewer components than this number.
const FEWEST_COMPONENTS: usize = 3;

/// Errors of a model's PSFs for one interpolator of the coefficients. The PSFs are exact sums over
/// the model's components.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct InterpolationRow {
    /// The interpolator.
    pub interpolation: Interpolation,
    /// True if the images of the report were made with this interpolator.
    pub in_use: bool,
    /// Errors of the model's PSFs.
    pub summary: ErrorSummary,
}

impl InterpolationRow {
    /// Measures the model of a record, with `interpolation` instead of the record's interpolator.
    ///
    /// # Errors
    /// [`LabError`] if the interpolator does not suit the samples, or if the model has no PSF at an
    /// object.
    pub(super) fn measure(
        record: &PsfModelRecord,
        interpolation: Interpolation,
        scenes: &Scenes,
    ) -> Result<Self, LabError> {
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
            summary: errors(&model, scenes)?,
        })
    }
}
