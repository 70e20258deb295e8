//! Uniform and non-uniform sampling of a PSF over the field of view.
//!
//! A [`SamplingMethod`] takes any [`psf_types::PsfSource`] and gives [`psf_types::PsfSamples`] with a [`SamplingReport`]:
//!
//! * [`UniformSampling`]: a regular grid from corner to corner.
//! * [`AdaptiveSampling`]: a coarse grid, refined until a [`RefinementCriterion`] holds: [`NeighbourDifference`] (the
//!   default, 1 %) or [`InterpolationError`], on a [`DifferenceMeasure`].
//!
//! [`ShiftAugmentation`] draws the samples again at sub-pixel shifts, for the training of a basis.
//!
//! # The mesh of adaptive sampling
//!
//! The field is covered by rectangular cells whose corners are samples; the outermost samples lie on the pixel centres of
//! the field's corners, 0 and `n - 1`. A cell in which the criterion fails is halved along the axis along which it fails, or
//! along both. Two rules keep linear interpolation on any triangulation of the samples, Delaunay's in particular, close to
//! the cells: the sides of a cell differ by at most a factor ([`AdaptiveSampling::with_max_aspect`], 2 by default), and no
//! edge has more than one sample between its ends, so that neighbouring cells differ by at most one halving along their
//! common edge.
//!
//! It ends in one of three ways, none of them silent: the criterion holds everywhere ([`SamplingOutcome::Met`]); cells
//! reached the smallest size, since the PSF jumps there ([`SamplingOutcome::CellSizeReached`], with their number); or the cap
//! on the number of samples came first ([`SampleError::CapReached`], an error that carries the samples so far).
//!
//! All PSFs are drawn in parallel on the current rayon pool, each position once; results, order and errors do not depend on
//! the number of threads.

mod adaptive;
mod criteria;
mod draws;
mod mesh;
mod sampling;

pub use adaptive::AdaptiveSampling;
pub use criteria::{
    CellProbes, CellStamps, CellVariation, DifferenceMeasure, InterpolationError, NeighbourDifference,
    RefinementCriterion,
};
pub use draws::{ShiftAugmentation, ShiftedStamps, UniformSampling};
pub use sampling::{CapReached, SampleError, Sampling, SamplingMethod, SamplingOutcome, SamplingReport};
