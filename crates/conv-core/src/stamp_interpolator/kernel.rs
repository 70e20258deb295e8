//! Interpolation kernels of stamps along one axis, and the weights with which coefficients
//! contribute to interpolated values.

use std::f64::consts::PI;

use ndarray::parallel::prelude::*;
use ndarray::{Array2, ArrayView2, ArrayViewMut2, Axis, s};
use psf_types::StampInterpolation;
use psf_types::maths::{gauss_legendre, sinc, spline_weights};

/// A rule of interpolation, along one axis. Pixels beyond the outermost ones count as 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kernel {
    /// Interpolated values up to `reach` pixels beyond the outermost pixels are kept.
    CubicSpline {
        reach: usize,
    },
    Lanczos3,
}

/// The coefficient of a spline beyond the outermost pixel is the coefficient before it times this
/// pole of the spline's filter, `sqrt(3) - 2`.
pub(super) const POLE: f64 = -0.267_949_192_431_122_7;

/// The largest [`Kernel::CubicSpline`] reach, in pixels. Farther out, less than 1e-7 of the light
/// of the outermost pixels is left.
pub(crate) const MOST_REACH: usize = 12;

/// The most coefficients that contribute to an interpolated value along one axis.
pub(crate) const MOST_TAPS: usize = 6;

/// A coordinate at most this far beyond the outermost pixel counts as on that pixel: the difference
/// is rounding.
const EDGE: f64 = 1e-9;

/// Lines of a stamp that are filtered together.
const LINES: usize = 64;
/// Stamps with fewer coefficients are filtered on one thread, because callers process many of them in parallel.
const PARALLEL_FROM: usize = 1 << 20;

impl Kernel {
    /// The kernel of an interpolation. `reach` is that of a spline.
    pub(crate) fn of(interpolation: StampInterpolation, reach: usize) -> Self {
        match interpolation {
            StampInterpolation::Lanczos3 => Self::Lanczos3,
            _ => Self::CubicSpline { reach },
        }
    }

    /// Computes, from the values of a stamp, the coefficients that the weights multiply. On every
    /// side there are [`margin`](Self::margin) more coefficients than pixels.
    pub(crate) fn coefficients<V: Copy + Into<f64> + Sync>(self, values: ArrayView2<'_, V>) -> Array2<f64> {
        let margin = self.margin();
        let (ny, nx) = values.dim();
        let mut coefficients = Array2::zeros((ny + 2 * margin, nx + 2 * margin));
        coefficients
            .slice_mut(s![margin..margin + ny, margin..margin + nx])
            .zip_mut_with(&values, |c, &v| *c = v.into());
        if margin == 0 {
            return coefficients;
        }
        let at_once = if coefficients.len() < PARALLEL_FROM {
            usize::MAX
        } else {
            1
        };
        let columns = coefficients.axis_chunks_iter_mut(Axis(1), LINES).into_par_iter();
        columns
            .with_min_len(at_once)
            .for_each(|columns| filter_columns(columns, margin));
        let rows = coefficients.axis_chunks_iter_mut(Axis(0), LINES).into_par_iter();
        rows.with_min_len(at_once).for_each(|mut rows| {
            for mut row in rows.outer_iter_mut() {
                spline_filter(row.as_slice_mut().expect("row-major"), margin);
            }
        });
        coefficients
    }

    /// The number of coefficients before the first pixel and after the last one.
    fn margin(self) -> usize {
        match self {
            Self::CubicSpline { reach } => reach + 1,
            Self::Lanczos3 => 0,
        }
    }

    /// The number of coefficients that contribute to a value.
    pub(crate) fn tap_count(self) -> usize {
        match self {
            Self::CubicSpline { .. } => 4,
            Self::Lanczos3 => MOST_TAPS,
        }
    }

    /// The first coefficient that contributes to the value at a coordinate, as an offset (0 or
    /// negative) from the pixel at or below this coordinate.
    pub(crate) fn first_tap(self) -> i64 {
        1 - self.tap_count() as i64 / 2
    }

