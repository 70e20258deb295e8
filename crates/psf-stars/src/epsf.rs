//! One oversampled PSF over the field, fitted to the pixels of all stars together.

use nalgebra::{Matrix3, Vector3};
use ndarray::Array2;
use psf_types::FrameShape;
use psf_types::maths::term_count;
use rayon::prelude::*;

use crate::Camera;
use crate::background::median;
use crate::epsf_prior::{ACCURACY, Prior, pixel_variance};
use crate::epsf_solver::{combined, solve};
use crate::frame::{Star, StarPixel};
use crate::registration::FineGrid;
use crate::selection::FieldTerms;
use crate::surface::{Place, SurfaceGrid};

/// An oversampled PSF and the stars to which it was fitted. The PSF at the offset `u` from a star
/// at the position `x` is `E(u; x) = sum_j P_j(x) E_j(u)`, where `P_j` are polynomials over the
/// field.
#[derive(Debug)]
pub(crate) struct Epsf {
    /// The stars that agree with the PSF.
    pub(crate) stars: Vec<Star>,
    /// Indices of the sources whose stars do not agree with the PSF.
    pub(crate) mismatched: Vec<usize>,
    pub(crate) median_chi: f64,
    /// The errors with which stars were predicted that had no part in the fit, if the fit chose its
    /// degree.
    pub(crate) left_out: Option<LeftOut>,
    psf: FieldPsf,
    /// The width of the expected PSF in nodes, for well-sampled stars.
    width_nodes: Option<f64>,
}

/// The prediction of stars by PSFs to which they did not contribute.
#[derive(Debug)]
pub(crate) struct LeftOut {
    stars: Vec<Star>,
    /// The error of each star ([`prediction_error`]).
    errors: Vec<f64>,
    surface: SurfaceGrid,
    peak: f64,
}

impl LeftOut {
    /// Returns whether other PSFs predict the stars better: `psf_of` a star, as a function of the
    /// offset from it along x and y.
    pub(crate) fn is_worse_than<P: Fn(f64, f64) -> f64>(&self, psf_of: impl Fn(&Star) -> P + Sync) -> bool {
        let errors = self.stars.par_iter().map(|star| {
            let psf = psf_of(star);
            prediction_error(star, self.surface, self.peak, |pixel, _| {
                psf(pixel.x - star.x, pixel.y - star.y)
            })
        });
        is_smaller(&errors.collect::<Vec<_>>(), &self.errors)
    }
}

/// The planes `E_j` of an oversampled PSF, as spline coefficients, and the terms `P_j` that
/// multiply them.
#[derive(Debug)]
struct FieldPsf {
    terms: FieldTerms,
    planes: Vec<Vec<f64>>,
    surface: SurfaceGrid,
    camera: Camera,
}

/// Number of rounds. Each fits the stars' positions and fluxes, and then the PSF.
const ROUNDS: usize = 6;
/// After this number of rounds the degree of the polynomial over the field is chosen. From then on
/// mismatched stars are excluded.
const ROUNDS_BEFORE_REJECTION: usize = 2;
const HIGHEST_DEGREE: usize = 4;
/// Stars that each term of the polynomial needs.
const STARS_PER_TERM: usize = 5;
/// To choose the degree, stars are divided into this number of groups. Each group is predicted from
/// a fit to the other groups.
const FOLDS: usize = 5;
/// At most this number of stars, evenly spread over the brightness, serve to choose the degree.
const STARS_FOR_DEGREE: usize = 500;
/// If this number of degrees in a row predict no better than a lower one, higher degrees are not
/// tried.
const VAIN_DEGREES: usize = 2;
/// Residuals beyond this number of sigma get a lower weight (Huber 1964).
const HUBER: f64 = 3.0;
/// A star is mismatched if its chi (root of the reduced chi squared) is above two limits. The first
/// limit is the median chi of the stars plus this number of sigma of their scatter.
const MISMATCH_SIGMA: f64 = 5.0;
/// The second limit is this multiple of the median chi.
const MISMATCH_RATIO: f64 = 3.0;
/// A star may move from the position of its Gaussian fit by at most this distance along each axis,
/// in pixels.
const SHIFT: f64 = 0.5;

