//! White noise in samples, estimated from their singular values.

use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis};
use psf_types::DataError;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde::{Deserialize, Serialize};

use crate::components::{Components, is_large};
use crate::decomposition::{BasisError, columns_of, count_above, decompose, project};

/// The noise in the samples' pixels. Serde reads and writes the standard deviation, if it is known.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(try_from = "Option<f64>", into = "Option<f64>")]
#[non_exhaustive]
pub enum PixelNoise {
    /// Estimate white noise, with one level for all samples or one per sample (bright and faint
    /// stars). The estimate may find that there is no noise. If there are at least 1024 samples and
    /// 1024 pixels, the search uses 256 samples, and the level of each sample follows from what the
    /// components leave of it.
    #[default]
    Estimate,
    /// White noise of this standard deviation, in the units of the stamps. 0 means no noise.
    Known(f64),
}

impl TryFrom<Option<f64>> for PixelNoise {
    type Error = DataError;
    fn try_from(sigma: Option<f64>) -> Result<Self, DataError> {
        match sigma {
            None => Ok(Self::Estimate),
            Some(sigma) if sigma >= 0.0 && sigma.is_finite() => Ok(Self::Known(sigma)),
            Some(sigma) => Err(DataError::setting("noise", "finite and 0 or more", sigma)),
        }
    }
}

impl From<PixelNoise> for Option<f64> {
    fn from(noise: PixelNoise) -> Self {
        match noise {
            PixelNoise::Estimate => None,
            PixelNoise::Known(sigma) => Some(sigma),
        }
    }
}

/// The floor that white noise causes in the singular values of an `L x P` matrix: `P` samples of
/// `L` pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct NoiseFloor {
    /// Standard deviation of the noise, or its root mean square over samples with uneven noise.
    pub(crate) sigma: f64,
    /// The largest singular value of pure noise, in the limit of large matrices. For even noise it
    /// is `sigma (sqrt L + sqrt P)` (Marchenko and Pastur 1967), for uneven noise see [`floor_of`].
    pub(crate) edge: f64,
    /// In 99 % of cases the largest singular value of pure even noise is below this value
    /// (Johnstone 2001, theorem 1.1, with the 0.99 quantile of the Tracy-Widom law of order 1). For
    /// uneven noise, it is the edge times `1 +` [`FINITE`].
    pub(crate) threshold: f64,
}

const TRACY_WIDOM_99: f64 = 2.0234;

impl NoiseFloor {
    pub(crate) fn new(sigma: f64, rows: usize, columns: usize) -> Self {
        let (l, p) = ((rows as f64).sqrt(), (columns as f64).sqrt());
        let width = (l + p) * (1.0 / l + 1.0 / p).cbrt();
        let threshold = sigma * ((l + p).powi(2) + TRACY_WIDOM_99 * width).sqrt();
        Self {
            sigma,
            edge: sigma * (l + p),
            threshold,
        }
    }
}

/// Points at which the tail of the spectrum (the singular values after the signal) is read, as
/// fractions of the tail's length from its largest value.
const READ_AT: [f64; 5] = [0.5, 0.6, 0.7, 0.8, 0.9];
/// Largest allowed ratio between the noise levels read at these points. If the ratio is larger, the
/// tail is not pure noise: it contains signal that decays.
const AGREEMENT: f64 = 1.25;
/// Shortest tail in which noise can be told from decay.
const MIN_TAIL: usize = 12;

/// Finds the noise floor of samples.
#[derive(Debug)]
pub(crate) enum NoiseSearch {
    /// The floor of a known noise, `None` for no noise.
    Known(Option<NoiseFloor>),
    /// The noise is estimated from the singular values of all samples.
    All,
    /// The noise was found in [`SUBSET`] samples, as a first estimate. Large matrices are searched
    /// in this way, because the search needs all singular values.
    Subset(Option<NoiseFloor>),
}

impl NoiseSearch {
    /// Prepares the search for samples `[sample, pixel]`. `freedom` is the number of samples, less
    /// one if the mean was subtracted.
    pub(crate) fn new(
        noise: PixelNoise,
        rows: ArrayView2<'_, f64>,
        freedom: usize,
    ) -> Result<Self, BasisError> {
        Ok(match noise {
            PixelNoise::Known(sigma) => Self::Known(known(sigma, rows.ncols(), freedom)?),
            PixelNoise::Estimate if is_large(rows) || needs_subset(rows) => {
                Self::Subset(search_subset(rows, freedom)?)
            }
            PixelNoise::Estimate => Self::All,
        })
    }

