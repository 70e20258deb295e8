//! Fits a model to PSF samples. The model gives the PSF at every position.

mod models;

use std::path::Path;
use std::sync::Arc;

use coeff_field::{FieldInterpolation, InterpolatedField, LeftOut};
use conv_core::StampInterpolator;
use metrics::Summary;
use ndarray::{Array3, ArrayView2, Axis, s};
use psf_basis::{BasisFit, BasisMethod, Centring, PixelNoise, RankSelection, Spectrum, Svd};
use psf_io::Card;
use psf_sample::ShiftAugmentation;
use psf_types::{
    Interpolation, Normalisation, OutsidePolicy, PsfBasis, PsfModel, PsfModelRecord, PsfSamples,
    SamplePositions, StampGrid,
};
use rayon::prelude::*;
use serde::Serialize;

use crate::stack_size::check_stack;
use crate::{ErrorKind, PsfieldError};

pub use models::model_of;
pub(crate) use models::{models_of, models_on};

/// Options for fitting a model to samples. The command line has the same defaults: rank `auto`,
/// mean-centred, interpolation `auto`, nearest outside, unit flux.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FitOptions {
    /// Number of components to keep.
    pub rank: RankSelection,
    /// The choice whether to subtract the mean stamp first.
    pub centring: Centring,
    /// The noise in the samples' pixels: estimated, or known. A known noise is in units of the
    /// samples after normalisation.
    pub noise: PixelNoise,
    /// The interpolation of the coefficients over the field.
    pub interpolation: Interpolation,
    /// The policy for positions outside the area of the samples.
    pub outside: OutsidePolicy,
    /// The scaling of samples and PSFs: to unit flux, or none.
    pub normalisation: Normalisation,
    /// The number of copies of each sample, shifted by up to half a pixel, from which the basis is
    /// computed in addition to the samples. Such a basis also represents stars between pixels.
    pub shift_copies: usize,
}

impl FitOptions {
    /// Options for a library of PSFs on a grid of positions (STPSF, STDPSF, photutils'
    /// `GriddedPSFModel`). Every component is kept. PSFs keep the flux that they have in the
    /// library. If the positions form a regular grid, PSFs are interpolated bilinearly between
    /// them, as in other software.
    pub fn of_gridded_library(positions: &SamplePositions) -> Self {
        Self {
            // The fit must reproduce the few planes of the library.
            rank: RankSelection::Full,
            // The flux of a PSF is part of the library's calibration.
            normalisation: Normalisation::Keep,
            interpolation: match coeff_field::resolve(Interpolation::Auto, positions) {
                Interpolation::Bicubic => Interpolation::Bilinear,
                other => other,
            },
            ..Self::default()
        }
    }

    /// Options for one stamp that is the PSF of the whole field, or for one in each state. There are no
    /// others for an interpolation over the field.
    pub fn of_single_stamp() -> Self {
        Self {
            interpolation: Interpolation::Nearest,
            ..Self::default()
        }
    }
}

