//! Sampling of a PSF over the field of view.
//!
//! A [`SamplingMethod`] takes any [`psf_types::PsfSource`] and returns [`psf_types::PsfSamples`]
//! with a [`SamplingReport`]:
//!
//! * [`KrigingSampling`]: draws where kriging expects the largest error, and tests each prediction. The
//!   default of [`SamplingOptions`].
//! * [`AdaptiveSampling`]: a coarse grid, refined until a [`RefinementCriterion`] holds. The
//!   criterion is [`InterpolationError`] (the default, 1 %) or [`NeighbourDifference`]. Both use a
//!   [`DifferenceMeasure`].
//! * [`UniformSampling`]: a regular grid from corner to corner.
//!
//! [`hold_out`] draws PSFs that are not samples, to check a model. [`ShiftAugmentation`] draws the
//! samples again at sub-pixel shifts, to train a basis.
//!
//! # Which method
//! A mesh compares PSFs with linear interpolation between neighbours, so its number of samples grows with
//! the inverse of the error. Kriging uses all samples, and the number grows with the logarithm of the
//! error if the field is smooth. PSFs drawn beside random ones, for errors of 1e-2, 3e-3, 1e-3 and 1e-4:
//!
//! | field | kriging | mesh |
//! |---|---|---|
//! | preset `survey-2m` | 76, 84, 92, 116 | 1609, -, 15 629, more than 66 000 |
//! | preset `wide-field-lens` | 168, 216, 240, 392 | 2963, -, -, more than 65 000 |
//!
//! At a step, a kink or a small hot spot, kriging has errors that it does not expect. These are its tests:
//! every PSF is predicted before it is drawn. Then the mesh takes over, with at most 150 draws
//! more than the mesh alone.
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
//! * The next refinement would exceed the number of draws allowed ([`SampleError::NotMet`]). This error
//!   carries the samples drawn so far.
//!
//! All PSFs are drawn in parallel on the current rayon pool, each position once. Results, order and
//! errors do not depend on the number of threads.

mod adaptive;
mod adaptive_run;
mod criteria;
mod draws;
mod kriging;
mod learner;
mod mesh;
mod options;
mod orthonormal;
mod sampling;
mod spread;
mod verification;
mod verifier;

pub use {ndarray, psf_types};

pub use adaptive::AdaptiveSampling;
pub use criteria::{
    CellProbes, CellStamps, CellVariation, DifferenceMeasure, InterpolationError, NeighbourDifference,
    RefinementCriterion,
};
pub use draws::{ShiftAugmentation, ShiftedStamps, UniformSampling, draw_states, hold_out};
pub use kriging::KrigingSampling;
pub use options::{Criterion, SamplingOptions};
pub use sampling::{
    NotMet, Refinement, SampleError, Sampling, SamplingMethod, SamplingOutcome, SamplingReport,
};
pub use verification::{Verification, fraction_limit};
