//! The level of white noise in samples, read from their singular values.

use crate::BasisError;

/// What is known of the noise in the samples' pixels.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub enum PixelNoise {
    /// Look for white noise, of one level or of a level of each sample's own (bright and faint stars); there may be none.
    #[default]
    Estimate,
    /// White noise of this standard deviation, in the units of the stamps. 0 for none.
    Known(f64),
}

/// The floor that white noise of standard deviation `sigma` makes in the singular values of an `L x P` matrix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct NoiseFloor {
    pub(crate) sigma: f64,
    /// `sigma (sqrt L + sqrt P)`: the largest singular value of the noise alone, in the limit of large matrices
    /// (Marchenko and Pastur 1967).
    pub(crate) edge: f64,
    /// The largest singular value of the noise alone stays below this in 99 % of cases (Johnstone 2001, theorem 1.1,
    /// with the 0.99 quantile of the Tracy-Widom law of order 1).
    pub(crate) threshold: f64,
}

const TRACY_WIDOM_99: f64 = 2.0234;

impl NoiseFloor {
    fn new(sigma: f64, rows: usize, columns: usize) -> Self {
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

/// Where in the tail of the spectrum the noise is read, as fractions of the tail from its top.
const READ_AT: [f64; 5] = [0.5, 0.6, 0.7, 0.8, 0.9];
/// The readings of white noise agree within this ratio; those of a spectrum that decays for any other reason do not.
const AGREEMENT: f64 = 1.25;
/// A shorter tail cannot tell noise from decay.
const SHORTEST_TAIL: usize = 12;

/// The noise floor of a matrix of `rows x columns` (columns: degrees of freedom left) with these singular values.
///
/// With [`PixelNoise::Estimate`] the lower half of the singular values is compared with the quantiles of the
/// Marchenko-Pastur law (the approach of Gavish and Donoho 2014, at several quantiles in place of the median alone). Each
/// quantile gives a sigma; only where all agree is it taken for noise.
pub(crate) fn noise_floor(
    noise: PixelNoise,
    singular_values: &[f64],
    rows: usize,
    columns: usize,
) -> Result<Option<NoiseFloor>, BasisError> {
    match noise {
        PixelNoise::Known(sigma) if sigma.is_finite() && sigma >= 0.0 => {
            Ok((sigma > 0.0).then(|| NoiseFloor::new(sigma, rows, columns)))
        }
        PixelNoise::Known(got) => Err(BasisError::BadNoise { got }),
        PixelNoise::Estimate => Ok(estimate(singular_values, rows, columns)),
    }
}

pub(crate) fn estimate(singular_values: &[f64], rows: usize, columns: usize) -> Option<NoiseFloor> {
    let count = rows.min(columns).min(singular_values.len());
    let (small, large) = (rows.min(columns), rows.max(columns));
    let law = MarchenkoPastur::new(small as f64 / large as f64);
    // The number of signal modes and the noise level depend on each other; a few rounds settle them.
    let mut signal = 0;
    let mut floor = None;
    for _ in 0..4 {
        let tail = &singular_values[signal..count];
        if tail.len() < SHORTEST_TAIL {
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
        let above = singular_values
            .iter()
            .take_while(|&&s| s > found.threshold)
            .count();
        if above == signal {
            break;
        }
        signal = above;
    }
    floor
}

/// The law of the eigenvalues of white noise, `s^2 / (n sigma^2)`, with `beta` = smaller over larger dimension.
struct MarchenkoPastur {
    /// Eigenvalues at the midpoints of the integration steps, and the probability below each.
    table: Vec<(f64, f64)>,
}

impl MarchenkoPastur {
    const STEPS: usize = 4000;

    fn new(beta: f64) -> Self {
        let middle = 1.0 + beta;
        let half = 2.0 * beta.sqrt();
        // x = middle - half cos(theta) takes the square roots at both ends out of the density.
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
        // Known value: the median of the law at beta = 1 is 0.6528 (Gavish and Donoho 2014, table IV: 2.858 = 4/sqrt(3)/sqrt(mu)).
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
        assert!(matches!(
            noise_floor(PixelNoise::Known(-1.0), &[], 4, 4),
            Err(BasisError::BadNoise { .. })
        ));
        assert!(
            noise_floor(PixelNoise::Known(0.0), &[1.0], 4, 4)
                .unwrap()
                .is_none()
        );
        let floor = noise_floor(PixelNoise::Known(0.1), &[1.0], 400, 100)
            .unwrap()
            .unwrap();
        assert!((floor.edge - 3.0).abs() < 1e-12 && floor.threshold > floor.edge);
    }
}
