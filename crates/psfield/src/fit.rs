//! Fits a model to PSF samples. The model gives the PSF at every position.

mod comparison;
mod models;
mod report;
mod split;
mod tables;

use std::path::Path;

use coeff_field::{Choice, FieldInterpolation};
use conv_core::StampInterpolator;
use ndarray::{Array3, ArrayView2, Axis, s};
use psf_basis::{BasisFit, BasisMethod, Centring, PixelNoise, RankSelection, Spectrum, Svd, WeightedPca};
use psf_io::Card;
use psf_sample::ShiftAugmentation;
use psf_types::{
    Interpolation, Normalisation, OutsidePolicy, PsfBasis, PsfModel, PsfModelRecord, PsfSamples,
    SampleCoefficients, SamplePositions, StampGrid,
};
use rayon::prelude::*;

use crate::error::{ErrorKind, PsfieldError};
use crate::stack_size::check_stack;

pub use comparison::{InterpolationErrors, compare_interpolations};
pub use models::model_of;
pub(crate) use models::{field_of, models_of, models_on};
pub use report::{FitReport, LeaveOneOutReport};
use split::Split;
pub use split::WingsReport;
pub(crate) use split::{Window, joined, radius, splits};
pub use tables::OwnInterpolation;
pub(crate) use tables::{table_of, tabulated};

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
            interpolation: match coeff_field::local_method(positions) {
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
    /// Whether the rank and the noise both come from the samples.
    noise_is_guessed: bool,
    /// The reason for the interpolation.
    reason: String,
    /// Leave-one-out errors that the model's coefficients do not tell: those of samples whose noise was
    /// removed, or of an interpolation of the caller's own.
    left_out: Option<LeaveOneOutReport>,
    /// The error that kriging expects between the samples: L2 of the PSF, r.m.s. over the field.
    expected_error: Option<f64>,
    /// The wings that were split from the samples.
    wings: Option<WingsReport>,
}

/// Fits a model to samples. Computes the basis by SVD, and interpolates the coefficients by a
/// method of `coeff-field`.
///
/// Samples of several states, such as wavelengths or frames, get one basis. Large stamps are divided into a core
/// and wings, if at most 4 stamps represent the wings of all samples ([`FitReport::wings`]). The
/// errors of the fit are then those of the core.
///
/// # Errors
/// [`ErrorKind::Fit`] when the basis cannot be computed, for example because
/// the samples do not have the requested rank. [`ErrorKind::TooLarge`]
/// if the shifted copies would fill too much memory. An interpolation that does not suit the positions is
/// an error of [`Fit::into_model`] and [`Fit::report`], not of the fit.
pub fn fit(samples: PsfSamples, options: &FitOptions) -> Result<Fit, PsfieldError> {
    if !splits(samples.grid()) {
        return fit_undivided(samples, options);
    }
    let samples = normalised(samples, options.normalisation);
    let Some(Split { core, wings, report }) = split::split(&samples)? else {
        return fit_undivided(samples, options);
    };
    let fluxes: Vec<f64> = (0..samples.len()).map(|sample| samples.flux(sample)).collect();
    let normalisation = Normalisation::Keep;
    let of_core = fit_undivided(
        core,
        &FitOptions {
            normalisation,
            ..*options
        },
    )?;
    Ok(Fit {
        record: split::joined(&of_core.record, wings, fluxes.into_iter())?,
        wings: Some(report),
        ..of_core
    })
}

