//! The report of a fit: its errors, and warnings of samples that do not determine the model.

use coeff_field::LeftOut;
use metrics::Summary;
use psf_types::{Interpolation, Normalisation, OutsidePolicy};
use serde::Serialize;

use super::{Fit, WingsReport};
use crate::error::PsfieldError;

/// The errors of a fit, and the choices that it made. Errors are relative L2 errors of stamps.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct FitReport {
    /// Number of samples.
    pub samples: usize,
    /// The quantity on which the PSF depends besides the position, such as "wavelength". None if it
    /// depends on the position only.
    pub depends_on: Option<String>,
    /// The values of this quantity that samples have, ascending (micrometres, seconds, or numbers of
    /// frames).
    pub states: Vec<f64>,
    /// Number of components kept, without the mean. If there are wings, one more may carry the flux.
    pub rank: usize,
    /// Number of components at the elbow of the cumulative weights ([`psf_basis`] defines it).
    pub elbow: Option<usize>,
    /// Standard deviation of the white noise in the samples' pixels, estimated or known
    /// ([`FitOptions::noise`](crate::FitOptions::noise)). None if there is no noise.
    pub noise_sigma: Option<f64>,
    /// The interpolation that the model uses.
    pub interpolation: Interpolation,
    /// The reason for this interpolation. Empty if the caller named it.
    pub interpolation_reason: String,
    /// The policy for positions outside the area of the samples.
    pub outside: OutsidePolicy,
    /// The scaling of PSFs: to unit flux, or none.
    pub normalise: Normalisation,
    /// The largest truncation error over the samples. The truncation error of a sample is the norm
    /// of the part that the basis cannot represent, relative to the norm of the sample.
    pub max_error: f64,
    /// The root mean square of the truncation errors.
    pub rms_error: f64,
    /// Truncation error of every sample.
    pub errors: Vec<f64>,
    /// The largest error of the flux in circles about the source, over the samples, relative to the
    /// total flux ([`BasisFit::circle_errors`](psf_basis::BasisFit::circle_errors)). None for a fit that was
    /// truncated later.
    pub circle_error: Option<f64>,
    /// Errors of predicting each sample from all others.
    pub leave_one_out: LeaveOneOutReport,
    /// The error that kriging expects between the samples: relative L2, r.m.s. over the field, without the
    /// truncation error. None for other interpolations.
    pub expected_error: Option<f64>,
    /// The wings that were split from the samples. None if the stamps are too small for it, or if a few stamps
    /// do not represent their wings.
    pub wings: Option<WingsReport>,
    /// The singular values that were computed, in descending order ([`psf_basis::Spectrum`]).
    pub singular_values: Vec<f64>,
    /// The cumulative weights of the singular values.
    pub cumulative_weights: Vec<f64>,
    /// Sentences on samples that do not determine the model: they differ more from their neighbours than
    /// their noise explains, or the model keeps nearly all components.
    pub warnings: Vec<String>,
}

/// Leave-one-out errors (median) above this value are warned of: the PSF between the samples is a guess.
const GUESSED: f64 = 0.1;
/// Noise explains leave-one-out errors of up to this multiple of the truncation error. Of noisy samples,
/// the truncation error is their noise, and a prediction from few neighbours has noise of its own.
const EXPLAINED_BY_NOISE: f64 = 1.5;
/// Nearly all components are this part of the largest possible number.
const NEARLY_ALL: f64 = 0.9;
/// Of fewer samples, all may well differ.
const MANY_SAMPLES: usize = 64;

/// Leave-one-out errors of stamps, relative to each sample's own norm. They include the truncation
/// error.
///
/// These errors show how well the model interpolates a sample from the other samples. If all
/// samples come from one smooth PSF, such as an oversampled PSF of a frame, the errors do not test
/// that PSF. The round trip of `psfield-lab` tests it, because it leaves out the stars themselves.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
#[non_exhaustive]
pub struct LeaveOneOutReport {
    /// The number of parts into which the samples were divided, if each part was predicted from the others.
    /// None if every sample was predicted from all others.
    pub folds: Option<usize>,
    /// Number of samples that lie in the area which the other samples cover. Each is predicted by
    /// interpolation.
    pub predicted: usize,
    /// Median error of these samples. None if `predicted` is 0.
    pub median: Option<f64>,
    /// Largest error of these samples. None if `predicted` is 0.
    pub max: Option<f64>,
    /// Number of samples at the border, which can only be extrapolated from the others.
    /// `predicted`, `median` and `max` do not include them.
    pub extrapolated: usize,
    /// Number of samples that cannot be predicted from the others.
    pub unpredictable: usize,
    /// Every sample's error. None where there is no prediction.
    pub errors: Vec<Option<f64>>,
}

