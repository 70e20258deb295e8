//! How much memory a piece of work takes.

use std::fs;

use crate::peak_memory_bytes;

/// Watches the memory of this process from one moment on, where the system tells (Linux).
///
/// Growth alone would say little: what earlier work gave back stays with the process and is used again.
#[derive(Debug)]
pub(super) struct PeakMemory {
    marked: bool,
}

impl PeakMemory {
    /// From now on.
    pub(super) fn start() -> Self {
        // Sets the mark of the most memory held back to what is held now.
        Self {
            marked: fs::write("/proc/self/clear_refs", "5").is_ok(),
        }
    }

    /// The most bytes held since then.
    pub(super) fn bytes(&self) -> Option<u64> {
        self.marked.then(peak_memory_bytes).flatten()
    }
}
