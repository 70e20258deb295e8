//! The linear step of the oversampled PSF: its coefficients from the stars' pixels.

use rayon::prelude::*;

use crate::FWHM_PER_SIGMA;
use crate::epsf::combined;
use crate::field_trend::FieldTerms;
use crate::star::Star;
use crate::surface::SurfaceGrid;

/// What is known of the PSF before: a round Gaussian of the stars' FWHM, and how far its coefficients may be from the truth.
///
/// The fit is the most probable PSF under Gaussian noise and independent Gaussian errors of these sizes, so that coefficients which no
/// pixel of any star determines stay where they are.
#[derive(Debug)]
pub(crate) struct Prior {
    mean: Vec<f64>,
    /// Standard deviations of the constant term.
    spread: Vec<f64>,
}

/// A coefficient may differ from the Gaussian by this part of itself ...
const OWN_PART: f64 = 0.5;
/// ... and this part of the peak, as wings do.
const PEAK_PART: f64 = 0.004;
/// How much less the PSF varies over the field than it differs from a Gaussian.
const FIELD_PART: f64 = 0.5;

/// A star's own PSF may differ from that of the field by this part (colour, local distortion).
const LOCAL_PART: f64 = 0.25;

impl Prior {
    pub(crate) fn gaussian(surface: SurfaceGrid, fwhm_px: f64) -> Self {
        let sigma2 = (fwhm_px / FWHM_PER_SIGMA).powi(2);
        // B-splines widen what their coefficients say by a third of a node's width squared.
        let scale = surface.grid().scale as f64;
        let narrowed = (sigma2 - 1.0 / (3.0 * scale * scale)).max(0.3 * sigma2);
        let mut mean: Vec<f64> = surface
            .offsets()
            .map(|(x, y)| (-0.5 * (x * x + y * y) / narrowed).exp())
            .collect();
        let flux = surface.flux(&mean);
        for v in &mut mean {
            *v /= flux;
        }
        let peak = mean.iter().copied().fold(0.0, f64::max);
        let spread = mean.iter().map(|v| OWN_PART * v + PEAK_PART * peak).collect();
        Self { mean, spread }
    }

    /// The PSF of the field at a star, from which the star's own may differ a little.
    pub(crate) fn local(mean: Vec<f64>) -> Self {
        let peak = mean.iter().copied().fold(0.0, f64::max);
        let spread = mean
            .iter()
            .map(|v| LOCAL_PART * v.abs() + PEAK_PART * peak)
            .collect();
        Self { mean, spread }
    }

    pub(crate) fn mean(&self) -> &[f64] {
        &self.mean
    }
}

/// Ends the iteration at this part of the first residual.
const CONVERGED: f64 = 1e-6;
const MOST_ITERATIONS: usize = 300;
/// Stars worked on as one piece: sums are taken in the order of pieces, whatever the threads.
const PIECE: usize = 32;

