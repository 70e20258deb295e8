//! The sampling trait, its result with samples and report, and its errors.

use psf_types::{Cancelled, DataError, Position, Progress, PsfSamples, PsfSource, SourceError};
use thiserror::Error;

use crate::verification::Verification;

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
    /// The way in which the last positions were chosen. `None` for fixed positions.
    pub refinement: Option<Refinement>,
    /// The reason why the sampling ended.
    pub outcome: SamplingOutcome,
    /// Number of PSFs drawn, all of them: samples, and other points that a criterion needs.
    pub draws: usize,
    /// Number of cells between the samples. 0 for kriging.
    pub cells: usize,
    /// Number of cells in which the criterion does not hold.
    pub unmet_cells: usize,
    /// The largest error measured: for kriging that of the last tests, for a mesh the largest variation
    /// that the criterion measured in any cell. For a uniform grid, the largest difference of neighbours.
    /// 0 for a method that measures no variation.
    pub worst: f64,
    /// The position of the worst error, or the middle of its cell.
    pub worst_at: Option<Position>,
    /// The largest error that kriging expects anywhere in the field (relative, L2).
    pub expected: Option<f64>,
    /// The random tests at the end.
    pub verification: Option<Verification>,
    /// The largest variation at which the criterion holds. `None` if there is no criterion.
    pub threshold: Option<f64>,
}

impl SamplingReport {
    /// The report of a method that uses fixed positions and measures no variation of the PSF.
    pub fn of_fixed_positions(draws: usize) -> Self {
        Self {
            refinement: None,
            outcome: SamplingOutcome::Met,
            draws,
            cells: 0,
            unmet_cells: 0,
            worst: 0.0,
            worst_at: None,
            expected: None,
            verification: None,
            threshold: None,
        }
    }

    /// The largest error that was found, and its position: of the tests and the criterion, and of the
    /// random tests at the end.
    fn largest_error(&self) -> (f64, Option<Position>) {
        match self.verification {
            Some(random) if random.worst > self.worst => (random.worst, Some(random.worst_at)),
            _ => (self.worst, self.worst_at),
        }
    }
}

/// A way to choose further positions. Written as `kriging` or `mesh`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Refinement {
    /// Where kriging expects the largest error ([`KrigingSampling`](crate::KrigingSampling)).
    #[default]
    Kriging,
    /// In the cells in which a criterion does not hold ([`AdaptiveSampling`](crate::AdaptiveSampling)).
    Mesh,
}

psf_types::named!(
    Refinement,
    SampleError,
    |text| SampleError::refused("the method", "kriging or mesh", text),
    "kriging" => Kriging,
    "mesh" => Mesh
);

/// The reason why a sampling ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SamplingOutcome {
    /// The criterion holds in every cell and every test, or there was no criterion.
    Met,
    /// Some cells are as small as allowed, and the criterion still does not hold there. Usually
    /// the PSF jumps there.
    CellSizeReached,
    /// The criterion does not hold everywhere, and a further refinement would exceed the number of
    /// draws allowed.
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
    /// The threshold is not met. The error contains the samples drawn so far.
    #[error(transparent)]
    NotMet(Box<NotMet>),
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

    pub(crate) fn not_met(most_draws: usize, wanted: Option<usize>, sampling: Sampling) -> Self {
        Self::NotMet(Box::new(NotMet {
            most_draws,
            wanted,
            sampling,
        }))
    }

    pub(crate) fn refused(name: &'static str, allowed: &'static str, got: impl std::fmt::Display) -> Self {
        let got = got.to_string();
        Self::Setting { name, allowed, got }
    }
}

/// A sampling that does not meet its threshold: complete and valid, but less accurate than asked.
#[derive(Debug, Error)]
#[error("{}", self.text())]
pub struct NotMet {
    pub(crate) most_draws: usize,
    pub(crate) wanted: Option<usize>,
    pub(crate) sampling: Sampling,
}

impl NotMet {
    /// The largest number of draws allowed.
    pub fn most_draws(&self) -> usize {
        self.most_draws
    }

    /// The number of draws after the next refinement, if the number allowed ended the sampling. The
    /// criterion may need even more.
    pub fn wanted(&self) -> Option<usize> {
        self.wanted
    }

    /// The samples drawn, and their report. If the number of draws ended the sampling, the cells with
    /// the largest variation were refined last.
    pub fn sampling(&self) -> &Sampling {
        &self.sampling
    }

    /// Returns the samples drawn, to use them although the threshold is not met.
    pub fn into_sampling(self) -> Sampling {
        self.sampling
    }

    fn text(&self) -> String {
        let Sampling { samples, report } = &self.sampling;
        let threshold = report.threshold.unwrap_or(f64::NAN);
        let (why, what) = match self.wanted {
            Some(wanted) => (
                format!(
                    " with the {} draws allowed: the next refinement would have {wanted}",
                    self.most_draws
                ),
                "the number of draws or the threshold",
            ),
            None => (
                ": cells between samples cannot be smaller, and the PSF is probably discontinuous there"
                    .to_owned(),
                "the threshold",
            ),
        };
        let mut sentences = vec![format!("the threshold {threshold} is not met{why}")];
        if let (worst, Some(at)) = report.largest_error() {
            let (x, y) = (at.x(), at.y());
            sentences.push(format!("The largest error is {worst:.2e}, at ({x:.1}, {y:.1})"));
        }
        if let Some(expected) = report.expected {
            sentences.push(format!(
                "Kriging expects errors of up to {expected:.2e} elsewhere"
            ));
        }
        if report.cells > 0 {
            let (unmet, cells) = (report.unmet_cells, report.cells);
            sentences.push(format!(
                "Errors are above the threshold in {unmet} of {cells} cells"
            ));
        }
        if let Some(random) = &report.verification {
            let (above, tests) = (random.above, random.tests);
            sentences.push(format!(
                "Of {tests} random tests, {above} have errors above the threshold"
            ));
        }
        let count = samples.len();
        sentences.push(format!("Raise {what}, or use the {count} samples as they are"));
        sentences.join(". ")
    }
}