/// A model that was fitted to samples, and the errors of the fit.
#[derive(Debug, Clone)]
pub struct Fit {
    record: PsfModelRecord,
    spectrum: Option<Spectrum>,
    errors: Vec<f64>,
    norms: Vec<f64>,
    selection: RankSelection,
}

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
    /// Number of components kept, without the mean.
    pub rank: usize,
    /// Number of components at the elbow of the cumulative weights ([`psf_basis`] defines it).
    pub elbow: Option<usize>,
    /// Standard deviation of the white noise in the samples' pixels, estimated or known
    /// ([`FitOptions::noise`]). None if there is no noise.
    pub noise_sigma: Option<f64>,
    /// The interpolation that the model uses.
    pub interpolation: Interpolation,
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
    /// total flux ([`BasisFit::circle_errors`]). None for a fit that was truncated later.
    pub circle_error: Option<f64>,
    /// Errors of predicting each sample from all others.
    pub leave_one_out: LeaveOneOutReport,
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
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct LeaveOneOutReport {
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

/// Fits a model to samples. Computes the basis by SVD, and interpolates the coefficients by a
/// method of `coeff-field`.
///
/// Samples of several states, such as wavelengths or frames, get one basis.
///
/// # Errors
/// [`ErrorKind::Fit`](crate::ErrorKind::Fit) when the basis cannot be computed, for example because
/// the samples do not have the requested rank. [`ErrorKind::TooLarge`](crate::ErrorKind::TooLarge)
/// if the shifted copies would fill too much memory. An interpolation that does not suit the positions is
/// an error of [`Fit::into_model`] and [`Fit::report`], not of the fit.
pub fn fit(samples: PsfSamples, options: &FitOptions) -> Result<Fit, PsfieldError> {
    let copies = shifted_copies(&samples, options.shift_copies)?;
    fit_trained(samples, copies, options)
}

/// Copies of every sample, shifted by up to half a frame pixel along each axis, `[stamp, y, x]`. The
/// shifts are pseudo-random, and always the same.
fn shifted_copies(samples: &PsfSamples, copies: usize) -> Result<Array3<f64>, PsfieldError> {
    const LARGEST_SHIFT: f64 = 0.5;
    const SEED: u64 = 0;
    let grid = samples.grid();
    let count = samples.len().saturating_mul(copies);
    check_stack(count, grid)?;
    let mut stamps = Array3::zeros((count, grid.ny(), grid.nx()));
    if copies == 0 {
        return Ok(stamps);
    }
    let augmentation = ShiftAugmentation::new(copies, LARGEST_SHIFT, SEED)?;
    let blocks: Vec<_> = stamps.axis_chunks_iter_mut(Axis(0), copies).collect();
    blocks
        .into_par_iter()
        .enumerate()
        .for_each(|(sample, mut block)| {
            let between = StampInterpolator::new(samples.stamp(sample), grid);
            for (mut stamp, shift) in block.outer_iter_mut().zip(augmentation.shifts(sample)) {
                stamp.assign(&between.resample(shift, grid));
            }
        });
    Ok(stamps)
}

/// Finds the coefficients of samples in a given basis, `a_jk = <h_j - B_0, B_k>`, which is the
/// least-squares solution. The rank, the centring, the noise and the shifted copies of `options` do
/// not apply.
///
/// # Errors
/// [`ErrorKind::Data`](crate::ErrorKind::Data) for samples whose stamps have other pixels than the
/// basis.
pub fn fit_in_basis(
    samples: PsfSamples,
    basis: &PsfBasis,
    options: &FitOptions,
) -> Result<Fit, PsfieldError> {
    let (own, of_basis) = (samples.grid(), basis.grid());
    if own != of_basis {
        let describe = |grid: StampGrid| {
            format!(
                "{} x {} pixels, oversampling {}, centre ({}, {}), {} the pixel response",
                grid.nx(),
                grid.ny(),
                grid.oversampling(),
                grid.centre_x(),
                grid.centre_y(),
                if grid.pixel_response_included() {
                    "with"
                } else {
                    "without"
                }
            )
        };
        let message = format!(
            "the samples have stamps of {}, but the basis has stamps of {}: sample the PSF as for the basis",
            describe(own),
            describe(of_basis)
        );
        return Err(PsfieldError::new(ErrorKind::Data, message));
    }
    let interpolation = coeff_field::resolve(options.interpolation, samples.positions());
    let samples = normalised(samples, options.normalisation);
    let norms = norms_of(&samples);
    let fit = psf_basis::project(&samples, basis.clone())?;
    Fit::of_parts(fit, norms, interpolation, options)
}

fn norms_of(samples: &PsfSamples) -> Vec<f64> {
    let stamps = samples.stamps();
    let norm = |stamp: ArrayView2<'_, f64>| stamp.iter().map(|v| v * v).sum::<f64>().sqrt();
    stamps.outer_iter().map(norm).collect()
}

/// Fits a model to samples. The basis is computed from the samples and from the stamps in
/// `training`, `[stamp, y, x]`. These may be the samples' PSFs at sub-pixel shifts
/// ([`psf_sample::ShiftAugmentation`]). Coefficients and errors are computed only for the samples.
///
/// With [`Normalisation::Unit`], the training stamps are scaled to unit flux, like the samples.
///
/// # Errors
/// The errors of [`fit()`], and [`ErrorKind::Fit`](crate::ErrorKind::Fit) for training stamps that
/// differ in shape from the samples.
pub fn fit_trained(
    samples: PsfSamples,
    mut training: Array3<f64>,
    options: &FitOptions,
) -> Result<Fit, PsfieldError> {
    let interpolation = coeff_field::resolve(options.interpolation, samples.positions());
    let method = Svd::new()
        .with_rank(options.rank)
        .with_centring(options.centring)
        .with_noise(options.noise);
    let samples = normalised(samples, options.normalisation);
    let norms = norms_of(&samples);
    if options.normalisation != Normalisation::Keep {
        for mut stamp in training.outer_iter_mut() {
            let flux = samples.grid().flux_of_sum(stamp.sum());
            stamp.mapv_inplace(|v| v / flux);
        }
    }
    let fit = method.fit_augmented(samples, training.view())?;
    Fit::of_parts(fit, norms, interpolation, options)
}

/// Fits a model with any basis method and any interpolation. The caller may implement both.
///
/// # Errors
/// [`PsfieldError`] when the basis method or the interpolation fails.
pub fn fit_with(
    samples: PsfSamples,
    method: &dyn BasisMethod,
    interpolation: &dyn FieldInterpolation,
    outside: OutsidePolicy,
    normalisation: Normalisation,
) -> Result<(PsfModel, BasisFit), PsfieldError> {
    let field_shape = samples.positions().field();
    let fit = method.fit(&normalised(samples, normalisation))?;
    let field = InterpolatedField::new(fit.coefficients(), interpolation, outside)?;
    let model = PsfModel::new(fit.basis(), Arc::new(field), normalisation, field_shape)?;
    Ok((model, fit))
}

fn normalised(samples: PsfSamples, normalisation: Normalisation) -> PsfSamples {
    match normalisation {
        Normalisation::Keep => samples,
        _ => samples.into_unit_flux(),
    }
}

impl Fit {
    /// A fit of samples with these norms.
    fn of_parts(
        fit: BasisFit,
        norms: Vec<f64>,
        interpolation: Interpolation,
        options: &FitOptions,
    ) -> Result<Self, PsfieldError> {
        let (spectrum, errors) = (fit.spectrum().cloned(), fit.errors().to_vec());
        let circle_error = fit.circle_errors().iter().copied().fold(0.0, f64::max);
        let (basis, coefficients) = fit.into_parts();
        let record = PsfModelRecord::new(
            basis,
            coefficients,
            interpolation,
            options.outside,
            options.normalisation,
        )?
        .with_circle_error(Some(circle_error));
        Ok(Self {
            record,
            spectrum,
            errors,
            norms,
            selection: options.rank,
        })
    }

    /// A sentence for a fit that chose nearly all components by itself and found no noise: then the model
    /// probably contains the noise of the samples.
    fn warning_of_all_components(&self) -> Option<String> {
        let spectrum = self.spectrum.as_ref()?;
        let (rank, samples) = (self.record.basis().rank(), self.norms.len());
        let chosen = self.selection == RankSelection::Auto && spectrum.noise_sigma.is_none();
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
    fn leave_one_out(&self) -> Result<LeaveOneOutReport, PsfieldError> {
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

    /// The root mean square of the truncation errors.
    fn rms_error(&self) -> f64 {
        (self.errors.iter().map(|e| e * e).sum::<f64>() / self.errors.len() as f64).sqrt()
    }

    /// The record that a model file stores.
    pub fn record(&self) -> &PsfModelRecord {
        &self.record
    }

    /// Returns the record without a copy.
    pub fn into_record(self) -> PsfModelRecord {
        self.record
    }

    /// The singular values that were computed, in descending order ([`psf_basis::Spectrum`]).
    pub fn singular_values(&self) -> &[f64] {
        self.spectrum.as_ref().map_or(&[], |s| &s.singular_values)
    }

    /// Writes the model to a file, with `cards` added to its header.
    ///
    /// # Errors
    /// [`ErrorKind::Io`] if the file cannot be written, or if it exists and `overwrite` is false.
    pub fn write(&self, path: impl AsRef<Path>, cards: &[Card], overwrite: bool) -> Result<(), PsfieldError> {
        let values = self.singular_values();
        Ok(psf_io::write_model(path, &self.record, values, cards, overwrite)?)
    }

    /// Truncates the fit to its first `rank` components, or keeps all if there are fewer. The error
    /// of each sample grows by the part that the removed components represented.
    ///
    /// # Errors
    /// [`ErrorKind::Data`](crate::ErrorKind::Data) for rank 0 of a basis without mean. The cause is
    /// [`DataError::EmptyBasis`](psf_types::DataError::EmptyBasis).
    pub fn truncated(&self, rank: usize) -> Result<Self, PsfieldError> {
        let record = self.record.truncated(rank)?;
        let values = self.record.coefficients().values();
        let left_out = values.slice_move(s![.., record.basis().rank()..]);
        let tails = left_out.outer_iter().map(|tail| tail.dot(&tail).sqrt());
        let errors = tails.zip(&self.norms).zip(&self.errors);
        Ok(Self {
            // Components are orthonormal, so errors add in quadrature.
            errors: errors
                .map(|((tail, norm), error)| error.hypot(tail / norm))
                .collect(),
            record,
            spectrum: self.spectrum.clone(),
            norms: self.norms.clone(),
            selection: RankSelection::Fixed(rank),
        })
    }

    /// The largest truncation error over the samples.
    pub fn max_error(&self) -> f64 {
        self.errors.iter().copied().fold(0.0, f64::max)
    }

    /// The model.
    ///
    /// # Errors
    /// The errors of [`model_of`].
    pub fn into_model(self) -> Result<PsfModel, PsfieldError> {
        model_of(self.record)
    }

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
            samples: record.coefficients().positions().len(),
            depends_on: states.map(|states| states.kind().to_string()),
            states: states.map_or_else(Vec::new, |states| states.values().to_vec()),
            rank: record.basis().rank(),
            elbow: spectrum.map(|s| s.elbow),
            noise_sigma: spectrum.and_then(|s| s.noise_sigma),
            interpolation: record.interpolation(),
            outside: record.outside(),
            normalise: record.normalisation(),
            max_error: self.max_error(),
            rms_error: self.rms_error(),
            errors: self.errors.clone(),
            circle_error: record.circle_error(),
            warnings: self.warnings_of(&left_out),
            leave_one_out: left_out,
            singular_values: self.singular_values().to_vec(),
            cumulative_weights: spectrum.map(|s| s.cumulative_weights.clone()).unwrap_or_default(),
        })
    }
}

