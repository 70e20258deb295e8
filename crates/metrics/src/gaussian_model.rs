//! The Gaussian that is fitted, and its derivatives.

use nalgebra::SVector;

use crate::window::Cutout;
use crate::{Covariance, MetricsError};

/// Which ellipses a fit may use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Profile {
    Round,
    Elliptical,
}

/// A Gaussian at pixel centres, in parameters that are free of bounds:
///
/// ```text
/// m(x, y) = A exp(-(u^2 + v^2) / 2) + B      (u, v) = L^T (x - x0, y - y0)      L L^T = inverse covariance
/// ```
///
/// Round: `A, x0, y0, s` with `u = e^s dx`, `v = e^s dy`. Elliptical: `A, x0, y0, a, b, c` with `u = e^a dx + b dy`,
/// `v = e^c dy`. The background `B`, if fitted, comes last. Any values make a positive definite covariance, and nothing
/// special happens where the ellipse is round.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GaussianModel {
    profile: Profile,
    background: bool,
}

/// A starting point of the fit: a round Gaussian.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Start {
    pub(crate) amplitude: f64,
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) sigma: f64,
    pub(crate) background: f64,
}

impl GaussianModel {
    pub(crate) fn new(profile: Profile, background: bool) -> Self {
        Self { profile, background }
    }

    pub(crate) fn parameters<const N: usize>(self, start: Start) -> SVector<f64, N> {
        let inverse_width = -start.sigma.ln();
        let mut p = SVector::zeros();
        p[0] = start.amplitude;
        p[1] = start.x;
        p[2] = start.y;
        p[3] = inverse_width;
        if self.profile == Profile::Elliptical {
            p[5] = inverse_width;
        }
        if self.background {
            p[N - 1] = start.background;
        }
        p
    }

    pub(crate) fn background<const N: usize>(self, p: &SVector<f64, N>) -> Option<f64> {
        self.background.then(|| p[N - 1])
    }

    pub(crate) fn covariance<const N: usize>(self, p: &SVector<f64, N>) -> Result<Covariance, MetricsError> {
        match self.profile {
            Profile::Round => {
                let variance = (-2.0 * p[3]).exp();
                Covariance::new(variance, 0.0, variance)
            }
            Profile::Elliptical => {
                let (lxx, lyx, lyy) = (p[3].exp(), p[4], p[5].exp());
                let tilt = lyx / (lxx * lyy);
                Covariance::new(1.0 / (lxx * lxx) + tilt * tilt, -tilt / lyy, 1.0 / (lyy * lyy))
            }
        }
    }

    /// Calls `visit(model - value, derivatives)` for every pixel.
    pub(crate) fn residuals<const N: usize>(
        self,
        p: &SVector<f64, N>,
        cutout: &Cutout,
        mut visit: impl FnMut(f64, &[f64; N]),
    ) {
        let (amplitude, x0, y0) = (p[0], p[1], p[2]);
        let (lxx, lyx, lyy) = match self.profile {
            Profile::Round => (p[3].exp(), 0.0, p[3].exp()),
            Profile::Elliptical => (p[3].exp(), p[4], p[5].exp()),
        };
        let background = self.background(p).unwrap_or(0.0);
        let mut derivatives = [0.0; N];
        for (x, y, value) in cutout.pixels() {
            let (dx, dy) = (x - x0, y - y0);
            let (u, v) = (lxx * dx + lyx * dy, lyy * dy);
            let shape = (-0.5 * (u * u + v * v)).exp();
            let gauss = amplitude * shape;
            derivatives[0] = shape;
            derivatives[1] = gauss * u * lxx;
            derivatives[2] = gauss * (u * lyx + v * lyy);
            match self.profile {
                Profile::Round => derivatives[3] = -gauss * (u * u + v * v),
                Profile::Elliptical => {
                    derivatives[3] = -gauss * u * lxx * dx;
                    derivatives[4] = -gauss * u * dy;
                    derivatives[5] = -gauss * v * v;
                }
            }
            if self.background {
                derivatives[N - 1] = 1.0;
            }
            visit(gauss + background - value, &derivatives);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Window;
    use ndarray::Array2;

    /// Central differences with step h err by h^2, relative to values of order 1.
    const DIFFERENCE_TOLERANCE: f64 = 1e-8;

    fn check<const N: usize>(model: GaussianModel, p: SVector<f64, N>) {
        let cutout = Window::whole()
            .cut(Array2::<f64>::zeros((9, 8)).view(), 1)
            .unwrap();
        let collect = |p: &SVector<f64, N>| {
            let mut all = Vec::new();
            model.residuals(p, &cutout, |r, d: &[f64; N]| all.push((r, *d)));
            all
        };
        let h = 1e-5;
        let at = collect(&p);
        for k in 0..N {
            let (mut up, mut down) = (p, p);
            up[k] += h;
            down[k] -= h;
            for ((above, below), here) in collect(&up).iter().zip(collect(&down)).zip(&at) {
                let slope = (above.0 - below.0) / (2.0 * h);
                assert!(
                    (slope - here.1[k]).abs() < DIFFERENCE_TOLERANCE,
                    "parameter {k}: {slope} {}",
                    here.1[k]
                );
            }
        }
    }

    #[test]
    fn the_derivatives_are_those_of_the_model() {
        let round = |b| GaussianModel::new(Profile::Round, b);
        let elliptical = |b| GaussianModel::new(Profile::Elliptical, b);
        check(round(false), SVector::from([1.3, 3.2, 4.4, -0.3]));
        check(round(true), SVector::from([1.3, 3.2, 4.4, -0.3, 0.7]));
        check(elliptical(false), SVector::from([1.3, 3.2, 4.4, -0.3, 0.2, -0.6]));
        check(
            elliptical(true),
            SVector::from([-1.3, 3.2, 4.4, -0.3, -0.4, 0.1, 0.7]),
        );
    }

    #[test]
    fn the_covariance_inverts_the_factor() {
        let p = SVector::from([1.0, 0.0, 0.0, -0.3, 0.2, -0.6]);
        let c = GaussianModel::new(Profile::Elliptical, false)
            .covariance(&p)
            .unwrap();
        let (lxx, lyx, lyy) = (p[3].exp(), p[4], p[5].exp());
        let inverse = (lxx * lxx, lxx * lyx, lyx * lyx + lyy * lyy);
        let product = [
            inverse.0 * c.xx() + inverse.1 * c.xy() - 1.0,
            inverse.0 * c.xy() + inverse.1 * c.yy(),
            inverse.1 * c.xx() + inverse.2 * c.xy(),
            inverse.1 * c.xy() + inverse.2 * c.yy() - 1.0,
        ];
        assert!(
            product.iter().all(|v| v.abs() < 8.0 * f64::EPSILON),
            "{product:?}"
        );
    }
}
