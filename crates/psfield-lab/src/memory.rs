//! The memory of the system and of this process (Linux).

use std::fs;

/// The largest number of bytes that this process has held since it started, or since a benchmark
/// last reset the system's record. None if the system does not report it.
pub fn peak_memory_bytes() -> Option<u64> {
    kibibytes("/proc/self/status", "VmHWM:")
}

/// The bytes of memory that are free for use. None if the system does not report them.
pub fn available_memory_bytes() -> Option<u64> {
    kibibytes("/proc/meminfo", "MemAvailable:")
}

fn kibibytes(file: &str, key: &str) -> Option<u64> {
    let text = std::fs::read_to_string(file).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(key))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes * 1024)
}

/// Measures the largest memory of this process from a chosen moment on (only on Linux).
///
/// The difference of memory before and after would say little, because memory that earlier work has
/// freed stays with the process and is used again.
#[derive(Debug)]
pub(super) struct PeakMemory {
    marked: bool,
}

impl PeakMemory {
    /// Starts measuring.
    pub(super) fn start() -> Self {
        // Resets the recorded peak to the memory held now.
        Self {
            marked: fs::write("/proc/self/clear_refs", "5").is_ok(),
        }
    }

    /// The largest number of bytes held since the start. None if the system does not report it.
    pub(super) fn bytes(&self) -> Option<u64> {
        self.marked.then(peak_memory_bytes).flatten()
    }
}
