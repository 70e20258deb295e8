//! Draws one galaxy on a square window, in Fourier space.

use std::ops::Range;
use std::sync::Arc;

use ndarray::Array2;
use psf_types::LightProfile;
use realfft::{ComplexToReal, RealFftPlanner};
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};

use super::power_spectrum::Outline;
use super::spectrum::Wavenumbers;
use crate::ConvReal;
use crate::simd::vectorized;

/// The transformed stamps from which the PSFs of some galaxies are combined.
#[derive(Debug)]
pub(super) struct Spectra<T> {
    pub(super) wavenumbers: Wavenumbers,
    /// `[stamp][wavenumber]`.
    pub(super) stamps: Vec<Vec<Complex<T>>>,
}

impl<T> Spectra<T> {
    pub(super) fn bytes(&self) -> usize {
        self.stamps
            .iter()
            .map(|stamp| size_of_val(stamp.as_slice()))
            .sum()
    }
}

/// Draws galaxies on windows of one side. Keeps the memory between galaxies.
pub(super) struct WindowDrawer<T: ConvReal> {
    side: usize,
    along_y: Arc<dyn Fft<T>>,
    along_x: Arc<dyn ComplexToReal<T>>,
    /// The transform of the window, folded: `[kx, ky]` with `kx = 0 ... side / 2`.
    folded: Vec<Complex<T>>,
    psf: Vec<Complex<T>>,
    product: Vec<Complex<T>>,
    transform: Vec<T>,
    /// The phase factors ([`Aliases`](super::spectrum::Aliases)) at the galaxy's column, for the `kx` of each
    /// alias.
    factors_x: Vec<Complex<T>>,
    /// The phase factors at the galaxy's row, for the `ky` of each alias, ascending.
    factors: Vec<Complex<T>>,
    scratch: Vec<Complex<T>>,
    lines: Vec<Complex<T>>,
}

/// Number of rows that are copied together from the transform's columns.
const ROWS_AT_ONCE: usize = 8;

/// A galaxy on a window: its light, its centre counted from the window's first pixel, and the
/// coefficients of the stamps that make its PSF, times its flux.
pub(super) struct Drawn<'a, T> {
    pub(super) spectra: &'a Spectra<T>,
    pub(super) light: &'a dyn LightProfile,
    pub(super) centre: (f64, f64),
    pub(super) coefficients: &'a [f64],
    /// Light at wavenumbers outside it is left out.
    pub(super) outline: &'a Outline,
}

impl<T: ConvReal> WindowDrawer<T> {
    pub(super) fn new(side: usize) -> Self {
        let zero = Complex::new(T::zero(), T::zero());
        let along_y = FftPlanner::new().plan_fft_inverse(side);
        let along_x = RealFftPlanner::new().plan_fft_inverse(side);
        let scratch = along_y.get_inplace_scratch_len().max(along_x.get_scratch_len());
        let half = side / 2 + 1;
        Self {
            side,
            along_y,
            along_x,
            folded: vec![zero; half * side],
            psf: Vec::new(),
            product: Vec::new(),
            transform: Vec::new(),
            factors_x: Vec::new(),
            factors: Vec::new(),
            scratch: vec![zero; scratch],
            lines: vec![zero; half * ROWS_AT_ONCE],
        }
    }

