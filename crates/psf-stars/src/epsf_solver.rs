//! The linear step of the fit of an oversampled PSF: the spline between the nodes of the PSF, and
//! the fit of its coefficients to the stars' pixels.

use ndarray::Array2;
use psf_types::maths::{FWHM_PER_SIGMA, spline_slopes, spline_weights};
use rayon::prelude::*;

use crate::Camera;
use crate::frame::Star;
use crate::registration::FineGrid;
use crate::selection::FieldTerms;

/// Number of rows and columns of B-spline coefficients before the grid.
const TAPS_BEFORE: usize = 1;
/// Number of rows and columns of B-spline coefficients after the grid. The second one always has
/// weight 0.
const TAPS_AFTER: usize = 2;

/// Weights of the coefficients before, at and after a node for the value of a cubic B-spline there.
const NODE: [f64; 3] = [1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0];

/// The layout of the B-spline coefficients of a PSF on a grid, row by row, with a border.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SurfaceGrid {
    pub(crate) grid: FineGrid,
}

/// The coefficients that determine the PSF at one point: the first of 4 x 4 coefficients, their
/// weights along x and y, and their weights in the derivatives.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place {
    first: usize,
    weights: [[f64; 4]; 2],
    slopes: [[f64; 4]; 2],
}

impl SurfaceGrid {
    pub(crate) fn new(grid: FineGrid) -> Self {
        Self { grid }
    }

    pub(crate) fn side(self) -> usize {
        self.grid.side() + TAPS_BEFORE + TAPS_AFTER
    }

    pub(crate) fn len(self) -> usize {
        self.side() * self.side()
    }

    /// Returns the coefficients and weights for the point at the offset `(dx, dy)` from the star in
    /// pixels of the frame, if it is on the grid.
    pub(crate) fn place(self, dx: f64, dy: f64) -> Option<Place> {
        let (scale, middle) = (self.grid.scale as f64, self.grid.middle() as f64);
        let (tx, ty) = (middle + scale * dx, middle + scale * dy);
        let last = 2.0 * middle;
        ((0.0..=last).contains(&tx) && (0.0..=last).contains(&ty)).then(|| {
            // The coefficient before the one of the node at or below `t`.
            let first = |t: f64| t.floor() as usize + TAPS_BEFORE - 1;
            let within = [tx - tx.floor(), ty - ty.floor()];
            Place {
                first: first(ty) * self.side() + first(tx),
                weights: within.map(spline_weights),
                slopes: within.map(spline_slopes),
            }
        })
    }

    /// The offset of every coefficient from the star in pixels of the frame, in the order of the
    /// coefficients.
    pub(crate) fn offsets(self) -> impl Iterator<Item = (f64, f64)> {
        let (side, middle, scale) = (self.side(), self.grid.middle() as f64, self.grid.scale as f64);
        let offset = move |k: usize| (k as f64 - TAPS_BEFORE as f64 - middle) / scale;
        (0..side * side).map(move |k| (offset(k % side), offset(k / side)))
    }

    pub(crate) fn value(self, coefficients: &[f64], place: &Place) -> f64 {
        self.weighted(coefficients, place.first, place.weights)
    }

    /// The derivatives with respect to the offset, in values per pixel of the frame.
    pub(crate) fn slopes(self, coefficients: &[f64], place: &Place) -> (f64, f64) {
        let scale = self.grid.scale as f64;
        (
            scale * self.weighted(coefficients, place.first, [place.slopes[0], place.weights[1]]),
            scale * self.weighted(coefficients, place.first, [place.weights[0], place.slopes[1]]),
        )
    }

    fn weighted(self, coefficients: &[f64], first: usize, [wx, wy]: [[f64; 4]; 2]) -> f64 {
        let side = self.side();
        let line = |j: usize| -> f64 {
            let at = first + j * side;
            coefficients[at..at + 4].iter().zip(&wx).map(|(c, w)| c * w).sum()
        };
        wy.iter().enumerate().map(|(j, w)| w * line(j)).sum()
    }

    /// The transpose of [`value`](Self::value): adds `amount`, multiplied by the weights of
    /// `place`, to the coefficients.
    pub(crate) fn spread(self, coefficients: &mut [f64], place: &Place, amount: f64) {
        let side = self.side();
        for (j, wy) in place.weights[1].iter().enumerate() {
            let first = place.first + j * side;
            for (c, wx) in coefficients[first..first + 4].iter_mut().zip(&place.weights[0]) {
                *c += amount * wy * wx;
            }
        }
    }

    /// The values at the nodes `[y, x]`.
    pub(crate) fn at_nodes(self, coefficients: &[f64]) -> Array2<f64> {
        let (n, side) = (self.grid.side(), self.side());
        Array2::from_shape_fn((n, n), |(j, i)| {
            let mut sum = 0.0;
            for (dj, wy) in NODE.iter().enumerate() {
                for (di, wx) in NODE.iter().enumerate() {
                    sum += wx * wy * coefficients[(j + dj) * side + i + di];
                }
            }
            sum
        })
    }

