//! Parts shared by all commands: messages, progress bars, and the header cards that say which
//! command wrote a file.

use std::io::Write;
use std::path::Path;

use anyhow::Context as _;
use clap::ArgMatches;
use clap::parser::ValueSource;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use psf_io::{Card, IoError, Place, Precision};
use psf_types::{Progress, PsfSamples};
use psfield::PsfieldError;
use psfield_lab::LabError;
use serde::Serialize;

/// A wrong combination of arguments: exit status 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct UsageError(pub(crate) String);

/// The options that were given, as in `--gain`.
#[derive(Debug, Clone)]
pub(crate) struct GivenOptions(Vec<String>);

impl GivenOptions {
    pub(crate) fn of(command: &clap::Command, matches: &ArgMatches) -> Self {
        let on_command_line = |arg: &&clap::Arg| {
            let source = matches.value_source(arg.get_id().as_str());
            source == Some(ValueSource::CommandLine)
        };
        Self(names_of(command.get_arguments().filter(on_command_line)))
    }

    /// The given options that belong to a group, in the group's order.
    pub(crate) fn of_group<A: clap::Args>(&self) -> Vec<String> {
        let mut names = names_of(A::augment_args(clap::Command::new("")).get_arguments());
        names.retain(|name| self.0.contains(name));
        names
    }
}

fn names_of<'a>(args: impl Iterator<Item = &'a clap::Arg>) -> Vec<String> {
    let names = args.filter_map(clap::Arg::get_long);
    names.map(|name| format!("--{name}")).collect()
}

