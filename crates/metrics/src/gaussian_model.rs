//! The Gaussian that is fitted, its derivatives, and the start of the fit.

use nalgebra::{SMatrix, SVector};
use ndarray::{Array2, s};

use crate::gaussian_rows::{GaussianRow, LARGEST_REACH, MonomialSums, UnitGaussian, dot, reach};
use crate::levenberg_marquardt::Linearised;
use crate::window::Cutout;
use crate::{Covariance, MetricsError};

/// The model is never cut off at a smaller distance. Where it covers a single pixel, its slope at
/// the neighbours tells the fit that it is too narrow.
const NEIGHBOURS_PX: f64 = 5.0;

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

    /// The Gaussian of height 1 with the centre and the width of the parameters `p`.
    fn unit_gaussian<const N: usize>(self, p: &SVector<f64, N>) -> UnitGaussian {
        let (lyx, lyy) = match self.profile {
            Profile::Round => (0.0, p[3].exp()),
            Profile::Elliptical => (p[4], p[5].exp()),
        };
        UnitGaussian {
            x: p[1],
            y: p[2],
            lxx: p[3].exp(),
            lyx,
            lyy,
        }
    }

    /// Half the sum of squared residuals at the parameters `p`, with its gradient, its normal matrix
    /// and, near the minimum, its second derivatives.
    pub(crate) fn linearise<const N: usize>(self, p: &SVector<f64, N>, cutout: &Cutout) -> Linearised<N> {
        let (rows, columns) = cutout.values.dim();
        let gaussian = self.unit_gaussian(p);
        let amplitude = p[0];
        let background = self.background(p).unwrap_or(0.0);
        // The values are at most 1.
        let reach = reach(1.0 + amplitude.abs(), rows * columns, 1.0)
            .max(NEIGHBOURS_PX * gaussian.lxx.max(gaussian.lyy))
            .min(LARGEST_REACH);
        let mut row = GaussianRow::new(columns);
        let mut residuals = vec![0.0; columns];
        let mut derivatives = [(); N].map(|()| vec![1.0; columns]);
        let mut cost = 0.0;
        let mut gradient = SVector::<f64, N>::zeros();
        let mut normal = SMatrix::<f64, N, N>::zeros();
        let mut of_residual = MonomialSums::default();
        for (i, values) in cutout.rows().enumerate() {
            for (residual, value) in residuals.iter_mut().zip(values) {
                *residual = background - value;
            }
            row.evaluate(gaussian, i, reach);
            let near = &mut residuals[row.columns()];
            for (residual, g) in near.iter_mut().zip(row.values()) {
                *residual += amplitude * g;
            }
            self.differentiate(amplitude, gaussian, &row, &mut derivatives);
            let n = near.len();
            for i in 0..N {
                let derivative = &derivatives[i][..n];
                gradient[i] += dot(derivative, near);
                for j in 0..=i {
                    normal[(i, j)] += dot(derivative, &derivatives[j][..n]);
                }
            }
            of_residual.add(&row, near);
            cost += 0.5 * dot(&residuals, &residuals);
            if self.background {
                // The background is in the residuals of all pixels.
                let columns = row.columns();
                gradient[N - 1] += residuals[..columns.start].iter().sum::<f64>();
                gradient[N - 1] += residuals[columns.end..].iter().sum::<f64>();
            }
        }
        if self.background {
            normal[(N - 1, N - 1)] = (rows * columns) as f64;
        }
        normal.fill_upper_triangle_with_lower_triangle();
        // Of the second derivatives `A g (f' f' + f'')` of `A g = A exp(f)`, only the first term
        // matters: at the minimum, the residuals are orthogonal to the polynomials of the second.
        let slopes = self.log_derivatives::<N>(gaussian);
        let curvature = slopes * of_residual.products() * slopes.transpose() * amplitude;
        Linearised {
            cost,
            gradient,
            normal,
            hessian: normal + curvature,
        }
    }

    /// The derivatives of the model by all parameters but the background, on a row.
    fn differentiate<const N: usize>(
        self,
        amplitude: f64,
        gaussian: UnitGaussian,
        row: &GaussianRow,
        derivatives: &mut [Vec<f64>; N],
    ) {
        let UnitGaussian { lxx, lyx, lyy, .. } = gaussian;
        let (v, dy) = (row.v(), row.v() / lyy);
        for (i, (&g, &u)) in row.values().iter().zip(row.u()).enumerate() {
            let light = amplitude * g;
            derivatives[0][i] = g;
            derivatives[1][i] = light * u * lxx;
            derivatives[2][i] = light * (u * lyx + v * lyy);
            match self.profile {
                Profile::Round => derivatives[3][i] = -light * (u * u + v * v),
                Profile::Elliptical => {
                    derivatives[3][i] = -light * u * (u - lyx * dy);
                    derivatives[4][i] = -light * u * dy;
                    derivatives[5][i] = -light * v * v;
                }
            }
        }
    }

    /// The derivatives of `log g` by all parameters: each row holds the factors of the [`MONOMIALS`].
    fn log_derivatives<const N: usize>(self, gaussian: UnitGaussian) -> SMatrix<f64, N, 6> {
        let UnitGaussian { lxx, lyx, lyy, .. } = gaussian;
        let mut factors = SMatrix::zeros();
        factors[(1, 1)] = lxx;
        factors[(2, 1)] = lyx;
        factors[(2, 2)] = lyy;
        factors[(3, 3)] = -1.0;
        match self.profile {
            Profile::Round => factors[(3, 5)] = -1.0,
            Profile::Elliptical => {
                factors[(3, 4)] = lyx / lyy;
                factors[(4, 4)] = -1.0 / lyy;
                factors[(5, 5)] = -1.0;
            }
        }
        factors
    }
}

