//! Reports of jobs, one line of JSON each.

use std::fs::File;
use std::io::{ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use serde::Serialize;

use crate::context::Context;

/// Writes lines of JSON, one for each job, to standard output and to a log.
pub(crate) struct LineWriter {
    log: Option<(File, PathBuf)>,
    failures_only: bool,
    /// True after standard output has lost its reader.
    closed: bool,
}

impl LineWriter {
    pub(crate) fn new(log: Option<&Path>, context: &Context) -> anyhow::Result<Self> {
        let log = log
            .map(|path| {
                let log = open(path).with_context(|| format!("cannot write the log {}", path.display()))?;
                anyhow::Ok((log, path.to_owned()))
            })
            .transpose()?;
        Ok(Self {
            log,
            failures_only: context.quiet && !context.json,
            closed: false,
        })
    }

    /// Writes the line of a job, which may have failed, without delay.
    pub(crate) fn write(&mut self, report: &impl Serialize, failed: bool) -> anyhow::Result<()> {
        let line = serde_json::to_string(report)? + "\n";
        if let Some((log, path)) = &mut self.log {
            append(log, &line).with_context(|| format!("cannot write the log {}", path.display()))?;
        }
        if self.closed || (self.failures_only && !failed) {
            return Ok(());
        }
        let mut out = std::io::stdout().lock();
        match out.write_all(line.as_bytes()).and_then(|()| out.flush()) {
            // The jobs continue without a reader, because the images are the result.
            Err(e) if e.kind() == ErrorKind::BrokenPipe => self.closed = true,
            other => other.context("cannot write to standard output")?,
        }
        Ok(())
    }
}

/// Opens a log. If its last line is incomplete, because an earlier batch was killed, ends that
/// line.
fn open(path: &Path) -> std::io::Result<File> {
    let log = File::options().create(true).append(true).open(path)?;
    // Pipes and devices have no last line. A log that cannot be read counts as complete.
    let found = log.metadata()?;
    if found.is_file() && found.len() > 0 && !ends_a_line(path).unwrap_or(true) {
        append(&log, "\n")?;
    }
    Ok(log)
}

fn ends_a_line(path: &Path) -> std::io::Result<bool> {
    let mut last = [0];
    let mut log = File::open(path)?;
    log.seek(SeekFrom::End(-1))?;
    log.read_exact(&mut last)?;
    Ok(last == *b"\n")
}

/// Appends a whole line or nothing, also on a full disk.
fn append(mut log: &File, line: &str) -> std::io::Result<()> {
    let before = log.metadata()?;
    log.write_all(line.as_bytes()).inspect_err(|_| {
        if before.is_file() {
            // The caller needs the error of the write, not an error of this truncation.
            let _ = log.set_len(before.len());
        }
    })
}

/// The largest number of failures that are named.
const MOST_NAMED: usize = 10;

/// Returns an error that names the jobs that failed, if there are any. `what` are all the jobs, as in `frames`.
pub(crate) fn failures(what: &str, failed: &[String], all: usize) -> anyhow::Result<()> {
    if failed.is_empty() {
        return Ok(());
    }
    let more = match failed.len().checked_sub(MOST_NAMED) {
        Some(more @ 1..) => format!(" and {more} more"),
        _ => String::new(),
    };
    anyhow::bail!(
        "{} of {all} {what} failed: {}{more}",
        failed.len(),
        failed[..failed.len().min(MOST_NAMED)].join(", ")
    )
}