impl Fit {
    /// Measures the leave-one-out errors and collects all errors of the fit.
    ///
    /// # Errors
    /// [`ErrorKind::Fit`](crate::ErrorKind::Fit) when the interpolation does not suit the samples.
    pub fn report(&self) -> Result<FitReport, PsfieldError> {
        let record = &self.record;
        let left_out = self.leave_one_out()?;
        let spectrum = self.spectrum.as_ref();
        let states = record.coefficients().positions().states();
        Ok(FitReport {
            samples: self.norms.len(),
            depends_on: states.map(|states| states.kind().to_string()),
            states: states.map_or_else(Vec::new, |states| states.values().to_vec()),
            rank: record.basis().rank(),
            elbow: spectrum.map(|s| s.elbow),
            noise_sigma: spectrum.and_then(|s| s.noise_sigma),
            interpolation: record.interpolation(),
            interpolation_reason: self.reason.clone(),
            outside: record.outside(),
            normalise: record.normalisation(),
            max_error: self.max_error(),
            rms_error: self.rms_error(),
            errors: self.errors.clone(),
            circle_error: record.circle_error(),
            warnings: self.warnings_of(&left_out),
            leave_one_out: left_out,
            expected_error: self.expected_error.map(|error| error / self.mean_norm()),
            wings: self.wings.clone(),
            singular_values: self.singular_values().to_vec(),
            cumulative_weights: spectrum.map(|s| s.cumulative_weights.clone()).unwrap_or_default(),
        })
    }

    /// A sentence for a fit that chose nearly all components by itself and found no noise: then the model
    /// probably contains the noise of the samples.
    fn warning_of_all_components(&self) -> Option<String> {
        let spectrum = self.spectrum.as_ref()?;
        let (rank, samples) = (self.record.basis().rank(), self.norms.len());
        let chosen = self.noise_is_guessed && spectrum.noise_sigma.is_none();
        let all = samples >= MANY_SAMPLES && rank as f64 >= NEARLY_ALL * (samples - 1) as f64;
        (chosen && all).then(|| {
            format!(
                "the fit keeps {rank} components for {samples} samples and found no noise edge, so the model probably holds the \
                 noise of the samples as well: state their noise, or choose the rank elbow"
            )
        })
    }

    /// A sentence for samples that cannot be predicted from their neighbours.
    fn warning_of_interpolation(&self, left_out: &LeaveOneOutReport) -> Option<String> {
        let median = left_out.median.filter(|&median| median > GUESSED)?;
        let noisy = self.spectrum.as_ref().is_some_and(|s| s.noise_sigma.is_some());
        let explained = noisy && median <= EXPLAINED_BY_NOISE * self.rms_error();
        (!explained).then(|| {
            format!(
                "the samples do not determine the PSF between them: a sample that is predicted from the others has an error of \
                 {:.0} % (median, relative L2): more samples, or cleaner ones, are needed",
                100.0 * median
            )
        })
    }

    /// The sentences of [`FitReport::warnings`].
    pub(crate) fn warnings(&self) -> Result<Vec<String>, PsfieldError> {
        Ok(self.warnings_of(&self.leave_one_out()?))
    }

    fn warnings_of(&self, left_out: &LeaveOneOutReport) -> Vec<String> {
        let of_interpolation = self.warning_of_interpolation(left_out);
        of_interpolation
            .into_iter()
            .chain(self.warning_of_all_components())
            .collect()
    }

    /// Predicts every sample from all others.
    pub(super) fn leave_one_out(&self) -> Result<LeaveOneOutReport, PsfieldError> {
        if let Some(left_out) = &self.left_out {
            return Ok(left_out.clone());
        }
        let record = &self.record;
        let interpolation = coeff_field::interpolation(record.interpolation())?;
        let left_out =
            coeff_field::leave_one_out(record.coefficients(), interpolation.as_ref(), record.outside())?;
        Ok(LeaveOneOutReport::new(
            left_out.outcomes(),
            &self.norms,
            &self.errors,
        ))
    }

    /// The root mean square of the samples' norms.
    fn mean_norm(&self) -> f64 {
        (self.norms.iter().map(|n| n * n).sum::<f64>() / self.norms.len() as f64).sqrt()
    }

