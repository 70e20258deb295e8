//! Fourier transforms of interpolated stamps.
//!
//! Between its pixels a stamp is interpolated, so it is a function of a continuous offset `u`. Its
//! transform is the discrete transform of its values times the transform of the interpolation
//! kernel, which is a product of a function of `kx` and one of `ky`. Wavenumbers are multiples of
//! `2 pi / N` radians per frame pixel, where `N` is the side of the window that is drawn.
//!
//! The discrete transform repeats with the sampling frequency of the stamp. If the oversampling is
//! a whole number, only one period of it is computed, and a wavenumber beyond takes its value from
//! there.

use std::f64::consts::TAU;
use std::ops::{Range, RangeInclusive};
use std::sync::Arc;

use ndarray::{Array2, ArrayView2};
use psf_types::maths::{gauss_legendre, sinc};
use psf_types::{StampGrid, StampInterpolation};
use rustfft::num_complex::{Complex, Complex64};
use rustfft::{Fft, FftPlanner};

use crate::ConvReal;
use crate::plan::cost_model::fast_size;
use crate::stamp_interpolator::Kernel;

/// The wavenumbers of a window: `kx = 0 ... most`, and for each `kx` all `ky` within a circle.
/// Wavenumbers of the other half-plane hold the complex conjugates. If the stamps' oversampling is a
/// whole number, the wavenumbers end with one period of the discrete transform.
#[derive(Debug, Clone)]
pub(super) struct Wavenumbers {
    /// The side of the window in pixels.
    pub(super) side: usize,
    /// For each `kx`, the largest `ky`. The smallest is its negative.
    pub(super) most_ky: Vec<usize>,
    /// For each `kx`, the index of its first value.
    pub(super) starts: Vec<usize>,
    pub(super) count: usize,
    pub(super) aliases: Aliases,
}

/// The wavenumbers at which interpolated stamps have light: the period of the discrete transform,
/// and its aliases around it.
#[derive(Debug, Clone)]
pub(super) struct Aliases {
    /// The number of wavenumbers in a period. `None` if there are no aliases.
    period: Option<i64>,
    /// The factor of interpolation at `k = 0, 1, 2 ...` along each axis. Wavenumbers half-way
    /// between two aliases count in both, so there it is half the kernel's transform.
    kernel: Vec<f64>,
    /// The stamps' centre, in stamp pixels. From one alias to the next, the phase of the transform
    /// grows by 2 pi times the centre.
    centre: (f64, f64),
}

/// Aliases farther from 0 than this number are left out.
pub(super) const ALIASES: i64 = 2;

/// Whether the discrete transforms of stamps repeat with a whole number of wavenumbers, for windows
/// of any side.
pub(super) fn has_aliases(grid: StampGrid) -> bool {
    grid.oversampling().fract() == 0.0
}

impl Wavenumbers {
    /// The wavenumbers up to `band` radians per pixel.
    pub(super) fn within(band: f64, side: usize, grid: StampGrid) -> Self {
        let radius = (band * side as f64 / TAU).ceil();
        let period = has_aliases(grid).then(|| side * grid.oversampling() as usize);
        let most = period.map_or(usize::MAX, |period| period / 2);
        let most_ky: Vec<usize> = (0..=most.min(radius as usize))
            .map(|kx| most.min((radius * radius - (kx * kx) as f64).max(0.0).sqrt() as usize))
            .collect();
        let mut count = 0;
        let starts = most_ky
            .iter()
            .map(|most| {
                let start = count;
                count += 2 * most + 1;
                start
            })
            .collect();
        // Within half a period there are no aliases.
        let last = match period {
            Some(period) if 2 * radius as usize >= period => ALIASES as usize * period + period / 2,
            _ => radius as usize,
        };
        let angle = TAU / (side as f64 * grid.oversampling());
        let kernel = (0..=last).map(|k| {
            let shared = period.is_some_and(|period| 2 * (k % period) == period);
            let weight = if shared { 0.5 } else { 1.0 };
            weight * kernel_transform(grid.interpolation(), k as f64 * angle)
        });
        Self {
            side,
            most_ky,
            starts,
            count,
            aliases: Aliases {
                period: period.map(|period| period as i64),
                kernel: kernel.collect(),
                centre: (grid.centre_x(), grid.centre_y()),
            },
        }
    }

    /// The distance between neighbouring wavenumbers, in radians per pixel.
    pub(super) fn step(&self) -> f64 {
        TAU / self.side as f64
    }
}

