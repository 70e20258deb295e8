//! How far a job is.

use std::path::Path;

use psf_io::{Card, CardValue};
use psfield::{JOB_KEYWORD, SpotCheck};

use super::job::Job;

/// What there is of a job's files.
#[derive(Debug)]
pub(super) enum Standing {
    Missing,
    /// Some of them, made by this job.
    Partial,
    Done,
    /// They are not to be touched, or not good: why.
    Refused(String),
}

impl Standing {
    pub(super) fn of(job: &Job) -> Self {
        let mut there = 0;
        // Without following a link into nowhere: what is there in any form is in the way.
        for file in job.files.iter().filter(|file| file.symlink_metadata().is_ok()) {
            if let Err(why) = judge(file, &job.digest) {
                return Self::Refused(why);
            }
            there += 1;
        }
        match there {
            0 => Self::Missing,
            n if n < job.files.len() => Self::Partial,
            _ => Self::Done,
        }
    }
}

/// Whether a file is a good one of the job with this digest.
fn judge(file: &Path, digest: &str) -> Result<(), String> {
    let header = psf_io::read_header(file).map_err(|e| {
        format!(
            "{} exists and is not of this job: --overwrite replaces it ({e})",
            file.display()
        )
    })?;
    let text = |keyword: &str| match header.get(keyword).and_then(Card::value) {
        Some(CardValue::Text(text)) => Some(text),
        _ => None,
    };
    match text(JOB_KEYWORD) {
        None => Err(format!(
            "{} exists and was not made by a batch: --overwrite replaces it",
            file.display()
        )),
        Some(found) if found != digest => Err(format!(
            "{} exists and was made with other options ({JOB_KEYWORD} {found}, now {digest}): --overwrite replaces it, or choose \
             another output",
            file.display()
        )),
        Some(_) if text(SpotCheck::VERDICT_KEYWORD).as_deref() == Some(SpotCheck::FAILED) => Err(format!(
            "{} exists, and failed its spot check when it was made: it differs from the direct sum by more than the method promises; \
             --overwrite makes it anew",
            file.display()
        )),
        Some(_) => Ok(()),
    }
}
