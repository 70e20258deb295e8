//! The memory of the system and of this process (Linux).

use std::fs;
use std::path::Path;

/// The largest number of bytes of physical memory that this process has held since it started, or
/// since a benchmark last reset the system's record. None if the system does not report it.
pub fn peak_memory_bytes() -> Option<u64> {
    kibibytes("/proc/self/status", "VmHWM:")
}

/// The number of bytes that this process can still allocate: the free memory of the system, or less
/// if a limit of the process (`ulimit -v`) or of its control groups leaves less. None if the system
/// does not report its free memory.
pub fn available_memory_bytes() -> Option<u64> {
    let free = kibibytes("/proc/meminfo", "MemAvailable:")?;
    Some(
        [address_space_left(), control_groups_left()]
            .into_iter()
            .flatten()
            .fold(free, u64::min),
    )
}

/// The number of bytes that the limit of the address space leaves. None if there is no limit.
fn address_space_left() -> Option<u64> {
    let limits = fs::read_to_string("/proc/self/limits").ok()?;
    let line = limits
        .lines()
        .find_map(|line| line.strip_prefix("Max address space"))?;
    let limit: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(limit.saturating_sub(kibibytes("/proc/self/status", "VmSize:")?))
}

/// The number of bytes that the control groups (version 2) of this process leave. None if none of
/// them has a limit.
fn control_groups_left() -> Option<u64> {
    let groups = fs::read_to_string("/proc/self/cgroup").ok()?;
    let path = groups.lines().find_map(|line| line.strip_prefix("0::/"))?;
    let text = |folder: &Path, name| fs::read_to_string(folder.join(name)).ok();
    let left = |folder: &Path| -> Option<u64> {
        // In a group without a limit, `memory.max` holds the word max, which is no number.
        let limit: u64 = text(folder, "memory.max")?.trim().parse().ok()?;
        let used: u64 = text(folder, "memory.current")?.trim().parse().ok()?;
        // `inactive_file` counts cached content of files. The system frees it when a process needs
        // memory.
        let stat = text(folder, "memory.stat")?;
        let cached = stat
            .lines()
            .find_map(|line| line.strip_prefix("inactive_file "))?;
        Some((limit + cached.trim().parse::<u64>().ok()?).saturating_sub(used))
    };
    // The limits of the groups that contain this group apply, too.
    Path::new("/sys/fs/cgroup")
        .join(path)
        .ancestors()
        .filter_map(left)
        .min()
}

fn kibibytes(file: &str, key: &str) -> Option<u64> {
    let text = std::fs::read_to_string(file).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(key))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes * 1024)
}

/// Measures the largest memory of this process from a chosen moment on (only on Linux).
///
/// The difference between the memory after the work and before it would say little. Memory that
/// earlier work has freed stays with the process, and later work uses it again.
#[derive(Debug)]
pub(super) struct PeakMemory {
    marked: bool,
}

impl PeakMemory {
    pub(super) fn start() -> Self {
        // Resets the recorded peak to the memory held now.
        Self {
            marked: fs::write("/proc/self/clear_refs", "5").is_ok(),
        }
    }

    /// The largest number of bytes held since [`start`](Self::start). None if the system does not
    /// report it.
    pub(super) fn bytes(&self) -> Option<u64> {
        self.marked.then(peak_memory_bytes).flatten()
    }
}
