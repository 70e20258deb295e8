//! How many components are kept.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::{BasisError, Spectrum};

/// How many components are kept.
///
/// Written as `auto`, `elbow`, `full`, a whole number, `energy=0.999` or `error=1e-3`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
#[non_exhaustive]
pub enum RankSelection {
    /// At least the elbow, and as many more as a largest truncation error of [`RankSelection::AUTO_ERROR`] over the
    /// samples asks, but never a component below the noise.
    #[default]
    Auto,
    /// The elbow of the cumulative weights.
    Elbow,
    /// Every component above rounding.
    Full,
    /// This many.
    Fixed(usize),
    /// As many as hold this fraction of the sum of the squared singular values.
    Energy(f64),
    /// As many as bring the relative L2 truncation error of every sample to this or below.
    Error(f64),
}

impl RankSelection {
    /// The largest truncation error over the samples that `auto` asks for.
    pub const AUTO_ERROR: f64 = 1e-4;

    /// The rank for a spectrum. `max_errors[k]` is the largest truncation error over the samples with `k` components.
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
    type Err = BasisError;
    fn from_str(text: &str) -> Result<Self, BasisError> {
        let refused = || BasisError::BadRank { got: text.to_owned() };
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

impl TryFrom<String> for RankSelection {
    type Error = BasisError;
    fn try_from(text: String) -> Result<Self, BasisError> {
        text.parse()
    }
}

impl From<RankSelection> for String {
    fn from(selection: RankSelection) -> Self {
        selection.to_string()
    }
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
}