    /// Computes the rows `rows` of a galaxy's image, which repeats with the period of the window.
    /// Returns the values `[row, column]`.
    pub(super) fn draw(&mut self, galaxy: &Drawn<'_, T>, rows: Range<usize>) -> Array2<T> {
        let columns = self.fold(galaxy);
        let (side, half) = (self.side, self.side / 2 + 1);
        self.along_y
            .process_with_scratch(&mut self.folded[..columns * side], &mut self.scratch);
        let mut values = Array2::zeros((rows.len(), side));
        let mut each_row = values.as_slice_mut().expect("row-major").chunks_exact_mut(side);
        for first in rows.clone().step_by(ROWS_AT_ONCE) {
            let count = ROWS_AT_ONCE.min(rows.end - first);
            for (kx, column) in self.folded.chunks_exact(side).enumerate() {
                for (line, &value) in column[first..first + count].iter().enumerate() {
                    self.lines[line * half + kx] = value;
                }
            }
            let lines = self.lines.chunks_exact_mut(half);
            for (line, values) in lines.zip(each_row.by_ref().take(count)) {
                // The first and the last value of a real line's transform are real.
                line[0].im = T::zero();
                line[half - 1].im = T::zero();
                self.along_x
                    .process_with_scratch(line, values, &mut self.scratch)
                    .expect("the lengths of the plan");
            }
        }
        values
    }

    /// Multiplies the transforms of galaxy and PSF, and folds them into the wavenumbers of the
    /// window's pixels. Returns the number of columns, from the first on, that hold light.
    fn fold(&mut self, galaxy: &Drawn<'_, T>) -> usize {
        let side = self.side;
        let wavenumbers = &galaxy.spectra.wavenumbers;
        let lit = Lit::new(wavenumbers, galaxy.outline);
        let step = wavenumbers.step();
        let aliases = &wavenumbers.aliases;
        let zero = Complex::new(T::zero(), T::zero());
        let most = wavenumbers.most_ky[0] as i64;
        let row = (2 * most + 1) as usize;
        let lines = wavenumbers.most_ky.len();
        let (x, y) = galaxy.centre;
        lit.phase_factors_into(0, x, 0..lines as i64, &mut self.factors_x);
        lit.phase_factors_into(1, y, -most..most + 1, &mut self.factors);
        self.folded.fill(zero);
        self.psf.resize(row, zero);
        self.product.resize(row, zero);
        self.transform.resize(lit.most_count(), T::zero());
        let area = (side * side) as f64;
        let coefficients: Vec<T> = galaxy.coefficients.iter().map(|c| T::nearest(c / area)).collect();
        let mut columns = 0;
        for line in 0..lines {
            let Some((start, most_ky)) = lit.line(line) else {
                continue;
            };
            let count = (2 * most_ky + 1) as usize;
            let psf = &mut self.psf[..count];
            vectorized!({
                psf.fill(zero);
                for (stamp, &c) in galaxy.spectra.stamps.iter().zip(&coefficients) {
                    for (sum, v) in psf.iter_mut().zip(&stamp[start..start + count]) {
                        sum.re += c * v.re;
                        sum.im += c * v.im;
                    }
                }
            });
            let product = &mut self.product[..count];
            product.fill(zero);
            for (across, factors_x) in lit.aliases().zip(self.factors_x.chunks_exact(lines)) {
                let kx = line as i64 + aliases.distance(across);
                let Some(end) = lit.most_at(kx) else { continue };
                let transform = &mut self.transform[..(2 * end + 1) as usize];
                T::transform_into(
                    galaxy.light,
                    kx as f64 * step,
                    -(end as f64) * step,
                    step,
                    transform,
                );
                let factor_x = factors_x[line];
                for (up, factors) in lit.aliases().zip(self.factors.chunks_exact(row)) {
                    let distance = aliases.distance(up);
                    let Some(rows) = lit_rows((most_ky, end), distance) else {
                        continue;
                    };
                    let part = |first: i64| (rows.start - first) as usize..(rows.end - first) as usize;
                    let product = &mut product[part(-most_ky)];
                    let psf = &psf[part(-most_ky)];
                    let (transform, factors) = (&transform[part(-end - distance)], &factors[part(-most)]);
                    vectorized!(add_product(product, psf, transform, factor_x, factors));
                }
            }
            vectorized!(add_line(&mut self.folded, side, line, product));
            columns = line + 1;
        }
        columns.min(side / 2 + 1)
    }
}

