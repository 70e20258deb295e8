//! `psfield batch`.

mod job;
mod jobs_file;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::Instant;

use psf_types::Progress;
use serde::Serialize;

use crate::batch::job::{Job, JobState};
use crate::batch::jobs_file::{JobsFile, assignment};
use crate::context::{Context, message_of, with_overwrite};
use crate::json_lines::{LineWriter, failures};
use crate::simulate::{Report, Simulators};

pub(crate) use crate::batch::job::{parsed, simulate_command};
pub(crate) use crate::batch::jobs_file::{Settings, settings};

/// Simulate many scenes, and reuse PSF models and plans between them
///
/// A job is a set of options of psfield simulate, by their long names. `scene` gives the file of
/// the scene (SCENE.fits). `name` is optional and names the job in the report. Relative paths in
/// the jobs file refer to the folder of this file. All jobs are checked before the first one runs.
/// A job that fails does not stop the others, and the exit status is then 1.
///
/// For each job, one line of JSON is printed on standard output. With --quiet, only the lines of
/// failed jobs are printed. With --quiet --json, the lines of all jobs are printed.
///
/// A batch that is run again continues where it was interrupted: a job whose files exist is
/// skipped. A job on which another batch works is skipped, too. The header of each image holds a
/// digest of the options of its job (PSFJOB). If the options of a job have changed since its image
/// was written, the job fails unless --overwrite is given. Changes in the content of input files
/// are not detected.
#[derive(Debug, clap::Args)]
#[command(after_long_help = SAMPLE)]
pub(crate) struct BatchArgs {
    /// Jobs file (TOML or CSV)
    ///
    /// TOML: a table `[[job]]` for each job, and a table `[defaults]` for all. CSV: a line of
    /// option names and a row for each job. An empty field means that the option is not given.
    #[arg(value_name = "JOBS.toml|csv")]
    jobs: PathBuf,
    /// Set an option for all jobs that do not set it themselves (repeatable)
    ///
    /// This overrides `[defaults]`. Relative paths refer to the working directory. A flag such as
    /// --one-based is set by --set one-based or --set one-based=true, and in a jobs file by the
    /// value true.
    #[arg(long, value_name = "OPTION=VALUE", value_parser = assignment)]
    set: Vec<(String, String)>,
    /// Run all jobs, and replace outputs that exist
    #[arg(long)]
    overwrite: bool,
    /// Also append the lines of all jobs to this file
    // Not an `OutputFile`, because a log may exist already.
    #[arg(long, value_name = "LOG.jsonl")]
    log: Option<PathBuf>,
    /// Number of PSF models that are kept in memory for later jobs, with their plans
    ///
    /// A plan is the PSF data prepared for one image shape and one set of options. The option
    /// --memory of psfield simulate limits the memory of each plan.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..=1000))]
    keep: u16,
}

/// The end of the long help.
const SAMPLE: &str = r#"A jobs file in TOML:

  [defaults]
  psf = "telescope.fits"
  shape = [1024, 1024]
  tolerance = 1e-4

  [[job]]
  catalog = "field1.csv"
  output = "field1.fits"

  [[job]]
  name = "second field, as the camera sees it"
  catalog = "field2.csv"
  columns = { x = "X_IMAGE", y = "Y_IMAGE", flux = "FLUX_AUTO" }
  one-based = true
  detector = "camera.toml"
  truth = "field2_truth.fits"
  output = "field2.fits"
  seed = 2

and one in CSV, run as psfield batch jobs.csv --set psf=telescope.fits --set shape=1024,1024:

  output,catalog,seed,detector
  field1.fits,field1.csv,,
  field2.fits,field2.csv,2,camera.toml

A job's line has the keys job (counted from 1), name, output, status (done, skipped or failed),
reason (only of a skipped job: exists, or in progress if another batch works on it), error, reused
(true if model and plan were made for an earlier job), seconds, and report (the object of simulate
--json)."#;

impl BatchArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        let mut from_command_line = Settings::default();
        for assignment in self.set {
            from_command_line.add(assignment)?;
        }
        let jobs = Job::all(
            JobsFile::read(&self.jobs)?,
            &from_command_line,
            self.log.as_deref(),
        )?;
        let mut lines = LineWriter::new(self.log.as_deref(), context)?;
        let mut simulators = Simulators::keeping(usize::from(self.keep));
        let mut failed = Vec::new();
        let bar = context.bar("jobs");
        bar.start(jobs.len() as u64);
        for job in &jobs {
            let report = report_of(job, self.overwrite, &mut simulators, context);
            bar.aside(|| lines.write(&report, report.status == Status::Failed))?;
            bar.advance(1);
            if report.status == Status::Failed {
                failed.push(format!("{} ({})", job.number, job.name));
            }
        }
        drop(bar);
        failures("jobs", &failed, jobs.len())
    }
}

