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

mod adaptive_run;
mod adaptive_sampling;
mod difference_measure;
mod draws;
mod error;
mod interpolation_error;
mod mesh;
mod neighbour_difference;
mod refinement_criterion;
mod sampling;
mod shift_augmentation;
mod uniform_sampling;

pub use adaptive_sampling::AdaptiveSampling;
pub use difference_measure::DifferenceMeasure;
pub use error::{CapReached, SampleError};
pub use interpolation_error::InterpolationError;
pub use neighbour_difference::NeighbourDifference;
pub use refinement_criterion::{CellProbes, CellStamps, CellVariation, RefinementCriterion};
pub use sampling::{Sampling, SamplingMethod, SamplingOutcome, SamplingReport};
pub use shift_augmentation::{ShiftAugmentation, ShiftedStamps};
pub use uniform_sampling::UniformSampling;
