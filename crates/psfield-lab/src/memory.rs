//! The memory of the system and of this process (Linux).

use std::fs;

/// The most bytes that this process has held, where the system tells.
pub fn peak_memory_bytes() -> Option<u64> {
    kibibytes("/proc/self/status", "VmHWM:")
}

/// The bytes of memory that are free for use, where the system tells.
pub fn available_memory_bytes() -> Option<u64> {
    kibibytes("/proc/meminfo", "MemAvailable:")
}

fn kibibytes(file: &str, key: &str) -> Option<u64> {
    let text = std::fs::read_to_string(file).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(key))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes * 1024)
}

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
