//! Ctrl-C and other requests to stop: temporary files go, outputs stay as they were.

use std::fmt::Write as _;
use std::io::{IsTerminal, Write as _};
use std::path::PathBuf;
use std::sync::Arc;

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ};
use signal_hook::flag;
use signal_hook::iterator::Signals;
use signal_hook::low_level::signal_name;

/// A process that a signal ends has this exit status and the signal's number, as shells tell it.
const SIGNALLED: i32 = 128;

/// Ends the process on SIGINT, SIGTERM or SIGHUP with status 130, 143 or 129, after it has removed the temporary files. More signals on the
/// way there change nothing: `timeout` and others send two at once. Signals that whoever started the process wants ignored (`nohup`, jobs
/// in the background of a script) stay ignored.
///
/// A limit on the size of files (`ulimit -f`) becomes an error like that of a full disk, for the same sake.
///
/// # Errors
/// What the system says against it.
pub(crate) fn remove_files_when_told_to_stop() -> std::io::Result<()> {
    let ignored = ignored_signals();
    let wanted: Vec<i32> = [SIGINT, SIGTERM, SIGHUP]
        .into_iter()
        .filter(|&signal| ignored & (1 << (signal - 1)) == 0)
        .collect();
    // A signal with a handler lets the write fail; the flag itself says nothing.
    flag::register(SIGXFSZ, Arc::default())?;
    let mut signals = Signals::new(&wanted)?;
    std::thread::Builder::new()
        .name("signals".to_owned())
        .spawn(move || {
            if let Some(signal) = signals.forever().next() {
                // The outputs are locked until the process is gone.
                psf_io::remove_unfinished(|outputs| {
                    tell(signal, outputs);
                    std::process::exit(SIGNALLED + signal)
                });
            }
        })?;
    Ok(())
}

/// One line about what was left as it was.
fn tell(signal: i32, outputs: &[PathBuf]) {
    let mut line = String::from("psfield: ");
    if std::io::stderr().is_terminal() {
        // Over what is left of a progress bar and the terminal's `^C`.
        line = format!("\r\x1b[2K{line}");
    }
    let name = signal_name(signal).unwrap_or("a signal");
    let _ = write!(line, "stopped by {name}: ");
    if outputs.is_empty() {
        line.push_str("no file was being written");
    }
    for (n, output) in outputs.iter().enumerate() {
        let state = if output.exists() {
            "is as it was"
        } else {
            "was not written"
        };
        let separator = if n > 0 { ", " } else { "" };
        let _ = write!(line, "{separator}{} {state}", output.display());
    }
    line.push('\n');
    // Nobody may be left to read it, as after the end of a terminal.
    let _ = std::io::stderr().write_all(line.as_bytes());
}

/// The signals that the process was started to ignore, signal 1 in the lowest bit; none where the system does not tell.
fn ignored_signals() -> u64 {
    std::fs::read_to_string("/proc/self/status")
        .ok()
        .and_then(|status| {
            let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"))?;
            u64::from_str_radix(mask.trim(), 16).ok()
        })
        .unwrap_or(0)
}
