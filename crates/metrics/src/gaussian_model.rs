//! The Gaussian that is fitted, its derivatives, and the start of the fit.

use nalgebra::{SMatrix, SVector};
use ndarray::{Array2, s};

use crate::levenberg_marquardt::Linearised;
use crate::window::Cutout;
use crate::{Covariance, MetricsError};

/// The kind of ellipse that a fit uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Profile {
    Round,
    Elliptical,
}

/// A Gaussian, evaluated at pixel centres:
///
/// ```text
/// m(x, y) = A exp(-(u^2 + v^2) / 2) + B
/// (u, v) = L^T (x - x0, y - y0)            L L^T = inverse covariance
/// ```
///
/// With `dx = x - x0` and `dy = y - y0`, a round model has the parameters `A, x0, y0, s` in
/// `u = e^s dx` and `v = e^s dy`. An elliptical model has `A, x0, y0, a, b, c` in
/// `u = e^a dx + b dy` and `v = e^c dy`. The background `B`, if fitted, is the last parameter. Any
/// values give a positive definite covariance, so the parameters need no bounds. A round ellipse is
/// not a special case.
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

    /// Half the sum of squared residuals at the parameters `p`, with its gradient and its normal
    /// matrix.
    pub(crate) fn linearise<const N: usize>(self, p: &SVector<f64, N>, cutout: &Cutout) -> Linearised<N> {
        let mut cost = 0.0;
        let mut gradient = [0.0; N];
        let mut normal = [[0.0; N]; N];
        self.residuals(p, cutout, |residual, derivatives| {
            cost += 0.5 * residual * residual;
            for i in 0..N {
                gradient[i] += residual * derivatives[i];
                for j in 0..=i {
                    normal[i][j] += derivatives[i] * derivatives[j];
                }
            }
        });
        Linearised {
            cost,
            gradient: SVector::from(gradient),
            normal: SMatrix::from_fn(|i, j| normal[i.max(j)][i.min(j)]),
        }
    }
}

const FIRST_SIGMA_PX: f64 = 0.4;
const SIGMA_RATIO: f64 = 1.5;

/// Returns the best round Gaussian of a coarse search, or `None` if none has a positive amplitude.
///
/// It tries three centres: the brightest pixel, and the centre of the brightest box, for boxes with
/// sides of 3 pixels and of about a quarter of the window's shorter side. The boxes find a wide PSF
/// in noise. The sigmas are a geometric series from 0.4 pixels to the window's longer side. For
/// each pair of centre and sigma, linear least squares give the amplitude and the background. The
/// pair with the smallest sum of squares is returned.
pub(crate) fn coarse_search(cutout: &Cutout, background: bool) -> Option<Start> {
    let (rows, columns) = cutout.values.dim();
    let mut centres = Vec::new();
    for half in [0, 1, rows.min(columns) / 8] {
        let centre = brightest_box(&cutout.values, half);
        if !centres.contains(&centre) {
            centres.push(centre);
        }
    }
    let mut best: Option<(f64, Start)> = None;
    for (row, column) in centres {
        let mut sigma = FIRST_SIGMA_PX;
        while sigma <= rows.max(columns) as f64 {
            if let Some((gain, start)) = linear_fit(cutout, column as f64, row as f64, sigma, background)
                && best.is_none_or(|(most, _)| gain > most)
            {
                best = Some((gain, start));
            }
            sigma *= SIGMA_RATIO;
        }
    }
    best.map(|(_, start)| start)
}

/// Fits the amplitude and the background of a round Gaussian with a given centre and sigma. Returns
/// the amount by which the Gaussian decreases the sum of squares, and the Gaussian. Returns `None`
/// if the amplitude is not positive.
fn linear_fit(cutout: &Cutout, x: f64, y: f64, sigma: f64, background: bool) -> Option<(f64, Start)> {
    let (rows, columns) = cutout.values.dim();
    let profile = |n: usize, centre: f64| -> Vec<f64> {
        (0..n)
            .map(|i| (-0.5 * ((i as f64 - centre) / sigma).powi(2)).exp())
            .collect()
    };
    let (along_x, along_y) = (profile(columns, x), profile(rows, y));
    let (mut gg, mut gd, mut g, mut d) = (0.0, 0.0, 0.0, 0.0);
    for (row, wy) in cutout.values.rows().into_iter().zip(&along_y) {
        for (value, wx) in row.iter().zip(&along_x) {
            let w = wx * wy;
            gg += w * w;
            gd += w * value;
            g += w;
            d += value;
        }
    }
    let n = cutout.values.len() as f64;
    let (power, product) = if background {
        (gg - g * g / n, gd - g * d / n)
    } else {
        (gg, gd)
    };
    let amplitude = product / power;
    (amplitude > 0.0 && amplitude.is_finite()).then(|| {
        let start = Start {
            amplitude,
            x,
            y,
            sigma,
            background: if background { (d - amplitude * g) / n } else { 0.0 },
        };
        (amplitude * product, start)
    })
}

/// Row and column of the centre of the brightest box. A box has sides of `2 half + 1` pixels and
/// lies entirely on the array.
fn brightest_box(values: &Array2<f64>, half: usize) -> (usize, usize) {
    let side = 2 * half + 1;
    let along_x = running_sums(values, side);
    let sums = running_sums(&along_x.t().to_owned(), side);
    let mut best = (f64::NEG_INFINITY, (half, half));
    for ((column, row), &sum) in sums.indexed_iter() {
        if sum > best.0 {
            best = (sum, (row + half, column + half));
        }
    }
    best.1
}

/// Sums of every `side` consecutive values along the last axis.
fn running_sums(values: &Array2<f64>, side: usize) -> Array2<f64> {
    let (rows, columns) = values.dim();
    Array2::from_shape_fn((rows, columns + 1 - side), |(i, j)| {
        values.slice(s![i, j..j + side]).sum()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Window;

    /// The error of central differences with step h is of order h^2, relative to values of order 1.
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

    #[test]
    fn the_brightest_box_is_found() {
        let mut values = Array2::zeros((8, 11));
        values[[1, 2]] = 5.0;
        values.slice_mut(s![4..7, 6..9]).fill(1.0);
        assert_eq!(brightest_box(&values, 0), (1, 2));
        assert_eq!(brightest_box(&values, 1), (5, 7));
    }
}
