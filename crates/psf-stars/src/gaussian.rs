//! Elliptical Gaussians fitted to single sources.

use nalgebra::{SMatrix, SVector};
use ndarray::ArrayView2;

use crate::FWHM_PER_SIGMA;

type Parameters = SVector<f64, 6>;
type Normal = SMatrix<f64, 6, 6>;

/// A source as a Gaussian, in pixels of the frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Gaussian {
    pub(crate) amplitude: f64,
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) fwhm_px: f64,
    /// Distortion along the axes of the grid.
    pub(crate) e1: f64,
    /// Distortion along the diagonals.
    pub(crate) e2: f64,
}

/// What the fit looks at: the frame without its background, in a square window cut at the frame's edges.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FitWindow {
    pub(crate) column: usize,
    pub(crate) row: usize,
    pub(crate) reach: usize,
}

const MOST_ITERATIONS: usize = 60;
/// Steps that move nothing by more than this part of a pixel (or of a width) end the fit.
const SETTLED: f64 = 1e-6;
/// A centre that leaves the peak by more than this is that of something else.
const FARTHEST: f64 = 2.0;
/// Widths in pixels beyond which a fit is no measurement.
const SMALLEST_FWHM: f64 = 0.3;

impl Gaussian {
    /// The least-squares fit `A exp(-|L^T r|^2 / 2)`, `L = [[exp a, 0], [b, exp c]]`, by Levenberg and Marquardt; nothing where it
    /// does not settle near the peak.
    pub(crate) fn fit(excess: ArrayView2<'_, f64>, window: FitWindow, fwhm_px: f64) -> Option<Self> {
        let (ny, nx) = excess.dim();
        let columns = window.column.saturating_sub(window.reach)..(window.column + window.reach + 1).min(nx);
        let rows = window.row.saturating_sub(window.reach)..(window.row + window.reach + 1).min(ny);
        if columns.len() * rows.len() < 9 {
            return None;
        }
        let (x0, y0) = (window.column as f64, window.row as f64);
        let pixels: Vec<(f64, f64, f64)> = rows
            .flat_map(|y| columns.clone().map(move |x| (x, y)))
            .map(|(x, y)| (x as f64 - x0, y as f64 - y0, excess[[y, x]]))
            .collect();
        let inverse_sigma = (FWHM_PER_SIGMA / fwhm_px).ln();
        let peak = excess[[window.row, window.column]];
        if peak <= 0.0 {
            return None;
        }
        let p = minimise(
            &pixels,
            Parameters::from([peak, 0.0, 0.0, inverse_sigma, 0.0, inverse_sigma]),
        )?;
        let found = Self::of(&p, x0, y0)?;
        let near = p[1].abs() <= FARTHEST && p[2].abs() <= FARTHEST;
        let sized = (SMALLEST_FWHM..=4.0 * window.reach as f64).contains(&found.fwhm_px);
        (near && sized && found.amplitude > 0.0).then_some(found)
    }

    fn of(p: &Parameters, x0: f64, y0: f64) -> Option<Self> {
        let (l, m, n) = (p[3].exp(), p[4], p[5].exp());
        // The inverse covariance is L L^T.
        let (qxx, qxy, qyy) = (l * l, l * m, m * m + n * n);
        let determinant = qxx * qyy - qxy * qxy;
        let (xx, yy, xy) = (qyy / determinant, qxx / determinant, -qxy / determinant);
        let fwhm_px = FWHM_PER_SIGMA * determinant.powf(-0.25);
        let trace = xx + yy;
        (fwhm_px.is_finite() && trace.is_finite()).then(|| Self {
            amplitude: p[0],
            x: x0 + p[1],
            y: y0 + p[2],
            fwhm_px,
            e1: (xx - yy) / trace,
            e2: 2.0 * xy / trace,
        })
    }
}

/// Half the sum of squared residuals, its gradient and the normal matrix.
fn linearised(pixels: &[(f64, f64, f64)], p: &Parameters) -> (f64, Parameters, Normal) {
    let (l, m, n) = (p[3].exp(), p[4], p[5].exp());
    let (mut cost, mut gradient, mut normal) = (0.0, Parameters::zeros(), Normal::zeros());
    for &(x, y, value) in pixels {
        let (dx, dy) = (x - p[1], y - p[2]);
        let (u, v) = (l * dx + m * dy, n * dy);
        let shape = (-0.5 * (u * u + v * v)).exp();
        let model = p[0] * shape;
        let row = Parameters::from([
            shape,
            model * u * l,
            model * (u * m + v * n),
            -model * u * l * dx,
            -model * u * dy,
            -model * v * n * dy,
        ]);
        let residual = model - value;
        cost += 0.5 * residual * residual;
        gradient += row * residual;
        normal += row * row.transpose();
    }
    (cost, gradient, normal)
}

