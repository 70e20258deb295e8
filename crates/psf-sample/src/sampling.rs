//! Samplings: the method, its samples and report, and its errors.

use psf_types::{DataError, Position, Progress, PsfSamples, PsfSource, SourceError};
use thiserror::Error;

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

/// What went wrong while a field was sampled.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SampleError {
    /// A setting out of range.
    #[error("{name} must be {allowed}, got {got}")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// What is allowed, in words.
        allowed: &'static str,
        /// What was given.
        got: String,
    },
    /// The source gave no PSF.
    #[error("the PSF at {position} could not be drawn")]
    Draw {
        /// Where.
        position: Position,
        /// What the source says.
        #[source]
        source: SourceError,
    },
    /// The source drew something that is no PSF: NaN, infinity.
    #[error("the PSF drawn at {position} is not valid")]
    Stamp {
        /// Where.
        position: Position,
        /// What is wrong with it.
        #[source]
        source: DataError,
    },
    /// The source drew a PSF without light.
    #[error("the PSF drawn at {position} has flux {flux}: a PSF must have positive flux")]
    NoLight {
        /// Where.
        position: Position,
        /// The stamp's flux.
        flux: f64,
    },
    /// A criterion that gave no number.
    #[error(
        "the refinement criterion gave {value} for the cell around {position}: it must be a number of 0 or above"
    )]
    Criterion {
        /// Centre of the cell.
        position: Position,
        /// What it gave.
        value: f64,
    },
    /// The criterion does not hold with as many samples as are allowed. The samples drawn so far are inside.
    #[error(transparent)]
    CapReached(Box<CapReached>),
    /// Data that is not valid.
    #[error(transparent)]
    Data(#[from] DataError),
    /// An error of a sampling method implemented elsewhere.
    #[error("the sampling method failed")]
    External(#[source] Box<dyn std::error::Error + Send + Sync>),
}

impl SampleError {
    /// [`SampleError::Setting`] unless a setting is sound.
    pub(crate) fn check(
        is_sound: bool,
        name: &'static str,
        allowed: &'static str,
        got: impl std::fmt::Display,
    ) -> Result<(), Self> {
        if is_sound {
            Ok(())
        } else {
            Err(Self::Setting {
                name,
                allowed,
                got: got.to_string(),
            })
        }
    }
}

/// The state of an adaptive sampling that hit its cap: a complete, valid sampling whose criterion does not hold everywhere.
#[derive(Debug, Error)]
#[error(
    "the criterion does not hold with the {cap} samples allowed: the next refinement needs {wanted}. {unmet} of {cells} cells \
     exceed {threshold}, the worst has {worst:.3e}. Raise the cap or the threshold, or take the {count} samples as they are",
    unmet = sampling.report.unmet_cells,
    cells = sampling.report.cells,
    threshold = sampling.report.threshold.unwrap_or(f64::NAN),
    worst = sampling.report.worst,
    count = sampling.samples.len()
)]
pub struct CapReached {
    pub(crate) cap: usize,
    pub(crate) wanted: usize,
    pub(crate) sampling: Sampling,
}

impl CapReached {
    /// The largest number of samples allowed.
    pub fn cap(&self) -> usize {
        self.cap
    }

    /// The number of samples that the next refinement would have had; the criterion may need more in the end.
    pub fn wanted(&self) -> usize {
        self.wanted
    }

    /// The samples drawn, refined where the criterion was worst, and their report.
    pub fn sampling(&self) -> &Sampling {
        &self.sampling
    }

    /// The samples drawn, to go on with all the same.
    pub fn into_sampling(self) -> Sampling {
        self.sampling
    }
}