/// Makes an object from keys and values. JSON has the keys in the given order, and code can read
/// them as fields.
macro_rules! object {
    ($($(#[$meta:meta])* $key:ident $(: $value:expr)?),+ $(,)?) => {{
        #[allow(non_camel_case_types, reason = "each field has its own type parameter, which has the name of the field")]
        let object = {
            #[derive(serde::Serialize)]
            struct Object<$($key),+> {
                $($(#[$meta])* $key: $key),+
            }
            Object { $($key $(: $value)?),+ }
        };
        object
    }};
}
pub(crate) use object;

/// The message of an error with its causes, in one line, and the option that avoids the error, if
/// there is one.
pub(crate) fn message_of(error: &anyhow::Error) -> String {
    let setting = error.chain().find_map(|cause| {
        let of_pipeline = || cause.downcast_ref().and_then(PsfieldError::setting);
        of_pipeline().or_else(|| cause.downcast_ref().and_then(IoError::setting))
    });
    with_option(psfield::error::error_text(error.as_ref()), setting)
}

/// Appends to a message of the library the command-line option for `setting`, if there is one.
pub(crate) fn with_option(text: impl std::fmt::Display, setting: Option<&str>) -> String {
    match setting.and_then(option_of) {
        Some(option) => format!("{text} (option {option})"),
        None => text.to_string(),
    }
}

/// Names the option in a message of the library that advises to overwrite.
pub(crate) fn with_overwrite(text: &str) -> String {
    text.replace("again with overwrite", "again with --overwrite")
}

/// Keeps only the text of an error, so that [`message_of`] appends no option to it. For errors of
/// files to which the options of the command do not apply.
pub(crate) fn without_option(error: impl std::error::Error + 'static) -> anyhow::Error {
    anyhow::anyhow!(psfield::error::error_text(&error))
}

/// If an error concerns a pixel, adds to it the setting that accepts NaN.
pub(crate) fn with_nan_setting(error: IoError, setting: &'static str) -> IoError {
    match error.place() {
        Some(Place::Pixel { .. }) => error.with_setting(setting),
        _ => error,
    }
}

/// The option for a setting of the library.
fn option_of(setting: &str) -> Option<String> {
    Some(match setting {
        // No option sets these: world coordinates come from a header, and the command line always
        // simulates the whole frame.
        "sky" | "region" => return None,
        "hdu" => "--extension".to_owned(),
        "plane_order" => "--psf-order".to_owned(),
        "skip_invalid" => "--psf-skip-invalid".to_owned(),
        "invalid_skipped" => "--skip-invalid".to_owned(),
        "wavelength_um" => "--psf-wavelength".to_owned(),
        "time_s" => "--psf-time".to_owned(),
        "frame_number" => "--psf-frame".to_owned(),
        "shift_copies" => "--shift-augment".to_owned(),
        "pixel_scale_arcsec" => "--pixel-scale".to_owned(),
        "contexts" => "--psf-context".to_owned(),
        "extension" | "detector" | "positions" | "oversampling" | "centre" => format!("--psf-{setting}"),
        "pixel_response_included" => "--pixel-response".to_owned(),
        "at" => "--grid".to_owned(),
        "oversample" => "--oversampling".to_owned(),
        "degree" => "--to psfex=DEGREE".to_owned(),
        "nan_is_masked" => "--nan-is-masked, or --mask for other bad pixels".to_owned(),
        _ => format!("--{}", setting.replace('_', "-")),
    })
}

/// Appends `--window` to the error that no star could be measured.
pub(crate) fn with_window_hint(error: LabError) -> anyhow::Error {
    match error {
        LabError::NothingMeasured { .. } => anyhow::anyhow!("{error} (--window)"),
        other => other.into(),
    }
}

/// The output settings of a command.
#[derive(Debug)]
pub(crate) struct Context {
    pub(crate) json: bool,
    pub(crate) quiet: bool,
    /// The start of warnings and notes: the name of a batch job and a colon. Empty outside a batch.
    pub(crate) part: String,
    pub(crate) given: GivenOptions,
}

impl Context {
    /// Returns the context of a batch job. Warnings and notes start with the name of the job, and
    /// progress bars are not shown.
    pub(crate) fn for_part(&self, name: &str) -> Self {
        Self {
            part: format!("{name}: "),
            given: self.given.clone(),
            ..*self
        }
    }

    /// With `--json` prints the object. Otherwise prints the text, unless `--quiet` is given.
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

    /// Prints a warning on standard error, unless `--quiet`.
    pub(crate) fn warn(&self, text: &str) {
        if !self.quiet {
            say(&format!("psfield: warning: {}{text}", self.part));
        }
    }

    /// Prints a note on standard error about what was done, unless `--quiet`.
    pub(crate) fn note(&self, text: &str) {
        if !self.quiet {
            say(&format!("psfield: note: {}{text}", self.part));
        }
    }

    /// Returns a progress bar. It is drawn only on a terminal.
    pub(crate) fn bar(&self, what: &'static str) -> Bar {
        self.bar_of("{msg} {wide_bar} {pos}/{len} {eta}", what)
    }

    /// Returns a spinner for work without steps. It is drawn only on a terminal.
    pub(crate) fn spinner(&self, what: &'static str) -> Bar {
        let bar = self.bar_of("{spinner} {msg} {elapsed}", what);
        if !bar.0.is_hidden() {
            bar.0.enable_steady_tick(std::time::Duration::from_millis(100));
        }
        bar
    }

    fn bar_of(&self, template: &str, what: &'static str) -> Bar {
        // `stderr()` hides the bar if standard error is not a terminal.
        let target = if self.quiet || !self.part.is_empty() {
            ProgressDrawTarget::hidden()
        } else {
            ProgressDrawTarget::stderr()
        };
        let style = ProgressStyle::with_template(template).expect("a valid template");
        let bar = ProgressBar::with_draw_target(None, target);
        Bar(bar.with_style(style).with_message(what))
    }
}

/// Header cards with the program's version and the command line. They leave out some options that
/// do not change the result ([`matters`]): runs that differ only in these options write equal
/// bytes.
pub(crate) fn signature() -> Vec<Card> {
    signature_of(&given_arguments())
}

/// Writes PSF samples in single precision.
pub(crate) fn write_samples(path: &Path, samples: &PsfSamples, overwrite: bool) -> Result<(), IoError> {
    psf_io::write_samples(path, samples, &signature(), Precision::Single, overwrite)
}

/// The command line as it was given, quoted for a shell.
pub(crate) fn command_text() -> String {
    let arguments: Vec<String> = given_arguments().iter().map(quoted).collect();
    format!("psfield {}", arguments.join(" "))
}

fn given_arguments() -> Vec<String> {
    // `std::env::args` would panic on an argument that is not UTF-8.
    std::env::args_os()
        .skip(1)
        .map(|arg| arg.to_string_lossy().into_owned())
        .collect()
}

/// Header cards like those of [`signature`], for the given arguments instead of the program's own.
pub(crate) fn signature_of(arguments: &[String]) -> Vec<Card> {
    let command: Vec<String> = matters(arguments).map(quoted).collect();
    psfield::image_cards::provenance_cards(&format!("psfield {}", command.join(" ")))
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

/// An argument, quoted for a shell where needed.
fn quoted(arg: impl AsRef<str>) -> String {
    let arg = arg.as_ref();
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_=./,:+@%".contains(c);
    if !arg.is_empty() && arg.chars().all(plain) {
        arg.to_owned()
    } else {
        format!("'{}'", arg.replace('\'', r"'\''"))
    }
}

/// A progress bar or spinner on standard error. It is drawn only on a terminal, and disappears when
/// this value is dropped.
#[derive(Debug)]
pub(crate) struct Bar(ProgressBar);

impl Bar {
    /// Hides the bar while `print` runs.
    pub(crate) fn aside<R>(&self, print: impl FnOnce() -> R) -> R {
        self.0.suspend(print)
    }
}

impl Progress for Bar {
    fn start(&self, total: u64) {
        self.0.set_length(total);
    }

    fn advance(&self, steps: u64) {
        self.0.inc(steps);
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

/// Prints a line on standard error. A closed pipe or a full disk there does not stop the work.
pub(crate) fn say(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}
