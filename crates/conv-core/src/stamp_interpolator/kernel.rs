//! What a value between pixels is made of.

use std::f64::consts::PI;

use ndarray::{Array2, ArrayView2, Axis};
use psf_types::StampInterpolation;

use super::bspline::{mirror, prefilter};

/// A rule of interpolation, along one axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kernel {
    CubicSpline,
    Lanczos3,
}

/// The most coefficients that a value is made of.
pub(crate) const MOST_TAPS: usize = 6;

/// A coordinate this far beyond the outermost pixel still counts as on it: rounding, not position.
const EDGE: f64 = 1e-9;

impl Kernel {
    pub(crate) fn of(interpolation: StampInterpolation) -> Self {
        match interpolation {
            StampInterpolation::Lanczos3 => Self::Lanczos3,
            _ => Self::CubicSpline,
        }
    }

    /// What the weights multiply, from the values of a stamp.
    pub(crate) fn coefficients(self, values: ArrayView2<'_, f64>) -> Array2<f64> {
        let mut coefficients = values.as_standard_layout().into_owned();
        if self == Self::CubicSpline {
            for axis in [Axis(0), Axis(1)] {
                for mut lane in coefficients.lanes_mut(axis) {
                    let mut line = lane.to_vec();
                    prefilter(&mut line);
                    lane.iter_mut().zip(line).for_each(|(c, v)| *c = v);
                }
            }
        }
        coefficients
    }

    /// Coefficients a value is made of.
    pub(crate) fn tap_count(self) -> usize {
        match self {
            Self::CubicSpline => 4,
            Self::Lanczos3 => MOST_TAPS,
        }
    }

    /// The first of them, counted from the pixel below the coordinate.
    pub(crate) fn first_tap(self) -> i64 {
        1 - self.tap_count() as i64 / 2
    }

    /// Their weights at a fraction of a pixel, 0 to 1, above that pixel.
    pub(crate) fn weights(self, u: f64) -> [f64; MOST_TAPS] {
        match self {
            Self::CubicSpline => {
                let v = 1.0 - u;
                [
                    v * v * v / 6.0,
                    2.0 / 3.0 - u * u * (2.0 - u) / 2.0,
                    2.0 / 3.0 - v * v * (2.0 - v) / 2.0,
                    u * u * u / 6.0,
                    0.0,
                    0.0,
                ]
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

    /// The coordinates at which a stamp of `length` pixels has values.
    pub(crate) fn domain(self, length: usize) -> std::ops::RangeInclusive<f64> {
        let last = (length - 1) as f64;
        match self {
            Self::CubicSpline => -EDGE..=last + EDGE,
            Self::Lanczos3 => -3.0..=last + 3.0,
        }
    }

    /// Pixels beyond the outermost ones where there still are values.
    pub(crate) fn reach(self) -> f64 {
        match self {
            Self::CubicSpline => 0.0,
            Self::Lanczos3 => 3.0,
        }
    }

    /// The coefficient that stands at an index which may lie off the stamp; none where there is nothing.
    pub(crate) fn index(self, index: i64, length: usize) -> Option<usize> {
        match self {
            Self::CubicSpline => Some(mirror(index, length)),
            Self::Lanczos3 => usize::try_from(index).ok().filter(|&i| i < length),
        }
    }

    /// The pixel at or below a coordinate, and the fraction above it.
    pub(crate) fn split(self, t: f64, length: usize) -> (i64, f64) {
        let t = match self {
            Self::CubicSpline => t.clamp(0.0, (length - 1) as f64),
            Self::Lanczos3 => t,
        };
        (t.floor() as i64, t - t.floor())
    }
}

fn sinc(t: f64) -> f64 {
    if t == 0.0 { 1.0 } else { (PI * t).sin() / (PI * t) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_add_up_to_one_and_pick_pixels() {
        for kernel in [Kernel::CubicSpline, Kernel::Lanczos3] {
            for i in 0..=20 {
                let sum: f64 = kernel.weights(f64::from(i) / 20.0).iter().sum();
                assert!((sum - 1.0).abs() < 1e-14, "{kernel:?}");
            }
        }
        let at_pixel = Kernel::Lanczos3.weights(0.0);
        assert!((at_pixel[2] - 1.0).abs() < 1e-15 && at_pixel[3].abs() < 1e-15);
    }

    #[test]
    fn the_weights_are_symmetric() {
        for kernel in [Kernel::CubicSpline, Kernel::Lanczos3] {
            let count = kernel.tap_count();
            let (a, b) = (kernel.weights(0.3), kernel.weights(0.7));
            for tap in 0..count {
                assert!((a[tap] - b[count - 1 - tap]).abs() < 1e-14);
            }
        }
    }
}
