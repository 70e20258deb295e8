//! White noise whose level differs from sample to sample, as between bright and faint stars.

use faer::Mat;
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis};

use crate::noise::{NoiseFloor, estimate};
use crate::svd::{decompose, project};

/// Numbers of leading components that are tried as the signal.
const SIGNALS: [usize; 6] = [1, 2, 4, 8, 16, 32];
/// Rounds of scaling the samples to equal noise and decomposing them anew, for each of these.
const ROUNDS: usize = 4;
/// Samples scaled by their own noise have white noise of this level, within a quarter.
const SCALED: std::ops::Range<f64> = 0.75..1.33;
/// Noise of samples that differ by more than the fluxes of stars do is none.
const MOST_UNEVEN: f64 = 1e3;
/// Variances that scatter by so many times what even noise makes them scatter are uneven.
const EVEN: f64 = 3.0;
/// Work beyond this (the product of both dimensions and the smaller one) is not spent on looking for noise.
const MOST_WORK: f64 = 1e9;
/// The largest singular value of finite matrices scatters about the limit by this part.
const FINITE: f64 = 0.02;

/// The floor of samples `[sample, pixel]` (centred, with these singular vectors and values) whose pixels have white noise of a level of
/// each sample's own; nothing where there is no such noise.
///
/// Samples divided by their noise have even noise, which the Marchenko-Pastur law then shows or denies. The levels come from what a few
/// leading components of the divided samples leave over, again and again until they agree; the smallest number of components
/// for which that works is taken.
///
/// Divided samples lie in the space of the samples, so that all this is done with coordinates in it, of which there are no more than
/// samples, in place of pixels.
pub(crate) fn uneven_floor(
    rows: ArrayView2<'_, f64>,
    vectors: &Mat<f64>,
    singular_values: &[f64],
    freedom: usize,
) -> Option<NoiseFloor> {
    let (count, pixels) = rows.dim();
    let size = count.min(pixels);
    if size < 2 || count as f64 * pixels as f64 * size as f64 > MOST_WORK || !may_be_noise(singular_values) {
        return None;
    }
    let coordinates = project(rows, vectors, size);
    SIGNALS
        .into_iter()
        .take_while(|signal| 3 * signal <= size)
        .find_map(|signal| levels(coordinates.view(), pixels, signal, freedom))
        .map(|variances| floor_of(&variances, pixels))
}

/// The floor once more where noise was taken to be even: the same if it is, else that of the samples' own levels.
///
/// Levels come from what the components above the floor leave over, and the floor from the levels, until the number of components
/// above it stays.
pub(crate) fn by_sample(
    rows: ArrayView2<'_, f64>,
    vectors: &Mat<f64>,
    singular_values: &[f64],
    even: NoiseFloor,
) -> NoiseFloor {
    let (count, pixels) = rows.dim();
    let above = |floor: &NoiseFloor| {
        singular_values
            .iter()
            .take_while(|&&s| s > floor.threshold)
            .count()
    };
    let mut floor = even;
    for _ in 0..ROUNDS {
        let signal = above(&floor);
        if 3 * signal > count.min(pixels) {
            return even;
        }
        let left = degrees_of_freedom(count, pixels, signal);
        let variances: Vec<f64> = rows
            .outer_iter()
            .map(|row| unexplained(row, vectors, signal) / left)
            .collect();
        let mean = variances.iter().sum::<f64>() / count as f64;
        let scatter = variances.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / count as f64;
        // The variance of a variance of so many values.
        if scatter.sqrt() <= EVEN * mean * (2.0 / left).sqrt() {
            return even;
        }
        floor = floor_of(&variances, pixels);
        if above(&floor) == signal {
            break;
        }
    }
    floor
}

/// What `signal` components leave of the square of a row.
fn unexplained(row: ArrayView1<'_, f64>, vectors: &Mat<f64>, signal: usize) -> f64 {
    let explained: f64 = (0..signal)
        .map(|k| {
            let a: f64 = row.iter().enumerate().map(|(u, v)| v * vectors[(u, k)]).sum();
            a * a
        })
        .sum();
    (row.dot(&row) - explained).max(0.0)
}

