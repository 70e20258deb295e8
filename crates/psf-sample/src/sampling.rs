//! What sampling a field gives.

use psf_types::{Progress, PsfSamples, PsfSource};

use crate::SampleError;

/// A way to choose the positions at which a PSF is sampled. Object-safe.
pub trait SamplingMethod: std::fmt::Debug + Send + Sync {
    /// Samples `source` over its field, in parallel on the current rayon pool. The result does not depend on the number
    /// of threads.
    ///
    /// # Errors
    /// [`SampleError`] with the position where there is one.
    fn sample(&self, source: &dyn PsfSource, progress: &dyn Progress) -> Result<Sampling, SampleError>;
}

/// Samples and how they came about.
#[derive(Debug, Clone, PartialEq)]
pub struct Sampling {
    /// The samples, ordered by y, then x.
    pub samples: PsfSamples,
    /// How well they cover the field.
    pub report: SamplingReport,
}

/// How well the samples cover the field, and what that cost.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SamplingReport {
    /// How the sampling ended.
    pub outcome: SamplingOutcome,
    /// PSFs drawn: the samples and the points at which a criterion looked.
    pub draws: usize,
    /// Cells between the samples.
    pub cells: usize,
    /// Cells in which the criterion does not hold.
    pub unmet_cells: usize,
    /// The largest value of the criterion over the cells.
    pub worst: f64,
    /// The value below which the criterion holds, where one was asked for.
    pub threshold: Option<f64>,
}

impl SamplingReport {
    /// The report of a method that takes positions as they are and asks nothing of what lies between them.
    pub fn of_fixed_positions(draws: usize) -> Self {
        Self {
            outcome: SamplingOutcome::Met,
            draws,
            cells: 0,
            unmet_cells: 0,
            worst: 0.0,
            threshold: None,
        }
    }
}

/// How a sampling ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SamplingOutcome {
    /// The criterion holds in every cell, or there was none.
    Met,
    /// Some cells are as small as allowed and the criterion still does not hold: the PSF jumps there.
    CellSizeReached,
    /// The cap on the number of samples was reached first.
    CapReached,
}
