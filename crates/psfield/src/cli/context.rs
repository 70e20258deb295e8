//! What every command shares: how it speaks, and how it signs its files.

use std::io::Write;

use psf_io::Card;
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

    /// A progress bar; drawn on a terminal only.
    pub(crate) fn bar(&self, what: &'static str) -> Bar {
        Bar::counting(what, self.quiet)
    }

    /// A spinner for work without steps; drawn on a terminal only.
    pub(crate) fn spinner(&self, what: &'static str) -> Bar {
        Bar::spinning(what, self.quiet)
    }
}

/// The program's version and the command line as it was given, for headers.
pub(crate) fn signature() -> Vec<Card> {
    let command: Vec<String> = std::env::args().skip(1).map(|arg| quoted(&arg)).collect();
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

/// An argument as one would type it.
fn quoted(arg: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_=./,:+@%".contains(c);
    if !arg.is_empty() && arg.chars().all(plain) {
        arg.to_owned()
    } else {
        format!("'{}'", arg.replace('\'', r"'\''"))
    }
}