/// Values of a row's noise that are left when `signal` components have taken their part.
fn degrees_of_freedom(count: usize, pixels: usize, signal: usize) -> f64 {
    (pixels - signal) as f64 * (1.0 - signal as f64 / count as f64)
}

/// A cheap look first: the tail of noise-free samples falls by many decades.
fn may_be_noise(singular_values: &[f64]) -> bool {
    let at = |part: f64| singular_values[(part * singular_values.len() as f64) as usize];
    at(0.5) > 0.0 && at(0.9) * MOST_UNEVEN > at(0.5)
}

/// The noise variance of every sample of so many pixels, if `signal` components leave noise alone. Samples come as `[sample, coordinate]`.
fn levels(rows: ArrayView2<'_, f64>, pixels: usize, signal: usize, freedom: usize) -> Option<Vec<f64>> {
    let count = rows.nrows();
    let left = degrees_of_freedom(count, pixels, signal);
    let mut variances: Vec<f64> = rows
        .outer_iter()
        .map(|row| row.dot(&row) / pixels as f64)
        .collect();
    let mut values = Vec::new();
    for _ in 0..ROUNDS {
        // A sample without any noise would outweigh all others.
        let least = variances.iter().copied().fold(0.0, f64::max) / (MOST_UNEVEN * MOST_UNEVEN);
        if least <= 0.0 {
            return None;
        }
        let scales: Array1<f64> = variances.iter().map(|v| 1.0 / v.max(least).sqrt()).collect();
        let divided: Array2<f64> = &rows * &scales.insert_axis(Axis(1));
        let (found, vectors) = decompose(divided.view()).ok()?;
        for (row, variance) in divided.outer_iter().zip(&mut variances) {
            *variance = variance.max(least) * unexplained(row, &vectors, signal) / left;
        }
        values = found;
    }
    let floor = estimate(&values, pixels, freedom)?;
    let above = values.iter().take_while(|&&s| s > floor.threshold).count();
    (SCALED.contains(&floor.sigma) && above <= signal).then_some(variances)
}

/// The floor that noise of these variances, one a row of `pixels` values, makes.
///
/// The largest singular value is `sqrt(P min z)`, `z(u) = 1/u + (1/P) sum_j v_j / (1 - v_j u)` over `0 < u < 1 / max v`, in the limit of
/// large matrices (Silverstein and Choi 1995, J. Multivariate Anal. 54, 295); for equal variances `sigma (sqrt L + sqrt P)`.
fn floor_of(variances: &[f64], pixels: usize) -> NoiseFloor {
    let largest = variances.iter().copied().fold(0.0, f64::max);
    let z = |u: f64| {
        let sum: f64 = variances.iter().map(|v| v / (1.0 - v * u)).sum();
        1.0 / u + sum / pixels as f64
    };
    // z is convex there: thirds of the interval close in on its minimum.
    let (mut low, mut high) = (0.0, 1.0 / largest);
    for _ in 0..200 {
        let (a, b) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        if z(a) < z(b) { high = b } else { low = a }
    }
    let edge = (pixels as f64 * z(f64::midpoint(low, high))).sqrt();
    let mean = variances.iter().sum::<f64>() / variances.len() as f64;
    NoiseFloor {
        sigma: mean.sqrt(),
        edge,
        threshold: edge * (1.0 + FINITE),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_edge_of_equal_variances_is_that_of_marchenko_and_pastur() {
        for (rows, pixels) in [(400, 225), (50, 900), (100, 100)] {
            let floor = floor_of(&vec![0.09; rows], pixels);
            let expected = 0.3 * ((rows as f64).sqrt() + (pixels as f64).sqrt());
            assert!(
                (floor.edge / expected - 1.0).abs() < 1e-9,
                "{} against {expected}",
                floor.edge
            );
            assert!((floor.sigma - 0.3).abs() < 1e-12);
        }
    }

    #[test]
    fn one_noisy_sample_stands_out_alone() {
        // A single row of much larger variance: its own norm, sigma sqrt(P), widened a little by the others.
        let mut variances = vec![1.0; 100];
        variances[7] = 1e4;
        let floor = floor_of(&variances, 400);
        let norm = 100.0 * 20.0;
        assert!(floor.edge > norm && floor.edge < 1.2 * norm, "{}", floor.edge);
    }
}
