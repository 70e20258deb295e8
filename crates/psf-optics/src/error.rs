//! Errors of making or drawing a PSF source.

use std::path::PathBuf;

use psf_types::{DataError, Position};
use thiserror::Error;

/// An error in the description of a PSF source, or in the PSF of a source at a position.
///
/// Keys are written as in the TOML file, for example `aperture.diameter_m`. List entries are
/// counted from 0.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum OpticsError {
    /// The file could not be read.
    #[error("cannot read the telescope file {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        #[source]
        source: std::io::Error,
    },
    /// The file was read, but its content does not describe a telescope.
    #[error("the telescope file {} is not usable", path.display())]
    InFile {
        /// The file.
        path: PathBuf,
        /// The error in it.
        #[source]
        source: Box<OpticsError>,
    },
    /// The text is not TOML, has an unknown or a missing key, or a value of the wrong type.
    #[error("the telescope description is not valid")]
    Toml(#[source] Box<toml::de::Error>),
    /// A value out of range.
    #[error("{key} must be {allowed}, got {got}")]
    Setting {
        /// The key.
        key: String,
        /// The values that are allowed.
        allowed: &'static str,
        /// The value that was given.
        got: String,
    },
    /// A description that cannot be used. Examples: an entry is repeated. Exactly one of two keys
    /// is needed, but none or both are given. The computation needs too much memory. The wavefront
    /// sends light beyond the computed part of the focal plane.
    #[error("{0}")]
    Unusable(String),
    /// The size of a profile is not finite or not above 0.
    #[error("the profile's FWHM at {position} is {fwhm_px} pixels: it must be finite and above 0")]
    ProfileSize {
        /// The position in the field.
        position: Position,
        /// The polynomial's value there.
        fwhm_px: f64,
    },
    /// The distortion of a profile is too large for an ellipse.
    #[error("the profile's distortion at {position} is e1 = {e1}, e2 = {e2}: e1^2 + e2^2 must be below 1")]
    ProfileShape {
        /// The position in the field.
        position: Position,
        /// The first component there.
        e1: f64,
        /// The second component there.
        e2: f64,
    },
    /// A frame or a stamp grid that is not possible.
    #[error(transparent)]
    Data(#[from] DataError),
}

impl OpticsError {
    /// Returns the error for a repeated entry. `key` names the later entry.
    pub(crate) fn repeated(key: &str, what: &str) -> Self {
        Self::Unusable(format!("{key} repeats {what}: merge the two"))
    }

    pub(crate) fn setting(
        key: impl Into<String>,
        allowed: &'static str,
        got: impl std::fmt::Display,
    ) -> Self {
        Self::Setting {
            key: key.into(),
            allowed,
            got: got.to_string(),
        }
    }
}

/// Returns `value` if it is finite and `holds` is true, else an error that names `key`.
pub(crate) fn require(key: &str, allowed: &'static str, value: f64, holds: bool) -> Result<f64, OpticsError> {
    if value.is_finite() && holds {
        Ok(value)
    } else {
        Err(OpticsError::setting(key, allowed, value))
    }
}