    /// The weights of the contributing coefficients, from the first coefficient to the last, for a
    /// coordinate that lies a fraction `u` (0 to 1) of a pixel above a pixel.
    pub(crate) fn weights(self, u: f64) -> [f64; MOST_TAPS] {
        match self {
            Self::CubicSpline { .. } => {
                let [a, b, c, d] = spline_weights(u);
                [a, b, c, d, 0.0, 0.0]
            }
            Self::Lanczos3 => {
                let weights: [f64; MOST_TAPS] = std::array::from_fn(|tap| {
                    let t = u - (self.first_tap() + tap as i64) as f64;
                    sinc(t) * sinc(t / 3.0)
                });
                let sum: f64 = weights.iter().sum();
                weights.map(|w| w / sum)
            }
        }
    }

    /// The derivatives of the [`weights`](Self::weights) with respect to `u`.
    pub(crate) fn slopes(self, u: f64) -> [f64; MOST_TAPS] {
        match self {
            Self::CubicSpline { .. } => {
                let v = 1.0 - u;
                let [a, d] = [-0.5 * v * v, 0.5 * u * u];
                [a, (1.5 * u - 2.0) * u, (2.0 - 1.5 * v) * v, d, 0.0, 0.0]
            }
            Self::Lanczos3 => {
                // That of sinc(t).
                let slope = |t: f64| {
                    if t.abs() < 1e-4 {
                        -PI * PI / 3.0 * t
                    } else {
                        ((PI * t).cos() - sinc(t)) / t
                    }
                };
                let at = |tap: usize| u - (self.first_tap() + tap as i64) as f64;
                let weight = |tap| sinc(at(tap)) * sinc(at(tap) / 3.0);
                let of_weight = |tap| {
                    let t = at(tap);
                    slope(t) * sinc(t / 3.0) + sinc(t) * slope(t / 3.0) / 3.0
                };
                let sum: f64 = (0..MOST_TAPS).map(weight).sum();
                let of_sum: f64 = (0..MOST_TAPS).map(of_weight).sum();
                // The weights are divided by their sum.
                std::array::from_fn(|tap| (of_weight(tap) - weight(tap) * of_sum / sum) / sum)
            }
        }
    }

    /// The largest sum of the absolute weights, at any coordinate.
    pub(crate) fn largest_sum(self) -> f64 {
        self.weights(0.5).iter().map(|w| w.abs()).sum()
    }

    /// The coordinates at which a stamp of `length` pixels has values.
    pub(crate) fn domain(self, length: usize) -> std::ops::RangeInclusive<f64> {
        let beyond = self.reach() + EDGE;
        -beyond..=(length - 1) as f64 + beyond
    }

    /// The distance from the outermost pixels up to which there are values, in pixels. Values at
    /// this distance are 0, unless the distance is 0.
    pub(crate) fn reach(self) -> f64 {
        match self {
            Self::CubicSpline { reach } => reach as f64,
            Self::Lanczos3 => 3.0,
        }
    }

    /// Converts the index of a pixel, which may lie outside the stamp, to the index of its
    /// coefficient. `None` if the coefficient is not used.
    pub(crate) fn index(self, index: i64, length: usize) -> Option<usize> {
        let margin = self.margin();
        let index = usize::try_from(index + margin as i64).ok();
        index.filter(|&i| i < length + 2 * margin)
    }
}

/// Converts values to the coefficients of their cubic B-spline, in place. The line starts and ends
/// with `margin` zeros. It continues by zeros at both ends, so the recursive filter starts from 0,
/// and the coefficients of the margins fall by the factor [`POLE`] from pixel to pixel.
fn spline_filter(line: &mut [f64], margin: usize) {
    let (from, to) = (margin, line.len() - margin);
    let mut before = 0.0;
    for c in &mut line[from..to] {
        before = *c + POLE * before;
        *c = before;
    }
    // The sum over the zeros beyond the last pixel, to which the filter leaves a falling tail.
    let mut after = POLE * POLE / (POLE * POLE - 1.0) * before;
    for c in line[from..to].iter_mut().rev() {
        after = POLE * (after - *c);
        *c = 6.0 * after;
    }
    for k in 0..margin {
        line[from - 1 - k] = POLE * line[from - k];
        line[to + k] = POLE * line[to + k - 1];
    }
}