    /// The noise floor of samples of `pixels` pixels with these components, or `None` if there is
    /// no noise.
    pub(crate) fn floor(&self, found: &Components, pixels: usize, freedom: usize) -> Option<NoiseFloor> {
        match self {
            Self::Known(floor) => *floor,
            Self::Subset(first) => first.map(|floor| by_sample(found, pixels, floor)),
            Self::All => {
                let even = estimate(&found.values, pixels, freedom);
                // Uneven noise of few samples may look like even noise of a lower level, and many components.
                let is_sound = |even: &NoiseFloor| {
                    3 * count_above(&found.values, even.threshold) <= found.coefficients.nrows().min(pixels)
                };
                let uneven = || {
                    let variances = uneven_levels(found, pixels, freedom)?;
                    Some(floor_of(&variances, pixels, 1.0))
                };
                let first = even.filter(is_sound).or_else(uneven);
                first.map(|first| by_sample(found, pixels, first)).or(even)
            }
        }
    }
}

/// Returns whether there are so many samples that uneven noise is only searched in some of them.
fn needs_subset(rows: ArrayView2<'_, f64>) -> bool {
    let (count, pixels) = rows.dim();
    count > SUBSET && work(count, pixels, count.min(pixels)) > MAX_WORK
}

/// The work of a decomposition.
fn work(count: usize, pixels: usize, size: usize) -> f64 {
    count as f64 * pixels as f64 * size as f64
}

/// The floor of known noise.
fn known(sigma: f64, pixels: usize, freedom: usize) -> Result<Option<NoiseFloor>, BasisError> {
    if !(sigma.is_finite() && sigma >= 0.0) {
        return Err(BasisError::BadNoise { got: sigma });
    }
    Ok((sigma > 0.0).then(|| NoiseFloor::new(sigma, pixels, freedom)))
}

/// Number of samples in which the noise of a large matrix is searched. They are chosen at random.
const SUBSET: usize = 256;

/// The noise floor of samples, from the noise in a subset of them.
fn search_subset(rows: ArrayView2<'_, f64>, freedom: usize) -> Result<Option<NoiseFloor>, BasisError> {
    let (count, pixels) = rows.dim();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut chosen = rand::seq::index::sample(&mut random, count, SUBSET).into_vec();
    chosen.sort_unstable();
    let found = Components::all(rows.select(Axis(0), &chosen).view())?;
    Ok(match estimate(&found.values, pixels, SUBSET) {
        Some(even) => Some(NoiseFloor::new(even.sigma, pixels, freedom)),
        None => uneven_levels(&found, pixels, SUBSET)
            .map(|variances| floor_of(&variances, pixels, freedom as f64 / SUBSET as f64)),
    })
}

/// Estimates white noise of one level from the singular values of a matrix of `rows x columns`, the
/// numbers of pixels and of samples. (One less if the mean was subtracted.) Returns `None` if there
/// is no noise.
///
/// Compares the lower half of the singular values with the quantiles of the Marchenko-Pastur law.
/// This is the approach of Gavish and Donoho 2014, at several quantiles instead of only the median.
/// Each quantile gives a sigma. The singular values count as noise only if all these sigmas agree.
fn estimate(singular_values: &[f64], rows: usize, columns: usize) -> Option<NoiseFloor> {
    let count = rows.min(columns).min(singular_values.len());
    let (small, large) = (rows.min(columns), rows.max(columns));
    let law = MarchenkoPastur::new(small as f64 / large as f64);
    // The number of signal components and the noise level depend on each other. A few iterations
    // suffice.
    let mut signal = 0;
    let mut floor = None;
    for _ in 0..4 {
        let tail = &singular_values[signal..count];
        if tail.len() < MIN_TAIL {
            return None;
        }
        let readings = READ_AT.map(|fraction| {
            let index = (fraction * tail.len() as f64) as usize;
            let quantile = law.quantile(1.0 - (index as f64 + 0.5) / tail.len() as f64);
            tail[index] / (large as f64 * quantile).sqrt()
        });
        let lowest = readings.iter().copied().fold(f64::INFINITY, f64::min);
        let highest = readings.iter().copied().fold(0.0, f64::max);
        if lowest <= 0.0 || highest > AGREEMENT * lowest {
            return None;
        }
        let found = NoiseFloor::new(readings[0], rows, columns);
        floor = Some(found);
        let above = count_above(singular_values, found.threshold);
        if above == signal {
            break;
        }
        signal = above;
    }
    floor
}

