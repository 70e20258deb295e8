//! The covariances of kriging, and its coordinates.

use psf_types::{KrigingKernel, KrigingParameters};

use crate::geometry::{Point, range};

/// Scaled coordinates: 0 at the middle of the samples' bounding box, and 1 at the ends of its longer
/// side.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scaled {
    centre: Point,
    half: f64,
}

impl Scaled {
    pub(crate) fn of(points: &[Point]) -> Self {
        let ranges = [0, 1].map(|axis| range(points, axis));
        let half = ranges
            .iter()
            .map(|(low, high)| 0.5 * (high - low))
            .fold(0.0, f64::max);
        Self {
            centre: ranges.map(|(low, high)| f64::midpoint(low, high)),
            half: if half > 0.0 { half } else { 1.0 },
        }
    }

    /// A scaled distance in pixels.
    pub(crate) fn pixels(&self, distance: f64) -> f64 {
        distance * self.half
    }

    pub(crate) fn at(&self, p: Point) -> Point {
        [0, 1].map(|axis| (p[axis] - self.centre[axis]) / self.half)
    }
}

/// A covariance as a function of two scaled points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Covariance {
    kernel: KrigingKernel,
    inverse_lengths: Point,
}

impl Covariance {
    pub(super) fn new(parameters: &KrigingParameters) -> Self {
        Self {
            kernel: parameters.kernel(),
            inverse_lengths: parameters.lengths().map(f64::recip),
        }
    }

    pub(super) fn between(&self, a: Point, b: Point) -> f64 {
        let d = [0, 1].map(|axis| (a[axis] - b[axis]) * self.inverse_lengths[axis]);
        let square = d[0] * d[0] + d[1] * d[1];
        match self.kernel {
            KrigingKernel::Matern52 => {
                let s = (5.0 * square).sqrt();
                (1.0 + s + s * s / 3.0) * (-s).exp()
            }
            KrigingKernel::Matern32 => {
                let s = (3.0 * square).sqrt();
                (1.0 + s) * (-s).exp()
            }
            KrigingKernel::ThinPlate if square == 0.0 => 0.0,
            KrigingKernel::ThinPlate => 0.5 * square * square.ln(),
            KrigingKernel::Cubic => square * square.sqrt(),
            KrigingKernel::Quintic => -square * square * square.sqrt(),
            // Gaussian.
            _ => (-0.5 * square).exp(),
        }
    }
}

/// The terms `x^i y^j`, `i + j <= degree`, at a scaled point.
pub(super) fn terms(degree: usize, [x, y]: Point) -> impl Iterator<Item = f64> {
    (0..=degree).flat_map(move |i| (0..=degree - i).map(move |j| x.powi(i as i32) * y.powi(j as i32)))
}
