//! Stamps with known answers.

#![allow(dead_code, reason = "each test file uses a part of it")]

use ndarray::Array2;

/// An elliptical Gaussian at pixel centres.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Gaussian {
    pub(crate) amplitude: f64,
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) sigma_major: f64,
    pub(crate) sigma_minor: f64,
    pub(crate) angle: f64,
    pub(crate) background: f64,
}

impl Gaussian {
    /// An ellipse of amplitude 3 near the middle of 64 x 64 pixels, without background.
    pub(crate) fn ellipse(sigma_major: f64, axis_ratio: f64, angle: f64) -> Self {
        Self {
            amplitude: 3.0,
            x: 32.3,
            y: 31.8,
            sigma_major,
            sigma_minor: sigma_major * axis_ratio,
            angle,
            background: 0.0,
        }
    }

    pub(crate) fn at(self, x: f64, y: f64) -> f64 {
        let (dx, dy) = (x - self.x, y - self.y);
        let (sin, cos) = self.angle.sin_cos();
        let u = (cos * dx + sin * dy) / self.sigma_major;
        let v = (cos * dy - sin * dx) / self.sigma_minor;
        self.background + self.amplitude * (-0.5 * (u * u + v * v)).exp()
    }

    pub(crate) fn stamp(self, ny: usize, nx: usize) -> Array2<f64> {
        Array2::from_shape_fn((ny, nx), |(y, x)| self.at(x as f64, y as f64))
    }
}

/// An elliptical Moffat profile at pixel centres, peak 1.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Moffat {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) major: f64,
    pub(crate) minor: f64,
    pub(crate) angle: f64,
    pub(crate) beta: f64,
}

impl Moffat {
    pub(crate) fn stamp(self, ny: usize, nx: usize) -> Array2<f64> {
        let (sin, cos) = self.angle.sin_cos();
        Array2::from_shape_fn((ny, nx), |(y, x)| {
            let (dx, dy) = (x as f64 - self.x, y as f64 - self.y);
            let u = (cos * dx + sin * dy) / self.major;
            let v = (cos * dy - sin * dx) / self.minor;
            (1.0 + u * u + v * v).powf(-self.beta)
        })
    }
}

/// Moffat profiles on 48 x 48 pixels that other software has also measured.
pub(crate) const MOFFATS: [Moffat; 3] = [
    Moffat {
        x: 24.3,
        y: 23.8,
        major: 3.0,
        minor: 2.0,
        angle: 0.5,
        beta: 3.0,
    },
    Moffat {
        x: 23.6,
        y: 24.4,
        major: 4.0,
        minor: 3.8,
        angle: -1.2,
        beta: 2.5,
    },
    Moffat {
        x: 25.1,
        y: 22.7,
        major: 5.2,
        minor: 3.6,
        angle: 2.0,
        beta: 4.0,
    },
];
