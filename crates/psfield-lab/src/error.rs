//! Errors of measuring and showing simulations.

use psf_types::FrameShape;
use psfield::PsfieldError;
use thiserror::Error;

/// Errors of measuring, comparing and showing simulations.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum LabError {
    /// An error of the library psfield, for example of a fit or of a simulation.
    #[error("{0}")]
    Pipeline(#[source] PsfieldError),
    /// No star can be measured in both the frame and its simulation.
    #[error(
        "none of the {stars} stars could be measured in both the frame and its simulation, in windows of {window} x {window} pixels: choose another window size"
    )]
    NothingMeasured {
        /// Number of stars that became PSF samples. Only these are measured.
        stars: usize,
        /// Pixels along each side of the window.
        window: usize,
    },
    /// Objects that would overlap, or would lie too near to the frame's edges.
    #[error(
        "{across} x {across} objects do not fit into a frame of {frame} pixels, because neighbours must be at least {least_apart} pixels apart \
         and all objects must keep away from the edges: ask for fewer objects or a larger frame"
    )]
    ObjectsTooClose {
        /// The frame.
        frame: FrameShape,
        /// Objects along each axis.
        across: usize,
        /// Smallest allowed distance between neighbours, in pixels.
        least_apart: usize,
    },
    /// The model's PSFs include the pixel response, but the true PSFs lack it.
    #[error(
        "the true PSFs lack the pixel response, but the PSFs of the model include it, so they cannot be compared: give true PSFs with the \
         pixel response, or a model of PSFs without it (FITS keyword PIXCONV)"
    )]
    TruthWithoutPixels,
}

impl<E: Into<PsfieldError>> From<E> for LabError {
    fn from(error: E) -> Self {
        Self::Pipeline(error.into())
    }
}