    /// The root mean square of the truncation errors.
    fn rms_error(&self) -> f64 {
        (self.errors.iter().map(|e| e * e).sum::<f64>() / self.errors.len() as f64).sqrt()
    }
}

impl LeaveOneOutReport {
    /// Computes the relative error of every predicted sample, and summarises these errors.
    ///
    /// The part of a sample that the basis leaves out is orthogonal to the basis. The relative
    /// truncation error and the error of the predicted coefficients therefore add in quadrature.
    pub(super) fn new(outcomes: &[LeftOut], norms: &[f64], truncation: &[f64]) -> Self {
        let (mut predicted, mut errors) = (Vec::new(), Vec::with_capacity(outcomes.len()));
        let (mut extrapolated, mut unpredictable) = (0, 0);
        for ((outcome, norm), truncation) in outcomes.iter().zip(norms).zip(truncation) {
            let relative = |error: &f64| (error / norm).hypot(*truncation);
            errors.push(match outcome {
                LeftOut::Predicted { error } => {
                    predicted.push(relative(error));
                    Some(relative(error))
                }
                LeftOut::Extrapolated { error } => {
                    extrapolated += 1;
                    Some(relative(error))
                }
                _ => {
                    unpredictable += 1;
                    None
                }
            });
        }
        let summary = Summary::of(predicted.iter().copied()).ok();
        Self {
            folds: None,
            predicted: predicted.len(),
            median: summary.as_ref().map(Summary::median),
            max: summary.as_ref().map(Summary::max),
            extrapolated,
            unpredictable,
            errors,
        }
    }
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;
    use psf_basis::PixelNoise;
    use psf_types::{Position, PsfSamples, SamplePositions, StampGrid};

    use super::*;
    use crate::fit::{FitOptions, fit};

    /// Samples of noise, and of noise on one PSF whose width varies smoothly.
    #[test]
    fn samples_that_do_not_determine_the_model_are_told() {
        let random = |j: usize, u: usize| ((j * 7919 + u * 104_729) as f64 * 12.9898).sin() * 43_758.547;
        let report = |psf: f64, noise: f64| {
            let stamps = Array3::from_shape_fn((81, 9, 9), |(j, y, x)| {
                let square = (x as f64 - 4.0).powi(2) + (y as f64 - 4.0).powi(2);
                let width = 2.0 + 0.1 * (j % 9) as f64;
                psf * (-square / width).exp() + noise * (random(j, 9 * y + x).rem_euclid(1.0) - 0.5)
            });
            let at = (0..81)
                .map(|j| Position::of_pixel(j % 9 * 10, j / 9 * 10))
                .collect();
            let positions = SamplePositions::new(at, None).unwrap();
            let samples = PsfSamples::new(stamps, positions, StampGrid::new(9, 9).unwrap()).unwrap();
            let options = FitOptions {
                normalisation: Normalisation::Keep,
                ..FitOptions::default()
            };
            fit(samples, &options).unwrap().report().unwrap().warnings
        };
        assert_eq!(report(1.0, 1e-3), Vec::<String>::new());
        // Noise is told from a PSF, so an error by noise alone is no reason to warn.
        assert_eq!(report(1.0, 0.3), Vec::<String>::new());
        // Each sample is something else, with light on one pixel.
        let positions = (0..81)
            .map(|j| Position::of_pixel(j % 9 * 10, j / 9 * 10))
            .collect();
        let stamps = Array3::from_shape_fn((81, 9, 9), |(j, y, x)| {
            f64::from(u8::from(9 * y + x == j)) * 1.3f64.powi(j as i32)
        });
        let positions = SamplePositions::new(positions, None).unwrap();
        let samples = PsfSamples::new(stamps, positions, StampGrid::new(9, 9).unwrap()).unwrap();
        let warnings = |noise| {
            let options = FitOptions {
                normalisation: Normalisation::Keep,
                noise,
                ..FitOptions::default()
            };
            let fitted = fit(samples.clone(), &options).unwrap();
            fitted.report().unwrap().warnings
        };
        // A noise that is stated is known.
        assert_eq!(warnings(PixelNoise::Known(0.0)).len(), 1);
        let warnings = warnings(PixelNoise::Estimate);
        assert!(
            warnings.len() == 2 && warnings[0].contains("do not determine"),
            "{warnings:?}"
        );
        assert!(
            warnings[1].contains("80 components for 81 samples"),
            "{warnings:?}"
        );
    }
}
