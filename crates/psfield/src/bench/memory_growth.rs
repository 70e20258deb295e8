//! How much memory a piece of work takes.

use std::fs;

/// Watches the memory of this process from one moment on, where the system tells (Linux).
#[derive(Debug)]
pub(super) struct MemoryGrowth {
    before: Option<u64>,
}

impl MemoryGrowth {
    /// From now on.
    pub(super) fn start() -> Self {
        // Sets the mark of the most memory held back to what is held now.
        let marked = fs::write("/proc/self/clear_refs", "5").is_ok();
        Self {
            before: marked.then(|| status("VmRSS:")).flatten(),
        }
    }

    /// The most bytes held since then beyond those held then.
    pub(super) fn bytes(&self) -> Option<u64> {
        Some(status("VmHWM:")?.saturating_sub(self.before?))
    }
}

/// A figure of the process in bytes.
fn status(name: &str) -> Option<u64> {
    let text = fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes * 1024)
}
