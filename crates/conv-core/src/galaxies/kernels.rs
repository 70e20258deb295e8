//! The stamps of a model, and the PSFs of some galaxies as combinations of them.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use ndarray::{Array2, ArrayView1, ArrayView2, Axis};
use psf_types::StampGrid;
use rustfft::num_complex::Complex64;

use super::floor::PsfOutskirts;
use super::power_spectrum::{AliasedPower, PowerSpectrum};
use super::spectrum::{Wavenumbers, discrete_transform, has_aliases, nearest, spectrum};
use super::window::Spectra;
use crate::ConvReal;
use crate::kept::Kept;

/// The stamps that combine to all PSFs of a model.
#[derive(Debug)]
pub(super) struct ModelStamps {
    grid: StampGrid,
    /// `[stamp, pixel]`.
    values: Array2<f64>,
    moments: Vec<Moments>,
    /// Transforms up to the stamps' Nyquist frequency. They tell the power of PSFs.
    coarse: Transforms,
    aliases: AliasedPower,
    /// Transforms for windows of each side, and the number of the band.
    spectra: Kept<(usize, usize), Transforms>,
    /// Transforms of one side and band that need more memory than this are not made.
    memory_bytes: usize,
}

/// Transforms of stamps, `[stamp, 2 wavenumber]`: the real part of each value, then the imaginary
/// part.
#[derive(Debug)]
struct Transforms(Array2<f64>);

impl Transforms {
    fn new(stamps: &[Vec<Complex64>]) -> Self {
        let columns = stamps.first().map_or(0, |stamp| 2 * stamp.len());
        let mut values = Array2::zeros((stamps.len(), columns));
        for (mut row, stamp) in values.outer_iter_mut().zip(stamps) {
            let parts = stamp.iter().flat_map(|v| [v.re, v.im]);
            row.iter_mut().zip(parts).for_each(|(to, v)| *to = v);
        }
        Self(values)
    }

    /// The transforms of combinations `[PSF, stamp]` of the stamps. `value` converts the real and
    /// the imaginary part at each wavenumber.
    fn combined<V>(&self, directions: ArrayView2<'_, f64>, value: impl Fn(f64, f64) -> V) -> Vec<Vec<V>> {
        let transforms = directions.dot(&self.0);
        let of_row = |row: ArrayView1<'_, f64>| {
            let parts = row.to_slice().expect("row-major").chunks_exact(2);
            parts.map(|v| value(v[0], v[1])).collect()
        };
        transforms.outer_iter().map(of_row).collect()
    }
}

/// PSFs as combinations of a model's [`ModelStamps`], and the properties that decide how a galaxy is
/// drawn through them.
#[derive(Debug)]
pub(super) struct Kernels {
    /// `[PSF, stamp]`.
    directions: Array2<f64>,
    moments: Vec<Moments>,
    pub(super) power: PowerSpectrum,
}

/// Moments of a stamp about its centre, in frame pixels: flux, x, y, xx, xy, yy.
pub(super) type Moments = [f64; 6];

impl ModelStamps {
    /// The stamps `[stamp, pixel]`. Transforms of windows are kept up to the given memory.
    pub(super) fn new(values: Array2<f64>, grid: StampGrid, memory_bytes: usize) -> Self {
        let aliases = AliasedPower::new(grid);
        let coarse: Vec<Vec<Complex64>> = (0..values.nrows())
            .map(|i| {
                let stamp = stamp_of(values.row(i), grid);
                discrete_transform(stamp, grid, aliases.step, aliases.radius)
                    .into_iter()
                    .collect()
            })
            .collect();
        Self {
            moments: values
                .outer_iter()
                .map(|stamp| moments(stamp_of(stamp, grid), grid))
                .collect(),
            grid,
            values,
            coarse: Transforms::new(&coarse),
            aliases,
            spectra: Kept::new(memory_bytes),
            memory_bytes,
        }
    }

    /// The outskirts of combinations `[PSF, stamp]` of the stamps, with their largest coefficients.
    pub(super) fn outskirts(
        &self,
        directions: &Array2<f64>,
        largest: &[f64],
        typical: ArrayView1<'_, f64>,
    ) -> PsfOutskirts {
        PsfOutskirts::new((self.values.view(), self.grid), directions, largest, typical)
    }

    /// The moments of a combination of the stamps.
    pub(super) fn moments_of(&self, direction: ArrayView1<'_, f64>) -> Moments {
        combined(&self.moments, direction.iter())
    }

    /// The number of the narrowest band that holds a wavenumber. Wavenumbers beyond one
    /// period of the discrete transform all get one number, because they need the same stored
    /// values.
    pub(super) fn band_number(&self, k: f64) -> usize {
        let whole = PI * self.grid.oversampling() * std::f64::consts::SQRT_2;
        let k = if has_aliases(self.grid) { k.min(whole) } else { k };
        ((k / LEAST_BAND).ln() / BAND_RATIO.ln()).ceil().max(0.0) as usize
    }