/// As [`spline_filter`], for all columns of an array together.
fn filter_columns(mut columns: ArrayViewMut2<'_, f64>, margin: usize) {
    let (from, to) = (margin, columns.nrows() - margin);
    let mut before = vec![0.0; columns.ncols()];
    for row in from..to {
        let mut values = columns.row_mut(row);
        for (c, before) in values.iter_mut().zip(&mut before) {
            *before = *c + POLE * *before;
            *c = *before;
        }
    }
    // The sum over the zeros beyond the last pixel, as for a line.
    let mut after: Vec<f64> = before
        .iter()
        .map(|v| POLE * POLE / (POLE * POLE - 1.0) * v)
        .collect();
    for row in (from..to).rev() {
        let mut values = columns.row_mut(row);
        for (c, after) in values.iter_mut().zip(&mut after) {
            *after = POLE * (*after - *c);
            *c = 6.0 * *after;
        }
    }
    for k in 0..margin {
        for [to, from] in [[from - 1 - k, from - k], [to + k, to + k - 1]] {
            let (mut to, from) = columns.multi_slice_mut((s![to, ..], s![from, ..]));
            to.zip_mut_with(&from, |to, from| *to = POLE * from);
        }
    }
}

/// The coefficients that contribute to each of several values: their indices and weights. No
/// coefficient contributes to a value at a coordinate outside [`Kernel::domain`].
#[derive(Debug)]
pub(crate) struct Taps {
    starts: Vec<usize>,
    taps: Vec<(usize, f64)>,
}

/// Nodes and weights on 0 to 1: exact for the pieces of a cubic spline, and accurate to 1e-7 for the
/// pieces of a Lanczos kernel.
const GAUSS: [(f64, f64); 4] = gauss_legendre();

impl Taps {
    /// The taps of `count` values at the coordinates that `coordinate` returns, along a stamp of
    /// `length` pixels. If `width` is above 0, each value is the average over `width` pixels around
    /// its coordinate.
    pub(crate) fn new(
        kernel: Kernel,
        length: usize,
        width: f64,
        count: usize,
        coordinate: impl Fn(usize) -> f64,
    ) -> Self {
        Self::of_values(kernel, count, |all, i| {
            if width > 0.0 {
                all.push_average(kernel, length, coordinate(i), width);
            } else {
                all.push_point(kernel, length, coordinate(i), 1.0, Kernel::weights);
            }
        })
    }

    /// The taps whose sums are the derivatives of values with respect to their coordinates, times `scale`.
    pub(crate) fn slopes(
        kernel: Kernel,
        length: usize,
        scale: f64,
        count: usize,
        coordinate: impl Fn(usize) -> f64,
    ) -> Self {
        Self::of_values(kernel, count, |all, i| {
            all.push_point(kernel, length, coordinate(i), scale, Kernel::slopes);
        })
    }

    /// The taps that `push` adds for each of `count` values.
    fn of_values(kernel: Kernel, count: usize, push: impl Fn(&mut Self, usize)) -> Self {
        let mut all = Self {
            starts: Vec::with_capacity(count + 1),
            taps: Vec::with_capacity(count * kernel.tap_count()),
        };
        for i in 0..count {
            all.starts.push(all.taps.len());
            push(&mut all, i);
        }
        all.starts.push(all.taps.len());
        all
    }

    pub(crate) fn of(&self, value: usize) -> &[(usize, f64)] {
        &self.taps[self.starts[value]..self.starts[value + 1]]
    }

    fn push_point(
        &mut self,
        kernel: Kernel,
        length: usize,
        t: f64,
        scale: f64,
        weights: fn(Kernel, f64) -> [f64; MOST_TAPS],
    ) {
        if !kernel.domain(length).contains(&t) {
            return;
        }
        let t = t.clamp(-kernel.reach(), (length - 1) as f64 + kernel.reach());
        let first = t.floor() as i64 + kernel.first_tap();
        let weights = weights(kernel, t - t.floor());
        for (tap, weight) in weights.iter().take(kernel.tap_count()).enumerate() {
            if let Some(index) = kernel.index(first + tap as i64, length) {
                self.taps.push((index, weight * scale));
            }
        }
    }

