//! Why a frame gave no samples.

use psf_types::DataError;
use thiserror::Error;

/// What went wrong while stars were turned into PSF samples.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum StarError {
    /// A setting out of range.
    #[error("{name} must be {allowed}, got {got}")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// What is allowed, in words.
        allowed: &'static str,
        /// What was given.
        got: f64,
    },
    /// A background without noise, so that a threshold in sigma means nothing.
    #[error(
        "the background has no noise (r.m.s. 0): sources are found by their excess over the noise, so add some to a noise-free image"
    )]
    NoNoise,
    /// A frame that gives no samples with these settings: it is too small, nothing in it is bright
    /// enough, no source is fit to be a sample, the stars are too few for an oversampled PSF that
    /// was asked for by name, or stamps have no room at the distance from the edge asked for.
    #[error("{0}")]
    NoSamples(String),
    /// Data that break an invariant.
    #[error(transparent)]
    Data(#[from] DataError),
}

/// Refuses a setting unless `holds`.
pub(crate) fn check(
    holds: bool,
    name: &'static str,
    allowed: &'static str,
    got: f64,
) -> Result<(), StarError> {
    if holds {
        Ok(())
    } else {
        Err(StarError::Setting { name, allowed, got })
    }
}

/// Whether a value is a number, `least` or above.
pub(crate) fn at_least(least: f64, value: f64) -> bool {
    value.is_finite() && value >= least
}

/// Methods that change one setting, inside an `impl`: a table of method, number given and field
/// (`: Some` where the field is an option), the condition that the number must meet, its name, and
/// what is allowed, in words.
macro_rules! checked_setters {
    ($(
        $(#[$doc:meta])*
        $method:ident($given:ident) => $field:ident $(: $option:ident)?, if $holds:expr,
        else $name:literal, $allowed:literal;
    )+) => {$(
        $(#[$doc])*
        pub fn $method(self, $given: f64) -> Result<Self, StarError> {
            $crate::error::check($holds, $name, $allowed, $given)?;
            Ok(Self { $field: $($option)?($given), ..self })
        }
    )+};
}
pub(crate) use checked_setters;
