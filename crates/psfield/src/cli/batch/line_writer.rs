//! Where the lines go.

use std::fs::File;
use std::io::{ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use anyhow::Context as _;

use super::super::context::Context;
use super::job_report::{JobReport, Status};

/// Standard output and the log.
pub(super) struct LineWriter {
    log: Option<(File, PathBuf)>,
    failures_only: bool,
    /// Nobody reads standard output any more.
    closed: bool,
}

impl LineWriter {
    pub(super) fn new(log: Option<&Path>, context: &Context) -> anyhow::Result<Self> {
        let log = log
            .map(|path| {
                let log = open(path).with_context(|| format!("cannot write the log {}", path.display()))?;
                anyhow::Ok((log, path.to_owned()))
            })
            .transpose()?;
        Ok(Self {
            log,
            failures_only: context.errors_only(),
            closed: false,
        })
    }

    /// Writes the line of a job at once.
    pub(super) fn write(&mut self, report: &JobReport<'_>) -> anyhow::Result<()> {
        let line = serde_json::to_string(report)? + "\n";
        if let Some((log, path)) = &mut self.log {
            append(log, &line).with_context(|| format!("cannot write the log {}", path.display()))?;
        }
        if self.closed || (self.failures_only && report.status != Status::Failed) {
            return Ok(());
        }
        let mut out = std::io::stdout().lock();
        match out.write_all(line.as_bytes()).and_then(|()| out.flush()) {
            // The images are what was asked for: the jobs go on.
            Err(e) if e.kind() == ErrorKind::BrokenPipe => self.closed = true,
            other => other.context("cannot write to standard output")?,
        }
        Ok(())
    }
}

/// Opens a log whose last line is whole: what a killed process has begun gets its end here.
fn open(path: &Path) -> std::io::Result<File> {
    let log = File::options().create(true).append(true).open(path)?;
    // A pipe or a device holds nothing, and a log that may not be read is taken as whole.
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

/// Appends a line, or nothing: a full disk must not leave half of it.
fn append(mut log: &File, line: &str) -> std::io::Result<()> {
    let before = log.metadata()?;
    log.write_all(line.as_bytes()).inspect_err(|_| {
        if before.is_file() {
            // The first error is the one to tell.
            let _ = log.set_len(before.len());
        }
    })
}
