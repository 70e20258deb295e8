//! One oversampled PSF over the field, from the pixels of all stars together.

use nalgebra::{Matrix4, Vector4};
use ndarray::Array2;
use psf_types::FrameShape;
use rayon::prelude::*;

use crate::background::median;
use crate::camera::Camera;
use crate::epsf_solver::{Prior, solve};
use crate::field_trend::FieldTerms;
use crate::registration::FineGrid;
use crate::star::Star;
use crate::surface::SurfaceGrid;

/// An oversampled PSF, `E(u; x) = sum_j P_j(x) E_j(u)`, and the stars that it was fitted to.
#[derive(Debug)]
pub(crate) struct Epsf {
    pub(crate) terms: FieldTerms,
    /// Of the stars that agree with it.
    pub(crate) stars: Vec<Star>,
    /// Of the stars that do not: indices of their sources.
    pub(crate) mismatched: Vec<usize>,
    pub(crate) median_chi: f64,
    planes: Vec<Vec<f64>>,
    surface: SurfaceGrid,
    camera: Camera,
}

/// The PSF is known to this part of a pixel's light at best: bright stars do not count for more (PSFEx's PSF_ACCURACY).
const ACCURACY: f64 = 0.02;
/// Rounds of fitting the PSF and then the stars.
const ROUNDS: usize = 6;
/// After so many rounds the degree is chosen, and mismatched stars are left out from then on.
const SETTLING: usize = 2;
const HIGHEST_DEGREE: usize = 4;
/// Stars that each term of the polynomial needs.
const STARS_PER_TERM: usize = 5;
/// Each star is predicted once from the others, this part of the stars at a time.
const FOLDS: usize = 5;
/// A higher degree must predict better by this part.
const GAIN: f64 = 0.002;
/// Residuals beyond so many sigma count less (Huber 1964).
const HUBER: f64 = 3.0;
/// Stars whose chi exceeds the median by so many sigma of the scatter, and three times, do not belong.
const MISMATCH_SIGMA: f64 = 5.0;
const MISMATCH_RATIO: f64 = 3.0;
/// Farthest that a star may move from where its Gaussian put it, pixels.
const FARTHEST: f64 = 0.5;

impl Epsf {
    pub(crate) fn fit(
        mut stars: Vec<Star>,
        grid: FineGrid,
        fwhm_px: f64,
        frame: FrameShape,
        camera: &Camera,
    ) -> Self {
        let surface = SurfaceGrid::new(grid);
        let prior = Prior::gaussian(surface, fwhm_px);
        let start: Vec<(f64, f64)> = stars.iter().map(|s| (s.x, s.y)).collect();
        let mut start = start;
        let mut terms = FieldTerms::new(0, frame);
        let mut planes = vec![prior.mean().to_vec()];
        let mut mismatched = Vec::new();
        for round in 0..ROUNDS {
            // Positions first: the first PSF is the Gaussian itself.
            let chi = refine(&mut stars, &start, &planes, terms, surface, camera);
            if round >= SETTLING {
                let limit = mismatch_limit(&chi);
                let fits: Vec<bool> = chi.iter().map(|c| *c <= limit).collect();
                mismatched.extend(
                    stars
                        .iter()
                        .zip(&fits)
                        .filter(|(_, f)| !**f)
                        .map(|(s, _)| s.source),
                );
                let mut fit = fits.iter();
                stars.retain(|_| *fit.next().expect("one a star"));
                let mut fit = fits.iter();
                start.retain(|_| *fit.next().expect("one a star"));
            }
            if round == SETTLING {
                terms = choose_degree(&stars, surface, &prior, frame, camera);
            }
            planes = solve(&stars, &prior, surface, terms, |star, model, rms| {
                weight(star, model, rms, camera)
            });
        }
        let chi = refine(&mut stars, &start, &planes, terms, surface, camera);
        Self {
            terms,
            stars,
            mismatched,
            median_chi: median(&mut chi.clone()),
            planes,
            surface,
            camera: *camera,
        }
    }

    /// The PSF at a star, of unit flux, and the star's flux; nothing where there is no light. With `own_shape` the star's own pixels bend
    /// the PSF of the field.
    pub(crate) fn sample(&self, star: &Star, own_shape: bool) -> Option<(Array2<f64>, f64)> {
        let smooth = combined(&self.planes, &self.terms.at(star.x, star.y));
        let coefficients = if own_shape {
            self.bent(smooth, star)
        } else {
            smooth
        };
        let flux = self.surface.flux(&coefficients);
        (flux > 0.0 && star.flux > 0.0)
            .then(|| (self.surface.at_nodes(&coefficients) / flux, star.flux * flux))
    }

    /// The PSF of the field, `smooth`, fitted to the pixels of one star.
    fn bent(&self, smooth: Vec<f64>, star: &Star) -> Vec<f64> {
        let constant = FieldTerms::new(0, self.terms.frame());
        let own = Prior::local(smooth);
        let alone = std::slice::from_ref(star);
        let mut planes = solve(alone, &own, self.surface, constant, |star, model, rms| {
            weight(star, model, rms, &self.camera)
        });
        planes.swap_remove(0)
    }
}