/// Simulates a job. A panic is the failure of this job alone. What it may have left half made is not used
/// again.
fn simulated(
    job: &Job,
    replace: bool,
    simulators: &mut Simulators,
    context: &Context,
) -> anyhow::Result<Report> {
    let run = || job.marked(replace).simulate(simulators, context);
    caught(run).unwrap_or_else(|| {
        simulators.forget();
        anyhow::bail!("this job met an error in psfield, which standard error shows: please report it")
    })
}

/// Runs work. Returns `None` if it panics.
fn caught<R>(work: impl FnOnce() -> R) -> Option<R> {
    catch_unwind(AssertUnwindSafe(work)).ok()
}

/// Runs a job and returns its report. Skips the job if another batch works on it or, without
/// `overwrite`, if its files exist.
fn report_of<'a>(
    job: &'a Job,
    overwrite: bool,
    simulators: &mut Simulators,
    context: &Context,
) -> JobReport<'a> {
    let clock = Instant::now();
    let mut report = JobReport {
        job: job.number,
        name: &job.name,
        output: &job.output,
        status: Status::Failed,
        reason: None,
        error: None,
        reused: None,
        seconds: 0.0,
        report: None,
    };
    // A finished job is not locked, because its folder may be read-only.
    let is_done = !overwrite && matches!(JobState::of(job), JobState::Done);
    // The lock is held until the files of the job are written.
    let lock = if is_done { Ok(None) } else { job.lock() };
    let state = match &lock {
        _ if is_done => JobState::Done,
        Err(error) => JobState::Refused(psfield::error::error_text(error)),
        Ok(None) => JobState::InProgress,
        Ok(Some(_)) if overwrite => JobState::Partial,
        Ok(Some(_)) => JobState::of(job),
    };
    let replace = matches!(state, JobState::Partial);
    match state {
        JobState::Done | JobState::InProgress => {
            report.status = Status::Skipped;
            let done = matches!(state, JobState::Done);
            report.reason = Some(if done { "exists" } else { "in progress" });
        }
        JobState::Refused(why) => report.error = Some(with_overwrite(&why)),
        JobState::Missing | JobState::Partial => {
            let context = context.for_part(&format!("job {} ({})", job.number, job.name));
            let made = simulators.made;
            match simulated(job, replace, simulators, &context) {
                Ok(simulated) => {
                    match simulated.verdict() {
                        Ok(()) => report.status = Status::Done,
                        Err(error) => report.error = Some(message_of(&error)),
                    }
                    report.reused = Some(simulators.made == made);
                    report.report = Some(simulated);
                }
                Err(error) => report.error = Some(message_of(&error)),
            }
        }
    }
    report.seconds = clock.elapsed().as_secs_f64();
    report
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Status {
    Done,
    Skipped,
    Failed,
}

