//! Uniform and non-uniform sampling of a PSF over the field of view.
//!
//! A [`SamplingMethod`] takes any [`psf_types::PsfSource`] and returns [`psf_types::PsfSamples`]
//! with a [`SamplingReport`]:
//!
//! * [`UniformSampling`]: a regular grid from corner to corner.
//! * [`AdaptiveSampling`]: a coarse grid, refined until a [`RefinementCriterion`] holds. The
//!   criterion is [`InterpolationError`] (the default, 1 %) or [`NeighbourDifference`]. Both use a
//!   [`DifferenceMeasure`].
//!
//! [`hold_out`] draws PSFs that are not samples, to check a model. [`ShiftAugmentation`] draws the
//! samples again at sub-pixel shifts, to train a basis.
//!
//! # The mesh of adaptive sampling
//!
//! The field is covered by rectangular cells whose corners are samples. The outermost samples lie
//! on the pixel centres of the field's corners, 0 and `n - 1`. A cell in which the criterion fails
//! is halved along each axis on which it fails.
//!
//! Interpolation uses a triangulation of the samples, usually Delaunay's, and not the cells. Two
//! rules keep the triangles similar to the cells. First, a cell is also halved along its longer
//! side if the sides of its halves would otherwise differ by more than a factor
//! ([`AdaptiveSampling::with_max_aspect`], 2 by default). Second, no edge has more than one sample
//! between its ends. Neighbouring cells therefore differ by at most one halving along their common
//! edge.
//!
//! Unless there is another error, the sampling ends in one of three ways:
//!
//! * The criterion holds everywhere ([`SamplingOutcome::Met`]).
//! * The criterion fails only in cells of the smallest size, usually because the PSF jumps there
//!   ([`SamplingOutcome::CellSizeReached`]). The report contains the number of these cells.
//! * The next refinement would exceed the cap on the number of samples
//!   ([`SampleError::CapReached`]). This error carries the samples drawn so far.
//!
//! All PSFs are drawn in parallel on the current rayon pool, each position once. Results, order and
//! errors do not depend on the number of threads.

mod adaptive;
mod criteria;
mod draws;
mod mesh;
mod options;
mod sampling;

pub use adaptive::AdaptiveSampling;
pub use criteria::{
    CellProbes, CellStamps, CellVariation, DifferenceMeasure, InterpolationError, NeighbourDifference,
    RefinementCriterion,
};
pub use draws::{ShiftAugmentation, ShiftedStamps, UniformSampling, draw_states, hold_out};
pub use options::{Criterion, SamplingOptions};
pub use sampling::{CapReached, SampleError, Sampling, SamplingMethod, SamplingOutcome, SamplingReport};