    /// The number of points, along each axis, of a stamp's transform for windows of a side, up to a band
    /// of this number.
    pub(super) fn transform_points(&self, side: usize, number: usize) -> usize {
        let whole = has_aliases(self.grid).then(|| side as f64 * self.grid.oversampling());
        (2.0 * band(number) * side as f64 / TAU).min(whole.unwrap_or(f64::INFINITY)) as usize
    }

    /// The transforms of PSFs for windows of a side, up to a band of this number.
    pub(super) fn spectra_of<T: ConvReal>(
        &self,
        kernels: &Kernels,
        side: usize,
        number: usize,
    ) -> Spectra<T> {
        let wavenumbers = Wavenumbers::within(band(number), side, self.grid);
        let bytes = self.values.nrows() * wavenumbers.count * size_of::<Complex64>();
        let stamps = if bytes > self.memory_bytes {
            let combined = kernels.directions.dot(&self.values);
            let stamps = combined.outer_iter();
            stamps
                .map(|stamp| spectrum(stamp_of(stamp, self.grid), self.grid, &wavenumbers))
                .collect()
        } else {
            let own = self.transforms(side, number, &wavenumbers);
            own.combined(kernels.directions.view(), |re, im| {
                nearest(Complex64::new(re, im))
            })
        };
        Spectra { wavenumbers, stamps }
    }

    /// The transforms of all stamps.
    fn transforms(&self, side: usize, number: usize, wavenumbers: &Wavenumbers) -> Arc<Transforms> {
        let make = || {
            let stamps: Vec<Vec<Complex64>> = (0..self.values.nrows())
                .map(|i| spectrum(stamp_of(self.values.row(i), self.grid), self.grid, wavenumbers))
                .collect();
            Transforms::new(&stamps)
        };
        let bytes = |made: &Transforms| made.0.len() * size_of::<f64>();
        self.spectra.get((side, number), make, bytes)
    }
}

/// The largest wavenumber of a band, in radians per pixel.
fn band(number: usize) -> f64 {
    BAND_RATIO.powi(number as i32) * LEAST_BAND
}

impl Kernels {
    /// PSFs `[PSF, stamp]`, with the largest absolute values of the coefficients with which they
    /// are combined. `typical` is one of the combinations. Light at wavenumbers that are left out is
    /// at most `accuracy` of this one, in the L2 norm.
    pub(super) fn new(
        stamps: &ModelStamps,
        directions: Array2<f64>,
        largest: &[f64],
        typical: ArrayView1<'_, f64>,
        accuracy: f64,
    ) -> Self {
        let power =
            |directions: ArrayView2<'_, f64>| stamps.coarse.combined(directions, |re, im| re * re + im * im);
        let typical = power(typical.insert_axis(Axis(0))).swap_remove(0);
        let mut limit = vec![0.0; typical.len()];
        for (power, &largest) in power(directions.view()).iter().zip(largest) {
            for (sum, v) in limit.iter_mut().zip(power) {
                *sum += largest * v.sqrt();
            }
        }
        for v in &mut limit {
            *v *= *v;
        }
        let rows = directions.outer_iter();
        Self {
            moments: rows.map(|direction| stamps.moments_of(direction)).collect(),
            power: PowerSpectrum::new(&stamps.aliases, &limit, &typical, accuracy),
            directions,
        }
    }

    /// The moments of a PSF.
    pub(super) fn moments_of(&self, coefficients: &[f64]) -> Moments {
        combined(&self.moments, coefficients.iter())
    }
}

/// Transforms end at bands of a geometric series, so that galaxies and blocks of the field share
/// them. This is the narrowest band, in radians per frame pixel.
const LEAST_BAND: f64 = 1e-3;
/// Each band is wider than the one before by this factor.
const BAND_RATIO: f64 = 1.4;

fn combined<'a>(moments: &[Moments], coefficients: impl Iterator<Item = &'a f64>) -> Moments {
    let mut sum = [0.0; 6];
    for (moments, c) in moments.iter().zip(coefficients) {
        sum.iter_mut().zip(moments).for_each(|(sum, m)| *sum += c * m);
    }
    sum
}

fn stamp_of(values: ArrayView1<'_, f64>, grid: StampGrid) -> ArrayView2<'_, f64> {
    values
        .into_shape_with_order(grid.dim())
        .expect("the size of a stamp")
}

fn moments(stamp: ArrayView2<'_, f64>, grid: StampGrid) -> Moments {
    let s = grid.oversampling();
    let mut sum = [0.0; 6];
    for ((j, i), &v) in stamp.indexed_iter() {
        let (x, y) = ((i as f64 - grid.centre_x()) / s, (j as f64 - grid.centre_y()) / s);
        let flux = v / (s * s);
        for (sum, power) in sum.iter_mut().zip([1.0, x, y, x * x, x * y, y * y]) {
            *sum += flux * power;
        }
    }
    sum
}