/// The wavenumbers at which a galaxy's image has light.
pub(super) struct Lit<'a> {
    wavenumbers: &'a Wavenumbers,
    outline: &'a Outline,
    /// The largest wavenumber along an axis at which stamps have light.
    largest: f64,
    /// The largest wavenumber along either axis, and along y.
    radius: f64,
    most_ky: f64,
}

impl<'a> Lit<'a> {
    pub(super) fn new(wavenumbers: &'a Wavenumbers, outline: &'a Outline) -> Self {
        let (step, largest) = (wavenumbers.step(), wavenumbers.aliases.largest() as f64);
        let [most_kx, most_ky] = outline.extent().map(|k| (k / step).min(largest));
        Self {
            wavenumbers,
            outline,
            largest,
            radius: most_kx.max(most_ky),
            most_ky,
        }
    }

    /// The numbers of the aliases, along either axis.
    pub(super) fn aliases(&self) -> impl Iterator<Item = i64> {
        self.wavenumbers.aliases.numbers(self.radius)
    }

    /// The largest `ky` at `kx`. `None` if there is no light.
    pub(super) fn most_at(&self, kx: i64) -> Option<i64> {
        let (step, kx) = (self.wavenumbers.step(), kx.unsigned_abs() as f64);
        let end = self.outline.end(kx * step)?;
        (kx <= self.largest).then(|| (end / step).min(self.largest) as i64)
    }

    /// The largest number of values at one `kx`.
    pub(super) fn most_count(&self) -> usize {
        2 * self.most_ky as usize + 1
    }

    /// The index of the first stored wavenumber of a line that has light, in its own period or in an alias, and the
    /// largest `ky` there.
    pub(super) fn line(&self, line: usize) -> Option<(usize, i64)> {
        let (stored, start) = (self.wavenumbers.most_ky[line], self.wavenumbers.starts[line]);
        let kx = |across: i64| line as i64 + self.wavenumbers.aliases.distance(across);
        let of_aliases = self.aliases().filter_map(|across| self.most_at(kx(across)));
        let most_ky = of_aliases.max()?.min(stored as i64);
        Some((start + stored - most_ky as usize, most_ky))
    }

    /// The phase factors of a galaxy's centre along x (axis 0) or y (1), for a range of stored wavenumbers.
    pub(super) fn phase_factors_into<T: ConvReal>(
        &self,
        axis: usize,
        centre: f64,
        range: Range<i64>,
        factors: &mut Vec<Complex<T>>,
    ) {
        let angle = self.wavenumbers.step() * centre;
        let aliases = &self.wavenumbers.aliases;
        aliases.phase_factors_into(axis, angle, self.radius, range, factors);
    }
}

/// The stored `ky`, up to `most_ky`, of an alias at a distance, whose light ends at `end`.
pub(super) fn lit_rows((most_ky, end): (i64, i64), distance: i64) -> Option<Range<i64>> {
    let from = (-most_ky).max(-end - distance);
    let to = most_ky.min(end - distance) + 1;
    (from < to).then_some(from..to)
}

/// Adds `psf * light * factor_x * factors` to `sums`.
#[inline(always)]
fn add_product<T: ConvReal>(
    sums: &mut [Complex<T>],
    psf: &[Complex<T>],
    light: &[T],
    factor_x: Complex<T>,
    factors: &[Complex<T>],
) {
    for (((sum, psf), &light), factor) in sums.iter_mut().zip(psf).zip(light).zip(factors) {
        let shifted = Complex::new(
            (factor_x.re * factor.re - factor_x.im * factor.im) * light,
            (factor_x.re * factor.im + factor_x.im * factor.re) * light,
        );
        sum.re += psf.re * shifted.re - psf.im * shifted.im;
        sum.im += psf.re * shifted.im + psf.im * shifted.re;
    }
}