    /// The flux of a PSF: the sum over its nodes divided by the number of nodes per pixel.
    pub(crate) fn flux(self, coefficients: &[f64]) -> f64 {
        self.at_nodes(coefficients).sum() / (self.grid.scale * self.grid.scale) as f64
    }
}

/// The accuracy of the PSF model, as a fraction of the star's flux in a pixel. It limits the weight
/// of bright stars (PSFEx's PSF_ACCURACY).
pub(crate) const ACCURACY: f64 = 0.02;

/// The weight of a pixel for values relative to the star's flux: `F^2 / variance`.
pub(crate) fn weight(star: &Star, model: f64, rms: f64, camera: &Camera) -> f64 {
    let signal = star.flux * model.max(0.0);
    let variance = camera.variance(signal, rms) + (ACCURACY * signal).powi(2);
    star.flux * star.flux / variance
}

/// Returns the sum of the planes `E_j`, each multiplied by its term `P_j`.
pub(crate) fn combined(planes: &[Vec<f64>], terms: &[f64]) -> Vec<f64> {
    let mut sum = vec![0.0; planes[0].len()];
    for (plane, term) in planes.iter().zip(terms) {
        for (s, v) in sum.iter_mut().zip(plane) {
            *s += term * v;
        }
    }
    sum
}

/// The PSF that is expected before the fit: its coefficients, and by how much the true coefficients
/// may differ from them. For the PSF of the field, the expected PSF is a round Gaussian of the
/// stars' FWHM with the mean wings of the stars. For a star's own PSF, it is the PSF of the field
/// at the star.
///
/// The fit is the most probable PSF if the noise of the pixels and the differences from the
/// expected coefficients are Gaussian and independent. Coefficients that no pixel of any star
/// determines keep their expected values.
#[derive(Debug)]
pub(crate) struct Prior {
    /// The expected coefficients of the constant term. For the other terms they are 0.
    pub(crate) mean: Vec<f64>,
    /// Standard deviations of the true coefficients of the constant term about `mean`.
    spread: Vec<f64>,
}

/// The standard deviation of a coefficient is the sum of two parts. The first is this fraction of
/// the coefficient.
const OWN_PART: f64 = 0.5;
/// The second part of the standard deviation is this fraction of the peak, which allows for wings.
const PEAK_PART: f64 = 0.004;
/// The standard deviations of the terms that vary over the field, relative to those of the constant
/// term.
const FIELD_PART: f64 = 0.5;

/// For a star's own PSF, this fraction replaces [`OWN_PART`]. It allows for the star's colour and
/// for local distortion.
const LOCAL_PART: f64 = 0.25;

impl Prior {
    pub(crate) fn gaussian(surface: SurfaceGrid, fwhm_px: f64) -> Self {
        let sigma2 = (fwhm_px / FWHM_PER_SIGMA).powi(2);
        // A B-spline is wider than its coefficients by a variance of a third of a squared node
        // distance.
        let scale = surface.grid.scale as f64;
        let narrowed = (sigma2 - 1.0 / (3.0 * scale * scale)).max(0.3 * sigma2);
        let mut mean: Vec<f64> = surface
            .offsets()
            .map(|(x, y)| (-0.5 * (x * x + y * y) / narrowed).exp())
            .collect();
        let flux = surface.flux(&mean);
        for v in &mut mean {
            *v /= flux;
        }
        Self::about(mean, OWN_PART)
    }

    /// Returns the prior with the wings of `stars` in place of the wings of the Gaussian: beyond
    /// one FWHM, the mean of the stars' pixels at the same distance from their star.
    ///
    /// A real PSF has more light in its wings than a Gaussian. Faint wings have little weight in
    /// the fit of a single coefficient, so that a Gaussian prior would remove them.
    pub(crate) fn with_wings_of(
        &self,
        stars: &[Star],
        surface: SurfaceGrid,
        fwhm_px: f64,
        camera: &Camera,
    ) -> Self {
        let width = 1.0 / surface.grid.scale as f64;
        let ring = |x: f64, y: f64| (x.hypot(y) / width).round() as usize;
        let mut mean = self.mean.clone();
        let rings = surface.offsets().map(|(x, y)| ring(x, y)).max().unwrap_or(0) + 1;
        let mut sums = vec![(0.0, 0.0); rings];
        for star in stars {
            for pixel in star.pixels.iter().filter(|p| p.trust > 0.0) {
                let (dx, dy) = (pixel.x - star.x, pixel.y - star.y);
                if let Some(place) = surface.place(dx, dy) {
                    let expected = surface.value(&mean, &place);
                    let w = pixel.trust * weight(star, expected, pixel.rms, camera);
                    let (sum, weights) = &mut sums[ring(dx, dy)];
                    *sum += w * (pixel.value - star.offset) / star.flux;
                    *weights += w;
                }
            }
        }
        for (v, (x, y)) in mean.iter_mut().zip(surface.offsets()) {
            let (sum, weights) = sums[ring(x, y)];
            if x.hypot(y) > fwhm_px && weights > 0.0 {
                *v = sum / weights;
            }
        }
        Self::about(mean, OWN_PART)
    }