/// Fits a model to samples without dividing large stamps.
pub(crate) fn fit_undivided(samples: PsfSamples, options: &FitOptions) -> Result<Fit, PsfieldError> {
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
/// [`ErrorKind::Data`] for samples whose stamps have other pixels than the
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
    let samples = normalised(samples, options.normalisation);
    let norms = norms_of(&samples);
    let fit = psf_basis::project(&samples, basis.clone())?;
    Fit::of_parts(fit, norms, options)
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
/// The errors of [`fit()`], and [`ErrorKind::Fit`] for training stamps that
/// differ in shape from the samples.
pub fn fit_trained(
    samples: PsfSamples,
    training: Array3<f64>,
    options: &FitOptions,
) -> Result<Fit, PsfieldError> {
    let (fit, norms) = fit_basis(samples, training, options)?;
    Fit::of_parts(fit, norms, options)
}

/// Computes the basis of samples, and the norms of the samples.
fn fit_basis(
    samples: PsfSamples,
    mut training: Array3<f64>,
    options: &FitOptions,
) -> Result<(BasisFit, Vec<f64>), PsfieldError> {
    let samples = normalised(samples, options.normalisation);
    let norms = norms_of(&samples);
    if options.normalisation != Normalisation::Keep {
        for mut stamp in training.outer_iter_mut() {
            let flux = samples.grid().flux_of_sum(stamp.sum());
            stamp.mapv_inplace(|v| v / flux);
        }
    }
    let smaller_error = |coefficients: &SampleCoefficients| {
        let median = interpolation_error(coefficients, &norms, options);
        let error = median.map_or(RankSelection::AUTO_ERROR, |median| BELOW_INTERPOLATION * median);
        error.max(SMALLEST_AUTO_ERROR)
    };
    let fit = svd_of(options).fit_for_field(samples, training.view(), &smaller_error)?;
    Ok((fit, norms))
}

/// The basis method that the options describe.
fn svd_of(options: &FitOptions) -> Svd {
    Svd::new()
        .with_rank(options.rank)
        .with_centring(options.centring)
        .with_noise(options.noise)
}

/// With the rank `auto`, the truncation error is at most this fraction of the interpolation error.
const BELOW_INTERPOLATION: f64 = 0.25;
/// It need not be smaller than this, which is the rounding of samples in single precision.
const SMALLEST_AUTO_ERROR: f64 = 1e-8;

/// The median leave-one-out error of samples with these norms, relative. None if no sample can be
/// predicted.
fn interpolation_error(
    coefficients: &SampleCoefficients,
    norms: &[f64],
    options: &FitOptions,
) -> Option<f64> {
    let choice = coeff_field::choose(options.interpolation, coefficients, None, options.outside).ok()?;
    let method = coeff_field::interpolation(choice.interpolation).ok()?;
    let left_out = coeff_field::leave_one_out(coefficients, method.as_ref(), options.outside).ok()?;
    let errors = left_out.predicted().map(|(sample, error)| error / norms[sample]);
    metrics::Summary::of(errors).ok().map(|summary| summary.median())
}

/// Fits a model with any basis method, which the caller may implement. The rank, the centring, the noise and
/// the shifted copies of `options` do not apply.
///
/// # Errors
/// [`PsfieldError`] when the basis method fails.
pub fn fit_by(
    samples: PsfSamples,
    method: &dyn BasisMethod,
    options: &FitOptions,
) -> Result<Fit, PsfieldError> {
    let samples = normalised(samples, options.normalisation);
    let norms = norms_of(&samples);
    Fit::of_parts(method.fit(&samples)?, norms, options)
}

/// Fits a model to samples with bad pixels, or of very different noise. `weights` `[sample, y, x]` are
/// inverse variances of the samples' pixels, as the samples are given, and 0 for bad pixels. The basis is
/// that of [`WeightedPca`]. Kriging uses the noise that the weights state. The shifted copies of `options` do
/// not apply.
///
/// If PSFs are scaled to unit flux, bad pixels count with the value that the mean of the samples has there.
///
/// # Errors
/// The errors of [`WeightedPca`] and of [`fit()`].
pub fn fit_weighted(
    samples: PsfSamples,
    weights: Array3<f64>,
    options: &FitOptions,
) -> Result<Fit, PsfieldError> {
    let method = WeightedPca::new(weights)?.with_svd(svd_of(options));
    let filled = method.filled(&samples)?;
    if options.normalisation == Normalisation::Keep {
        return fit_by(filled, &method, options);
    }
    let flux = |stamp: ArrayView2<'_, f64>| filled.grid().flux_of_sum(stamp.sum());
    let fluxes: Vec<f64> = filled.stamps().outer_iter().map(flux).collect();
    fit_by(filled, &method.for_divided(&fluxes), options)
}

/// Fits a model with any basis method and any interpolation. The caller may implement both.
///
/// [`Psf::from`](crate::Psf) takes the model. If its field is the caller's own, a table of the field is made
/// where one is needed: for files, and for other stamps or pixels ([`Psf::record`](crate::Psf::record)).
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
    let field = interpolation.interpolate(fit.coefficients(), outside)?;
    let model = PsfModel::new(fit.basis(), field, normalisation, field_shape)?;
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
    fn of_parts(fit: BasisFit, norms: Vec<f64>, options: &FitOptions) -> Result<Self, PsfieldError> {
        let (spectrum, errors) = (fit.spectrum().cloned(), fit.errors().to_vec());
        let circle_error = fit.circle_errors().iter().copied().fold(0.0, f64::max);
        let noise = fit.noise().map(<[f64]>::to_vec);
        let (basis, coefficients) = fit.into_parts();
        // An interpolation that does not suit the positions is an error of the model, not of the fit.
        let choice = coeff_field::choose(
            options.interpolation,
            &coefficients,
            noise.as_deref(),
            options.outside,
        );
        let choice = choice.unwrap_or_else(|_| Choice::named(options.interpolation));
        let (coefficients, left_out) = match choice.smoothed {
            Some(smoothed) => {
                let report = LeaveOneOutReport::new(smoothed.left_out.outcomes(), &norms, &errors);
                (smoothed.samples, Some(report))
            }
            None => (coefficients, None),
        };
        let record = PsfModelRecord::new(
            basis,
            coefficients,
            choice.interpolation,
            options.outside,
            options.normalisation,
        )?
        .with_circle_error(Some(circle_error));
        Ok(Self {
            record,
            spectrum,
            errors,
            norms,
            noise_is_guessed: options.rank == RankSelection::Auto && options.noise == PixelNoise::Estimate,
            reason: choice.reason,
            left_out,
            expected_error: choice.expected_error,
            wings: None,
        })
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
    /// [`ErrorKind::Data`] for rank 0 of a basis without mean. The cause is
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
            noise_is_guessed: false,
            ..self.clone()
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
}

#[cfg(test)]
mod tests {
    use psf_basis::RankSelection;
    use psf_types::{Position, SamplePositions, StampGrid};

    use super::*;

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
