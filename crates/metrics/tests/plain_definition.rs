//! Fast measurements compared with slow ones that follow the definitions: sums over every pixel, and
//! plain steps.

mod common;

use common::{Gaussian, MOFFATS};
use ndarray::{Array2, s};
use psf_metrics::{AdaptiveMomentFinder, GaussianFitter, MetricsError, Window};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The reference ends at a change of 1e-12, the fast iteration at 1e-11. Errors are a few times
/// larger.
const EXACT: f64 = 1e-10;

/// Sums with Neumaier's compensation of `w I` times 1, dx, dy, dx dx, dx dy, dy dy.
fn moments(stamp: &Array2<f64>, [x0, y0, xx, xy, yy]: [f64; 5]) -> [f64; 6] {
    let determinant = xx * yy - xy * xy;
    let (mut sums, mut lost) = ([0.0; 6], [0.0; 6]);
    for ((row, column), value) in stamp.indexed_iter() {
        let (dx, dy) = (column as f64 - x0, row as f64 - y0);
        let rho2 = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / determinant;
        let light = (-0.5 * rho2).exp() * value;
        for (i, factor) in [1.0, dx, dy, dx * dx, dx * dy, dy * dy].into_iter().enumerate() {
            let (before, term) = (sums[i], light * factor);
            sums[i] += term;
            lost[i] += if f64::abs(before) > f64::abs(term) {
                (before - sums[i]) + term
            } else {
                (term - sums[i]) + before
            };
        }
    }
    std::array::from_fn(|i| sums[i] + lost[i])
}

/// Smaller and larger sigma of second moments.
fn sigmas(xx: f64, xy: f64, yy: f64) -> (f64, f64) {
    let largest = 0.5 * (xx + yy + (xx - yy).hypot(2.0 * xy));
    (((xx * yy - xy * xy) / largest).sqrt(), largest.sqrt())
}

/// Adaptive moments by plain steps from the default start: the amplitude, the centroid and `Mxx`,
/// `Mxy`, `Myy`, or the name of the error.
fn slow_moments(stamp: &Array2<f64>) -> Result<(f64, [f64; 5]), &'static str> {
    let (rows, columns) = stamp.dim();
    let side = rows.min(columns) as f64;
    let start = f64::min(5.0, side / 6.0);
    let mut at = [
        (columns / 2) as f64,
        (rows / 2) as f64,
        start * start,
        0.0,
        start * start,
    ];
    let mut change = f64::INFINITY;
    for _ in 0..1000 {
        let [x, y, xx, xy, yy] = at;
        let (minor, major) = sigmas(xx, xy, yy);
        let inside = |v: f64, n: usize| (-0.5..=n as f64 - 0.5).contains(&v);
        if !(inside(x, columns) && inside(y, rows)) {
            return Err("CentreLeftWindow");
        }
        if minor < 0.2 {
            return Err("WeightCollapsed");
        }
        if major > 4.0 * f64::max(side / 3.0, start) || (change <= 1e-12 && major > side / 3.0) {
            return Err("WidthOutOfRange");
        }
        let [flux, wx, wy, wxx, wxy, wyy] = moments(stamp, at);
        if flux <= 0.0 {
            return Err("NonPositiveFlux");
        }
        if change <= 1e-12 {
            return Ok((2.0 * flux, at));
        }
        let units = [minor, minor, minor * minor, minor * minor, minor * minor];
        let steps = [
            2.0 * wx / flux,
            2.0 * wy / flux,
            4.0 * (wxx / flux - 0.5 * xx),
            4.0 * (wxy / flux - 0.5 * xy),
            4.0 * (wyy / flux - 0.5 * yy),
        ];
        change = 0.0;
        for i in 0..5 {
            let step = f64::clamp(steps[i] / units[i], -0.25, 0.25);
            at[i] += step * units[i];
            change = f64::max(change, step.abs());
        }
    }
    Err("NotConverged")
}

fn name(error: &MetricsError) -> &'static str {
    match error {
        MetricsError::CentreLeftWindow { .. } => "CentreLeftWindow",
        MetricsError::WeightCollapsed { .. } => "WeightCollapsed",
        MetricsError::WidthOutOfRange { .. } => "WidthOutOfRange",
        MetricsError::NonPositiveFlux { .. } => "NonPositiveFlux",
        MetricsError::NotConverged { .. } => "NotConverged",
        _ => "another error",
    }
}

/// Compares the moments of a stamp with the reference. Returns the number of iterations.
fn check_moments(stamp: &Array2<f64>) -> Option<usize> {
    let fast = AdaptiveMomentFinder::new().measure(stamp.view());
    let (fast, (amplitude, [x, y, xx, xy, yy])) = match (fast, slow_moments(stamp)) {
        (Ok(fast), Ok(slow)) => (fast, slow),
        (fast, slow) => {
            assert_eq!(fast.as_ref().map_err(name).err(), slow.err(), "{fast:?}");
            return None;
        }
    };
    let (c, (minor, _)) = (fast.covariance(), sigmas(xx, xy, yy));
    let (px, variance) = (minor, minor * minor);
    for difference in [
        fast.amplitude() / amplitude - 1.0,
        (fast.x_centroid() - x) / px,
        (fast.y_centroid() - y) / px,
        (c.xx() - xx) / variance,
        (c.xy() - xy) / variance,
        (c.yy() - yy) / variance,
    ] {
        assert!(difference.abs() < EXACT, "{difference:e} {fast:?}");
    }
    Some(fast.iterations())
}