    /// Adds the taps of the average over `width` pixels around `t`. Integrates piece by piece
    /// between the stamp's pixels, where the kernels are smooth.
    fn push_average(&mut self, kernel: Kernel, length: usize, t: f64, width: f64) {
        let domain = kernel.domain(length);
        let from = (t - width / 2.0).max(*domain.start());
        let to = (t + width / 2.0).min(*domain.end());
        let begin = self.taps.len();
        let mut piece = from;
        while piece < to {
            let end = (piece.floor() + 1.0).min(to);
            let part = end - piece;
            for (node, weight) in GAUSS {
                let scale = weight * part / width;
                self.push_point(kernel, length, piece + part * node, scale, Kernel::weights);
            }
            piece = end;
        }
        // Sums the weights of equal indices.
        let mut taps = self.taps.split_off(begin);
        taps.sort_by_key(|&(index, _)| index);
        taps.dedup_by(|next, kept| {
            let is_same = next.0 == kept.0;
            if is_same {
                kept.1 += next.1;
            }
            is_same
        });
        self.taps.extend(taps);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KERNELS: [Kernel; 3] = [
        Kernel::CubicSpline { reach: 0 },
        Kernel::CubicSpline { reach: 2 },
        Kernel::Lanczos3,
    ];

    #[test]
    fn weights_add_up_to_one_and_pick_pixels() {
        for kernel in KERNELS {
            for i in 0..=20 {
                let sum: f64 = kernel.weights(f64::from(i) / 20.0).iter().sum();
                assert!((sum - 1.0).abs() < 1e-14, "{kernel:?}");
            }
        }
        let at_pixel = Kernel::Lanczos3.weights(0.0);
        assert!((at_pixel[2] - 1.0).abs() < 1e-15 && at_pixel[3].abs() < 1e-15);
    }

    #[test]
    fn slopes_are_the_derivatives_of_weights() {
        for kernel in KERNELS {
            for u in [0.0, 1e-5, 0.3, 0.77, 0.99999, 1.0] {
                let step = 1e-3;
                let at = |t: f64| kernel.weights(u + t * step);
                let (far, near) = ([at(-2.0), at(2.0)], [at(-1.0), at(1.0)]);
                for (tap, slope) in kernel.slopes(u).into_iter().enumerate() {
                    let [far, near] = [&far, &near].map(|w| w[1][tap] - w[0][tap]);
                    let difference = (8.0 * near - far) / (12.0 * step);
                    assert!((slope - difference).abs() < 1e-9, "{kernel:?} {u} {tap}");
                }
            }
        }
    }

    #[test]
    fn the_weights_are_symmetric() {
        for kernel in KERNELS {
            let count = kernel.tap_count();
            let (a, b) = (kernel.weights(0.3), kernel.weights(0.7));
            for tap in 0..count {
                assert!((a[tap] - b[count - 1 - tap]).abs() < 1e-14);
            }
        }
    }

    #[test]
    fn an_average_over_whole_pixels_keeps_a_constant() {
        for kernel in KERNELS {
            for width in [0.0, 1.0, 2.1, 4.0] {
                let taps = Taps::new(kernel, 20, width, 1, |_| 9.37);
                let sum: f64 = taps.of(0).iter().map(|t| t.1).sum();
                assert!((sum - 1.0).abs() < 1e-13, "{kernel:?} {width}: {sum}");
            }
        }
    }

    #[test]
    fn values_beyond_the_stamp_have_no_taps() {
        for kernel in KERNELS {
            let taps = Taps::new(kernel, 5, 0.0, 2, |i| [-3.5, 7.5][i]);
            assert!(taps.of(0).is_empty() && taps.of(1).is_empty());
        }
    }
}
