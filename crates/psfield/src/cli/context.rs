//! What every command shares: how it speaks, and how it signs its files.

use std::io::Write;

use psf_io::Card;
use psfield::SpotCheck;
use serde::Serialize;

use super::progress::Bar;

/// A wrong combination of arguments: exit status 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct UsageError(pub(crate) String);

/// How a command speaks.
#[derive(Debug)]
pub(crate) struct Context {
    json: bool,
    quiet: bool,
}

impl Context {
    pub(crate) fn new(json: bool, quiet: bool) -> Self {
        Self { json, quiet }
    }

    /// Prints the object under `--json`, else the text unless `--quiet`.
    pub(crate) fn report(
        &self,
        object: &impl Serialize,
        text: impl FnOnce() -> String,
    ) -> anyhow::Result<()> {
        let mut out = std::io::stdout().lock();
        if self.json {
            serde_json::to_writer(&mut out, object)?;
            writeln!(out)?;
        } else if !self.quiet {
            writeln!(out, "{}", text().trim_end())?;
        }
        out.flush()?;
        Ok(())
    }

    /// A line on standard error that a user must see, unless `--quiet`.
    pub(crate) fn warn(&self, text: &str) {
        if !self.quiet {
            eprintln!("psfield: warning: {text}");
        }
    }

    /// A line on standard error about what was done, unless `--quiet`.
    pub(crate) fn note(&self, text: &str) {
        if !self.quiet {
            eprintln!("psfield: note: {text}");
        }
    }

    /// A progress bar; drawn on a terminal only.
    pub(crate) fn bar(&self, what: &'static str) -> Bar {
        Bar::counting(what, self.quiet)
    }

    /// A spinner for work without steps; drawn on a terminal only.
    pub(crate) fn spinner(&self, what: &'static str) -> Bar {
        Bar::spinning(what, self.quiet)
    }
}

/// The program's version and the command line as it was given, for headers. Options that change no result stay out
/// ([`matters`]): the same input, options and seed give the same bytes.
pub(crate) fn signature() -> Vec<Card> {
    // Not `args`, which panics on a name that is not UTF-8.
    let arguments: Vec<String> = std::env::args_os()
        .skip(1)
        .map(|arg| arg.to_string_lossy().into_owned())
        .collect();
    let command: Vec<String> = matters(&arguments).map(quoted).collect();
    vec![
        Card::new(
            "PSFIELD",
            env!("CARGO_PKG_VERSION"),
            "version of psfield that wrote this",
        )
        .expect("a valid card"),
        Card::history(&format!("psfield {}", command.join(" "))),
    ]
}

/// The arguments without the number of threads, `--json`, `--quiet` and `--stream`.
fn matters(arguments: &[String]) -> impl Iterator<Item = &String> {
    let mut is_count = false;
    arguments.iter().filter(move |arg| {
        let was_count = std::mem::replace(&mut is_count, *arg == "--threads");
        let silent = matches!(
            arg.as_str(),
            "--threads" | "--json" | "-q" | "--quiet" | "--stream"
        );
        !(was_count || silent || arg.starts_with("--threads="))
    })
}

/// An argument as one would type it.
fn quoted(arg: impl AsRef<str>) -> String {
    let arg = arg.as_ref();
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_=./,:+@%".contains(c);
    if !arg.is_empty() && arg.chars().all(plain) {
        arg.to_owned()
    } else {
        format!("'{}'", arg.replace('\'', r"'\''"))
    }
}

/// The keywords of [`check_cards`].
pub(crate) const CHECK_KEYWORDS: [&str; 4] = ["PSFCHKN", "PSFCHKS", "PSFCHKM", "PSFCHKR"];

/// What a spot check found, for headers.
pub(crate) fn check_cards(check: &SpotCheck) -> anyhow::Result<[Card; 4]> {
    let [count, seed, largest, rms] = CHECK_KEYWORDS;
    Ok([
        Card::new(count, check.pixels, "pixels checked against the direct sum")?,
        Card::new(seed, check.seed.to_string(), "seed that chose them")?,
        Card::new(largest, check.max_abs, "largest difference found")?,
        Card::new(rms, check.rms, "r.m.s. difference found")?,
    ])
}