const FIRST_SIGMA_PX: f64 = 0.4;
const SIGMA_RATIO: f64 = 1.5;
/// In sigmas. Beyond it, a Gaussian is below 1e-17.
const COARSE_REACH: f64 = 9.0;

/// Returns the best round Gaussian of a coarse search, or `None` if none has a positive amplitude.
///
/// Three centres are tried: the brightest pixel, and the centre of the brightest box, for boxes with
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
    let longer = rows.max(columns);
    let n = cutout.values.len() as f64;
    let sum: f64 = cutout.values.iter().sum();
    // Gaussians at all distances from their centre, which is element `longer`.
    let mut profiles = Vec::new();
    let mut sigma = FIRST_SIGMA_PX;
    while sigma <= longer as f64 {
        let at = |i: usize| (-0.5 * ((i as f64 - longer as f64) / sigma).powi(2)).exp();
        profiles.push((sigma, (0..2 * longer).map(at).collect::<Vec<f64>>()));
        sigma *= SIGMA_RATIO;
    }
    let mut best: Option<(f64, Start)> = None;
    for (row, column) in centres {
        for (sigma, profile) in &profiles {
            let reach = (COARSE_REACH * sigma) as usize;
            let (first_column, first_row) = (column.saturating_sub(reach), row.saturating_sub(reach));
            let near_x = first_column..columns.min(column + reach + 1);
            let near_y = first_row..rows.min(row + reach + 1);
            let along_x = &profile[longer - column..][near_x.clone()];
            let along_y = &profile[longer - row..][near_y];
            // Sums over the pixels of the Gaussian, its square and its product with the values.
            let g = along_x.iter().sum::<f64>() * along_y.iter().sum::<f64>();
            let gg = dot(along_x, along_x) * dot(along_y, along_y);
            let mut gd = 0.0;
            for (values, weight) in cutout.rows().skip(first_row).zip(along_y) {
                gd += weight * dot(&values[near_x.clone()], along_x);
            }
            let (power, product) = if background {
                (gg - g * g / n, gd - g * sum / n)
            } else {
                (gg, gd)
            };
            let amplitude = product / power;
            let gain = amplitude * product;
            if amplitude > 0.0 && amplitude.is_finite() && best.is_none_or(|(most, _)| gain > most) {
                let level = if background {
                    (sum - amplitude * g) / n
                } else {
                    0.0
                };
                let start = Start {
                    amplitude,
                    x: column as f64,
                    y: row as f64,
                    sigma: *sigma,
                    background: level,
                };
                best = Some((gain, start));
            }
        }
    }
    best.map(|(_, start)| start)
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

