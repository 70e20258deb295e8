//! Errors of detectors.

use std::ops::Range;
use std::path::PathBuf;

use psf_types::{DataError, FrameShape};
use thiserror::Error;

/// An error in the description of a detector, or in the data that it exposes.
///
/// Keys are written as in the TOML file, for example `bad_pixels.dead_fraction`. Pixels are
/// `[y, x]`, 0-based.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum DetectorError {
    /// The file could not be read.
    #[error("cannot read the detector file {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        #[source]
        source: std::io::Error,
    },
    /// The file was read, but its content does not describe a detector.
    #[error("the detector file {} is not usable", path.display())]
    InFile {
        /// The file.
        path: PathBuf,
        /// The error in it.
        #[source]
        source: Box<DetectorError>,
    },
    /// The text is not TOML, has an unknown key, or a value of the wrong type.
    #[error("the detector description is not valid")]
    Toml(#[source] Box<toml::de::Error>),
    /// A value out of range.
    #[error("{key} must be {allowed}, got {got}")]
    Setting {
        /// The key.
        key: &'static str,
        /// The values that are allowed.
        allowed: &'static str,
        /// The value that was given.
        got: f64,
    },
    /// A setting that has no meaning without another one.
    #[error("{} needs {}: set {other}", quantity_and_key(key), quantity(other))]
    Needs {
        /// The key, or the input, that needs the other key.
        key: &'static str,
        /// The key that is missing.
        other: &'static str,
    },
    /// The sky is negative or not finite in a corner of the frame.
    #[error(
        "the sky is {lowest_e} electrons at pixel {index:?} ([y, x]): raise sky_e or choose a weaker sky_gradient_e_per_px"
    )]
    NegativeSky {
        /// Electrons in that corner.
        lowest_e: f64,
        /// The corner.
        index: [usize; 2],
    },
    /// An expected charge that is not a finite number.
    #[error(
        "the charge expected at pixel {index:?} ([y, x]) is {value}: every pixel must be a finite number"
    )]
    NonFinite {
        /// The pixel.
        index: [usize; 2],
        /// NaN or an infinity.
        value: f64,
    },
    /// A result that is too large for the type of the image.
    #[error(
        "the result at pixel {index:?} ([y, x]) is {value}, beyond the range of {precision}: use smaller values or double precision"
    )]
    TooLarge {
        /// The pixel.
        index: [usize; 2],
        /// The result.
        value: f64,
        /// The type of the image.
        precision: &'static str,
    },
    /// Rows that are not in the frame, or an image that does not have all rows of the frame.
    #[error("got rows {} to {} (0-based, the end not included) for a frame of {frame} pixels: rows must lie in the frame, and an image that is exposed as a whole must have as many rows as the frame", rows.start, rows.end)]
    Rows {
        /// The rows that were given.
        rows: Range<usize>,
        /// The frame.
        frame: FrameShape,
    },
    /// Rows that are not as wide as the frame.
    #[error("rows must be as wide as the frame: expected {expected} pixels, got {got}")]
    RowWidth {
        /// Columns of the frame.
        expected: usize,
        /// Columns that were given.
        got: usize,
    },
    /// A mask that does not have the shape of the frame.
    #[error("the bad-pixel mask has {mask} pixels, the image {frame}: the shapes must be equal")]
    MaskShape {
        /// Shape of the mask.
        mask: FrameShape,
        /// Shape of the image.
        frame: FrameShape,
    },
    /// A value of a mask that is not a sum of flags.
    #[error(
        "the bad-pixel mask has the value {value} at pixel {index:?} ([y, x]): it must be 0 (good) or a sum of 1 (dead), 2 (hot), 4 (bad \
         column) and 8 (saturated, ignored)"
    )]
    MaskValue {
        /// The pixel.
        index: [usize; 2],
        /// Its value.
        value: f64,
    },
    /// Data that break an invariant of their type.
    #[error(transparent)]
    Data(#[from] DataError),
}

/// The quantity that a key sets, or the key itself if it has no other name.
fn quantity(key: &str) -> &str {
    match key {
        "dark_e_per_s" => "a dark current",
        "exposure_s" => "an exposure time",
        "bad_pixels.hot_fraction" => "a fraction of hot pixels",
        "bad_pixels.hot_dark_e_per_s" => "a dark current of hot pixels",
        other => other,
    }
}

/// The quantity that a key sets, followed by the key.
fn quantity_and_key(key: &str) -> String {
    let quantity = quantity(key);
    if quantity == key {
        key.to_owned()
    } else {
        format!("{quantity} ({key})")
    }
}

/// Returns `value` if it is finite and `holds` returns true for it, else an error that names `key`.
pub(crate) fn require(
    key: &'static str,
    allowed: &'static str,
    value: f64,
    holds: impl FnOnce(f64) -> bool,
) -> Result<f64, DetectorError> {
    if value.is_finite() && holds(value) {
        Ok(value)
    } else {
        Err(DetectorError::Setting {
            key,
            allowed,
            got: value,
        })
    }
}

/// Returns `value` if it is finite and at least 0.
pub(crate) fn at_least_zero(key: &'static str, value: f64) -> Result<f64, DetectorError> {
    require(key, "a number, 0 or above", value, |v| v >= 0.0)
}

/// Returns `value` if it is finite and above 0.
pub(crate) fn above_zero(key: &'static str, value: f64) -> Result<f64, DetectorError> {
    require(key, "a number above 0", value, |v| v > 0.0)
}
