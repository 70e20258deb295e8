//! Where the lines go.

use std::fs::File;
use std::io::{ErrorKind, Write};
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
                let file = File::options().create(true).append(true).open(path);
                let file = file.with_context(|| format!("cannot write the log {}", path.display()))?;
                anyhow::Ok((file, path.to_owned()))
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
            log.write_all(line.as_bytes())
                .with_context(|| format!("cannot write the log {}", path.display()))?;
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