/// Sums of every `side` consecutive values along the last axis. Equal values have equal sums
/// wherever they are.
fn running_sums(values: &Array2<f64>, side: usize) -> Array2<f64> {
    if side == 1 {
        return values.clone();
    }
    let half = side / 2;
    let halves = running_sums(values, half);
    let n = values.ncols() + 1 - side;
    let mut sums = &halves.slice(s![.., ..n]) + &halves.slice(s![.., half..half + n]);
    if side % 2 == 1 {
        sums += &values.slice(s![.., side - 1..]);
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Window;
    use crate::levenberg_marquardt::minimise;

    /// The error of differences with step h is of order h^4, relative to values of order 1.
    const DIFFERENCE_TOLERANCE: f64 = 1e-8;

    /// Derivative of `f` at 0, from four points.
    fn slope<const N: usize>(f: impl Fn(f64) -> SVector<f64, N>) -> SVector<f64, N> {
        let h = 1e-3;
        ((f(h) - f(-h)) * 8.0 - (f(2.0 * h) - f(-2.0 * h))) / (12.0 * h)
    }

    fn check<const N: usize>(model: GaussianModel, p: SVector<f64, N>) {
        let light = |x: f64, y: f64| 0.3 * (x - 0.7 * y).sin();
        let values = Array2::from_shape_fn((9, 8), |(y, x)| light(x as f64, y as f64));
        let waves = Window::whole().cut(values.view(), 1).unwrap();
        let moved = |k: usize, step: f64| {
            let mut q = p;
            q[k] += step;
            q
        };
        let here = model.linearise(&p, &waves);
        for k in 0..N {
            let by_cost = slope(|step| SVector::from([model.linearise(&moved(k, step), &waves).cost]));
            assert!(
                (by_cost[0] - here.gradient[k]).abs() < DIFFERENCE_TOLERANCE,
                "parameter {k}: {by_cost} {}",
                here.gradient[k]
            );
        }
        // The normal matrix does not depend on the values. Without residuals, it holds the second
        // derivatives of the cost.
        let gaussian = model.unit_gaussian(&p);
        let exact = Array2::from_shape_fn((9, 8), |(row, column)| {
            let (dx, dy) = (column as f64 - gaussian.x, row as f64 - gaussian.y);
            let (u, v) = (gaussian.lxx * dx + gaussian.lyx * dy, gaussian.lyy * dy);
            p[0] * (-0.5 * (u * u + v * v)).exp() + model.background(&p).unwrap_or(0.0)
        });
        let exact = Window::whole().cut(exact.view(), 1).unwrap();
        assert!(model.linearise(&p, &exact).cost < f64::EPSILON);
        for k in 0..N {
            let by_gradient = slope(|step| model.linearise(&moved(k, step), &exact).gradient);
            assert!(
                (by_gradient - here.normal.column(k)).amax() < DIFFERENCE_TOLERANCE,
                "parameter {k}: {by_gradient} {}",
                here.normal
            );
        }
    }

    /// At the minimum for light that is no Gaussian.
    #[test]
    fn the_second_derivatives_are_those_of_the_cost() {
        let light =
            |x: f64, y: f64| 1.0 / (1.0 + 0.3 * (x - 3.9).powi(2) + 0.2 * (y - 4.2 - 0.3 * x).powi(2));
        let values = Array2::from_shape_fn((9, 8), |(y, x)| light(x as f64, y as f64));
        let cutout = Window::whole().cut(values.view(), 1).unwrap();
        let model = GaussianModel::new(Profile::Elliptical, true);
        let start = SVector::<f64, 7>::from([0.8, 3.9, 5.3, -0.5, 0.1, -0.5, 0.1]);
        let minimum = minimise(start, values.sum(), |p| model.linearise(p, &cutout)).unwrap();
        assert!(minimum.at.cost > 1e-3, "{minimum:?}");
        for k in 0..7 {
            let by_gradient = slope(|step| {
                let mut q = minimum.parameters;
                q[k] += step;
                model.linearise(&q, &cutout).gradient
            });
            assert!(
                (by_gradient - minimum.at.hessian.column(k)).amax() < DIFFERENCE_TOLERANCE,
                "parameter {k}: {by_gradient} {}",
                minimum.at.hessian
            );
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
