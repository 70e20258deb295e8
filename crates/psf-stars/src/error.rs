//! Why a frame gave no samples.

use psf_types::{DataError, FrameShape};
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
    /// A frame in which no star has room.
    #[error("a frame of {frame} pixels is too small: at least {need} pixels each way are needed")]
    FrameTooSmall {
        /// The frame.
        frame: FrameShape,
        /// Pixels needed along each axis.
        need: usize,
    },
    /// A background without noise, so that a threshold in sigma means nothing.
    #[error(
        "the background has no noise (r.m.s. 0): sources are found by their excess over the noise, so add some to a noise-free image"
    )]
    NoNoise,
    /// No source at all.
    #[error("no source exceeds {threshold} sigma of the background noise: lower the threshold")]
    NoSources {
        /// The threshold in sigma.
        threshold: f64,
    },
    /// No source that is fit to be a PSF sample.
    #[error(
        "none of the {detected} sources can serve as a PSF sample: {reasons}. Loosen the cut that rejects most of them"
    )]
    NoStars {
        /// Number of sources found.
        detected: usize,
        /// How many were rejected for which reason.
        reasons: String,
    },
    /// Too few stars for a method that was asked for by name.
    #[error(
        "an oversampled PSF (epsf) at {oversampling} x needs at least {need} stars, {got} were accepted: use the stars' own stamps, or loosen the cuts"
    )]
    TooFewForEpsf {
        /// Accepted stars.
        got: usize,
        /// Stars needed.
        need: usize,
        /// The oversampling.
        oversampling: usize,
    },
    /// A distance from the frame's edge at which a stamp does not fit into the frame.
    #[error(
        "{edge_px} pixels from the frame's edge are less than half a stamp, {half_stamp} pixels: ask for at least as many, or for smaller stamps"
    )]
    EdgeInsideStamp {
        /// The distance asked for.
        edge_px: f64,
        /// Pixels from a stamp's centre to its edge.
        half_stamp: usize,
    },
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
