//! A job: options that are understood, and how far its files are.

use std::any::TypeId;
use std::collections::HashMap;
use std::ffi::OsString;
use std::hash::Hasher;
use std::path::{Path, PathBuf};

use clap::{ArgAction, ArgMatches, Args, Command, FromArgMatches};
use psf_io::{Card, CardValue};
use psfield::{JOB_KEYWORD, SpotCheck, resolved};

use crate::UsageError;
use crate::batch::jobs_file::{JobsFile, Setting, Settings};
use crate::simulate::{JobMark, SimulateArgs};

/// The scene, which has no long name on the command line.
const SCENE: &str = "scene";
/// The files that a job makes; the first one is always there.
const OUTPUTS: [&str; 3] = ["output", "truth", "quality"];
/// Options that change where results go and how they come about, not what they are.
const SILENT: [&str; 1] = ["stream"];

/// A run of `simulate`.
#[derive(Debug)]
pub(super) struct Job {
    /// Counted from 1.
    pub(super) number: usize,
    /// As given, else the output.
    pub(super) name: String,
    pub(super) output: PathBuf,
    /// All that it writes.
    pub(super) files: Vec<PathBuf>,
    /// Of the options that its results depend on.
    pub(super) digest: String,
    inputs: Vec<PathBuf>,
    args: SimulateArgs,
    /// The command line that does the same.
    arguments: Vec<OsString>,
}

impl Job {
    /// All jobs of a file, each checked as far as can be told before the work. `stronger` are defaults that precede the file's.
    ///
    /// # Errors
    /// [`UsageError`] that names the job and the option: for options that `simulate` does not take, for files that two jobs write, and for
    /// outputs that would replace what this job or one before it reads, the jobs file or the log.
    pub(super) fn all(
        file: JobsFile,
        stronger: &Settings,
        log: Option<&Path>,
    ) -> Result<Vec<Self>, UsageError> {
        let defaults = stronger.clone().or(&file.defaults);
        let named = [
            ("--set".to_owned(), stronger),
            (format!("{}: [defaults]", file.path.display()), &file.defaults),
        ];
        for (place, settings) in named {
            if settings.get("name").is_some() {
                return Err(UsageError(format!("{place}: name is of single jobs, not of all")));
            }
        }
        let mut command = SimulateArgs::augment_args(Command::new("simulate"))
            .no_binary_name(true)
            .disable_help_flag(true);
        let mut taken = Places::default();
        taken
            .reads
            .insert(resolved(&file.path), "the jobs file".to_owned());
        if let Some(log) = log {
            taken.reads.insert(resolved(log), "the log".to_owned());
        }
        let mut jobs = Vec::with_capacity(file.jobs.len());
        for (k, (place, settings)) in file.jobs.into_iter().enumerate() {
            let job = Self::new(k + 1, settings.or(&defaults), &mut command)
                .and_then(|job| taken.add(&job, &place).map(|()| job))
                .map_err(|what| UsageError(format!("{}: {place}: {what}", file.path.display())))?;
            jobs.push(job);
        }
        Ok(jobs)
    }

    fn new(number: usize, mut settings: Settings, command: &mut Command) -> Result<Self, String> {
        let name = settings.take("name").map(|name| name.value);
        if settings.get("overwrite").is_some() {
            return Err("overwrite is of the whole batch: psfield batch --overwrite".to_owned());
        }
        let name = name.or_else(|| Some(settings.get("output")?.value.clone()));
        let arguments = arguments(&settings, command)?;
        let mut matches = command
            .try_get_matches_from_mut(&arguments)
            .map_err(|e| in_one_line(&e))?;
        let path = |matches: &ArgMatches, id: &str| matches.get_one::<PathBuf>(id).cloned();
        let mut files: Vec<PathBuf> = OUTPUTS.iter().filter_map(|id| path(&matches, id)).collect();
        let inputs = command
            .get_arguments()
            .filter(|arg| is_path(arg) && !OUTPUTS.contains(&arg.get_id().as_str()))
            .filter_map(|arg| path(&matches, arg.get_id().as_str()))
            .collect();
        let output = path(&matches, OUTPUTS[0]).ok_or("output is missing")?;
        let args = SimulateArgs::from_arg_matches_mut(&mut matches).map_err(|e| in_one_line(&e))?;
        files.extend(args.truth_beside().filter(|truth| !files.contains(truth)));
        if let Some(what) = args.misused() {
            return Err(what);
        }
        Ok(Self {
            number,
            name: name.unwrap_or_default(),
            output,
            files,
            digest: digest(&settings, command),
            inputs,
            args,
            arguments,
        })
    }

