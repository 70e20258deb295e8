//! Errors of measuring and showing simulations.

use psf_types::FrameShape;
use psfield::PsfieldError;
use thiserror::Error;

use crate::plot::PlotError;

/// Errors of measuring, comparing and showing simulations: those of the pipeline, and of what is
/// done with its results.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum LabError {
    /// The pipeline failed.
    #[error(transparent)]
    Pipeline(PsfieldError),
    /// A figure that could not be drawn.
    #[error(transparent)]
    Plot(#[from] PlotError),
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
    /// Objects that would overlap.
    #[error(
        "{across} x {across} objects do not fit onto a frame of {frame} pixels: neighbours must be {least_apart} pixels apart; ask for \
         fewer objects or a larger frame"
    )]
    ObjectsTooClose {
        /// The frame.
        frame: FrameShape,
        /// Objects along each axis.
        across: usize,
        /// Pixels that neighbours need.
        least_apart: usize,
    },
    /// A model and true PSFs on pixels that cannot be compared.
    #[error(
        "the true PSFs are without the response of a pixel and the model's are with it: they cannot be compared; sample the model from PSFs \
         without it (PIXCONV)"
    )]
    TruthWithoutPixels,
}

impl<E: Into<PsfieldError>> From<E> for LabError {
    fn from(error: E) -> Self {
        Self::Pipeline(error.into())
    }
}
