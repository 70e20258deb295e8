//! What can go wrong in the pipeline.

use psf_types::{DataError, FrameShape};
use thiserror::Error;

/// Errors of the pipeline: those of its stages, and of what joins them.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PsfieldError {
    /// Data that break an invariant.
    #[error(transparent)]
    Data(#[from] DataError),
    /// Making the basis failed.
    #[error(transparent)]
    Basis(#[from] psf_basis::BasisError),
    /// Interpolating the coefficients failed.
    #[error(transparent)]
    Interpolation(#[from] coeff_field::CoeffFieldError),
    /// The PSF has no value at a position.
    #[error(transparent)]
    Field(#[from] psf_types::FieldError),
    /// The convolution failed.
    #[error(transparent)]
    Convolution(#[from] conv_core::ConvError),
    /// A file could not be read or written.
    #[error(transparent)]
    Io(#[from] psf_io::IoError),
    /// A measurement failed that everything else needs.
    #[error(transparent)]
    Metrics(#[from] metrics::MetricsError),
    /// The stars of a frame gave no samples.
    #[error(transparent)]
    Stars(Box<psf_stars::StarError>),
    /// No star can be measured in a frame and its simulation.
    #[error(
        "none of the {stars} stars could be measured in both frames in windows of {window} pixels: try another window (--window)"
    )]
    NothingMeasured {
        /// Stars that became samples.
        stars: usize,
        /// Pixels along each side of the window.
        window: usize,
    },
    /// The frame is larger than the field over which the PSF is known.
    #[error(
        "the frame is {frame} pixels, but the PSF is known over a field of {field} pixels: cut the scene to the field \
         with a frame (--frame X0,Y0,NX,NY); light of the scene beyond it still comes in"
    )]
    FrameBeyondField {
        /// The frame.
        frame: FrameShape,
        /// The field of the PSF.
        field: FrameShape,
    },
    /// A method that cannot be read.
    #[error("the method must be auto, lowrank, basis, patch=N (N at least 1) or direct, got {got}")]
    BadMethod {
        /// What was given.
        got: String,
    },
    /// A position outside the field over which the PSF is known.
    #[error(
        "position {index} (0-based) at {position} lies outside the field of {field} pixels over which the PSF is known"
    )]
    OutsideField {
        /// Index of the position.
        index: usize,
        /// The position.
        position: psf_types::Position,
        /// The field of the PSF.
        field: FrameShape,
    },
    /// No positions at all.
    #[error("there are no positions: at least one is needed")]
    NoPositions,
    /// A position that is there twice.
    #[error("positions {first} and {second} (0-based) are both {position}: remove one")]
    DuplicatePositions {
        /// Index of the first.
        first: usize,
        /// Index of the other.
        second: usize,
        /// The position.
        position: psf_types::Position,
    },
    /// Sub-pixel phases on a grid that is not the frame's.
    #[error("sub-pixel phases need the frame's own pixels: choose the native grid")]
    SubPixelNeedsNative,
    /// A stack of stamps that is larger than any that is meant.
    #[error("{stamps} stamps of {nx} x {ny} pixels would fill more than {} GiB: ask for fewer or smaller ones", limit >> 30)]
    TooLarge {
        /// Number of stamps.
        stamps: usize,
        /// Columns of each.
        nx: usize,
        /// Rows of each.
        ny: usize,
        /// The largest stack in bytes.
        limit: usize,
    },
}
