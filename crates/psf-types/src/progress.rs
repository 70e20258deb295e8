//! Progress of long work.

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
}

/// Says nothing, and never stops the work.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoProgress;

impl Progress for NoProgress {
    fn start(&self, _total: u64) {}
    fn advance(&self, _steps: u64) {}
}