impl Epsf {
    /// Fits the PSF to stars. `degree` is the degree of the polynomial over the field. If it is
    /// `None`, the fit chooses the degree that best predicts stars left out of a trial fit.
    pub(crate) fn fit(
        mut stars: Vec<Star>,
        grid: FineGrid,
        fwhm_px: f64,
        frame: FrameShape,
        camera: &Camera,
        degree: Option<usize>,
    ) -> Self {
        let surface = SurfaceGrid::new(grid);
        let gaussian = Prior::gaussian(surface, fwhm_px);
        let mut psf = FieldPsf {
            terms: FieldTerms::new(0, frame),
            planes: vec![gaussian.mean.clone()],
            surface,
            camera: *camera,
        };
        let mut mismatched = Vec::new();
        let mut left_out = None;
        for round in 0..ROUNDS {
            // Each round fits the stars' positions before the PSF. In the first round, the PSF for
            // this fit is a Gaussian.
            let chi = psf.refine(&mut stars);
            if round >= ROUNDS_BEFORE_REJECTION {
                let limit = mismatch_limit(&chi);
                let mut agree = chi.iter().map(|c| *c <= limit);
                let removed = stars.extract_if(.., |_| !agree.next().expect("one chi per star"));
                mismatched.extend(removed.map(|star| star.source));
            }
            let prior = gaussian.with_wings_of(&stars, surface, fwhm_px, camera);
            let terms = match degree {
                _ if round != ROUNDS_BEFORE_REJECTION => psf.terms,
                Some(degree) => FieldTerms::new(degree, frame),
                None => {
                    let (terms, errors) = psf.choose_degree(&stars, &prior);
                    left_out = Some(errors);
                    terms
                }
            };
            psf = psf.fitted(&stars, &prior, terms);
        }
        let chi = psf.refine(&mut stars);
        Self {
            stars,
            mismatched,
            median_chi: median(chi),
            left_out,
            psf,
            width_nodes: gaussian.width_nodes,
        }
    }

    /// Returns the PSF at a star, scaled to unit flux, and the flux of the star. Returns `None` if
    /// the flux of the unscaled PSF or of the star is not positive. With `own_shape`, the PSF of
    /// the field is first adapted to the pixels of this star.
    pub(crate) fn sample(&self, star: &Star, own_shape: bool) -> Option<(Array2<f64>, f64)> {
        let (psf, surface) = (&self.psf, self.psf.surface);
        let mut coefficients = psf.at(star);
        if own_shape {
            let constant = FieldTerms::new(0, psf.terms.frame());
            let alone = psf.fitted(
                std::slice::from_ref(star),
                &Prior::local(coefficients, self.width_nodes),
                constant,
            );
            coefficients = alone.at(star);
        }
        let flux = surface.flux(&coefficients);
        (flux > 0.0 && star.flux > 0.0).then(|| (surface.at_nodes(&coefficients) / flux, star.flux * flux))
    }

    /// The most probable flux of a star from its fit and from the `sum` of its pixels over the stamp.
    /// The fit has less noise, but errs where the PSF does.
    pub(crate) fn flux_with(&self, star: &Star, sum: f64) -> f64 {
        let coefficients = self.psf.at(star);
        let of_psf = self.psf.surface.flux(&coefficients);
        let (mut power, mut variance_of_sum) = (0.0, 0.0);
        for pixel in star.pixels.iter().filter(|p| p.trust > 0.0) {
            if let Some(place) = self.psf.surface.place(pixel.x - star.x, pixel.y - star.y) {
                let value = self.psf.surface.value(&coefficients, &place) / of_psf;
                power += value * value / pixel.rms.powi(2);
                variance_of_sum += pixel.rms.powi(2);
            }
        }
        let fitted = star.flux * of_psf;
        let variance_of_fit = power.recip() + (FLUX_ACCURACY * fitted).powi(2);
        let weights = [variance_of_fit.recip(), variance_of_sum.recip()];
        (weights[0] * fitted + weights[1] * sum) / (weights[0] + weights[1])
    }

    /// Fits the PSF to a star that was not part of its fit. Returns the star's position and flux,
    /// or `None` if the PSF does not fit the star.
    pub(crate) fn measure(&self, star: &Star) -> Option<(f64, f64, f64)> {
        let mut star = star.clone();
        let fitted = self.psf.refine_one(&mut star).is_finite();
        let (_, flux) = self.sample(&star, false).filter(|_| fitted)?;
        Some((star.x, star.y, flux))
    }

