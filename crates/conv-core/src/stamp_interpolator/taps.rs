//! The coefficients that the values along an axis are made of.

use super::kernel::Kernel;

/// Index and weight of every coefficient, value by value. A value beyond the stamp has none.
#[derive(Debug)]
pub(crate) struct Taps {
    starts: Vec<usize>,
    taps: Vec<(usize, f64)>,
}

/// Gauss-Legendre nodes and weights on [-1, 1]: exact for the pieces of a cubic spline, and to 1e-7 for those of a Lanczos kernel.
const GAUSS: [(f64, f64); 4] = [
    (-0.861_136_311_594_052_6, 0.347_854_845_137_453_86),
    (-0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
    (0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
    (0.861_136_311_594_052_6, 0.347_854_845_137_453_86),
];

impl Taps {
    /// Those of `count` values at the coordinates that `coordinate` gives, along a stamp of `length` pixels; averages over `width`
    /// pixels about them where that is above 0.
    pub(crate) fn new(
        kernel: Kernel,
        length: usize,
        width: f64,
        count: usize,
        coordinate: impl Fn(usize) -> f64,
    ) -> Self {
        let mut all = Self {
            starts: Vec::with_capacity(count + 1),
            taps: Vec::with_capacity(count * kernel.tap_count()),
        };
        for i in 0..count {
            all.starts.push(all.taps.len());
            if width > 0.0 {
                all.push_average(kernel, length, coordinate(i), width);
            } else {
                all.push_point(kernel, length, coordinate(i), 1.0);
            }
        }
        all.starts.push(all.taps.len());
        all
    }

    pub(crate) fn of(&self, value: usize) -> &[(usize, f64)] {
        &self.taps[self.starts[value]..self.starts[value + 1]]
    }

    fn push_point(&mut self, kernel: Kernel, length: usize, t: f64, scale: f64) {
        if !kernel.domain(length).contains(&t) {
            return;
        }
        let (pixel, u) = kernel.split(t, length);
        let first = pixel + kernel.first_tap();
        let weights = kernel.weights(u);
        for (tap, weight) in weights.iter().take(kernel.tap_count()).enumerate() {
            if let Some(index) = kernel.index(first + tap as i64, length) {
                self.taps.push((index, weight * scale));
            }
        }
    }

    /// Piece by piece between the stamp's pixels, where the kernels are smooth.
    fn push_average(&mut self, kernel: Kernel, length: usize, t: f64, width: f64) {
        let domain = kernel.domain(length);
        let from = (t - width / 2.0).max(*domain.start());
        let to = (t + width / 2.0).min(*domain.end());
        let begin = self.taps.len();
        let mut piece = from;
        while piece < to {
            let end = (piece.floor() + 1.0).min(to);
            let (middle, half) = (f64::midpoint(piece, end), (end - piece) / 2.0);
            for (node, weight) in GAUSS {
                self.push_point(kernel, length, middle + half * node, weight * half / width);
            }
            piece = end;
        }
        self.merge(begin);
    }

    /// Adds up the weights of equal indices.
    fn merge(&mut self, begin: usize) {
        self.taps[begin..].sort_by_key(|&(index, _)| index);
        let mut kept = begin;
        for i in begin..self.taps.len() {
            let (index, weight) = self.taps[i];
            if kept > begin && self.taps[kept - 1].0 == index {
                self.taps[kept - 1].1 += weight;
            } else {
                self.taps[kept] = (index, weight);
                kept += 1;
            }
        }
        self.taps.truncate(kept);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_average_over_whole_pixels_keeps_a_constant() {
        for kernel in [Kernel::CubicSpline, Kernel::Lanczos3] {
            for width in [0.0, 1.0, 2.1, 4.0] {
                let taps = Taps::new(kernel, 20, width, 1, |_| 9.37);
                let sum: f64 = taps.of(0).iter().map(|t| t.1).sum();
                assert!((sum - 1.0).abs() < 1e-13, "{kernel:?} {width}: {sum}");
            }
        }
    }

    #[test]
    fn what_lies_beyond_the_stamp_has_no_taps() {
        for kernel in [Kernel::CubicSpline, Kernel::Lanczos3] {
            let taps = Taps::new(kernel, 5, 0.0, 2, |i| [-3.5, 7.5][i]);
            assert!(taps.of(0).is_empty() && taps.of(1).is_empty());
        }
    }
}