    /// What runs it, such that its files bear its mark.
    pub(super) fn marked(&self, overwrite: bool) -> SimulateArgs {
        let arguments = self
            .arguments
            .iter()
            .map(|arg| arg.to_string_lossy().into_owned());
        let mark = JobMark {
            arguments: std::iter::once("simulate".to_owned()).chain(arguments).collect(),
            digest: self.digest.clone(),
        };
        self.args.for_job(mark, overwrite)
    }
}

/// Files of the jobs so far, and whose they are.
#[derive(Default)]
struct Places {
    reads: HashMap<PathBuf, String>,
    writes: HashMap<PathBuf, String>,
}

impl Places {
    fn add(&mut self, job: &Job, place: &str) -> Result<(), String> {
        for input in &job.inputs {
            self.reads
                .entry(resolved(input))
                .or_insert_with(|| format!("an input of {place}"));
        }
        for file in &job.files {
            let at = resolved(file);
            if let Some(whose) = self.reads.get(&at) {
                return Err(format!("{} is an output, but also {whose}", file.display()));
            }
            if let Some(other) = self.writes.insert(at, place.to_owned()) {
                return Err(format!("{} is also an output of {other}", file.display()));
            }
        }
        Ok(())
    }
}

fn is_flag(arg: &clap::Arg) -> bool {
    matches!(arg.get_action(), ArgAction::SetTrue)
}

fn is_path(arg: &clap::Arg) -> bool {
    arg.get_value_parser().type_id() == TypeId::of::<PathBuf>()
}

/// The option of this name.
fn option<'a>(command: &'a Command, name: &str) -> Option<&'a clap::Arg> {
    command
        .get_arguments()
        .find(|arg| arg.get_long() == Some(name) || (name == SCENE && arg.get_id() == SCENE))
}

/// Whether a flag is up.
fn flag(name: &str, setting: &Setting) -> Result<bool, String> {
    match setting.value.as_str() {
        "true" => Ok(true),
        "false" => Ok(false),
        other => Err(format!("{name}: true or false is needed, not {other:?}")),
    }
}

/// The options as arguments of `simulate`. Unknown ones too: the parser knows best what to say of them.
fn arguments(settings: &Settings, command: &Command) -> Result<Vec<OsString>, String> {
    let mut arguments = Vec::new();
    let mut scene = None;
    for (name, setting) in settings.iter() {
        let known = option(command, name);
        if known.is_some_and(is_flag) {
            if flag(name, setting)? {
                arguments.push(format!("--{name}").into());
            }
            continue;
        }
        let value = match known {
            Some(arg) if is_path(arg) => setting.folder.join(&setting.value).into_os_string(),
            _ => OsString::from(&setting.value),
        };
        if name == SCENE {
            scene = Some(value);
            continue;
        }
        let mut argument = OsString::from(format!("--{name}="));
        argument.push(value);
        arguments.push(argument);
    }
    if let Some(scene) = scene {
        arguments.extend([OsString::from("--"), scene]);
    }
    Ok(arguments)
}

/// Tells jobs apart by the options that their results depend on, with paths as they are written, so that a batch can be moved. FNV-1a of
/// 64 bits: the same on every machine and in every release.
fn digest(settings: &Settings, command: &Command) -> String {
    let mut hasher = fnv::FnvHasher::default();
    for (name, setting) in settings.iter() {
        let off = option(command, name).is_some_and(is_flag) && setting.value == "false";
        if off || OUTPUTS.contains(&name) || SILENT.contains(&name) {
            continue;
        }
        for text in [name, &setting.value] {
            hasher.write(text.as_bytes());
            // Where a text ends counts.
            hasher.write(&[0xff]);
        }
    }
    format!("{:016x}", hasher.finish())
}

/// What the parser complains of, without its advice on the command line.
fn in_one_line(error: &clap::Error) -> String {
    let text = error.to_string();
    let end = ["\n\nUsage:", "\n\nFor more information"]
        .iter()
        .filter_map(|advice| text.find(advice))
        .min()
        .unwrap_or(text.len());
    let words: Vec<&str> = text[..end].split_whitespace().collect();
    let line = words.join(" ");
    line.strip_prefix("error: ").unwrap_or(&line).to_owned()
}

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
