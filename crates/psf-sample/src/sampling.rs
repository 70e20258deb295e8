//! The sampling trait, its result with samples and report, and its errors.

use psf_types::{Cancelled, DataError, Position, Progress, PsfSamples, PsfSource, SourceError};
use thiserror::Error;

/// A method that chooses the positions at which a PSF is sampled. The trait is object-safe.
pub trait SamplingMethod: std::fmt::Debug + Send + Sync {
    /// Samples `source` over its field, in parallel on the current rayon pool. The result does not
    /// depend on the number of threads.
    ///
    /// # Errors
    /// [`SampleError`], which contains the position of the PSF if the error concerns one PSF.
    /// [`SampleError::Cancelled`] if `progress` cancels the work.
    fn sample(&self, source: &dyn PsfSource, progress: &dyn Progress) -> Result<Sampling, SampleError>;
}

/// Samples and the report about them.
#[derive(Debug, Clone, PartialEq)]
pub struct Sampling {
    /// The samples, ordered by y, then x.
    pub samples: PsfSamples,
    /// The report on the quality and the cost.
    pub report: SamplingReport,
}

/// The quality and the cost of a sampling.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SamplingReport {
    /// The reason why the sampling ended.
    pub outcome: SamplingOutcome,
    /// Number of PSFs drawn: at the samples and at the other points that a criterion needs.
    pub draws: usize,
    /// Number of cells between the samples.
    pub cells: usize,
    /// Number of cells in which the criterion does not hold.
    pub unmet_cells: usize,
    /// The largest variation that the criterion measured in any cell. For a uniform grid, the
    /// largest difference of neighbours. 0 for a method that measures no variation.
    pub worst: f64,
    /// The largest variation at which the criterion holds. `None` if there is no criterion.
    pub threshold: Option<f64>,
}

impl SamplingReport {
    /// The report of a method that uses fixed positions and measures no variation of the PSF.
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

/// The reason why a sampling ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SamplingOutcome {
    /// The criterion holds in every cell, or there was no criterion.
    Met,
    /// Some cells are as small as allowed, and the criterion still does not hold there. Usually
    /// the PSF jumps there.
    CellSizeReached,
    /// The criterion does not hold in every cell, and a further refinement would exceed the cap on
    /// the number of samples.
    CapReached,
}

/// An error of sampling a field.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SampleError {
    /// A setting out of range.
    #[error("{name} must be {allowed}, got {got}")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// The values that are allowed.
        allowed: &'static str,
        /// The value that was given.
        got: String,
    },
    /// The source could not draw a PSF.
    #[error("the PSF at {position} could not be drawn")]
    Draw {
        /// The field position.
        position: Position,
        /// The error of the source.
        #[source]
        source: SourceError,
    },
    /// The source drew values that are not valid: NaN or infinity.
    #[error("the PSF drawn at {position} is not valid")]
    Stamp {
        /// The field position.
        position: Position,
        /// The error in the values.
        #[source]
        source: DataError,
    },
    /// The source drew a PSF whose flux is not positive.
    #[error("the PSF drawn at {position} has flux {flux}: a PSF must have positive flux")]
    NoLight {
        /// The field position.
        position: Position,
        /// The stamp's flux.
        flux: f64,
    },
    /// A criterion returned a negative value, NaN or infinity.
    #[error(
        "the refinement criterion returned {value} for the cell around {position}: the value must be finite and 0 or above"
    )]
    Criterion {
        /// Centre of the cell.
        position: Position,
        /// The value that the criterion returned.
        value: f64,
    },
    /// The criterion does not hold with the largest number of samples allowed. The error contains
    /// the samples drawn so far.
    #[error(transparent)]
    CapReached(Box<CapReached>),
    /// The progress object cancelled the work ([`Progress::cancelled`]).
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// Positions or stamps that the types of `psf_types` refuse.
    #[error(transparent)]
    Data(#[from] DataError),
    /// An error of a sampling method implemented elsewhere.
    #[error("the sampling method failed")]
    External(#[source] Box<dyn std::error::Error + Send + Sync>),
}

impl SampleError {
    /// Returns [`SampleError::Setting`] unless `is_sound`.
    pub(crate) fn check(
        is_sound: bool,
        name: &'static str,
        allowed: &'static str,
        got: impl std::fmt::Display,
    ) -> Result<(), Self> {
        if is_sound {
            Ok(())
        } else {
            Err(Self::refused(name, allowed, got))
        }
    }

    pub(crate) fn refused(name: &'static str, allowed: &'static str, got: impl std::fmt::Display) -> Self {
        let got = got.to_string();
        Self::Setting { name, allowed, got }
    }
}

/// The state of an adaptive sampling that reached its cap: a complete, valid sampling whose
/// criterion does not hold everywhere.
#[derive(Debug, Error)]
#[error(
    "the criterion does not hold with the {cap} samples allowed: the next refinement would have {wanted} samples. The threshold {threshold} \
     is exceeded in {unmet} of {cells} cells, the largest variation is {worst:.3e}. Raise the cap or the threshold, or use the {count} samples as they are",
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

    /// The number of samples that the next refinement would have. The criterion may need even more.
    pub fn wanted(&self) -> usize {
        self.wanted
    }

    /// The samples drawn, and their report. The last refinement halved the cells with the largest
    /// variation, as many as the cap allows.
    pub fn sampling(&self) -> &Sampling {
        &self.sampling
    }

    /// Returns the samples drawn, to use them although the criterion does not hold.
    pub fn into_sampling(self) -> Sampling {
        self.sampling
    }
}
