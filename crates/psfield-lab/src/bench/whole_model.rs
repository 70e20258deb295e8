//! PSFs drawn and seconds against the error of the whole model: samples, basis and interpolation.

use std::time::Instant;

use metrics::{Comparison, Summary};
use psf_sample::{Refinement, SampleError, SamplingMethod, SamplingOptions};
use psf_types::{Progress, PsfModel, PsfSamples, PsfSource};
use psfield::fit::fit;
use psfield::{FitOptions, PsfieldError};
use serde::Serialize;

/// A way to sample a PSF.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum ModelSampling {
    /// A refinement until errors are at most a threshold.
    Refined(Refinement, f64),
    /// A grid with this number of samples along each side.
    Grid(usize),
}

/// The cost and the errors of a model.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ModelRow {
    /// The way of sampling: `kriging`, `mesh` or `grid`.
    pub sampling: String,
    /// The threshold, or the number of samples along each side of a grid.
    pub setting: f64,
    /// Number of PSFs drawn.
    pub draws: usize,
    /// Number of samples of the model.
    pub samples: usize,
    /// Seconds to sample, with the computation of the PSFs.
    pub seconds_sample: f64,
    /// Seconds to fit.
    pub seconds_fit: f64,
    /// The interpolation that the fit chose.
    pub interpolation: String,
    /// Errors of PSFs that are not samples: relative L2, the median.
    pub median_error: f64,
    /// Their 99 % quantile.
    pub error_99: f64,
    /// The largest.
    pub max_error: f64,
}

impl ModelSampling {
    fn name(self) -> String {
        match self {
            Self::Refined(refinement, _) => refinement.to_string(),
            Self::Grid(_) => "grid".to_owned(),
        }
    }

    fn setting(self) -> f64 {
        match self {
            Self::Refined(_, threshold) => threshold,
            Self::Grid(side) => side as f64,
        }
    }

    fn method(self) -> Result<Box<dyn SamplingMethod>, SampleError> {
        let defaults = SamplingOptions::default();
        let options = match self {
            Self::Refined(refinement, threshold) => SamplingOptions {
                refinement: Some(refinement),
                threshold,
                ..defaults
            },
            Self::Grid(side) => SamplingOptions {
                uniform: Some((side, side)),
                ..defaults
            },
        };
        options.method()
    }
}

/// Measures a model that is sampled in a given way and fitted with the default options. `held_out` are PSFs
/// of the same source at other positions. None if the threshold is not met.
///
/// # Errors
/// [`PsfieldError`] when a PSF cannot be drawn, or the fit fails.
pub fn measure_model(
    source: &dyn PsfSource,
    sampling: ModelSampling,
    held_out: &PsfSamples,
    progress: &dyn Progress,
) -> Result<Option<ModelRow>, PsfieldError> {
    let method = sampling.method()?;
    let begun = Instant::now();
    let sampled = match method.sample(source, progress) {
        Err(SampleError::NotMet(_)) => return Ok(None),
        other => other?,
    };
    let seconds_sample = begun.elapsed().as_secs_f64();
    let samples = sampled.samples.len();
    let begun = Instant::now();
    let fitted = fit(sampled.samples, &FitOptions::default())?;
    let interpolation = fitted.record().interpolation().to_string();
    let model = fitted.into_model()?;
    let seconds_fit = begun.elapsed().as_secs_f64();
    let summary = model_errors(&held_out.clone().into_unit_flux(), &model)?;
    Ok(Some(ModelRow {
        sampling: sampling.name(),
        setting: sampling.setting(),
        draws: sampled.report.draws,
        samples,
        seconds_sample,
        seconds_fit,
        interpolation: interpolation.split('=').next().unwrap_or_default().to_owned(),
        median_error: summary.median(),
        error_99: summary.quantile(0.99)?,
        max_error: summary.max(),
    }))
}

/// Relative L2 errors of a model's PSFs against PSFs of unit flux that are not its samples.
///
/// # Errors
/// [`PsfieldError`] when the model has no PSF at a position.
pub fn model_errors(held_out: &PsfSamples, model: &PsfModel) -> Result<Summary, PsfieldError> {
    let positions = held_out.positions().as_slice().iter();
    let errors = positions.enumerate().map(|(k, &position)| {
        Ok(Comparison::of(model.psf_at(position)?.values(), held_out.stamp(k))?.relative_l2()?)
    });
    Ok(Summary::of(errors.collect::<Result<Vec<f64>, PsfieldError>>()?)?)
}
