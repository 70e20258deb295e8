//! A job of a batch: its parsed options, and the state of its files.

use std::ffi::OsString;
use std::hash::Hasher;
use std::path::{Path, PathBuf};

use clap::{ArgAction, Args, Command, FromArgMatches};
use psf_io::{IoError, OutputLock};
use psfield::image_cards::check_made_by;

use crate::UsageError;
use crate::batch::jobs_file::{JobsFile, Setting, Settings};
use crate::context::GivenOptions;
use crate::files::{FileType, FileUses, NamedFiles, Use};
use crate::simulate::{JobMark, SimulateArgs};
use crate::values::plain_text;

/// The name of the scene in a jobs file. On the command line, the scene has no option name.
const SCENE: &str = "scene";
/// Options that do not change the results.
const WITHOUT_EFFECT_ON_RESULTS: [&str; 1] = ["stream"];

/// A run of `simulate`.
#[derive(Debug)]
pub(super) struct Job {
    /// The number of the job, counted from 1.
    pub(super) number: usize,
    /// The `name` that the job sets, or else its `output`.
    pub(super) name: String,
    pub(super) output: PathBuf,
    /// All files that the job writes.
    pub(super) files: Vec<PathBuf>,
    /// The digest of the options on which the results of the job depend.
    pub(super) digest: String,
    inputs: Vec<PathBuf>,
    args: SimulateArgs,
    /// The arguments of `simulate` that run the job.
    arguments: Vec<OsString>,
}

impl Job {
    /// Parses all jobs of a file, and checks all that can be checked before the first job runs. The
    /// defaults `stronger` (from `--set`) override the defaults of the file.
    ///
    /// # Errors
    /// [`UsageError`] that names the job:
    /// - for an option or a value that `simulate` does not accept, and for the option `overwrite`
    /// - for an output that is also the jobs file, an output of another job, or an input of this
    ///   job or of an earlier one
    ///
    /// [`UsageError`] for a `name` among the defaults, and for a log that is also the jobs file, or
    /// an input or an output of a job.
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
            if settings.has("name") {
                return Err(UsageError(format!(
                    "{place}: name cannot be set for all jobs at once: give each job its own name"
                )));
            }
        }
        let mut command = simulate_command();
        let mut uses = FileUses::default();
        uses.read(&file.path, "the jobs file");
        let mut jobs = Vec::with_capacity(file.jobs.len());
        for (k, (place, settings)) in file.jobs.into_iter().enumerate() {
            let job = Self::new(k + 1, settings.or(&defaults), &mut command)
                .and_then(|job| job.record(&mut uses, &place).map(|()| job))
                .map_err(|what| UsageError(format!("{}: {place}: {what}", file.path.display())))?;
            jobs.push(job);
        }
        if let Some(log) = log {
            uses.write(log, "the log")
                .map_err(|what| UsageError(format!("--log: {what}")))?;
        }
        Ok(jobs)
    }

    fn new(number: usize, mut settings: Settings, command: &mut Command) -> Result<Self, String> {
        let name = settings.take("name").map(|name| name.value());
        if settings.has("overwrite") {
            return Err("overwrite applies only to the whole batch: psfield batch --overwrite".to_owned());
        }
        let name = name.or_else(|| Some(settings.get("output")?.value()));
        let (args, files, arguments) = parsed(&settings, command)?;
        Ok(Self {
            number,
            name: name.unwrap_or_default(),
            output: args.output.to_path_buf(),
            files: files.outputs,
            digest: digest(&settings, command),
            inputs: files.inputs,
            args,
            arguments,
        })
    }

    /// Locks the job's output against other batches. `None` if another batch works on the job.
    /// Returns an error if a file of the job cannot be written.
    pub(super) fn lock(&self) -> Result<Option<OutputLock>, IoError> {
        for file in &self.files {
            psf_io::check_output(file, true)?;
        }
        OutputLock::acquire(&self.output)
    }

    /// Adds the files of the job to `uses`. Returns an error message if an output is in use
    /// already. `place` names the job in messages, as in `job 2 (line 3)`.
    fn record(&self, uses: &mut FileUses, place: &str) -> Result<(), String> {
        for input in &self.inputs {
            uses.read(input, &format!("an input of {place}"));
        }
        let mut outputs = self.files.iter();
        outputs.try_for_each(|file| uses.write(file, &format!("an output of {place}")))
    }

    /// Returns the parsed arguments that run the job and write its mark in the headers of its
    /// files.
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

/// The options of `simulate`, for [`parsed`].
pub(crate) fn simulate_command() -> Command {
    SimulateArgs::augment_args(Command::new("simulate"))
        .no_binary_name(true)
        .disable_help_flag(true)
}

