//! Products of an image with a galaxy on its window, in Fourier space.
//!
//! A window is a sum over wavenumbers ([`WindowDrawer`](super::window::WindowDrawer)). So its scalar product with an
//! image is a sum over the same wavenumbers, of the terms of the galaxy times the conjugate transform of the image.

use std::ops::Range;
use std::sync::Arc;

use ndarray::ArrayView2;
use psf_types::{LightProfile, Real};
use realfft::{RealFftPlanner, RealToComplex};
use rustfft::num_complex::Complex64;
use rustfft::{Fft, FftPlanner};

use super::gradients::{ExtendedGradient, Variation};
use super::window::{Drawn, Lit, lit_rows};
use crate::ConvReal;
use crate::simd::{sum_of_products, vectorized};
use crate::sources::PointGradient;

/// Computes products on windows of one side. Keeps the memory between galaxies.
pub(super) struct WindowProducts {
    side: usize,
    along_x: Arc<dyn RealToComplex<f64>>,
    along_y: Arc<dyn Fft<f64>>,
    /// The conjugate transform of the image, `[kx, ky]` with `kx = 0 ... side / 2`.
    image: Vec<Complex64>,
    line: Vec<f64>,
    transformed: Vec<Complex64>,
    scratch: Vec<Complex64>,
}

/// Products with a galaxy of flux 1.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Products {
    /// With the galaxy, and with its derivatives with respect to x and y.
    pub(super) galaxy: [f64; 3],
    /// With each variation of its light, and the difference of its parameter.
    variations: Vec<(f64, f64)>,
}

impl Products {
    pub(super) fn none(variations: &[Variation]) -> Self {
        Self {
            galaxy: [0.0; 3],
            variations: variations.iter().map(|variation| (0.0, variation.step)).collect(),
        }
    }

    /// Adds, times a sign, the first of some products, which is with the light itself, and the slopes of the
    /// others: with the light moved by `step` to either side along x and along y, and with that of each
    /// variation after and before.
    pub(super) fn add_differences(&mut self, sums: &[f64], sign: f64, step: f64) {
        let (moved, varied) = sums[1..].split_at(4);
        self.galaxy[0] += sign * sums[0];
        for (sum, pair) in self.galaxy[1..].iter_mut().zip(moved.chunks_exact(2)) {
            *sum += sign * (pair[0] - pair[1]) / (2.0 * step);
        }
        for ((sum, step), pair) in self.variations.iter_mut().zip(varied.chunks_exact(2)) {
            *sum += sign * (pair[0] - pair[1]) / *step;
        }
    }

    /// The derivatives for a source of a flux.
    pub(super) fn for_flux(self, flux: f64) -> ExtendedGradient {
        ExtendedGradient {
            point: PointGradient::for_flux(flux, self.galaxy),
            variations: self.variations.into_iter().map(|(sum, _)| flux * sum).collect(),
        }
    }
}

/// At one `kx`, for each `ky`: the product of image and PSF, and of image and the derivatives of the PSF with
/// respect to x and y.
#[derive(Default)]
struct ImageTimesPsf([Vec<Complex64>; 3]);

impl WindowProducts {
    pub(super) fn new(side: usize) -> Self {
        let zero = Complex64::default();
        let along_x = RealFftPlanner::new().plan_fft_forward(side);
        let along_y = FftPlanner::new().plan_fft_forward(side);
        let scratch = along_y.get_inplace_scratch_len().max(along_x.get_scratch_len());
        Self {
            side,
            along_x,
            along_y,
            image: vec![zero; (side / 2 + 1) * side],
            line: vec![0.0; side],
            transformed: vec![zero; side / 2 + 1],
            scratch: vec![zero; scratch],
        }
    }