fn minimise(pixels: &[(f64, f64, f64)], start: Parameters) -> Option<Parameters> {
    let mut p = start;
    let (mut cost, mut gradient, mut normal) = linearised(pixels, &p);
    let mut damping = 1e-3;
    for _ in 0..MOST_ITERATIONS {
        let mut matrix = normal;
        for k in 0..6 {
            matrix[(k, k)] = normal[(k, k)] * (1.0 + damping) + f64::MIN_POSITIVE;
        }
        let Some(step) = matrix.cholesky().map(|c| c.solve(&-gradient)) else {
            damping *= 10.0;
            continue;
        };
        let trial = p + step;
        let at = linearised(pixels, &trial);
        if at.0.is_finite() && at.0 <= cost {
            let settled = step.iter().skip(1).all(|s| s.abs() < SETTLED);
            (p, (cost, gradient, normal)) = (trial, at);
            damping *= 0.2;
            if settled {
                return Some(p);
            }
        } else {
            damping *= 5.0;
            if damping > 1e10 {
                return None;
            }
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    /// The pixel-integrated Gaussian is not a Gaussian: what that costs in position on a FWHM of 1.5 pixels.
    const CENTRE_PX: f64 = 0.01;

    #[test]
    fn an_undersampled_pixel_integrated_star_keeps_its_place() {
        let sigma = 1.4 / FWHM_PER_SIGMA;
        for (x, y) in [(10.0, 10.0), (10.3, 9.8), (9.5, 10.49)] {
            let steps = 20;
            let frame = Array2::from_shape_fn((21, 21), |(j, i)| {
                let mut sum = 0.0;
                for k in 0..steps * steps {
                    let sub = |k: usize| (k as f64 + 0.5) / f64::from(steps as u32) - 0.5;
                    let (dx, dy) = (i as f64 + sub(k % steps) - x, j as f64 + sub(k / steps) - y);
                    sum += (-0.5 * (dx * dx + dy * dy) / (sigma * sigma)).exp();
                }
                sum
            });
            let window = FitWindow {
                column: 10,
                row: 10,
                reach: 3,
            };
            let fit = Gaussian::fit(frame.view(), window, 2.0).unwrap();
            assert!(
                (fit.x - x).abs() < CENTRE_PX && (fit.y - y).abs() < CENTRE_PX,
                "{fit:?}"
            );
            // The pixel widens it: sigma^2 + 1/12.
            let wide = FWHM_PER_SIGMA * (sigma * sigma + 1.0 / 12.0).sqrt();
            assert!((fit.fwhm_px / wide - 1.0).abs() < 0.03, "{fit:?} against {wide}");
        }
    }

    #[test]
    fn an_elongated_star_has_its_distortion() {
        let (xx, yy, xy) = (4.0, 2.0, 0.7);
        let determinant = xx * yy - xy * xy;
        let frame = Array2::from_shape_fn((31, 31), |(j, i)| {
            let (x, y) = (i as f64 - 15.2, j as f64 - 14.9);
            7.0 * (-0.5 * (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant).exp()
        });
        let window = FitWindow {
            column: 15,
            row: 15,
            reach: 8,
        };
        let fit = Gaussian::fit(frame.view(), window, 2.0).unwrap();
        assert!(
            (fit.e1 - 2.0 / 6.0).abs() < 1e-6 && (fit.e2 - 1.4 / 6.0).abs() < 1e-6,
            "{fit:?}"
        );
        assert!((fit.fwhm_px - FWHM_PER_SIGMA * determinant.powf(0.25)).abs() < 1e-6);
        assert!((fit.amplitude - 7.0).abs() < 1e-6 && (fit.x - 15.2).abs() < 1e-6);
    }

    #[test]
    fn what_has_no_peak_gives_nothing() {
        let flat = Array2::from_elem((11, 11), -1.0);
        let window = FitWindow {
            column: 5,
            row: 5,
            reach: 3,
        };
        assert_eq!(Gaussian::fit(flat.view(), window, 2.0), None);
    }
}
