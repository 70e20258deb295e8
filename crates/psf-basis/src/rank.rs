//! The number of components: the spectrum of singular values, its elbow, and the choice of a rank.

use std::str::FromStr;

use psf_types::{DataError, through_text};
use serde::{Deserialize, Serialize};

use crate::decomposition::{BasisError, count_above};
use crate::noise::NoiseFloor;

/// The number of components to keep.
///
/// Text forms: `auto`, `elbow`, `full`, a whole number, `energy=0.999` or `error=1e-3`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
#[non_exhaustive]
pub enum RankSelection {
    /// At least the elbow. More components are kept until the largest truncation error over the
    /// samples is at most [`RankSelection::AUTO_ERROR`]. Components below the noise are never kept.
    #[default]
    Auto,
    /// The elbow of the cumulative weights.
    Elbow,
    /// Every component above rounding.
    Full,
    /// This number of components.
    Fixed(usize),
    /// The smallest number of components that hold this fraction of the sum of the squared singular
    /// values.
    Energy(f64),
    /// The smallest number of components for which every sample's relative L2 truncation error is
    /// at most this value.
    Error(f64),
}

impl RankSelection {
    /// The largest truncation error over the samples that `auto` accepts.
    pub const AUTO_ERROR: f64 = 1e-4;

    /// Returns the rank for a spectrum. `max_errors[k]` is the largest truncation error over the
    /// samples with `k` components.
    pub(crate) fn select(self, spectrum: &Spectrum, max_errors: &[f64]) -> Result<usize, BasisError> {
        let available = spectrum.numerical_rank;
        let for_error = |limit: f64| {
            max_errors
                .iter()
                .position(|&e| e <= limit)
                .unwrap_or(available)
                .min(available)
        };
        Ok(match self {
            Self::Auto => spectrum
                .elbow
                .max(for_error(Self::AUTO_ERROR))
                .min(spectrum.significant),
            Self::Elbow => spectrum.elbow,
            Self::Full => available,
            Self::Fixed(asked) if asked > available => {
                return Err(BasisError::RankTooHigh { asked, available });
            }
            Self::Fixed(asked) => asked,
            Self::Energy(fraction) => spectrum.rank_for_energy(fraction),
            Self::Error(limit) => for_error(limit),
        })
    }
}

impl std::fmt::Display for RankSelection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Elbow => f.write_str("elbow"),
            Self::Full => f.write_str("full"),
            Self::Fixed(rank) => write!(f, "{rank}"),
            Self::Energy(fraction) => write!(f, "energy={fraction}"),
            Self::Error(limit) => write!(f, "error={limit:e}"),
        }
    }
}

impl FromStr for RankSelection {
    type Err = DataError;
    fn from_str(text: &str) -> Result<Self, DataError> {
        const ALLOWED: &str = "auto, elbow, full, a whole number, energy=F (0 < F <= 1) or error=E (E >= 0)";
        let refused = || DataError::setting("rank", ALLOWED, text);
        match (text, text.split_once('=')) {
            ("auto", _) => Ok(Self::Auto),
            ("elbow", _) => Ok(Self::Elbow),
            ("full", _) => Ok(Self::Full),
            (_, None) => text.parse().map(Self::Fixed).map_err(|_| refused()),
            (_, Some(("energy", value))) => match value.parse() {
                Ok(fraction) if fraction > 0.0 && fraction <= 1.0 => Ok(Self::Energy(fraction)),
                _ => Err(refused()),
            },
            (_, Some(("error", value))) => match value.parse() {
                Ok(limit) if limit >= 0.0 && f64::is_finite(limit) => Ok(Self::Error(limit)),
                _ => Err(refused()),
            },
            _ => Err(refused()),
        }
    }
}

through_text!(RankSelection);

/// The singular values of the matrix of all training stamps, in descending order, and the ranks and
/// noise derived from them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Spectrum {
    /// All singular values.
    pub singular_values: Vec<f64>,
    /// `c_k = sum_{i<=k} s_i / sum_i s_i`, from `c_1` on. All are 1 if every singular value is 0.
    pub cumulative_weights: Vec<f64>,
    /// The number of components at the elbow of the cumulative weights, without components below
    /// the noise. The crate's page defines the elbow.
    pub elbow: usize,
    /// The number of components above rounding, and above the noise if there is any.
    pub significant: usize,
    /// The number of components above rounding, which is the rank that `full` selects.
    pub numerical_rank: usize,
    /// The standard deviation of the white noise in the pixels, if it was found or given. If it
    /// differs from sample to sample, the root mean square over the samples.
    pub noise_sigma: Option<f64>,
    /// The largest singular value of this noise, in the limit of large matrices. If the noise has
    /// one level in all samples, it is `sigma (sqrt L + sqrt P)` for `P` samples of `L` pixels.
    /// (`P` is one less if the mean is subtracted.)
    pub noise_edge: Option<f64>,
}

impl Spectrum {
    /// Derives the cumulative weights and the ranks from the singular values. Values below
    /// `rounding` are rounding errors of the decomposition.
    pub(crate) fn new(singular_values: Vec<f64>, rounding: f64, noise: Option<NoiseFloor>) -> Self {
        let total: f64 = singular_values.iter().sum();
        let mut sum = 0.0;
        let cumulative_weights = singular_values
            .iter()
            .map(|s| {
                sum += s;
                if total > 0.0 { sum / total } else { 1.0 }
            })
            .collect();
        let numerical_rank = count_above(&singular_values, rounding);
        let significant = noise.map_or(numerical_rank, |n| {
            count_above(&singular_values, n.threshold.max(rounding))
        });
        Self {
            elbow: elbow(&singular_values).min(significant),
            significant,
            numerical_rank,
            noise_sigma: noise.map(|n| n.sigma),
            noise_edge: noise.map(|n| n.edge),
            cumulative_weights,
            singular_values,
        }
    }

