//! Errors of making samples from a frame.

use psf_types::DataError;
use thiserror::Error;

/// An error of making PSF samples from stars.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum StarError {
    /// A setting out of range.
    #[error("{name} must be {allowed}, got {got}")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// The values that are allowed.
        allowed: &'static str,
        /// The value that was given.
        got: f64,
    },
    /// Most of the background has no noise, so that a threshold in sigma has no meaning. This
    /// error also occurs if all pixels are NaN.
    #[error(
        "most of the background has no noise (r.m.s. 0): sources are found by their excess over the noise, so add noise to a noise-free image, or cut off blank areas"
    )]
    NoNoise,
    /// A frame that gives no samples with these settings. The text says why. For example, the frame
    /// is too small, no source is suitable, or the stars are too few for the requested method or
    /// for the requested number of held-out stars.
    #[error("{0}")]
    NoSamples(String),
    /// Positions or stamps that the types of `psf_types` refuse.
    #[error(transparent)]
    Data(#[from] DataError),
}

/// Returns [`StarError::Setting`] unless `holds`.
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

/// Returns whether a value is finite and at least `least`.
pub(crate) fn at_least(least: f64, value: f64) -> bool {
    value.is_finite() && value >= least
}

/// Defines methods inside an `impl`, each of which changes one setting. Each entry lists the
/// method, its argument and the field (`: Some` if the field is an option), the condition on the
/// argument, the name of the setting, and the allowed values.
macro_rules! checked_setters {
    ($(
        $(#[$doc:meta])*
        $method:ident($given:ident: $kind:ty) => $field:ident $(: $option:ident)?, if $holds:expr,
        else $name:literal, $allowed:literal;
    )+) => {$(
        $(#[$doc])*
        pub fn $method(self, $given: $kind) -> Result<Self, StarError> {
            $crate::error::check($holds, $name, $allowed, $given as f64)?;
            Ok(Self { $field: $($option)?($given), ..self })
        }
    )+};
}
pub(crate) use checked_setters;
