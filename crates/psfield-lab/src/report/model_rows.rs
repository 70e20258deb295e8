//! Errors of models with fewer samples, fewer components or other interpolators, without the
//! engine.

use psf_optics::Telescope;
use psf_sample::{SamplingMethod, UniformSampling};
use psf_types::{Interpolation, NoProgress, PsfModel, PsfModelRecord};
use psfield::{Fit, FitOptions, fit, model_of};
use rayon::prelude::*;
use serde::Serialize;

use crate::LabError;
use crate::report::document::{Table, short};
use crate::report::object_figures::error_table;
use crate::report::scenes::Scenes;
use crate::report::{ErrorSummary, ObjectRow};

/// Errors of a model's PSFs, computed by the exact sum over its components, without the engine.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ModelRow {
    /// Uniform samples along each axis.
    pub samples_across: usize,
    /// Components kept, the mean not counted.
    pub rank: usize,
    /// Largest truncation error over the samples, relative L2.
    pub truncation_error: f64,
    /// Errors of the model's PSFs.
    pub summary: ErrorSummary,
}

impl ModelRow {
    /// Makes models of the telescope with half the samples along each axis, a quarter, and so on,
    /// and measures each.
    ///
    /// # Errors
    /// [`LabError`] of sampling, fit and model.
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

    /// Measures a model with all its components, with half of them, with a quarter, and so on.
    ///
    /// # Errors
    /// [`LabError`] of the model.
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
        error_table(caption, &["samples", "components", "truncation"], rows)
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

/// Errors of a model's PSFs at the objects, by the exact sum over its components.
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

/// Models with fewer samples along each axis are not in the table.
const MIN_SAMPLES_ACROSS: usize = 5;
/// Models with fewer components are not in the table.
const FEWEST_COMPONENTS: usize = 3;

/// Errors of a model's PSFs, computed by the exact sum over its components, for one interpolator.
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
    /// The errors of the interpolator, of the model and of its field.
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