/// The distribution of the eigenvalues of white noise, `s^2 / (n sigma^2)`, with `n` = larger
/// dimension and `beta` = smaller dimension / larger dimension.
struct MarchenkoPastur {
    /// Eigenvalues at the midpoints of the integration steps, and the probability below each.
    table: Vec<(f64, f64)>,
}

impl MarchenkoPastur {
    const STEPS: usize = 4000;

    fn new(beta: f64) -> Self {
        let middle = 1.0 + beta;
        let half = 2.0 * beta.sqrt();
        // Substituting x = middle - half cos(theta) removes the square roots at both ends of the
        // density.
        let step = std::f64::consts::PI / Self::STEPS as f64;
        let mut below = 0.0;
        let table: Vec<(f64, f64)> = (0..Self::STEPS)
            .map(|i| {
                let theta = (i as f64 + 0.5) * step;
                let x = middle - half * theta.cos();
                let mass = (half * theta.sin()).powi(2) / (std::f64::consts::TAU * beta * x) * step;
                below += mass;
                (x, below - 0.5 * mass)
            })
            .collect();
        Self { table }
    }

    fn quantile(&self, probability: f64) -> f64 {
        let index = self.table.partition_point(|&(_, below)| below < probability);
        match index {
            0 => self.table[0].0,
            i if i == self.table.len() => self.table[i - 1].0,
            i => {
                let ((x0, p0), (x1, p1)) = (self.table[i - 1], self.table[i]);
                x0 + (x1 - x0) * (probability - p0) / (p1 - p0)
            }
        }
    }
}

/// Numbers of leading components that are tried as the signal.
const SIGNALS: [usize; 6] = [1, 2, 4, 8, 16, 32];
/// For each of these numbers, the samples are scaled to equal noise and decomposed again this many
/// times.
const ROUNDS: usize = 4;
/// Allowed noise level of samples scaled by their own noise. It should be 1.
const SCALED: std::ops::Range<f64> = 0.75..1.33;
/// Largest ratio of noise levels among samples. For samples scaled to unit flux, this is about the
/// ratio of the stars' fluxes, which is usually smaller.
pub(crate) const MAX_NOISE_RATIO: f64 = 1e3;
/// The samples' variances count as uneven if they scatter by more than this multiple of the scatter
/// expected for even noise.
const EVEN: f64 = 3.0;
/// Largest work (samples x pixels x the smaller of the two) for which uneven noise is searched. Of
/// 256 samples, stamps may have 15 000 pixels.
const MAX_WORK: f64 = 1e9;
/// A sample keeps at least this part of its noise when components are removed.
const LEAST_LEFT: f64 = 0.05;
/// Relative scatter of the largest singular value of finite matrices about its limit.
const FINITE: f64 = 0.02;

/// The noise variance of every sample, if the samples' pixels have white noise of a different level
/// in each sample, or `None` if there is no such noise. `found` holds all components of the samples.
/// `freedom` is the number of samples, less one if the mean was subtracted.
///
/// Samples divided by their noise have even noise, which is then tested by the Marchenko-Pastur
/// law. The noise levels are estimated from the residuals of the divided samples after a few
/// leading components are subtracted. Division and estimate are repeated a few times, because each
/// depends on the other. The smallest number of components that leaves only noise is used.
///
/// Divided samples lie in the space spanned by the samples. All computations use coordinates in
/// that space, at most as many as there are samples, instead of pixels.
fn uneven_levels(found: &Components, pixels: usize, freedom: usize) -> Option<Vec<f64>> {
    let (count, size) = found.coefficients.dim();
    if size < 2 || work(count, pixels, size) > MAX_WORK || !may_be_noise(&found.values) {
        return None;
    }
    SIGNALS
        .into_iter()
        .take_while(|signal| 3 * signal <= size)
        .find_map(|signal| levels(found.coefficients.view(), pixels, signal, freedom))
}

