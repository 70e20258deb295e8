//! Errors of measuring and showing simulations.

use psf_types::FrameShape;
use psfield::PsfieldError;
use thiserror::Error;

use crate::plot::PlotError;

/// Errors of measuring, comparing and showing simulations: those of the pipeline, and those of the
/// steps after it.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum LabError {
    /// The pipeline failed.
    #[error("{0}")]
    Pipeline(#[source] PsfieldError),
    /// A figure that could not be drawn.
    #[error(transparent)]
    Plot(#[from] PlotError),
    /// No star can be measured in a frame and its simulation.
    #[error(
        "none of the {stars} stars could be measured in both frames in windows of {window} pixels: choose another window"
    )]
    NothingMeasured {
        /// Stars that became samples.
        stars: usize,
        /// Pixels along each side of the window.
        window: usize,
    },
    /// Objects that would overlap.
    #[error(
        "{across} x {across} objects do not fit into a frame of {frame} pixels, because neighbours must be {least_apart} pixels apart: ask \
         for fewer objects or a larger frame"
    )]
    ObjectsTooClose {
        /// The frame.
        frame: FrameShape,
        /// Objects along each axis.
        across: usize,
        /// Smallest distance of neighbours in pixels.
        least_apart: usize,
    },
    /// True PSFs and a model that differ in the pixel response, so that they cannot be compared.
    #[error(
        "the true PSFs lack the pixel response and those of the model include it, so they cannot be compared: sample the model from PSFs \
         without the pixel response (PIXCONV)"
    )]
    TruthWithoutPixels,
}

impl<E: Into<PsfieldError>> From<E> for LabError {
    fn from(error: E) -> Self {
        Self::Pipeline(error.into())
    }
}
