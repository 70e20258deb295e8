//! Why a PSF source cannot be made or drawn.

use std::path::PathBuf;

use psf_types::{DataError, Position};
use thiserror::Error;

/// What is wrong with the description of a PSF source, or with the source at a position.
///
/// Keys are written as in the TOML file, `aperture.diameter_m`; list entries are counted from 0.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum OpticsError {
    /// The file could not be read.
    #[error("cannot read the telescope file {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        #[source]
        source: std::io::Error,
    },
    /// The file was read, its content is no telescope.
    #[error("the telescope file {} is not usable", path.display())]
    InFile {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
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
        /// What is allowed, in words.
        allowed: &'static str,
        /// What was given.
        got: String,
    },
    /// A description that cannot be used, in words: none or several of keys of which exactly one is
    /// needed, something listed twice that may be listed once, a computation that would need more
    /// memory than is sensible, or a wavefront that sends light further out than the computed part
    /// of the focal plane.
    #[error("{0}")]
    Unusable(String),
    /// A profile without a size.
    #[error("the profile's FWHM at {position} is {fwhm_px} pixels: it must be finite and above 0")]
    ProfileSize {
        /// The field position.
        position: Position,
        /// The polynomial's value there.
        fwhm_px: f64,
    },
    /// A profile whose ellipticity is that of no ellipse.
    #[error("the profile's distortion at {position} is e1 = {e1}, e2 = {e2}: e1^2 + e2^2 must be below 1")]
    ProfileShape {
        /// The field position.
        position: Position,
        /// The first component there.
        e1: f64,
        /// The second component there.
        e2: f64,
    },
    /// A frame or a stamp grid that cannot be.
    #[error(transparent)]
    Data(#[from] DataError),
}

impl OpticsError {
    /// The error for something that may be listed once; `key` is the later of the two.
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

/// `value` if it is finite and `holds`, else an error that names `key`.
pub(crate) fn require(key: &str, allowed: &'static str, value: f64, holds: bool) -> Result<f64, OpticsError> {
    if value.is_finite() && holds {
        Ok(value)
    } else {
        Err(OpticsError::setting(key, allowed, value))
    }
}