/// The line of JSON that is printed for a job.
#[derive(Debug, Serialize)]
struct JobReport<'a> {
    job: usize,
    name: &'a str,
    output: &'a Path,
    status: Status,
    /// For a skipped job: `exists`, or `in progress` if another process works on it.
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<&'static str>,
    error: Option<String>,
    /// True if model and plan were made for an earlier job. Null if nothing was simulated.
    reused: Option<bool>,
    seconds: f64,
    report: Option<Report>,
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// The two jobs files of the help.
    fn samples() -> [String; 2] {
        let blocks = |from: &str, to: &str| {
            let start = SAMPLE.find(from).unwrap();
            let end = SAMPLE.find(to).unwrap();
            SAMPLE[start..end]
                .lines()
                .map(str::trim)
                .collect::<Vec<_>>()
                .join("\n")
        };
        [
            blocks("[defaults]", "and one in CSV"),
            blocks("output,catalog", "A job's line"),
        ]
    }

    #[test]
    fn a_panic_of_a_job_is_caught() {
        assert_eq!(caught(|| 1), Some(1));
        assert_eq!(caught(|| -> i32 { panic!("in one job") }), None);
    }

    #[test]
    fn the_samples_of_the_help_are_understood() {
        let [toml, csv] = samples();
        let folder = Path::new("night");
        let toml = JobsFile::from_toml(&toml, folder).unwrap();
        let jobs = Job::all(toml, &Settings::default(), None).unwrap();
        assert_eq!(jobs.len(), 2);
        assert_eq!(jobs[0].name, "field1.fits");
        assert_eq!(jobs[1].output, folder.join("field2.fits"));
        assert_eq!(jobs[1].files.len(), 2);

        let mut common = Settings::default();
        for text in ["psf=telescope.fits", "shape=1024,1024"] {
            common.add(assignment(text).unwrap()).unwrap();
        }
        let csv = JobsFile::from_csv(csv.as_bytes(), folder).unwrap();
        let jobs = Job::all(csv, &common, None).unwrap();
        assert_eq!(jobs.len(), 2);
        assert_eq!(jobs[1].output, folder.join("field2.fits"));
    }

    #[test]
    fn a_digest_tells_options_apart_and_nothing_else() {
        let digest = |text: &str| {
            let text = format!("[defaults]\nseed = 1\n[[job]]\npsf = 'p.fits'\nscene = 's.fits'\n{text}");
            let file = JobsFile::from_toml(&text, Path::new("")).unwrap();
            Job::all(file, &Settings::default(), None).unwrap()[0]
                .digest
                .clone()
        };
        let plain = digest("output = 'a.fits'");
        assert_eq!(plain.len(), 16);
        for same in [
            "output = 'b.fits'\nname = 'b'",
            "output = 'a.fits'\nseed = 1",
            "output = 'a.fits'\nstream = true\none-based = false",
        ] {
            assert_eq!(digest(same), plain, "{same}");
        }
        for other in [
            "seed = 2",
            "tolerance = 1e-4",
            "extension = 1",
            "detector = 'd.toml'",
        ] {
            assert_ne!(digest(&format!("output = 'a.fits'\n{other}")), plain, "{other}");
        }
        // Options with equal names and one different value.
        assert_ne!(
            digest("output = 'a.fits'\nanchor = 'source'\nprecision = 'f64'"),
            digest("output = 'a.fits'\nanchor = 'output'\nprecision = 'f64'")
        );
    }

    /// A text with a few random errors.
    pub(crate) fn spoilt(text: &str, case: u64) -> String {
        const MARKS: [&str; 24] = [
            ",",
            "\"",
            "'",
            "\n",
            "\r\n",
            "#",
            "[",
            "]",
            "[[",
            "=",
            "{",
            "}",
            "\0",
            "é",
            "nan",
            "-1",
            "1e999",
            "99999999999999999999",
            "true",
            "1979-05-27",
            "name",
            "output",
            "overwrite = true\n",
            "x=",
        ];
        let mut rng = ChaCha8Rng::seed_from_u64(case);
        let mut text: Vec<char> = text.chars().collect();
        for _ in 0..rng.random_range(1..4) {
            let at = rng.random_range(0..text.len());
            let length = rng.random_range(0..3).min(text.len() - at);
            let mark = MARKS[rng.random_range(0..MARKS.len())];
            text.splice(at..at + length, mark.chars());
        }
        text.into_iter().collect()
    }

    /// Jobs files with random errors are accepted or refused, and never cause a panic. The parser
    /// of the file and the checks of the options are both tested.
    #[test]
    fn spoilt_jobs_are_understood_or_refused_by_name() {
        const CASES: u64 = 4000;
        let seeds = samples();
        let (mut understood, mut refused) = (0, 0);
        for case in 0..CASES {
            let is_toml = case % 2 == 0;
            let text = spoilt(&seeds[usize::from(!is_toml)], case);
            let folder = Path::new("night");
            let parsed = if is_toml {
                JobsFile::from_toml(&text, folder)
            } else {
                JobsFile::from_csv(text.as_bytes(), folder)
            };
            let mut common = Settings::default();
            common.add(assignment("psf=telescope.fits").unwrap()).unwrap();
            let checked = parsed.and_then(|file| {
                let path = folder.join("jobs");
                Job::all(JobsFile { path, ..file }, &common, None).map_err(|e| {
                    assert!(e.to_string().contains("jobs"), "{text}: {e}");
                    e.to_string()
                })
            });
            match checked {
                Ok(_) => understood += 1,
                Err(why) => {
                    assert!(!why.is_empty(), "{text}");
                    refused += 1;
                }
            }
        }
        assert!(
            understood > 0 && refused > 0,
            "{understood} understood, {refused} refused"
        );
    }
}
