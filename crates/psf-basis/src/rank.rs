//! The number of components: the spectrum of singular values, its elbow, and the choice of a rank.

use std::str::FromStr;

use psf_types::{DataError, through_text};
use serde::{Deserialize, Serialize};

use crate::components::Rest;
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
    /// samples is at most [`RankSelection::AUTO_ERROR`] or a smaller one that suits the interpolation, and
    /// the error of their flux in every circle about the source too
    /// ([`BasisFit::circle_errors`](crate::BasisFit::circle_errors)). Of components below the noise, only
    /// those are kept that vary smoothly over the field ([`Spectrum::smooth`]).
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
    /// The largest truncation error over the samples, and the largest error of their flux in circles,
    /// that `auto` accepts. A smaller one counts if it suits the interpolation of the coefficients
    /// ([`Svd::fit_for_field`](crate::Svd::fit_for_field)).
    pub const AUTO_ERROR: f64 = 1e-4;

    /// Returns the rank for a spectrum, or `None` if it depends on singular values in `rest`.
    /// `max_errors[k]` is the largest error over the samples with `k` components. `auto_error` is the
    /// largest one that `auto` accepts.
    pub(crate) fn select(
        self,
        spectrum: &Spectrum,
        rest: &Rest,
        max_errors: &[f64],
        auto_error: f64,
    ) -> Result<Option<usize>, BasisError> {
        let available = spectrum.numerical_rank;
        let if_all = |rank| (rest.count == 0).then_some(rank);
        let for_error = |limit: f64| {
            let enough = max_errors.iter().position(|&e| e <= limit);
            enough.map(|k| k.min(available)).or(if_all(available))
        };
        Ok(match self {
            Self::Auto => for_error(auto_error)
                // Components below the noise are not kept, so they are not needed.
                .or(spectrum.noise_sigma.map(|_| available))
                .map(|needed| spectrum.elbow.max(needed).min(spectrum.significant)),
            Self::Elbow => Some(spectrum.elbow),
            Self::Full => if_all(available),
            Self::Fixed(asked) if asked > available => match if_all(available) {
                Some(available) => return Err(BasisError::RankTooHigh { asked, available }),
                None => None,
            },
            Self::Fixed(asked) => Some(asked),
            Self::Energy(fraction) => spectrum.rank_for_energy(fraction, rest),
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
    /// The singular values that were computed, from the largest on. These are all, except if there
    /// are at least 1024 samples and pixels and the rank is not `full`. The values that are then
    /// left out have no influence on the ranks.
    pub singular_values: Vec<f64>,
    /// `c_k = sum_{i<=k} s_i / sum_i s_i`, from `c_1` on. All are 1 if every singular value is 0. If
    /// singular values are left out, their sum is estimated, to a few per cent.
    pub cumulative_weights: Vec<f64>,
    /// The number of components at the elbow of the cumulative weights, without components below
    /// the noise. The crate's page defines the elbow.
    pub elbow: usize,
    /// The number of computed components above rounding, and above the noise if there is any.
    pub significant: usize,
    /// The number of computed components above rounding. If no value is left out, this is the rank
    /// that `full` selects.
    pub numerical_rank: usize,
    /// The standard deviation of the white noise in the pixels, if it was found or given. If it
    /// differs from sample to sample, the root mean square over the samples.
    pub noise_sigma: Option<f64>,
    /// The largest singular value of this noise, in the limit of large matrices. If the noise has
    /// one level in all samples, it is `sigma (sqrt L + sqrt P)` for `P` samples of `L` pixels.
    /// (`P` is one less if the mean is subtracted.)
    pub noise_edge: Option<f64>,
    /// The number of components that the rank `auto` keeps although they lie below the noise, because they
    /// vary smoothly over the field.
    #[serde(default)]
    pub smooth: usize,
}

impl Spectrum {
    /// Derives the cumulative weights and the ranks from the singular values. Values below
    /// `rounding` are rounding errors of the decomposition. Returns `None` if the ranks depend on
    /// singular values that are not computed.
    pub(crate) fn new(
        singular_values: Vec<f64>,
        rest: &Rest,
        rounding: f64,
        noise: Option<NoiseFloor>,
    ) -> Option<Self> {
        let threshold = noise.map_or(0.0, |n| n.threshold);
        let negligible = FLOOR * singular_values.first()?;
        if rest.largest > noise.map_or(negligible, |n| n.threshold) {
            return None;
        }
        let total = singular_values.iter().sum::<f64>() + rest.sum;
        let mut sum = 0.0;
        let cumulative_weights = singular_values
            .iter()
            .map(|s| {
                sum += s;
                if total > 0.0 { sum / total } else { 1.0 }
            })
            .collect();
        let significant = count_above(&singular_values, threshold.max(rounding));
        Some(Self {
            elbow: elbow(&singular_values, rest, negligible.max(threshold), significant)?,
            significant,
            numerical_rank: count_above(&singular_values, rounding),
            noise_sigma: noise.map(|n| n.sigma),
            noise_edge: noise.map(|n| n.edge),
            smooth: 0,
            cumulative_weights,
            singular_values,
        })
    }

    /// The smallest number of components that hold the fraction `energy` of `sum s_i^2`. Returns
    /// `None` if it is larger than the number of components computed.
    fn rank_for_energy(&self, energy: f64, rest: &Rest) -> Option<usize> {
        let needed = energy * (self.singular_values.iter().map(|s| s * s).sum::<f64>() + rest.energy);
        let mut sum = 0.0;
        let enough = self
            .singular_values
            .iter()
            .take(self.numerical_rank)
            .take_while(|&&s| {
                let short = sum < needed;
                sum += s * s;
                short
            });
        let count = enough.count();
        (rest.count == 0 || sum >= needed).then_some(count)
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
/// `c_k = sum_{i<=k} s_i / sum_i s_i`, at most `significant`.
///
/// * A cliff is a fall by more than a factor of 1000 from one singular value to the next, in the
///   first half of the curve. There the curve has a sharp corner, which is the elbow. For example,
///   samples that span exactly six modes have their elbow at six, however unequal the six are. Of
///   several cliffs the deepest counts. A cliff that begins below `negligible` does not count. This
///   is 1e-8 of the largest value, because a smooth decay ends in rounding there, or the noise.
/// * Without a cliff, the elbow is the point of the curve furthest above its chord from (0, 0) to
///   (m, 1): "Kneedle", Satopaa, Albrecht, Irwin and Raghavan 2011 (ICDCS workshops, section II),
///   without smoothing. The curve is concave, so this is the number of singular values above their
///   mean, at least 1.
///
/// `singular_values` are in descending order, and those in `rest` are at most `negligible`. The
/// result is 0 if all are 0 or there are none, and `None` if the limits of the sum over `rest` allow
/// more than one result.
fn elbow(singular_values: &[f64], rest: &Rest, negligible: f64, significant: usize) -> Option<usize> {
    let sum: f64 = singular_values.iter().sum();
    if sum <= 0.0 {
        return Some(0);
    }
    if let Some(cliff) = cliff(singular_values, rest, negligible) {
        return Some(cliff.min(significant));
    }
    let size = (singular_values.len() + rest.count) as f64;
    let [most, least] = rest.sum_limits.map(|of_rest| {
        let mean = (sum + of_rest) / size;
        count_above(singular_values, mean).max(1).min(significant)
    });
    (least == most).then_some(least)
}

fn cliff(singular_values: &[f64], rest: &Rest, negligible: f64) -> Option<usize> {
    let half = usize::midpoint(singular_values.len(), rest.count);
    let next = singular_values.iter().skip(1).chain(Some(&rest.largest));
    let drops = singular_values.iter().zip(next).take(half).enumerate();
    drops
        .filter(|&(_, (&value, &next))| value > negligible && next < CLIFF * value)
        .min_by(|(_, (a, b)), (_, (c, d))| (*b / *a).total_cmp(&(*d / *c)))
        .map(|(k, _)| k + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn elbow_of(singular_values: &[f64]) -> usize {
        let negligible = FLOOR * singular_values.first().copied().unwrap_or_default();
        elbow(singular_values, &Rest::default(), negligible, usize::MAX).unwrap()
    }

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
        assert_eq!(elbow_of(&values), 6);
    }

    #[test]
    fn a_smooth_decay_bends_where_the_values_fall_below_their_mean() {
        let values: Vec<f64> = (0..50).map(|k| 0.8f64.powi(k)).collect();
        // The mean is 0.1, and 0.8^10 = 0.107, 0.8^11 = 0.086.
        assert_eq!(elbow_of(&values), 11);
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
        assert_eq!(elbow_of(&values), 3);
        // A fall from a higher value is a cliff.
        let cut: Vec<f64> = (0..60).map(|k| if k < 12 { decay(k) } else { 0.0 }).collect();
        assert_eq!(elbow_of(&cut), 12);
    }

    #[test]
    fn nothing_has_no_elbow() {
        assert_eq!(elbow_of(&[]), 0);
        assert_eq!(elbow_of(&[0.0, 0.0]), 0);
        assert_eq!(elbow_of(&[1.0]), 1);
    }
}