impl Aliases {
    /// The numbers of the aliases along an axis that have wavenumbers up to a radius.
    pub(super) fn numbers(&self, radius: f64) -> RangeInclusive<i64> {
        let most = self.period.map_or(0, |period| {
            (((radius / period as f64 + 0.5).floor()) as i64).min(ALIASES)
        });
        -most..=most
    }

    /// The distance of an alias from the wavenumbers that are computed.
    pub(super) fn distance(&self, number: i64) -> i64 {
        number * self.period.unwrap_or(0)
    }

    /// The largest wavenumber at which stamps have light.
    pub(super) fn largest(&self) -> usize {
        self.kernel.len() - 1
    }

    /// The factor of interpolation at a wavenumber along one axis.
    pub(super) fn kernel(&self, k: i64) -> f64 {
        self.kernel[k.unsigned_abs() as usize]
    }

    /// `exp(-i k angle)` times the factors of interpolation and phase, along x (axis 0) or y (1), for
    /// the aliases up to a radius: first all `k` of one alias, then those of the next. `range` holds the
    /// wavenumbers in the period that is computed.
    pub(super) fn phase_factors_into<T: ConvReal>(
        &self,
        axis: usize,
        angle: f64,
        radius: f64,
        range: Range<i64>,
        factors: &mut Vec<Complex<T>>,
    ) {
        let centre = [self.centre.0, self.centre.1][axis];
        let to_next = Complex64::from_polar(1.0, -angle);
        let first = Complex64::from_polar(1.0, -range.start as f64 * angle);
        let of_period: Vec<Complex64> = std::iter::successors(Some(first), |factor| Some(factor * to_next))
            .take(range.clone().count())
            .collect();
        factors.clear();
        for number in self.numbers(radius) {
            let distance = self.distance(number);
            let of_alias = TAU * (number as f64 * centre).fract() - distance as f64 * angle;
            let of_alias = Complex64::from_polar(1.0, of_alias);
            let shifted = range.clone().zip(&of_period);
            factors.extend(shifted.map(|(k, factor)| nearest(factor * of_alias * self.kernel(k + distance))));
        }
    }
}

/// The discrete transform of a stamp `[y, x]` at some wavenumbers, in their order.
pub(super) fn spectrum<T: ConvReal>(
    stamp: ArrayView2<'_, f64>,
    grid: StampGrid,
    wavenumbers: &Wavenumbers,
) -> Vec<Complex<T>> {
    let radius = wavenumbers.most_ky.len() - 1;
    let planes = discrete_transform(stamp, grid, wavenumbers.step(), radius);
    let mut values = Vec::with_capacity(wavenumbers.count);
    for (column, &most) in planes.outer_iter().zip(&wavenumbers.most_ky) {
        let within = column.iter().skip(radius - most).take(2 * most + 1);
        values.extend(within.copied().map(nearest));
    }
    values
}

/// The complex number in the precision of the image.
pub(super) fn nearest<T: ConvReal>(value: Complex64) -> Complex<T> {
    Complex::new(T::nearest(value.re), T::nearest(value.im))
}

/// The discrete transform of a stamp, `sum_j h(u_j) exp(-i k u_j) / s^2`, with the offsets `u_j` of
/// its pixels from its centre in frame pixels. `kx = 0 ... radius` and `ky = -radius ... radius`, in
/// units of `step` radians per frame pixel: `[kx, ky]`.
pub(super) fn discrete_transform(
    stamp: ArrayView2<'_, f64>,
    grid: StampGrid,
    step: f64,
    radius: usize,
) -> Array2<Complex64> {
    let (ny, nx) = stamp.dim();
    let s = grid.oversampling();
    let along_x = Chirp::new(nx, grid.centre_x(), step / s, 0, radius + 1);
    let along_y = Chirp::new(ny, grid.centre_y(), step / s, -(radius as i64), 2 * radius + 1);
    // [kx, row]
    let mut columns = Array2::zeros((radius + 1, ny));
    let mut work = Vec::new();
    let mut scratch = vec![Complex64::default(); along_x.scratch_len().max(along_y.scratch_len())];
    for (row, values) in stamp.outer_iter().enumerate() {
        let values = values.iter().map(|&v| Complex64::new(v, 0.0));
        let line = along_x.transform(values, &mut work, &mut scratch);
        let to = columns.column_mut(row);
        to.into_iter().zip(line).for_each(|(to, v)| *to = v);
    }
    let mut planes = Array2::zeros((radius + 1, 2 * radius + 1));
    let area = 1.0 / (s * s);
    for (column, mut to) in columns.outer_iter().zip(planes.outer_iter_mut()) {
        let line = along_y.transform(column.iter().map(|v| v * area), &mut work, &mut scratch);
        to.iter_mut().zip(line).for_each(|(to, v)| *to = v);
    }
    planes
}

