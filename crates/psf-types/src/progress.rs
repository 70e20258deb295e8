//! Progress of long work.

/// Told how far long work has come; called from many threads.
pub trait Progress: Sync {
    /// The work has `total` steps; called once, before the first step (again when the total grows).
    fn start(&self, total: u64);
    /// `steps` more steps are done.
    fn advance(&self, steps: u64);
}

/// Says nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoProgress;

impl Progress for NoProgress {
    fn start(&self, _total: u64) {}
    fn advance(&self, _steps: u64) {}
}