    /// The degree of the polynomial over the field.
    pub(crate) fn field_degree(&self) -> usize {
        self.psf.terms.degree
    }
}

fn mismatch_limit(chi: &[f64]) -> f64 {
    let middle = median(chi.iter().copied());
    let spread = 1.4826 * median(chi.iter().map(|c| (c - middle).abs()));
    (middle + MISMATCH_SIGMA * spread).max(MISMATCH_RATIO * middle)
}

/// The error of a fitted flux that the PSF's own error is assumed to cause, as a fraction.
const FLUX_ACCURACY: f64 = 0.05;
const STEPS: usize = 8;
/// Longest step of a star's position, in pixels.
const LONGEST: f64 = 0.2;

impl FieldPsf {
    /// The spline coefficients at a star.
    fn at(&self, star: &Star) -> Vec<f64> {
        combined(&self.planes, &self.terms.at(star.x, star.y))
    }

    /// Fits a PSF with the given terms to stars.
    fn fitted(&self, stars: &[Star], prior: &Prior, terms: FieldTerms) -> Self {
        Self {
            terms,
            planes: solve(stars, prior, self.surface, terms, &self.camera, &self.planes),
            ..*self
        }
    }

    /// Fits flux and position of every star with the current PSF. Returns the root of each star's
    /// reduced chi squared, or infinity for a star that cannot be fitted.
    ///
    /// A shift of the PSF is equivalent to an opposite shift of all stars, so the mean shift of the
    /// stars is removed.
    fn refine(&self, stars: &mut [Star]) -> Vec<f64> {
        let chi = stars.par_iter_mut().map(|star| self.refine_one(star)).collect();
        let count = stars.len() as f64;
        let mean = |of: fn(&Star) -> f64| stars.iter().map(of).sum::<f64>() / count;
        let (dx, dy) = (
            mean(|s| s.x) - mean(|s| s.start.0),
            mean(|s| s.y) - mean(|s| s.start.1),
        );
        for star in stars {
            star.x -= dx;
            star.y -= dy;
        }
        chi
    }

    fn refine_one(&self, star: &mut Star) -> f64 {
        let (surface, coefficients, start) = (self.surface, self.at(star), star.start);
        let peak = SurfaceGrid::peak(&coefficients);
        let mut chi = f64::INFINITY;
        for step in 0..=STEPS {
            let (mut normal, mut gradient) = (Matrix3::zeros(), Vector3::zeros());
            let (mut sum, mut count) = (0.0, 0.0);
            let (x, y, flux, offset) = (star.x, star.y, star.flux, star.offset);
            for pixel in &mut star.pixels {
                if pixel.trust == 0.0 {
                    continue;
                }
                let Some(place) = surface.place(pixel.x - x, pixel.y - y) else {
                    continue;
                };
                let psf = surface.value(&coefficients, &place);
                let (sx, sy) = surface.slopes(&coefficients, &place);
                let signal = flux * psf;
                let variance = pixel_variance(signal, flux * peak, pixel.rms, &self.camera);
                let residual = pixel.value - signal - offset;
                let deviation = residual.abs() / variance.sqrt();
                pixel.trust = if deviation > HUBER { HUBER / deviation } else { 1.0 };
                let w = pixel.trust / variance;
                let row = Vector3::new(psf, -flux * sx, -flux * sy);
                normal += w * row * row.transpose();
                gradient += w * residual * row;
                sum += w * residual * residual;
                count += 1.0;
            }
            chi = if count > 3.0 {
                (sum / (count - 3.0)).sqrt()
            } else {
                f64::INFINITY
            };
            if step == STEPS {
                break;
            }
            let Some(by) = normal.cholesky().map(|c| c.solve(&gradient)) else {
                return f64::INFINITY;
            };
            star.flux += by[0];
            star.x = (star.x + by[1].clamp(-LONGEST, LONGEST)).clamp(start.0 - SHIFT, start.0 + SHIFT);
            star.y = (star.y + by[2].clamp(-LONGEST, LONGEST)).clamp(start.1 - SHIFT, start.1 + SHIFT);
            if !(star.flux > 0.0 && star.flux.is_finite()) {
                star.flux = flux;
                return f64::INFINITY;
            }
        }
        chi
    }