    /// Takes an image on the window. It is dark outside `part`, whose first pixel is at `(column, row)`.
    pub(super) fn set_image<T: Real>(&mut self, part: ArrayView2<'_, T>, (column, row): (usize, usize)) {
        self.image.fill(Complex64::default());
        for (y, values) in (row..).zip(part.outer_iter()) {
            self.line.fill(0.0);
            let to = &mut self.line[column..column + values.len()];
            to.iter_mut().zip(values).for_each(|(to, v)| *to = v.as_f64());
            self.along_x
                .process_with_scratch(&mut self.line, &mut self.transformed, &mut self.scratch)
                .expect("the lengths of the plan");
            let columns = self.image.chunks_exact_mut(self.side);
            columns
                .zip(&self.transformed)
                .for_each(|(column, &v)| column[y] = v);
        }
        self.along_y
            .process_with_scratch(&mut self.image, &mut self.scratch);
        self.image.iter_mut().for_each(|v| v.im = -v.im);
    }

    /// The products of the image with a galaxy, its derivatives and variations. `slopes` are the derivatives of its
    /// coefficients with respect to x and y.
    pub(super) fn of<T: ConvReal>(
        &self,
        galaxy: &Drawn<'_, T>,
        slopes: [&[f64]; 2],
        variations: &[Variation],
    ) -> Products {
        let wavenumbers = &galaxy.spectra.wavenumbers;
        let lit = Lit::new(wavenumbers, galaxy.outline);
        let (step, aliases) = (wavenumbers.step(), &wavenumbers.aliases);
        let (most, lines) = (wavenumbers.most_ky[0] as i64, wavenumbers.most_ky.len());
        let row = (2 * most + 1) as usize;
        let (mut factors_x, mut factors_y) = (Vec::<Complex64>::new(), Vec::new());
        lit.phase_factors_into(0, galaxy.centre.0, 0..lines as i64, &mut factors_x);
        lit.phase_factors_into(1, galaxy.centre.1, -most..most + 1, &mut factors_y);
        let mut products = Products::none(variations);
        let (mut multiplied, mut terms) = (ImageTimesPsf::default(), [const { Vec::new() }; 3]);
        let mut lights = vec![vec![0.0; lit.most_count()]; 1 + variations.len()];
        let mut before = vec![0.0; lit.most_count()];
        for line in 0..lines {
            let Some((start, most_ky)) = lit.line(line) else {
                continue;
            };
            let stored = start..start + (2 * most_ky + 1) as usize;
            self.multiply_by_psf(galaxy, slopes, (line, stored), &mut multiplied);
            for (across, factors_x) in lit.aliases().zip(factors_x.chunks_exact(lines)) {
                let kx = line as i64 + aliases.distance(across);
                let Some(end) = lit.most_at(kx) else { continue };
                let count = (2 * end + 1) as usize;
                let kx = kx as f64 * step;
                let transform = |light: &dyn LightProfile, values: &mut [f64]| {
                    light.transform_f64_into(kx, -(end as f64) * step, step, values);
                };
                let (light, changes) = lights.split_first_mut().expect("that of the galaxy");
                transform(galaxy.light, &mut light[..count]);
                for (variation, change) in variations.iter().zip(changes) {
                    let (change, before) = (&mut change[..count], &mut before[..count]);
                    transform(variation.after.as_ref(), change);
                    transform(variation.before.as_ref(), before);
                    change
                        .iter_mut()
                        .zip(before)
                        .for_each(|(change, before)| *change -= *before);
                }
                for (up, factors_y) in lit.aliases().zip(factors_y.chunks_exact(row)) {
                    let distance = aliases.distance(up);
                    let Some(rows) = lit_rows((most_ky, end), distance) else {
                        continue;
                    };
                    let part = |first: i64| (rows.start - first) as usize..(rows.end - first) as usize;
                    let of_light = part(-end - distance);
                    let first_ky = (rows.start + distance) as f64 * step;
                    let place = (factors_x[line], &factors_y[part(-most)], kx, (first_ky, step));
                    // The wavenumbers of the other half-plane have the conjugate values.
                    let weight = if line == 0 { 1.0 } else { 2.0 };
                    vectorized!({
                        multiplied.terms(part(-most_ky), place, &mut terms);
                        let (light, changes) = lights.split_first().expect("that of the galaxy");
                        for (sum, terms) in products.galaxy.iter_mut().zip(&terms) {
                            *sum += weight * sum_of_products(terms, &light[of_light.clone()]);
                        }
                        for ((sum, _), change) in products.variations.iter_mut().zip(changes) {
                            *sum += weight * sum_of_products(&terms[0], &change[of_light.clone()]);
                        }
                    });
                }
            }
        }
        let area = (self.side * self.side) as f64;
        products.galaxy.iter_mut().for_each(|sum| *sum /= area);
        products
            .variations
            .iter_mut()
            .for_each(|(sum, step)| *sum /= area * *step);
        products
    }