/// `sum_j P_j E_j`.
pub(crate) fn combined(planes: &[Vec<f64>], terms: &[f64]) -> Vec<f64> {
    let mut sum = vec![0.0; planes[0].len()];
    for (plane, term) in planes.iter().zip(terms) {
        for (s, v) in sum.iter_mut().zip(plane) {
            *s += term * v;
        }
    }
    sum
}

/// The weight of a pixel in units of flux fractions: `F^2 / variance`.
fn weight(star: &Star, model: f64, rms: f64, camera: &Camera) -> f64 {
    let signal = star.flux * model.max(0.0);
    let variance = camera.variance(signal, rms) + (ACCURACY * signal).powi(2);
    star.flux * star.flux / variance
}

fn mismatch_limit(chi: &[f64]) -> f64 {
    let middle = median(&mut chi.to_vec());
    let spread = 1.4826 * median(&mut chi.iter().map(|c| (c - middle).abs()).collect::<Vec<_>>());
    (middle + MISMATCH_SIGMA * spread).max(MISMATCH_RATIO * middle)
}

/// Flux, position and background of every star under the PSF as it is; the root of each star's reduced chi squared.
///
/// A PSF that is off centre and stars that are off by the same amount look alike: the mean shift is taken back.
fn refine(
    stars: &mut [Star],
    start: &[(f64, f64)],
    planes: &[Vec<f64>],
    terms: FieldTerms,
    surface: SurfaceGrid,
    camera: &Camera,
) -> Vec<f64> {
    let chi = stars
        .par_iter_mut()
        .zip(start)
        .map(|(star, start)| refine_one(star, *start, planes, terms, surface, camera))
        .collect();
    let count = stars.len() as f64;
    let mean = |of: fn(&Star) -> f64, from: fn(&(f64, f64)) -> f64| {
        stars.iter().map(of).sum::<f64>() / count - start.iter().map(from).sum::<f64>() / count
    };
    let (dx, dy) = (mean(|s| s.x, |p| p.0), mean(|s| s.y, |p| p.1));
    for star in stars {
        star.x -= dx;
        star.y -= dy;
    }
    chi
}

const STEPS: usize = 8;
/// Longest step in pixels.
const LONGEST: f64 = 0.2;

fn refine_one(
    star: &mut Star,
    start: (f64, f64),
    planes: &[Vec<f64>],
    terms: FieldTerms,
    surface: SurfaceGrid,
    camera: &Camera,
) -> f64 {
    let coefficients = combined(planes, &terms.at(star.x, star.y));
    let mut chi = f64::INFINITY;
    for step in 0..=STEPS {
        let (mut normal, mut gradient) = (Matrix4::zeros(), Vector4::zeros());
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
            let variance = camera.variance(signal, pixel.rms) + (ACCURACY * signal).powi(2);
            let residual = pixel.value - signal - offset;
            let deviation = residual.abs() / variance.sqrt();
            pixel.trust = if deviation > HUBER { HUBER / deviation } else { 1.0 };
            let w = pixel.trust / variance;
            let row = Vector4::new(psf, -flux * sx, -flux * sy, 1.0);
            normal += w * row * row.transpose();
            gradient += w * residual * row;
            sum += w * residual * residual;
            count += 1.0;
        }
        chi = if count > 4.0 {
            (sum / (count - 4.0)).sqrt()
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
        star.x = (star.x + by[1].clamp(-LONGEST, LONGEST)).clamp(start.0 - FARTHEST, start.0 + FARTHEST);
        star.y = (star.y + by[2].clamp(-LONGEST, LONGEST)).clamp(start.1 - FARTHEST, start.1 + FARTHEST);
        star.offset += by[3];
        if !(star.flux > 0.0 && star.flux.is_finite()) {
            star.flux = flux;
            return f64::INFINITY;
        }
    }
    chi
}

/// The degree whose PSF predicts stars best that did not take part.
fn choose_degree(
    stars: &[Star],
    surface: SurfaceGrid,
    prior: &Prior,
    frame: FrameShape,
    camera: &Camera,
) -> FieldTerms {
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
                let planes = solve(&learn, prior, surface, terms, |star, model, rms| {
                    weight(star, model, rms, camera)
                });
                judge
                    .iter()
                    .map(|star| prediction_error(star, &planes, terms, surface, prior, camera))
                    .sum()
            })
            .sum();
        if error < (1.0 - GAIN) * least {
            (best, least) = (terms, error);
        }
    }
    best
}

fn prediction_error(
    star: &Star,
    planes: &[Vec<f64>],
    terms: FieldTerms,
    surface: SurfaceGrid,
    prior: &Prior,
    camera: &Camera,
) -> f64 {
    let coefficients = combined(planes, &terms.at(star.x, star.y));
    let used = star.pixels.iter().filter(|p| p.trust > 0.0);
    used.filter_map(|pixel| {
        let place = surface.place(pixel.x - star.x, pixel.y - star.y)?;
        let psf = surface.value(&coefficients, &place);
        // Weights that do not depend on the PSF that is judged.
        let w = weight(star, surface.value(prior.mean(), &place), pixel.rms, camera);
        let off = (pixel.value - star.offset) / star.flux - psf;
        Some(pixel.trust * w * off * off)
    })
    .sum()
}