/// Adds the values at one `kx` and all `ky`, with `ky = 0` in the middle, to the columns of a
/// folded transform. A real image: the value at `-k` is the conjugate of that at `k`. Of each pair,
/// one lies in the columns that are kept, and both if the column is its own opposite. Overwrites
/// `values`.
#[inline(always)]
fn add_line<T: ConvReal>(folded: &mut [Complex<T>], side: usize, kx: usize, values: &mut [Complex<T>]) {
    let first = -(values.len() as i64 / 2);
    let half = side / 2;
    let column = kx % side;
    if column <= half {
        add_folded(&mut folded[column * side..(column + 1) * side], values, first);
    }
    if kx > 0 && (column == 0 || column >= half) {
        let opposite = (side - column) % side;
        values.reverse();
        for v in values.iter_mut() {
            v.im = -v.im;
        }
        add_folded(&mut folded[opposite * side..(opposite + 1) * side], values, first);
    }
}

/// Adds values to a column, the first at index `first`, modulo the length of the column.
#[inline(always)]
fn add_folded<T: ConvReal>(column: &mut [Complex<T>], values: &[Complex<T>], first: i64) {
    let mut rest = values;
    let mut at = first.rem_euclid(column.len() as i64) as usize;
    while !rest.is_empty() {
        let (now, later) = rest.split_at(rest.len().min(column.len() - at));
        for (sum, &v) in column[at..].iter_mut().zip(now) {
            *sum += v;
        }
        (rest, at) = (later, 0);
    }
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;
    use psf_types::{Position, SersicProfile, SersicSource, StampGrid};
    use rustfft::num_complex::Complex64;
    use sersic::SersicLight;

    use super::*;
    use crate::galaxies::power_spectrum::{AliasedPower, PowerSpectrum};
    use crate::galaxies::spectrum::{discrete_transform, spectrum};

    /// Of columns that are not counted, the transform would be left out.
    #[test]
    fn columns_with_light_are_counted() {
        let mut lines = std::collections::BTreeSet::new();
        for (pixels, s) in [(32, 1.0), (64, 2.0), (96, 3.0), (50, 1.7)] {
            let grid = StampGrid::new(pixels, pixels).and_then(|grid| grid.with_oversampling(s));
            let grid = grid.unwrap();
            let stamp = Array2::from_shape_fn(grid.dim(), |(y, x)| {
                let [x, y] = [x as f64 - grid.centre_x(), y as f64 - grid.centre_y()];
                (1.0 + (x * x + y * y) / (4.0 * s * s)).powf(-2.5)
            });
            let aliases = AliasedPower::new(grid);
            let coarse = discrete_transform(stamp.view(), grid, aliases.step, aliases.radius);
            let power: Vec<f64> = coarse.iter().map(Complex64::norm_sqr).collect();
            let wavenumbers = Wavenumbers::within(12.0, 64, grid);
            let spectra = Spectra {
                stamps: vec![spectrum(stamp.view(), grid, &wavenumbers)],
                wavenumbers,
            };
            let mut drawer = WindowDrawer::<f64>::new(64);
            for step in 0..60 {
                let profile = SersicProfile::new(0.3 * 1.06_f64.powi(step), 1.0, 1.0, 0.0).unwrap();
                let galaxy = SersicSource::new(Position::of_pixel(0, 0), 1.0, profile).unwrap();
                let light = SersicLight::new(&galaxy);
                let outline = PowerSpectrum::new(&aliases, &power, &power, 1e-3).outline(&light, 1e-3);
                let galaxy = Drawn {
                    spectra: &spectra,
                    light: &light,
                    centre: (31.3, 32.4),
                    coefficients: &[1.0],
                    outline: &outline,
                };
                let columns = drawer.fold(&galaxy);
                lines.insert(columns);
                let beyond = &drawer.folded[columns * 64..];
                assert!(
                    beyond.iter().all(|v| v.norm_sqr() == 0.0),
                    "{pixels} {step}: {columns}"
                );
            }
        }
        assert!(lines.len() > 5, "{lines:?}");
    }
}
