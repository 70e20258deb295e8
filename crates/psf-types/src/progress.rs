//! Progress of long work.

use std::fmt;

use thiserror::Error;

/// Told how far long work has come, and asked whether it is still wanted; called from many threads.
pub trait Progress: Sync {
    /// The work has `total` steps; called once, before the first step (again when the total grows).
    fn start(&self, total: u64);
    /// `steps` more steps are done.
    fn advance(&self, steps: u64);
    /// Whether the work is to stop before its end. Asked between pieces of work of some milliseconds, by all threads, so that it must be
    /// cheap: the look at an atomic flag. Once it is `true` it stays so.
    fn cancelled(&self) -> bool {
        false
    }
    /// [`Self::cancelled`] as work asks it.
    ///
    /// # Errors
    /// [`Cancelled`] where the work is to stop.
    fn still_wanted(&self) -> Result<(), Cancelled> {
        if self.cancelled() { Err(Cancelled) } else { Ok(()) }
    }
}

/// Somebody wanted the work to stop before its end ([`Progress::cancelled`]).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("the work was stopped before its end")]
pub struct Cancelled;

/// Says nothing, and never stops the work.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoProgress;

impl Progress for NoProgress {
    fn start(&self, _total: u64) {}
    fn advance(&self, _steps: u64) {}
}

/// Stops work as another does, and does not tell it how far the work has come: for parts of work whose steps are not counted.
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