/// Nodes and weights for a piece of a kernel.
const GAUSS: [(f64, f64); 16] = gauss_legendre();

/// The transform of an interpolation kernel of unit spacing, at `w` radians per stamp pixel.
pub(super) fn kernel_transform(interpolation: StampInterpolation, w: f64) -> f64 {
    match interpolation {
        StampInterpolation::Lanczos3 => {
            // A ratio without a closed form, which is smooth within each of six pieces.
            let kernel = |t: f64| {
                let rule = Kernel::Lanczos3;
                rule.weights(t.fract())[(-rule.first_tap() - t as i64) as usize]
            };
            let piece = |first: f64| -> f64 {
                GAUSS
                    .iter()
                    .map(|&(node, weight)| (first + node, weight))
                    .map(|(t, weight)| weight * kernel(t) * (w * t).cos())
                    .sum()
            };
            2.0 * [0.0, 1.0, 2.0].map(piece).iter().sum::<f64>()
        }
        // The B-spline's transform over that of its values at the pixels (Unser et al. 1993).
        _ => sinc(w / TAU).powi(4) * 3.0 / (2.0 + w.cos()),
    }
}

/// The chirp z-transform (Rabiner, Schafer and Rader 1969): values of a discrete Fourier transform
/// at equal steps of any size, as a convolution.
struct Chirp {
    /// For each input, its factor.
    before: Vec<Complex64>,
    /// For each output, its factor.
    after: Vec<Complex64>,
    /// The transformed chirp, divided by the length of the convolution.
    transformed: Vec<Complex64>,
    forward: Arc<dyn Fft<f64>>,
    inverse: Arc<dyn Fft<f64>>,
}

impl Chirp {
    /// The transform `sum_j v_j exp(-i angle m (j - centre))` of `length` values, at `count`
    /// integers `m` from `first` on.
    fn new(length: usize, centre: f64, angle: f64, first: i64, count: usize) -> Self {
        // - m j = ((m - j)^2 - m^2 - j^2) / 2.
        let chirp_at = |t: i64| Complex64::from_polar(1.0, 0.5 * angle * (t as f64) * (t as f64));
        let size = fast_size(length + count - 1, 1);
        let mut planner = FftPlanner::new();
        let (forward, inverse) = (planner.plan_fft_forward(size), planner.plan_fft_inverse(size));
        let mut chirp = vec![Complex64::default(); size];
        let lowest = first - (length as i64 - 1);
        for (at, value) in chirp.iter_mut().enumerate().take(length + count - 1) {
            *value = chirp_at(lowest + at as i64) / size as f64;
        }
        forward.process(&mut chirp);
        let after = (0..count as i64).map(|i| {
            let m = first + i;
            chirp_at(m).conj() * Complex64::from_polar(1.0, angle * m as f64 * centre)
        });
        Self {
            before: (0..length as i64).map(|j| chirp_at(j).conj()).collect(),
            after: after.collect(),
            transformed: chirp,
            forward,
            inverse,
        }
    }

    /// The length of the memory that [`Self::transform`] needs beside its work.
    fn scratch_len(&self) -> usize {
        self.forward
            .get_inplace_scratch_len()
            .max(self.inverse.get_inplace_scratch_len())
    }

    fn transform<'a>(
        &'a self,
        values: impl Iterator<Item = Complex64>,
        work: &'a mut Vec<Complex64>,
        scratch: &mut [Complex64],
    ) -> impl Iterator<Item = Complex64> + 'a {
        work.clear();
        work.extend(values.zip(&self.before).map(|(v, factor)| v * factor));
        work.resize(self.transformed.len(), Complex64::default());
        self.forward.process_with_scratch(work, scratch);
        work.iter_mut()
            .zip(&self.transformed)
            .for_each(|(v, chirp)| *v *= chirp);
        self.inverse.process_with_scratch(work, scratch);
        let first = self.before.len() - 1;
        work[first..]
            .iter()
            .zip(&self.after)
            .map(|(v, factor)| v * factor)
    }
}
