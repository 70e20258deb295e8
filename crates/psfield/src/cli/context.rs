//! What every command shares: how it speaks, and how it signs its files.

use std::io::Write;

use anyhow::Context as _;
use psf_io::Card;
use serde::Serialize;

use super::progress::Bar;

/// A wrong combination of arguments: exit status 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct UsageError(pub(crate) String);

/// An error with its causes, in one line.
pub(crate) fn told(error: &anyhow::Error) -> String {
    psfield::error_text(error.as_ref())
}

/// How a command speaks.
#[derive(Debug)]
pub(crate) struct Context {
    json: bool,
    quiet: bool,
    /// Which part of the work speaks; empty for the whole.
    part: String,
}

impl Context {
    pub(crate) fn new(json: bool, quiet: bool) -> Self {
        Self {
            json,
            quiet,
            part: String::new(),
        }
    }

    /// For one of several pieces of work: it says which it is, and leaves the bars to the whole.
    pub(crate) fn for_part(&self, name: &str) -> Self {
        Self {
            part: format!("{name}: "),
            ..*self
        }
    }

    /// Whether only errors are to be printed.
    pub(crate) fn errors_only(&self) -> bool {
        self.quiet && !self.json
    }

    /// Prints the object under `--json`, else the text unless `--quiet`.
    pub(crate) fn report(
        &self,
        object: &impl Serialize,
        text: impl FnOnce() -> String,
    ) -> anyhow::Result<()> {
        let text = if self.json {
            serde_json::to_string(object)?
        } else if self.quiet {
            return Ok(());
        } else {
            text()
        };
        let mut out = std::io::stdout().lock();
        writeln!(out, "{}", text.trim_end())
            .and_then(|()| out.flush())
            .context("cannot write to standard output")
    }

    /// A line on standard error that a user must see, unless `--quiet`.
    pub(crate) fn warn(&self, text: &str) {
        if !self.quiet {
            eprintln!("psfield: warning: {}{text}", self.part);
        }
    }

    /// A line on standard error about what was done, unless `--quiet`.
    pub(crate) fn note(&self, text: &str) {
        if !self.quiet {
            eprintln!("psfield: note: {}{text}", self.part);
        }
    }

    /// A progress bar; drawn on a terminal only.
    pub(crate) fn bar(&self, what: &'static str) -> Bar {
        Bar::counting(what, self.quiet || !self.part.is_empty())
    }

    /// A spinner for work without steps; drawn on a terminal only.
    pub(crate) fn spinner(&self, what: &'static str) -> Bar {
        Bar::spinning(what, self.quiet || !self.part.is_empty())
    }
}

/// The program's version and the command line as it was given, for headers. Options that change no result stay out
/// ([`matters`]): the same input, options and seed give the same bytes.
pub(crate) fn signature() -> Vec<Card> {
    signature_of(&given_arguments())
}

/// The command line as one would type it again, with all its options.
pub(crate) fn command_text() -> String {
    let arguments: Vec<String> = given_arguments().iter().map(quoted).collect();
    format!("psfield {}", arguments.join(" "))
}

fn given_arguments() -> Vec<String> {
    // Not `args`, which panics on a name that is not UTF-8.
    std::env::args_os()
        .skip(1)
        .map(|arg| arg.to_string_lossy().into_owned())
        .collect()
}

/// The same for any command line.
pub(crate) fn signature_of(arguments: &[String]) -> Vec<Card> {
    let command: Vec<String> = matters(arguments).map(quoted).collect();
    psfield::provenance_cards(&format!("psfield {}", command.join(" ")))
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