impl LeaveOneOutReport {
    /// Computes the relative error of every predicted sample, and summarises these errors.
    ///
    /// The part of a sample that the basis leaves out is orthogonal to the basis. The relative
    /// truncation error and the error of the predicted coefficients therefore add in quadrature.
    fn new(outcomes: &[LeftOut], norms: &[f64], truncation: &[f64]) -> Self {
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
    use psf_basis::RankSelection;
    use psf_types::{Position, SamplePositions, StampGrid};

    use super::*;

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
            f64::from(u8::from(9 * y + x == j)) * 1.05f64.powi(j as i32)
        });
        let positions = SamplePositions::new(positions, None).unwrap();
        let samples = PsfSamples::new(stamps, positions, StampGrid::new(9, 9).unwrap()).unwrap();
        let options = FitOptions {
            normalisation: Normalisation::Keep,
            noise: PixelNoise::Known(0.0),
            ..FitOptions::default()
        };
        let warnings = fit(samples, &options).unwrap().report().unwrap().warnings;
        assert!(
            warnings.len() == 2 && warnings[0].contains("do not determine"),
            "{warnings:?}"
        );
        assert!(
            warnings[1].contains("80 components for 81 samples"),
            "{warnings:?}"
        );
    }

    #[test]
    fn the_first_components_of_a_fit_are_the_fit_of_that_rank() {
        // Gaussians that widen to the right and move upwards.
        let stamps = Array3::from_shape_fn((9, 9, 9), |(j, y, x)| {
            let (dx, dy) = (x as f64 - 4.0, y as f64 - 4.0 - 0.1 * (j / 3) as f64);
            (-(dx * dx + dy * dy) / (2.0 + (j % 3) as f64)).exp()
        });
        let positions = (0..9)
            .map(|j| Position::of_pixel(j % 3 * 10, j / 3 * 10))
            .collect();
        let positions = SamplePositions::new(positions, None).unwrap();
        let samples = PsfSamples::new(stamps, positions, StampGrid::new(9, 9).unwrap()).unwrap();
        let of_rank = |rank| {
            let options = FitOptions {
                rank,
                ..FitOptions::default()
            };
            fit(samples.clone(), &options).unwrap()
        };
        let (cut, direct) = (
            of_rank(RankSelection::Full).truncated(2).unwrap(),
            of_rank(RankSelection::Fixed(2)),
        );
        assert_eq!(cut.record().basis().rank(), 2);
        assert!(direct.max_error() > 1e-4);
        for (a, b) in cut.errors.iter().zip(&direct.errors) {
            // Rounding of sums over 81 pixels.
            assert!((a - b).abs() < 1e-13, "{a:e} {b:e}");
        }
    }
}