    /// Chooses the degree whose PSF best predicts stars that were not part of its fit. A higher
    /// degree must reduce the summed error by more than the error's own uncertainty, which follows
    /// from its scatter among the stars.
    fn choose_degree(&self, stars: &[Star], prior: &Prior) -> (FieldTerms, LeftOut) {
        let frame = self.terms.frame();
        let peak = prior.peak();
        let step = stars.len().div_ceil(STARS_FOR_DEGREE).max(1);
        let stars: Vec<Star> = stars.iter().step_by(step).cloned().collect();
        let errors_of = |terms: FieldTerms| -> Vec<f64> {
            let folds = (0..FOLDS).into_par_iter().map(|fold| {
                let learn: Vec<Star> = part_of(&stars, |k| k % FOLDS != fold);
                let judge = part_of(&stars, |k| k % FOLDS == fold);
                if learn.is_empty() {
                    return vec![0.0; judge.len()];
                }
                let learnt = self.fitted(&learn, prior, terms);
                let errors = judge.iter().map(|star| {
                    let coefficients = learnt.at(star);
                    let psf = |_: &StarPixel, place: &Place| self.surface.value(&coefficients, place);
                    prediction_error(star, self.surface, peak, psf)
                });
                errors.collect()
            });
            let folds: Vec<Vec<f64>> = folds.collect();
            (0..stars.len()).map(|k| folds[k % FOLDS][k / FOLDS]).collect()
        };
        let mut best = FieldTerms::new(0, frame);
        let mut errors = errors_of(best);
        for degree in 1..=HIGHEST_DEGREE {
            let too_few = stars.len() < STARS_PER_TERM * term_count(degree);
            if too_few || degree > best.degree + VAIN_DEGREES {
                break;
            }
            let terms = FieldTerms::new(degree, frame);
            let others = errors_of(terms);
            if is_smaller(&others, &errors) {
                (best, errors) = (terms, others);
            }
        }
        let left_out = LeftOut {
            stars,
            errors,
            surface: self.surface,
            peak,
        };
        (best, left_out)
    }
}

fn part_of(stars: &[Star], chosen: impl Fn(usize) -> bool) -> Vec<Star> {
    let all = stars.iter().enumerate();
    all.filter(|(k, _)| chosen(*k))
        .map(|(_, star)| star.clone())
        .collect()
}

/// Returns whether the sum of `errors` is smaller than that of `others` by more than the standard
/// deviation of the difference.
fn is_smaller(errors: &[f64], others: &[f64]) -> bool {
    let gains: Vec<f64> = others
        .iter()
        .zip(errors)
        .map(|(other, error)| other - error)
        .collect();
    let mean = gains.iter().sum::<f64>() / gains.len() as f64;
    let scatter: f64 = gains.iter().map(|gain| (gain - mean).powi(2)).sum();
    gains.iter().sum::<f64>() > scatter.sqrt()
}

/// The sum of squared differences between a star's pixels and a PSF times the flux that fits best, in
/// units of the pixels' variance. This variance is that of the background, and allows for an error of
/// the PSF by [`ACCURACY`] of its peak: an error counts as much in the wings as in the core, as in the
/// relative L2 error of a PSF.
fn prediction_error(
    star: &Star,
    surface: SurfaceGrid,
    peak: f64,
    psf: impl Fn(&StarPixel, &Place) -> f64,
) -> f64 {
    let used = star.pixels.iter().filter(|p| p.trust > 0.0);
    let pixels: Vec<(f64, f64, f64)> = used
        .filter_map(|pixel| {
            let place = surface.place(pixel.x - star.x, pixel.y - star.y)?;
            let variance = pixel.rms.powi(2) + (ACCURACY * star.flux * peak).powi(2);
            Some((pixel.value - star.offset, psf(pixel, &place), variance))
        })
        .collect();
    let product: f64 = pixels
        .iter()
        .map(|(value, psf, variance)| value * psf / variance)
        .sum();
    let power: f64 = pixels.iter().map(|(_, psf, variance)| psf * psf / variance).sum();
    let flux = product / power.max(f64::MIN_POSITIVE);
    let off = |(value, psf, variance): &(f64, f64, f64)| (value - flux * psf).powi(2) / variance;
    pixels.iter().map(|pixel| off(pixel).min(HUBER * HUBER)).sum()
}