/// Refines a floor that was estimated, such as one that assumed even noise. Returns the floor
/// computed from the samples' own noise levels. Returns `first` if these levels are even, or if too
/// few components lie below the floor to estimate them.
///
/// The noise levels follow from the residuals after the components above the floor are subtracted,
/// and the floor follows from the levels. Both are computed again and again, from no component on, so
/// that the smallest number of components is found that leaves only noise. (Components that follow
/// the noise of few samples leave less of it, and so would justify themselves.)
fn by_sample(found: &Components, pixels: usize, first: NoiseFloor) -> NoiseFloor {
    let count = found.coefficients.nrows();
    let mut signal = 0;
    let (variances, floor) = loop {
        let variances = variances_after(found, pixels, signal);
        let floor = floor_of(&variances, pixels, 1.0);
        let above = count_above(&found.values, floor.threshold);
        if 3 * above > count.min(pixels) {
            return first;
        }
        if above <= signal {
            break (variances, floor);
        }
        signal = above;
    };
    let left = degrees_of_freedom(pixels, signal, signal as f64 / count as f64);
    let mean = variances.iter().sum::<f64>() / count as f64;
    let scatter = variances.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / count as f64;
    // The last factor is the relative scatter of a variance computed from `left` values.
    if scatter.sqrt() <= EVEN * mean * (2.0 / left).sqrt() {
        return first;
    }
    floor
}

/// The noise variance of every sample, from what `signal` components leave of it.
pub(crate) fn variances_after(found: &Components, pixels: usize, signal: usize) -> Vec<f64> {
    let leverages = leverages(found.coefficients.view(), &found.values, signal);
    let left = found.left_after(signal).zip(leverages);
    left.map(|(square, leverage)| square / degrees_of_freedom(pixels, signal, leverage))
        .collect()
}

/// The degrees of freedom of the noise in a sample of this leverage after `signal` components are removed.
pub(crate) fn degrees_of_freedom(pixels: usize, signal: usize, leverage: f64) -> f64 {
    (pixels - signal) as f64 * (1.0 - leverage).max(LEAST_LEFT)
}

/// The leverage of each sample on the first `signal` components: the part of its noise that they follow. It
/// is near 1 for a sample that has a component for itself. `coefficients` `[sample, k]` are those of all
/// components, with these singular values.
pub(crate) fn leverages(coefficients: ArrayView2<'_, f64>, values: &[f64], signal: usize) -> Vec<f64> {
    let of_sample = |row: ArrayView1<'_, f64>| -> f64 {
        let shares = row.iter().zip(values).take(signal);
        shares.map(|(a, value)| (a / value).powi(2)).sum()
    };
    coefficients.outer_iter().map(of_sample).collect()
}

/// A cheap test: the tail of noise-free samples falls by many decades.
fn may_be_noise(singular_values: &[f64]) -> bool {
    let at = |part: f64| singular_values[(part * singular_values.len() as f64) as usize];
    at(0.5) > 0.0 && at(0.9) * MAX_NOISE_RATIO > at(0.5)
}

/// The noise variance of every sample of `pixels` pixels, or `None` if `signal` components leave
/// more than noise. Samples are rows `[sample, coordinate]`.
fn levels(rows: ArrayView2<'_, f64>, pixels: usize, signal: usize, freedom: usize) -> Option<Vec<f64>> {
    let mut variances: Vec<f64> = rows
        .outer_iter()
        .map(|row| row.dot(&row) / pixels as f64)
        .collect();
    let mut values = Vec::new();
    for _ in 0..ROUNDS {
        // A lower limit, because a sample without noise would outweigh all others.
        let least = variances.iter().copied().fold(0.0, f64::max) / (MAX_NOISE_RATIO * MAX_NOISE_RATIO);
        if least <= 0.0 {
            return None;
        }
        let scales: Array1<f64> = variances.iter().map(|v| 1.0 / v.max(least).sqrt()).collect();
        let divided: Array2<f64> = &rows * &scales.insert_axis(Axis(1));
        let (found, vectors) = decompose(columns_of(divided.view())).ok()?;
        let explained = project(divided.view(), vectors.subcols(0, signal));
        let leverages = leverages(explained.view(), &found, signal);
        for (((row, a), leverage), variance) in divided
            .outer_iter()
            .zip(explained.outer_iter())
            .zip(leverages)
            .zip(&mut variances)
        {
            let left = degrees_of_freedom(pixels, signal, leverage);
            *variance = variance.max(least) * (row.dot(&row) - a.dot(&a)).max(0.0) / left;
        }
        values = found;
    }
    let floor = estimate(&values, pixels, freedom)?;
    let above = count_above(&values, floor.threshold);
    (SCALED.contains(&floor.sigma) && above <= signal).then_some(variances)
}

