//! Progress and cancellation of long work.

use std::fmt;

use thiserror::Error;

/// Receives the progress of long work and can cancel it. Many threads call these methods.
pub trait Progress: Sync {
    /// Sets the number of steps of the work. Called once before the first step, and again when the
    /// number grows.
    fn start(&self, total: u64);
    /// Reports that `steps` more steps are done.
    fn advance(&self, steps: u64);
    /// Returns whether the work should stop early. Each thread calls this every few milliseconds,
    /// so the call must be cheap, such as reading an atomic flag. After the first `true`, it must
    /// always return `true`.
    fn cancelled(&self) -> bool {
        false
    }
    /// Returns [`Self::cancelled`] as a `Result`, for use with `?`.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    fn check_cancelled(&self) -> Result<(), Cancelled> {
        if self.cancelled() { Err(Cancelled) } else { Ok(()) }
    }
}

/// The work was cancelled through [`Progress::cancelled`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("the work was cancelled")]
pub struct Cancelled;

/// Ignores progress and never cancels.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoProgress;

impl Progress for NoProgress {
    fn start(&self, _total: u64) {}
    fn advance(&self, _steps: u64) {}
}

/// Wraps a progress object for work whose steps are not counted. Passes on cancellation, but no
/// progress.
pub struct Uncounted<'a>(pub &'a dyn Progress);

impl fmt::Debug for Uncounted<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("Uncounted").finish_non_exhaustive()
    }
}

impl Progress for Uncounted<'_> {
    fn start(&self, _total: u64) {}
    fn advance(&self, _steps: u64) {}
    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}