    /// Multiplies the image by the PSF and by its derivatives, at a line of stored wavenumbers.
    fn multiply_by_psf<T: ConvReal>(
        &self,
        galaxy: &Drawn<'_, T>,
        slopes: [&[f64]; 2],
        (line, stored): (usize, Range<usize>),
        multiplied: &mut ImageTimesPsf,
    ) {
        let (side, half) = (self.side as i64, self.side / 2);
        let most_ky = (stored.len() / 2) as i64;
        let column = line % self.side;
        let is_opposite = column > half;
        let column = if is_opposite { self.side - column } else { column };
        let of_image = &self.image[column * self.side..][..self.side];
        let image = |ky: i64| {
            if is_opposite {
                of_image[(-ky).rem_euclid(side) as usize].conj()
            } else {
                of_image[ky.rem_euclid(side) as usize]
            }
        };
        let coefficients = [galaxy.coefficients, slopes[0], slopes[1]];
        for (multiplied, coefficients) in multiplied.0.iter_mut().zip(coefficients) {
            multiplied.clear();
            multiplied.resize(stored.len(), Complex64::default());
            vectorized!(
                for (stamp, &c) in galaxy.spectra.stamps.iter().zip(coefficients) {
                    for (sum, v) in multiplied.iter_mut().zip(&stamp[stored.clone()]) {
                        sum.re += c * v.re.as_f64();
                        sum.im += c * v.im.as_f64();
                    }
                }
            );
            for (v, ky) in multiplied.iter_mut().zip(-most_ky..) {
                *v *= image(ky);
            }
        }
    }
}

/// The phase factors along x and y, `kx`, and the first `ky` with its step.
type Place<'a> = (Complex64, &'a [Complex64], f64, (f64, f64));

impl ImageTimesPsf {
    /// Computes the terms of some wavenumbers, to be multiplied by the transform of light and added up: those of the
    /// galaxy, and of its derivatives with respect to x and y.
    #[inline(always)]
    fn terms(
        &self,
        part: Range<usize>,
        (factor_x, factors_y, kx, (first_ky, step)): Place<'_>,
        terms: &mut [Vec<f64>; 3],
    ) {
        for terms in &mut *terms {
            terms.resize(part.len(), 0.0);
        }
        let [psf, along_x, along_y] = self.0.each_ref().map(|values| &values[part.clone()]);
        let [of_galaxy, of_x, of_y] = terms;
        let multiplied = psf.iter().zip(along_x).zip(along_y).zip(factors_y);
        let terms = of_galaxy.iter_mut().zip(of_x).zip(of_y).enumerate();
        for ((((psf, along_x), along_y), &factor_y), (i, ((galaxy, x), y))) in multiplied.zip(terms) {
            let phase = product(factor_x, factor_y);
            let term = product(*psf, phase);
            // The phase is exp(-i (kx x + ky y)).
            let ky = first_ky + i as f64 * step;
            *galaxy = term.re;
            *x = kx * term.im + product(*along_x, phase).re;
            *y = ky * term.im + product(*along_y, phase).re;
        }
    }
}

#[inline(always)]
fn product(a: Complex64, b: Complex64) -> Complex64 {
    Complex64::new(a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re)
}
