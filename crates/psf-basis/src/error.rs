//! What can go wrong when a basis is made.

use psf_types::DataError;
use thiserror::Error;

/// Errors of basis methods and rank selection.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum BasisError {
    /// The singular value decomposition did not converge.
    #[error("the singular value decomposition of {samples} samples of {pixels} pixels did not converge")]
    NoConvergence {
        /// Number of training stamps.
        samples: usize,
        /// Pixels a stamp.
        pixels: usize,
    },
    /// More components were asked for than there are.
    #[error("rank {asked} was asked for, but these samples span only {available} components")]
    RankTooHigh {
        /// The rank asked for.
        asked: usize,
        /// The number of components with non-zero singular values.
        available: usize,
    },
    /// Without a mean stamp at least one component is needed.
    #[error("rank 0 needs mean centring: without a mean stamp at least one component is needed")]
    RankZero,
    /// A rank selection that cannot be read or is out of range.
    #[error(
        "rank must be auto, elbow, full, a whole number, energy=F (0 < F <= 1) or error=E (E >= 0), got {got}"
    )]
    BadRank {
        /// What was given.
        got: String,
    },
    /// A centring that cannot be read.
    #[error("centring must be mean or none, got {got}")]
    BadCentring {
        /// What was given.
        got: String,
    },
    /// A noise level that is not a finite number of at least 0.
    #[error("the pixel noise must be finite and at least 0, got {got}")]
    BadNoise {
        /// What was given.
        got: f64,
    },
    /// Training stamps of another shape than the samples.
    #[error("training stamps are {got:?} [y, x], the samples are {expected:?}")]
    TrainingShape {
        /// Shape of the samples' stamps.
        expected: (usize, usize),
        /// Shape of the training stamps.
        got: (usize, usize),
    },
    /// Given stamps that are zero or not orthogonal, or parts that do not fit each other.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A given stamp without any light.
    #[error("the given basis stamp {index} (0-based) is zero everywhere")]
    ZeroStamp {
        /// Its index.
        index: usize,
    },
    /// An error of a basis method implemented elsewhere.
    #[error("the basis method failed")]
    External(#[source] Box<dyn std::error::Error + Send + Sync>),
}