/// Parses options of `simulate` that stand in a file. Returns the options, the files that they name, and
/// the equivalent arguments.
///
/// # Errors
/// A message for an option or a value that `simulate` does not accept, and for options that do not fit
/// together.
pub(crate) fn parsed(
    settings: &Settings,
    command: &mut Command,
) -> Result<(SimulateArgs, NamedFiles, Vec<OsString>), String> {
    let arguments = arguments(settings, command)?;
    let mut matches = command
        .try_get_matches_from_mut(&arguments)
        .map_err(|e| in_one_line(&e))?;
    let mut files = NamedFiles::of(command, &matches).map_err(|e| e.to_string())?;
    let given = GivenOptions::of(command, &matches);
    let args = SimulateArgs::from_arg_matches_mut(&mut matches).map_err(|e| in_one_line(&e))?;
    files.outputs.extend(args.default_truth());
    match args.misused(&given) {
        Some(what) => Err(what),
        None => Ok((args, files, arguments)),
    }
}

fn is_flag(arg: &clap::Arg) -> bool {
    matches!(arg.get_action(), ArgAction::SetTrue)
}

fn option<'a>(command: &'a Command, name: &str) -> Option<&'a clap::Arg> {
    command
        .get_arguments()
        .find(|arg| arg.get_long() == Some(name) || (name == SCENE && arg.get_id() == SCENE))
}

/// Parses the value of a flag: `true` or `false`.
fn flag(name: &str, setting: &Setting) -> Result<bool, String> {
    match setting.value().as_str() {
        "true" => Ok(true),
        "false" => Ok(false),
        other => Err(format!("{name}: true or false is needed, not {other:?}")),
    }
}

/// Returns the options as arguments of `simulate`. Unknown options are kept, so that the parser
/// reports them.
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
        let within = |value: &str| match known.and_then(FileType::of_argument) {
            Some(file_type) => (file_type.within)(&setting.folder, value),
            None => OsString::from(value),
        };
        let values = match known {
            // An option that may be repeated takes the values of a list one by one.
            Some(arg) if matches!(arg.get_action(), ArgAction::Append) => setting.list.clone(),
            _ => vec![setting.value()],
        };
        for value in values.iter().map(|value| within(value)) {
            if name == SCENE {
                scene = Some(value);
                continue;
            }
            let mut argument = OsString::from(format!("--{name}="));
            argument.push(value);
            arguments.push(argument);
        }
    }
    if let Some(scene) = scene {
        arguments.extend([OsString::from("--"), scene]);
    }
    Ok(arguments)
}

/// Returns the digest of the options on which the results depend. Relative paths enter without the
/// folder of the jobs file, so that a batch can be moved to another folder. The digest is FNV-1a of
/// 64 bits, which never changes between machines or releases.
fn digest(settings: &Settings, command: &Command) -> String {
    let mut hasher = fnv::FnvHasher::default();
    for (name, setting) in settings.iter() {
        let known = option(command, name);
        let off = known.is_some_and(is_flag) && setting.value() == "false";
        let file_type = known.and_then(FileType::of_argument);
        let is_output = file_type.is_some_and(|file| file.used == Use::Output);
        if off || is_output || WITHOUT_EFFECT_ON_RESULTS.contains(&name) {
            continue;
        }
        // Images of earlier releases stay valid: this option had another name.
        let name = if name == "oversampling" {
            "oversample"
        } else {
            name
        };
        for text in [name, &setting.value()] {
            hasher.write(text.as_bytes());
            // A separator after each string keeps ("ab", "c") apart from ("a", "bc").
            hasher.write(&[0xff]);
        }
    }
    format!("{:016x}", hasher.finish())
}

/// Returns the message of the parser in one line, without its advice for the command line.
fn in_one_line(error: &clap::Error) -> String {
    let text = plain_text(error);
    let end = ["\n\nUsage:", "\n\nFor more information"]
        .iter()
        .filter_map(|advice| text.find(advice))
        .min()
        .unwrap_or(text.len());
    let words: Vec<&str> = text[..end].split_whitespace().collect();
    let line = words.join(" ");
    line.strip_prefix("error: ").unwrap_or(&line).to_owned()
}

/// The state of a job's files.
#[derive(Debug)]
pub(super) enum JobState {
    Missing,
    /// Another process works on the job.
    InProgress,
    /// Some of the files exist, and this job made them.
    Partial,
    Done,
    /// A file failed its spot check, was not made by this job, or cannot be written. Holds the
    /// message.
    Refused(String),
}

impl JobState {
    pub(super) fn of(job: &Job) -> Self {
        let mut there = 0;
        // `symlink_metadata` also finds a dangling link, which would be in the way of the output.
        for file in job.files.iter().filter(|file| file.symlink_metadata().is_ok()) {
            if let Err(why) = check_made_by(file, &job.digest) {
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
