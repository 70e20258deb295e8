//! Measures the PSFs of models other than that of the report: with fewer samples, with fewer
//! components, or with other interpolators. The fast engine is not used, so that its error is not
//! included.

use ndarray::Array2;
use psf_optics::Telescope;
use psf_sample::{SamplingMethod, UniformSampling};
use psf_types::{Interpolation, NoProgress, Position, PsfModel, PsfModelRecord};
use psfield::FitOptions;
use psfield::fit::{Fit, fit, model_of};
use rayon::prelude::*;
use serde::Serialize;

use crate::LabError;
use crate::bench::interpolated_by;
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
    /// The interpolator of the coefficients.
    pub interpolation: Interpolation,
    /// Errors of the model's PSFs.
    pub summary: ErrorSummary,
}

/// The report has no models with fewer samples along each axis than this number.
const MIN_SAMPLES_ACROSS: usize = 5;
/// The report has no models with fewer components than this number.
const FEWEST_COMPONENTS: usize = 3;

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
        let of_grid = |across| {
            let sampling = UniformSampling::new(across, across)?.sample(telescope, &NoProgress)?;
            let fitted = fit(sampling.samples, &FitOptions::default())?;
            Self::measure(fitted.record(), fitted.max_error(), across, scenes)
        };
        halves(most_across.div_ceil(2), MIN_SAMPLES_ACROSS)
            .map(of_grid)
            .collect()
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
        let of_rank = |rank| {
            let truncated = fitted.truncated(rank)?;
            Self::measure(truncated.record(), truncated.max_error(), across, scenes)
        };
        let all = fitted.record().basis().rank();
        halves(all, FEWEST_COMPONENTS).map(of_rank).collect()
    }

    /// Measures a model with several interpolators: its own first, then two that miss the curvature of
    /// the PSF, and a polynomial over the whole field.
    ///
    /// # Errors
    /// [`LabError`] if an interpolator does not suit the samples, or if the model has no PSF at an
    /// object.
    pub(super) fn of_interpolations(
        fitted: &Fit,
        across: usize,
        scenes: &Scenes,
    ) -> Result<Vec<Self>, LabError> {
        let record = fitted.record();
        let of_interpolation = |interpolation| {
            let record = interpolated_by(record, interpolation)?;
            Self::measure(&record, fitted.max_error(), across, scenes)
        };
        let own = record.interpolation();
        let polynomial = polynomial_of(record.coefficients().positions().len());
        [
            own,
            Interpolation::Bilinear,
            Interpolation::NaturalNeighbour,
            polynomial,
        ]
        .into_iter()
        .map(of_interpolation)
        .collect()
    }

    fn measure(
        record: &PsfModelRecord,
        truncation_error: f64,
        samples_across: usize,
        scenes: &Scenes,
    ) -> Result<Self, LabError> {
        let rows = psf_errors(&model_of(record.clone())?, &scenes.positions, &scenes.star_truth)?;
        Ok(Self {
            samples_across,
            rank: record.basis().rank(),
            truncation_error,
            interpolation: record.interpolation(),
            summary: ErrorSummary::of(&rows),
        })
    }
}

/// A number, its half, its quarter and so on, each rounded up, as long as it is at least `least`.
fn halves(number: usize, least: usize) -> impl Iterator<Item = usize> {
    std::iter::successors(Some(number), |n| Some(n.div_ceil(2))).take_while(move |&n| n >= least)
}

/// The highest degree allowed for the polynomial that is compared with the default interpolation.
const MAX_DEGREE: usize = 16;
/// Smallest number of samples per term that determines a polynomial well.
const SAMPLES_PER_TERM: usize = 4;

/// Returns the polynomial of the highest degree that this number of samples determines well.
fn polynomial_of(samples: usize) -> Interpolation {
    let determined = |degree: &usize| (degree + 1) * (degree + 2) / 2 * SAMPLES_PER_TERM <= samples;
    let degree = (1..=MAX_DEGREE).rev().find(determined).unwrap_or(0);
    Interpolation::Polynomial { degree }
}

/// Compares a model's PSFs at some positions with the true PSFs there. The model's PSFs are exact sums
/// over its components.
pub(super) fn psf_errors(
    model: &PsfModel,
    positions: &[Position],
    truth: &[Array2<f64>],
) -> Result<Vec<ObjectRow>, LabError> {
    let rows = positions.par_iter().zip(truth).map(|(&at, truth)| {
        let psf = model.psf_at(at)?;
        let oversampling = psf.grid().oversampling();
        Ok(ObjectRow::measure(at, psf.values(), truth.view(), oversampling))
    });
    rows.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_do_not_outgrow_their_samples() {
        for (samples, degree) in [(1, 0), (64, 4), (1296, 16), (5041, 16)] {
            assert_eq!(polynomial_of(samples), Interpolation::Polynomial { degree });
        }
    }

    #[test]
    fn halves_end_at_the_least() {
        assert_eq!(halves(36, 5).collect::<Vec<_>>(), [36, 18, 9, 5]);
        assert_eq!(halves(4, 5).count(), 0);
    }
}
