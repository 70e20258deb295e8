//! What made a report.

use serde::Serialize;

/// Versions, machine and command.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct Software {
    /// psfield's version.
    pub psfield: &'static str,
    /// Operating system and processor.
    pub machine: String,
    /// Threads that shared the work.
    pub threads: usize,
    /// The command that makes the report again.
    pub command: String,
}

impl Software {
    /// This program on this machine.
    pub fn of_command(command: String) -> Self {
        Self {
            psfield: env!("CARGO_PKG_VERSION"),
            machine: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            threads: rayon::current_num_threads(),
            command,
        }
    }
}