    /// The smallest number of components that hold the fraction `energy` of `sum s_i^2`.
    pub(crate) fn rank_for_energy(&self, energy: f64) -> usize {
        let total: f64 = self.singular_values.iter().map(|s| s * s).sum();
        let mut sum = 0.0;
        let enough = self
            .singular_values
            .iter()
            .take(self.numerical_rank)
            .take_while(|&&s| {
                let short = sum < energy * total;
                sum += s * s;
                short
            });
        enough.count()
    }
}

/// A cliff is a drop to less than this fraction from one singular value to the next. The values
/// after it are negligible.
const CLIFF: f64 = 1e-3;
/// A cliff that begins below this fraction of the largest singular value does not count. Such small
/// values are hardly above rounding, where even a smooth decay ends in a sharp drop. The limit is
/// below the rounding of single-precision pixels (6e-8), so a cliff that ends in that rounding still
/// counts.
const FLOOR: f64 = 1e-8;

/// The number of components at the elbow of the curve of cumulative weights
/// `c_k = sum_{i<=k} s_i / sum_i s_i`.
///
/// * A cliff is a fall by more than a factor of 1000 from one singular value to the next, in the
///   first half of the curve. There the curve has a sharp corner, which is the elbow. For example,
///   samples that span exactly six modes have their elbow at six, however unequal the six are. Of
///   several cliffs the deepest counts. A cliff that begins below 1e-8 of the largest value does
///   not count, because a smooth decay ends in rounding there.
/// * Without a cliff, the elbow is the point of the curve furthest above its chord from (0, 0) to
///   (m, 1): "Kneedle", Satopaa, Albrecht, Irwin and Raghavan 2011 (ICDCS workshops, section II),
///   without smoothing. The curve is concave, so this is the number of singular values above their
///   mean, at least 1.
///
/// `singular_values` are in descending order. The result is 0 if all are 0 or there are none.
pub(crate) fn elbow(singular_values: &[f64]) -> usize {
    let total: f64 = singular_values.iter().sum();
    if total <= 0.0 {
        return 0;
    }
    cliff(singular_values).unwrap_or_else(|| {
        let mean = total / singular_values.len() as f64;
        count_above(singular_values, mean).max(1)
    })
}

fn cliff(singular_values: &[f64]) -> Option<usize> {
    let half = singular_values.len() / 2;
    let drop = |k: usize| singular_values[k] / singular_values[k - 1];
    (1..=half)
        .filter(|&k| singular_values[k - 1] > FLOOR * singular_values[0] && drop(k) < CLIFF)
        .min_by(|&a, &b| drop(a).total_cmp(&drop(b)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_forms_round_trip() {
        for text in ["auto", "elbow", "full", "12", "energy=0.999", "error=1e-3"] {
            assert_eq!(text.parse::<RankSelection>().unwrap().to_string(), text);
        }
        for text in [
            "",
            "-1",
            "1.5",
            "energy=0",
            "energy=1.1",
            "energy=x",
            "error=-1",
            "error=inf",
            "Full",
        ] {
            assert!(text.parse::<RankSelection>().is_err(), "{text}");
        }
    }

    #[test]
    fn a_cliff_is_the_elbow_however_unequal_the_modes() {
        let mut values = vec![1e-15; 60];
        values[..6].copy_from_slice(&[10.0, 3.0, 0.5, 0.01, 2e-3, 1e-3]);
        assert_eq!(elbow(&values), 6);
    }

    #[test]
    fn a_smooth_decay_bends_where_the_values_fall_below_their_mean() {
        let values: Vec<f64> = (0..50).map(|k| 0.8f64.powi(k)).collect();
        // The mean is 0.1, and 0.8^10 = 0.107, 0.8^11 = 0.086.
        assert_eq!(elbow(&values), 11);
        // The definition: the furthest point above the chord.
        let total: f64 = values.iter().sum();
        let above = |k: usize| values[..k].iter().sum::<f64>() / total - k as f64 / 50.0;
        let furthest = (0..=50).max_by(|&a, &b| above(a).total_cmp(&above(b))).unwrap();
        assert_eq!(furthest, 11);
    }

    #[test]
    fn the_fall_from_a_decay_to_rounding_is_no_cliff() {
        let decay = |k: i32| if k < 20 { 0.25f64.powi(k) } else { 0.0 };
        let values: Vec<f64> = (0..60).map(decay).collect();
        // 0.25^19 = 4e-12. The mean is 4 / 3 / 60 = 0.022.
        assert_eq!(elbow(&values), 3);
        // A fall from a higher value is a cliff.
        let cut: Vec<f64> = (0..60).map(|k| if k < 12 { decay(k) } else { 0.0 }).collect();
        assert_eq!(elbow(&cut), 12);
    }

    #[test]
    fn nothing_has_no_elbow() {
        assert_eq!(elbow(&[]), 0);
        assert_eq!(elbow(&[0.0, 0.0]), 0);
        assert_eq!(elbow(&[1.0]), 1);
    }
}
