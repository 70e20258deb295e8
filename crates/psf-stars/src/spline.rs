//! Cubic B-splines on regular nodes.

use ndarray::{Array2, ArrayView2, Axis};

/// The four nodes that a coordinate needs, their weights, and the weights of the derivative.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Taps {
    pub(crate) first: i64,
    pub(crate) weight: [f64; 4],
    pub(crate) slope: [f64; 4],
}

impl Taps {
    pub(crate) fn at(t: f64) -> Self {
        let base = t.floor();
        let u = t - base;
        let v = 1.0 - u;
        Self {
            first: base as i64 - 1,
            weight: [
                v * v * v / 6.0,
                2.0 / 3.0 - u * u * (2.0 - u) / 2.0,
                2.0 / 3.0 - v * v * (2.0 - v) / 2.0,
                u * u * u / 6.0,
            ],
            slope: [
                -v * v / 2.0,
                u * (1.5 * u - 2.0),
                -v * (1.5 * v - 2.0),
                u * u / 2.0,
            ],
        }
    }
}

/// The interpolating spline of an array `[y, x]`, continued by mirroring about its outermost values.
#[derive(Debug, Clone)]
pub(crate) struct Spline {
    coefficients: Array2<f64>,
}

impl Spline {
    pub(crate) fn through(values: ArrayView2<'_, f64>) -> Self {
        let mut coefficients = values.as_standard_layout().into_owned();
        for axis in [Axis(0), Axis(1)] {
            for mut lane in coefficients.lanes_mut(axis) {
                let mut line = lane.to_vec();
                prefilter(&mut line);
                lane.iter_mut().zip(line).for_each(|(c, v)| *c = v);
            }
        }
        Self { coefficients }
    }

    /// The value at column `x` and row `y`, clamped to the array.
    pub(crate) fn at(&self, x: f64, y: f64) -> f64 {
        let (rows, columns) = self.coefficients.dim();
        let (tx, ty) = (
            Taps::at(x.clamp(0.0, (columns - 1) as f64)),
            Taps::at(y.clamp(0.0, (rows - 1) as f64)),
        );
        let mut sum = 0.0;
        for (j, wy) in ty.weight.iter().enumerate() {
            let row = self.coefficients.row(mirror(ty.first + j as i64, rows));
            let line: f64 = tx
                .weight
                .iter()
                .enumerate()
                .map(|(i, wx)| wx * row[mirror(tx.first + i as i64, columns)])
                .sum();
            sum += wy * line;
        }
        sum
    }
}

/// ... 2 1 | 0 1 2 ... n-1 | n-2 n-3 ...
fn mirror(index: i64, length: usize) -> usize {
    if length == 1 {
        return 0;
    }
    let last = length as i64 - 1;
    let folded = index.rem_euclid(2 * last);
    folded.min(2 * last - folded) as usize
}

/// From values to B-spline coefficients, in place: the recursive filter of Unser, Aldroubi and Eden 1993.
fn prefilter(line: &mut [f64]) {
    let n = line.len();
    if n == 1 {
        return;
    }
    let pole = 3f64.sqrt() - 2.0;
    let (mut start, mut power) = (0.0, 1.0);
    for k in 0..2 * n - 2 {
        start += power * line[mirror(k as i64, n)];
        power *= pole;
    }
    line[0] = start / (1.0 - power);
    for k in 1..n {
        line[k] += pole * line[k - 1];
    }
    line[n - 1] = pole / (pole * pole - 1.0) * (line[n - 1] + pole * line[n - 2]);
    for k in (0..n - 1).rev() {
        line[k] = pole * (line[k + 1] - line[k]);
    }
    for c in line {
        *c *= 6.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_passes_through_the_values_of_any_shape() {
        for (ny, nx) in [(1, 1), (1, 4), (2, 3), (9, 6)] {
            let values = Array2::from_shape_fn((ny, nx), |(y, x)| ((5 * y + 3 * x) % 7) as f64 - 2.0);
            let spline = Spline::through(values.view());
            for ((y, x), value) in values.indexed_iter() {
                assert!((spline.at(x as f64, y as f64) - value).abs() < 1e-13);
            }
        }
    }

    #[test]
    fn weights_add_up_and_slopes_are_their_derivatives() {
        for t in [0.0, 0.3, 0.99, 4.5] {
            let (taps, step) = (Taps::at(t), 1e-6);
            assert!((taps.weight.iter().sum::<f64>() - 1.0).abs() < 1e-15);
            let next = Taps::at(t + step);
            assert_eq!(taps.first, next.first);
            for k in 0..4 {
                let slope = (next.weight[k] - taps.weight[k]) / step;
                assert!((slope - taps.slope[k]).abs() < 1e-5);
            }
        }
    }
}