/// A profile with rings: `(sin r / r)^2`.
fn rings(side: usize, x: f64, y: f64, width: f64, stretch: f64) -> Array2<f64> {
    Array2::from_shape_fn((side, side), |(row, column)| {
        let r = ((column as f64 - x) * stretch / width).hypot((row as f64 - y) / width);
        (r.max(1e-9).sin() / r.max(1e-9)).powi(2)
    })
}

/// PSFs as telescopes have them, large enough for their stamps' pixels.
fn ordinary_psfs() -> Vec<Array2<f64>> {
    let mut stamps = Vec::new();
    for (sigma, ratio, angle) in [
        (1.2, 0.9, 0.3),
        (2.5, 0.6, -0.7),
        (6.0, 1.0, 0.0),
        (7.3, 0.5, 1.2),
    ] {
        stamps.push(Gaussian::ellipse(sigma, ratio, angle).stamp(64, 61));
    }
    stamps.extend(MOFFATS.map(|moffat| moffat.stamp(48, 52)));
    stamps.push(rings(64, 31.2, 32.9, 2.2, 1.1));
    stamps.push(rings(96, 47.7, 48.1, 4.5, 0.8));
    stamps
}

/// Stamps at the limits of what can be measured, and beyond.
fn doubtful_stamps() -> Vec<Array2<f64>> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut stamps = Vec::new();
    for psf in ordinary_psfs() {
        // A neighbour of a million times the flux, 7 to 12 sigmas away, and negative pixels.
        let mut neighbour = psf.clone();
        neighbour[[1, 2]] = 1e6;
        stamps.push(neighbour);
        let mut holes = psf.clone();
        holes[[20, 20]] = -0.3;
        holes[[3, 40]] = -1e3;
        stamps.push(holes);
        // Noise in windows about the brightest pixels, and off them.
        let noisy = psf.mapv(|v| v + 0.05 * (rng.random::<f64>() - 0.5));
        let (row, column) = (psf.nrows() / 2, psf.ncols() / 2);
        for half in [3, 7] {
            stamps.push(
                noisy
                    .slice(s![row - half..=row + half, column - half..=column + half])
                    .to_owned(),
            );
            stamps.push(
                noisy
                    .slice(s![row..row + 2 * half, column - 1..column + half + 5])
                    .to_owned(),
            );
        }
        stamps.push(noisy.mapv(|v| v + 0.02));
    }
    // Undersampled stars and noise alone.
    for sigma in [0.45, 0.6, 0.75, 0.9] {
        stamps.push(
            Gaussian::ellipse(sigma, 1.0, 0.0)
                .stamp(64, 64)
                .slice(s![20..45, 20..45])
                .to_owned(),
        );
    }
    for side in [6, 9, 20] {
        stamps.push(Array2::from_shape_fn((side, side), |_| rng.random::<f64>()));
        stamps.push(Array2::from_shape_fn((side, side), |_| {
            rng.random::<f64>() - 0.55
        }));
    }
    stamps
}

#[test]
fn moments_of_psfs_take_few_iterations() {
    for stamp in ordinary_psfs() {
        let iterations = check_moments(&stamp).unwrap();
        assert!(iterations <= 20, "{iterations}");
    }
}

#[test]
fn doubtful_moments_and_failures_are_those_of_plain_steps() {
    let results: Vec<_> = doubtful_stamps().iter().map(check_moments).collect();
    let failures = results.iter().filter(|result| result.is_none()).count();
    // The comparison has many of both kinds.
    assert!(
        failures > 10 && failures + 10 < results.len(),
        "{failures} of {}",
        results.len()
    );
}

/// At the minimum, the residuals are orthogonal to the model's derivatives, which are polynomials
/// of degree 2 times the Gaussian. The sums run over every pixel.
#[test]
fn fits_solve_the_normal_equations() {
    for stamp in ordinary_psfs() {
        for background in [false, true] {
            let fit = GaussianFitter::elliptical()
                .with_background(background)
                .with_window(Window::central(40))
                .fit(stamp.view())
                .unwrap();
            assert!(fit.iterations() <= 15, "{fit:?}");
            let c = fit.covariance();
            let determinant = c.determinant();
            let (mut sums, mut norms) = ([0.0; 6], [0.0; 6]);
            let (rows, columns) = (stamp.nrows() / 2 - 20, stamp.ncols() / 2 - 20);
            for ((row, column), value) in stamp
                .slice(s![rows..rows + 40, columns..columns + 40])
                .indexed_iter()
            {
                let dx = (column + columns) as f64 - fit.x_centroid();
                let dy = (row + rows) as f64 - fit.y_centroid();
                let rho2 = (c.yy() * dx * dx - 2.0 * c.xy() * dx * dy + c.xx() * dy * dy) / determinant;
                let g = (-0.5 * rho2).exp();
                let residual = fit.amplitude() * g + fit.background().unwrap_or(0.0) - value;
                for (i, factor) in [1.0, dx, dy, dx * dx, dx * dy, dy * dy].into_iter().enumerate() {
                    sums[i] += residual * g * factor;
                    norms[i] += (fit.amplitude() * g * g * factor).abs();
                }
            }
            for (sum, norm) in sums.iter().zip(norms) {
                assert!(sum.abs() < EXACT * norm, "{sum:e} {norm:e} {fit:?}");
            }
        }
    }
}
