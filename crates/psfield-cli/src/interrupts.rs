//! Handles Ctrl-C and other requests to stop: removes temporary files and leaves outputs as they
//! were.

use std::fmt::Write as _;
use std::io::{IsTerminal, Write as _};
use std::path::PathBuf;
use std::sync::Arc;

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ};
use signal_hook::flag;
use signal_hook::iterator::Signals;
use signal_hook::low_level::signal_name;

/// The exit status after a signal is this number plus the number of the signal, as in shells.
const SIGNALLED: i32 = 128;

/// Installs handlers for SIGINT, SIGTERM and SIGHUP. They remove the temporary files and end the
/// process with status 130, 143 or 129. Further signals in the meantime have no effect: programs
/// such as `timeout` send two signals at once. On Linux, signals that the parent process has set to
/// be ignored (`nohup`, background jobs of a script) stay ignored.
///
/// A file that exceeds the size limit (`ulimit -f`) gives an error, as a full disk does. Temporary
/// files are then removed, too.
///
/// # Errors
/// The error of the system, if it refuses the handlers or the thread that waits for signals.
pub(crate) fn handle() -> std::io::Result<()> {
    let ignored = ignored_signals();
    let wanted: Vec<i32> = [SIGINT, SIGTERM, SIGHUP]
        .into_iter()
        .filter(|&signal| ignored & (1 << (signal - 1)) == 0)
        .collect();
    // By default, SIGXFSZ would end the process. With a handler, the write fails with an error.
    // The flag itself is not used.
    flag::register(SIGXFSZ, Arc::default())?;
    let mut signals = Signals::new(&wanted)?;
    std::thread::Builder::new()
        .name("signals".to_owned())
        .spawn(move || {
            if let Some(signal) = signals.forever().next() {
                // The process ends inside the closure. Until then, no other thread can start or
                // finish an output.
                psf_io::remove_unfinished(|outputs| {
                    tell(signal, outputs);
                    std::process::exit(SIGNALLED + signal)
                });
            }
        })?;
    Ok(())
}

/// Prints one line about the state of the outputs.
fn tell(signal: i32, outputs: &[PathBuf]) {
    let mut line = String::from("psfield: ");
    if std::io::stderr().is_terminal() {
        // Overwrites the rest of a progress bar and the `^C` of the terminal.
        line = format!("\r\x1b[2K{line}");
    }
    let name = signal_name(signal).unwrap_or("a signal");
    let state = |output: &PathBuf| {
        let state = if output.exists() {
            "is unchanged"
        } else {
            "was not written"
        };
        format!("{} {state}", output.display())
    };
    let states = match outputs {
        [] => "no output was being written".to_owned(),
        _ => outputs.iter().map(state).collect::<Vec<_>>().join(", "),
    };
    let _ = writeln!(line, "interrupted ({name}), {states}");
    // The write fails if standard error is closed, for example after the end of a terminal.
    let _ = std::io::stderr().write_all(line.as_bytes());
}

/// The signals that the process has ignored since its start, as a bit mask (lowest bit: signal 1).
/// 0 if the system does not report them (only Linux does).
fn ignored_signals() -> u64 {
    std::fs::read_to_string("/proc/self/status")
        .ok()
        .and_then(|status| {
            let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"))?;
            u64::from_str_radix(mask.trim(), 16).ok()
        })
        .unwrap_or(0)
}