/// The noise floor for noise of these variances, one for each row of `pixels` values. `multiple` is
/// the number of rows for which each variance stands.
///
/// In the limit of large matrices the largest singular value is `sqrt(L min z)`, for `L` pixels and
/// `z(u) = 1/u + (1/L) sum_j v_j / (1 - v_j u)` over `0 < u < 1 / max v` (Silverstein and Choi
/// 1995, J. Multivariate Anal. 54, 295). For equal variances it is `sigma (sqrt L + sqrt P)`.
fn floor_of(variances: &[f64], pixels: usize, multiple: f64) -> NoiseFloor {
    let largest = variances.iter().copied().fold(0.0, f64::max);
    let z = |u: f64| {
        let sum: f64 = variances.iter().map(|v| v / (1.0 - v * u)).sum();
        1.0 / u + multiple * sum / pixels as f64
    };
    // z is convex for these u, so a ternary search finds its minimum.
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
    fn the_law_is_a_probability_with_mean_one() {
        for beta in [0.05, 0.3, 1.0] {
            let law = MarchenkoPastur::new(beta);
            let total = law.table.last().unwrap().1;
            assert!((total - 1.0).abs() < 1e-3, "{beta}: {total}");
            let mean: f64 = (0..1000)
                .map(|i| law.quantile((f64::from(i) + 0.5) / 1000.0))
                .sum::<f64>()
                / 1000.0;
            assert!((mean - 1.0).abs() < 1e-2, "{beta}: {mean}");
        }
        // Known value: the median of the law at beta = 1 is 0.6528 (Gavish and Donoho 2014, table
        // IV: 2.858 = 4/sqrt(3)/sqrt(mu)).
        let median = MarchenkoPastur::new(1.0).quantile(0.5);
        assert!(
            (4.0 / 3f64.sqrt() / median.sqrt() - 2.858).abs() < 2e-3,
            "{median}"
        );
    }

    #[test]
    fn decay_is_not_taken_for_noise() {
        let exponential: Vec<f64> = (0..200).map(|k| 0.9f64.powi(k)).collect();
        assert!(estimate(&exponential, 1024, 200).is_none());
        let algebraic: Vec<f64> = (1..=200).map(|k| 1.0 / f64::from(k)).collect();
        assert!(estimate(&algebraic, 1024, 200).is_none());
    }

    #[test]
    fn a_known_level_is_checked() {
        assert!(matches!(known(-1.0, 4, 4), Err(BasisError::BadNoise { .. })));
        assert!(known(0.0, 4, 4).unwrap().is_none());
        let floor = known(0.1, 400, 100).unwrap().unwrap();
        assert!((floor.edge - 3.0).abs() < 1e-12 && floor.threshold > floor.edge);
    }

    #[test]
    fn the_edge_of_equal_variances_is_that_of_marchenko_and_pastur() {
        for (rows, pixels) in [(400, 225), (50, 900), (100, 100)] {
            let floor = floor_of(&vec![0.09; rows], pixels, 1.0);
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
        // A single row of much larger variance. Its own norm is sigma sqrt(L), and the others
        // raise the edge a little above it.
        let mut variances = vec![1.0; 100];
        variances[7] = 1e4;
        let floor = floor_of(&variances, 400, 1.0);
        let norm = 100.0 * 20.0;
        assert!(floor.edge > norm && floor.edge < 1.2 * norm, "{}", floor.edge);
    }
}