/// The planes `E_j` from the stars as they are: minimises `sum w (d / F - E)^2 + |(E - prior) / spread|^2` by conjugate gradients.
/// `weight(star, model, rms)` is that of a pixel.
pub(crate) fn solve(
    stars: &[Star],
    prior: &Prior,
    surface: SurfaceGrid,
    terms: FieldTerms,
    weight: impl Fn(&Star, f64, f64) -> f64 + Sync,
) -> Vec<Vec<f64>> {
    let count = terms.count();
    let size = surface.len();
    let rows: Vec<StarRows> = stars
        .par_iter()
        .map(|star| StarRows::new(star, prior, surface, terms, &weight))
        .collect();
    let spread = |j: usize, k: usize| prior.spread[k] * if j == 0 { 1.0 } else { FIELD_PART };

    // In units of the spreads the prior is the unit matrix.
    let transposed = |of: &(dyn Fn(&StarRows) -> Vec<f64> + Sync)| -> Vec<Vec<f64>> {
        let pieces: Vec<Vec<Vec<f64>>> = rows
            .par_chunks(PIECE)
            .map(|piece| {
                let mut sum = vec![vec![0.0; size]; count];
                for row in piece {
                    let back = of(row);
                    for (plane, term) in sum.iter_mut().zip(&row.terms) {
                        plane.iter_mut().zip(&back).for_each(|(s, b)| *s += term * b);
                    }
                }
                sum
            })
            .collect();
        let mut total = vec![vec![0.0; size]; count];
        for piece in pieces {
            for (plane, part) in total.iter_mut().zip(piece) {
                plane.iter_mut().zip(part).for_each(|(s, p)| *s += p);
            }
        }
        for (j, plane) in total.iter_mut().enumerate() {
            plane.iter_mut().enumerate().for_each(|(k, v)| *v *= spread(j, k));
        }
        total
    };
    let apply = |z: &[Vec<f64>]| -> Vec<Vec<f64>> {
        let scaled: Vec<Vec<f64>> = z
            .iter()
            .enumerate()
            .map(|(j, plane)| plane.iter().enumerate().map(|(k, v)| v * spread(j, k)).collect())
            .collect();
        let mut result = transposed(&|row: &StarRows| row.normal(&combined(&scaled, &row.terms), surface));
        for (plane, own) in result.iter_mut().zip(z) {
            plane.iter_mut().zip(own).for_each(|(r, v)| *r += v);
        }
        result
    };

    let mut z = vec![vec![0.0; size]; count];
    let mut residual = transposed(&|row: &StarRows| row.back(surface));
    let mut direction = residual.clone();
    let mut power = dot(&residual, &residual);
    let first = power;
    for _ in 0..MOST_ITERATIONS {
        if power <= CONVERGED * CONVERGED * first || power == 0.0 {
            break;
        }
        let image = apply(&direction);
        let step = power / dot(&direction, &image);
        add(&mut z, step, &direction);
        add(&mut residual, -step, &image);
        let next = dot(&residual, &residual);
        let ratio = next / power;
        power = next;
        for (d, r) in direction.iter_mut().zip(&residual) {
            d.iter_mut().zip(r).for_each(|(d, r)| *d = r + ratio * *d);
        }
    }
    for (j, plane) in z.iter_mut().enumerate() {
        for (k, v) in plane.iter_mut().enumerate() {
            *v *= spread(j, k);
            if j == 0 {
                *v += prior.mean[k];
            }
        }
    }
    z
}

fn dot(a: &[Vec<f64>], b: &[Vec<f64>]) -> f64 {
    a.iter()
        .zip(b)
        .map(|(a, b)| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>())
        .sum()
}

fn add(to: &mut [Vec<f64>], factor: f64, what: &[Vec<f64>]) {
    for (to, what) in to.iter_mut().zip(what) {
        to.iter_mut().zip(what).for_each(|(t, w)| *t += factor * w);
    }
}

/// The equations of one star: its pixels that count, less the prior.
struct StarRows {
    terms: Vec<f64>,
    /// Place, weight and what is left of the prior.
    pixels: Vec<(crate::surface::Place, f64, f64)>,
}

impl StarRows {
    fn new(
        star: &Star,
        prior: &Prior,
        surface: SurfaceGrid,
        terms: FieldTerms,
        weight: &(impl Fn(&Star, f64, f64) -> f64 + Sync),
    ) -> Self {
        let pixels = star
            .pixels
            .iter()
            .filter(|p| p.trust > 0.0)
            .filter_map(|p| {
                let place = surface.place(p.x - star.x, p.y - star.y)?;
                let expected = surface.value(&prior.mean, &place);
                let w = p.trust * weight(star, expected, p.rms);
                Some((place, w, (p.value - star.offset) / star.flux - expected))
            })
            .collect();
        Self {
            terms: terms.at(star.x, star.y),
            pixels,
        }
    }

    /// `A^T W A` applied to coefficients.
    fn normal(&self, coefficients: &[f64], surface: SurfaceGrid) -> Vec<f64> {
        let mut back = vec![0.0; coefficients.len()];
        for (place, w, _) in &self.pixels {
            surface.spread(&mut back, place, w * surface.value(coefficients, place));
        }
        back
    }

    /// `A^T W d`.
    fn back(&self, surface: SurfaceGrid) -> Vec<f64> {
        let mut back = vec![0.0; surface.len()];
        for (place, w, left) in &self.pixels {
            surface.spread(&mut back, place, w * left);
        }
        back
    }
}