    /// The prior with the expected coefficients `mean`, from which the true ones may differ by
    /// `part` of their size and by [`PEAK_PART`] of the peak.
    fn about(mean: Vec<f64>, part: f64) -> Self {
        let peak = mean.iter().copied().fold(0.0, f64::max);
        let spread = mean.iter().map(|v| part * v.abs() + PEAK_PART * peak).collect();
        Self { mean, spread }
    }

    /// The prior for a star's own PSF: the PSF of the field at the star, from which it may differ a
    /// little.
    pub(crate) fn local(mean: Vec<f64>) -> Self {
        Self::about(mean, LOCAL_PART)
    }
}

/// The iteration ends when the residual falls to this fraction of the first one.
const CONVERGED: f64 = 1e-6;
const MOST_ITERATIONS: usize = 300;
/// Number of stars over which one task sums. These partial sums are added in a fixed order, so that
/// the result does not depend on the number of threads.
const PIECE: usize = 32;

/// Fits the planes `E_j` to the stars' pixels, with the stars' positions and fluxes fixed.
/// Minimises `sum w (d / F - E)^2 + |(E - prior) / spread|^2` by conjugate gradients. Here `d` are
/// the values of the pixels above the background around their star, `F` is the star's flux, and `w`
/// are the weights of the pixels.
pub(crate) fn solve(
    stars: &[Star],
    prior: &Prior,
    surface: SurfaceGrid,
    terms: FieldTerms,
    camera: &Camera,
) -> Vec<Vec<f64>> {
    let count = terms.count();
    let size = surface.len();
    let rows: Vec<StarRows> = stars
        .par_iter()
        .map(|star| StarRows::new(star, prior, surface, terms, camera))
        .collect();
    let spread = |j: usize, k: usize| prior.spread[k] * if j == 0 { 1.0 } else { FIELD_PART };

    // In units of the prior's standard deviations, the matrix of the prior is the unit matrix.
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

/// The equations of one star: the residuals of its usable pixels from the prior.
struct StarRows {
    terms: Vec<f64>,
    /// Place, weight and residual of each pixel.
    pixels: Vec<(Place, f64, f64)>,
}

impl StarRows {
    fn new(star: &Star, prior: &Prior, surface: SurfaceGrid, terms: FieldTerms, camera: &Camera) -> Self {
        let pixels = star
            .pixels
            .iter()
            .filter(|p| p.trust > 0.0)
            .filter_map(|p| {
                let place = surface.place(p.x - star.x, p.y - star.y)?;
                let expected = surface.value(&prior.mean, &place);
                let w = p.trust * weight(star, expected, p.rms, camera);
                Some((place, w, (p.value - star.offset) / star.flux - expected))
            })
            .collect();
        Self {
            terms: terms.at(star.x, star.y),
            pixels,
        }
    }

    /// Returns `A^T W A` applied to coefficients. `A` evaluates the PSF at the star's pixels, and
    /// `W` contains their weights.
    fn normal(&self, coefficients: &[f64], surface: SurfaceGrid) -> Vec<f64> {
        let mut back = vec![0.0; coefficients.len()];
        for (place, w, _) in &self.pixels {
            surface.spread(&mut back, place, w * surface.value(coefficients, place));
        }
        back
    }

    /// Returns `A^T W d`, where `d` are the residuals of the pixels from the prior.
    fn back(&self, surface: SurfaceGrid) -> Vec<f64> {
        let mut back = vec![0.0; surface.len()];
        for (place, w, left) in &self.pixels {
            surface.spread(&mut back, place, w * left);
        }
        back
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> SurfaceGrid {
        SurfaceGrid::new(FineGrid { reach: 3, scale: 2 })
    }

    fn bumpy() -> Vec<f64> {
        (0..grid().len()).map(|k| ((k * 29) % 31) as f64 - 11.0).collect()
    }

    #[test]
    fn nodes_slopes_and_the_transpose_agree_with_values() {
        let (surface, c) = (grid(), bumpy());
        let nodes = surface.at_nodes(&c);
        for (j, i) in [(0, 0), (12, 12), (3, 7)] {
            let at = |k: usize| (k as f64 - 6.0) / 2.0;
            let place = surface.place(at(i), at(j)).unwrap();
            assert!((surface.value(&c, &place) - nodes[[j, i]]).abs() < 1e-12);
        }
        let step = 1e-6;
        let value = |x: f64, y: f64| surface.value(&c, &surface.place(x, y).unwrap());
        let (x, y) = (0.31, -1.77);
        let place = surface.place(x, y).unwrap();
        let (sx, sy) = surface.slopes(&c, &place);
        assert!((sx - (value(x + step, y) - value(x - step, y)) / (2.0 * step)).abs() < 1e-6);
        assert!((sy - (value(x, y + step) - value(x, y - step)) / (2.0 * step)).abs() < 1e-6);
        let mut spread = vec![0.0; c.len()];
        surface.spread(&mut spread, &place, 2.5);
        let product: f64 = spread.iter().zip(&c).map(|(a, b)| a * b).sum();
        assert!((product - 2.5 * surface.value(&c, &place)).abs() < 1e-10);
        assert!(surface.place(3.01, 0.0).is_none());
    }
}
