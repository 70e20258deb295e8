//! What is said of a job.

use std::path::Path;

use serde::Serialize;

use super::super::simulate::Report;
use super::job::Job;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Status {
    Done,
    Skipped,
    Failed,
}

/// The line of a job.
#[derive(Debug, Serialize)]
pub(super) struct JobReport<'a> {
    job: usize,
    name: &'a str,
    output: &'a Path,
    pub(super) status: Status,
    pub(super) error: Option<String>,
    /// Whether model and plan were those of an earlier job; null where nothing was simulated.
    pub(super) reused: Option<bool>,
    pub(super) seconds: f64,
    pub(super) report: Option<Report>,
}

impl<'a> JobReport<'a> {
    /// Of a job that has not succeeded yet.
    pub(super) fn of(job: &'a Job) -> Self {
        Self {
            job: job.number,
            name: &job.name,
            output: &job.output,
            status: Status::Failed,
            error: None,
            reused: None,
            seconds: 0.0,
            report: None,
        }
    }
}
