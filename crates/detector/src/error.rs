//! What goes wrong with detectors.

use std::ops::Range;
use std::path::PathBuf;

use psf_types::{DataError, FrameShape};
use thiserror::Error;

/// What is wrong with the description of a detector, or with what it is to expose.
///
/// Keys are written as in the TOML file, `bad_pixels.dead_fraction`. Pixels are `[y, x]`, 0-based.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum DetectorError {
    /// The file could not be read.
    #[error("cannot read the detector file {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        #[source]
        source: std::io::Error,
    },
    /// The file was read, its content is no detector.
    #[error("the detector file {} is not usable", path.display())]
    InFile {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
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
        /// What is allowed, in words.
        allowed: &'static str,
        /// What was given.
        got: f64,
    },
    /// A setting that says nothing without another.
    #[error("{key} needs {other}: give {other}, or leave {key} out")]
    Needs {
        /// The key.
        key: &'static str,
        /// The key that is missing.
        other: &'static str,
    },
    /// A sky that becomes negative in a corner of the frame.
    #[error(
        "the sky is {lowest_e} electrons at pixel {index:?} ([y, x]): raise sky_e or lower sky_gradient_e_per_px"
    )]
    NegativeSky {
        /// Electrons in that corner.
        lowest_e: f64,
        /// The corner.
        index: [usize; 2],
    },
    /// An expected charge that is no number.
    #[error(
        "the charge expected at pixel {index:?} ([y, x]) is {value}: every pixel must be a finite number"
    )]
    NonFinite {
        /// The pixel.
        index: [usize; 2],
        /// NaN or an infinity.
        value: f64,
    },
    /// A result that the type of the image cannot hold.
    #[error(
        "the result at pixel {index:?} ([y, x]) is {value}, beyond the range of {precision}: use double precision"
    )]
    TooLarge {
        /// The pixel.
        index: [usize; 2],
        /// The result.
        value: f64,
        /// The type of the image.
        precision: &'static str,
    },
    /// Rows that the frame does not have, or an image that does not have all of them.
    #[error("rows {} to {} (not included, 0-based) do not fit a frame of {frame} pixels", rows.start, rows.end)]
    Rows {
        /// The rows given.
        rows: Range<usize>,
        /// The frame.
        frame: FrameShape,
    },
    /// Rows that are not as wide as the frame.
    #[error("rows must be as wide as the frame, {expected} pixels, got {got}")]
    RowWidth {
        /// Columns of the frame.
        expected: usize,
        /// Columns given.
        got: usize,
    },
    /// A mask of another shape than the frame.
    #[error("the bad-pixel mask is {mask} pixels, the image {frame}: give a mask of the image's shape")]
    MaskShape {
        /// Shape of the mask.
        mask: FrameShape,
        /// Shape of the image.
        frame: FrameShape,
    },
    /// A value of a mask that is no sum of flags.
    #[error(
        "the bad-pixel mask is {value} at pixel {index:?} ([y, x]): it must be 0 (good) or a sum of 1 (dead), 2 (hot), 4 (bad \
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

/// `value` if it is finite and `holds`, else an error that names `key`.
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

/// `value` if it is a number, 0 or above.
pub(crate) fn at_least_zero(key: &'static str, value: f64) -> Result<f64, DetectorError> {
    require(key, "a number, 0 or above", value, |v| v >= 0.0)
}

/// `value` if it is a number above 0.
pub(crate) fn above_zero(key: &'static str, value: f64) -> Result<f64, DetectorError> {
    require(key, "a number above 0", value, |v| v > 0.0)
}
