//! One oversampled PSF over the field, fitted to the pixels of all stars together.

use nalgebra::{Matrix3, Vector3};
use ndarray::Array2;
use psf_types::FrameShape;
use rayon::prelude::*;

use crate::Camera;
use crate::background::median;
use crate::epsf_solver::{ACCURACY, Prior, SurfaceGrid, combined, solve, weight};
use crate::frame::Star;
use crate::registration::FineGrid;
use crate::selection::FieldTerms;

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
    psf: FieldPsf,
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
/// A higher degree is chosen only if it reduces the prediction error by more than this fraction.
const GAIN: f64 = 0.002;
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
        for round in 0..ROUNDS {
            // Each round fits the stars' positions before the PSF. In the first round, the PSF for
            // this fit is a Gaussian.
            let chi = psf.refine(&mut stars);
            if round >= ROUNDS_BEFORE_REJECTION {
                let limit = mismatch_limit(&chi);
                let agree: Vec<bool> = chi.iter().map(|c| *c <= limit).collect();
                mismatched.extend(
                    stars
                        .iter()
                        .zip(&agree)
                        .filter(|(_, f)| !**f)
                        .map(|(s, _)| s.source),
                );
                let mut agree = agree.iter();
                stars.retain(|_| *agree.next().expect("one flag per star"));
            }
            let prior = gaussian.with_wings_of(&stars, surface, fwhm_px, camera);
            let terms = match degree {
                _ if round != ROUNDS_BEFORE_REJECTION => psf.terms,
                Some(degree) => FieldTerms::new(degree, frame),
                None => psf.choose_degree(&stars, &prior),
            };
            psf = psf.fitted(&stars, &prior, terms);
        }
        let mut chi = psf.refine(&mut stars);
        Self {
            stars,
            mismatched,
            median_chi: median(&mut chi),
            psf,
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
            let alone = psf.fitted(std::slice::from_ref(star), &Prior::local(coefficients), constant);
            coefficients = alone.at(star);
        }
        let flux = surface.flux(&coefficients);
        (flux > 0.0 && star.flux > 0.0).then(|| (surface.at_nodes(&coefficients) / flux, star.flux * flux))
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
    let middle = median(&mut chi.to_vec());
    let spread = 1.4826 * median(&mut chi.iter().map(|c| (c - middle).abs()).collect::<Vec<_>>());
    (middle + MISMATCH_SIGMA * spread).max(MISMATCH_RATIO * middle)
}

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
            planes: solve(stars, prior, self.surface, terms, &self.camera),
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
                let variance = self.camera.variance(signal, pixel.rms) + (ACCURACY * signal).powi(2);
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

    /// Chooses the degree whose PSF best predicts stars that were not part of its fit.
    fn choose_degree(&self, stars: &[Star], prior: &Prior) -> FieldTerms {
        let frame = self.terms.frame();
        let mut best = FieldTerms::new(0, frame);
        let mut least = f64::INFINITY;
        for degree in 0..=HIGHEST_DEGREE {
            if degree > 0 && stars.len() < STARS_PER_TERM * FieldTerms::count_of(degree) {
                break;
            }
            let terms = FieldTerms::new(degree, frame);
            let error: f64 = (0..FOLDS)
                .map(|fold| {
                    let part = |inside: bool| -> Vec<Star> {
                        let chosen = stars
                            .iter()
                            .enumerate()
                            .filter(|(k, _)| (k % FOLDS == fold) == inside);
                        chosen.map(|(_, s)| s.clone()).collect()
                    };
                    let (learn, judge) = (part(false), part(true));
                    if learn.is_empty() {
                        return 0.0;
                    }
                    let learnt = self.fitted(&learn, prior, terms);
                    judge
                        .iter()
                        .map(|star| learnt.prediction_error(star, prior))
                        .sum()
                })
                .sum();
            if error < (1.0 - GAIN) * least {
                (best, least) = (terms, error);
            }
        }
        best
    }

    fn prediction_error(&self, star: &Star, prior: &Prior) -> f64 {
        let (surface, coefficients) = (self.surface, self.at(star));
        let used = star.pixels.iter().filter(|p| p.trust > 0.0);
        used.filter_map(|pixel| {
            let place = surface.place(pixel.x - star.x, pixel.y - star.y)?;
            let psf = surface.value(&coefficients, &place);
            // All degrees get the same weights, so that their errors can be compared.
            let w = weight(star, surface.value(&prior.mean, &place), pixel.rms, &self.camera);
            let off = (pixel.value - star.offset) / star.flux - psf;
            Some(pixel.trust * w * off * off)
        })
        .sum()
    }
}
