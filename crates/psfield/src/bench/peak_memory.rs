//! How much memory a piece of work takes.

use std::fs;

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
        if !self.marked {
            return None;
        }
        let text = fs::read_to_string("/proc/self/status").ok()?;
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
        let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
        Some(kibibytes * 1024)
    }
}
