//! The files that a command reads and writes: which arguments name them, and the check that no
//! output replaces an input or another output.

use std::any::TypeId;
use std::collections::HashMap;
use std::ffi::OsString;
use std::ops::Deref;
use std::path::{Path, PathBuf};

use clap::ArgMatches;
use serde::Serialize;

use crate::UsageError;

/// The destination of a command's JSON, if any.
///
/// In `bench`, `--json` may take a file. In other commands, `--json` takes no value. The parser
/// needs one type for both.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum JsonTo {
    Nowhere,
    /// Standard output. The JSON replaces the text there.
    Output,
    File(PathBuf),
}

impl JsonTo {
    /// The destination for `--json` without a value, which is given or not.
    pub(crate) fn of_flag(given: bool) -> Self {
        if given { Self::Output } else { Self::Nowhere }
    }

    /// Parses `--json FILE`. `-` is standard output.
    pub(crate) fn of_argument(text: OsString) -> Self {
        if text == "-" {
            Self::Output
        } else {
            Self::File(text.into())
        }
    }

    pub(crate) fn file(&self) -> Option<&Path> {
        match self {
            Self::File(path) => Some(path),
            _ => None,
        }
    }
}

/// An argument that names a file to write. (An argument of type [`PathBuf`] names a file to read,
/// or the log of a batch.)
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(transparent)]
pub(crate) struct OutputFile(PathBuf);

/// An argument that names a folder to write files in.
#[derive(Debug, Clone, Serialize)]
#[serde(transparent)]
pub(crate) struct OutputFolder(PathBuf);

impl From<OsString> for OutputFile {
    fn from(path: OsString) -> Self {
        Self(path.into())
    }
}

impl From<OsString> for OutputFolder {
    fn from(path: OsString) -> Self {
        Self(path.into())
    }
}

impl Deref for OutputFile {
    type Target = PathBuf;
    fn deref(&self) -> &PathBuf {
        &self.0
    }
}

impl OutputFile {
    /// The default name of another FITS file, which is written next to this output: `a/b.fits` and
    /// the ending `truth` give `a/b_truth.fits`.
    pub(crate) fn beside(&self, ending: &str) -> PathBuf {
        beside(self, ending)
    }
}

/// The name of another FITS file next to an output ([`OutputFile::beside`]).
pub(crate) fn beside(output: &Path, ending: &str) -> PathBuf {
    let stem = output.file_stem().unwrap_or_default().to_string_lossy();
    output.with_file_name(format!("{stem}_{ending}.fits"))
}

impl AsRef<Path> for OutputFile {
    fn as_ref(&self) -> &Path {
        &self.0
    }
}

impl Deref for OutputFolder {
    type Target = PathBuf;
    fn deref(&self) -> &PathBuf {
        &self.0
    }
}

/// The files and folders that the arguments of a command name.
#[derive(Debug, Default)]
pub(crate) struct NamedFiles {
    pub(crate) inputs: Vec<PathBuf>,
    pub(crate) outputs: Vec<PathBuf>,
    folders: Vec<PathBuf>,
    overwrite: bool,
}

impl NamedFiles {
    /// Collects the files from all arguments of a command, by the type of each argument.
    ///
    /// # Errors
    /// [`UsageError`] for an empty name.
    pub(crate) fn of(command: &clap::Command, matches: &ArgMatches) -> Result<Self, UsageError> {
        let mut named = Self {
            overwrite: matches
                .try_get_one("overwrite")
                .is_ok_and(|given| given == Some(&true)),
            ..Self::default()
        };
        for arg in command.get_arguments() {
            let of = arg.get_value_parser().type_id();
            let (list, paths) = if of == TypeId::of::<PathBuf>() {
                (
                    &mut named.inputs,
                    paths(matches, arg, |path: &PathBuf| Some(path.clone())),
                )
            } else if of == TypeId::of::<OutputFile>() {
                (
                    &mut named.outputs,
                    paths(matches, arg, |file: &OutputFile| Some(file.0.clone())),
                )
            } else if of == TypeId::of::<OutputFolder>() {
                (
                    &mut named.folders,
                    paths(matches, arg, |folder: &OutputFolder| Some(folder.0.clone())),
                )
            } else if of == TypeId::of::<JsonTo>() {
                (
                    &mut named.outputs,
                    paths(matches, arg, |json: &JsonTo| json.file().map(Path::to_owned)),
                )
            } else {
                continue;
            };
            if paths.iter().any(|path| path.as_os_str().is_empty()) {
                return Err(UsageError(format!("{arg}: the name is empty")));
            }
            list.extend(paths);
        }
        Ok(named)
    }

    /// Checks that all outputs can be written and that none is an input, as far as this can be
    /// known before the work.
    ///
    /// # Errors
    /// [`UsageError`] if an output is an input or another output, or if a folder for outputs holds
    /// an input. The errors of [`check_output`](psf_io::check_output) for each output.
    pub(crate) fn check(&self) -> anyhow::Result<()> {
        let mut uses = FileUses::default();
        for input in &self.inputs {
            uses.read(input, "an input");
        }
        for output in &self.outputs {
            uses.write(output, "another output").map_err(UsageError)?;
        }
        for folder in &self.folders {
            let place = resolved(folder);
            let held = |input: &&PathBuf| resolved(input).parent() == Some(place.as_path());
            if let Some(input) = self.inputs.iter().find(held) {
                let (folder, input) = (folder.display(), input.display());
                let text = format!("{folder} holds the input {input}: choose another folder for the outputs");
                return Err(UsageError(text).into());
            }
        }
        for output in &self.outputs {
            psf_io::check_output(output, self.overwrite)?;
        }
        Ok(())
    }
}

/// The paths among the values of an argument.
fn paths<T: Clone + Send + Sync + 'static>(
    matches: &ArgMatches,
    arg: &clap::Arg,
    path: impl Fn(&T) -> Option<PathBuf>,
) -> Vec<PathBuf> {
    let values = matches.get_many::<T>(arg.get_id().as_str());
    values.into_iter().flatten().filter_map(path).collect()
}

/// The files that one or more runs read and write, each with a text that says what uses it.
#[derive(Debug, Default)]
pub(crate) struct FileUses(HashMap<FileId, String>);

impl FileUses {
    /// Records a file that is read. A file may be read several times.
    pub(crate) fn read(&mut self, file: &Path, whose: &str) {
        self.0.entry(FileId::of(file)).or_insert_with(|| whose.to_owned());
    }

    /// Records a file that is written. Returns a message if it was recorded before as read or
    /// written.
    pub(crate) fn write(&mut self, file: &Path, whose: &str) -> Result<(), String> {
        match self.0.insert(FileId::of(file), whose.to_owned()) {
            None => Ok(()),
            Some(other) => Err(format!(
                "{} is an output, but also {other}: choose another name for the output",
                file.display()
            )),
        }
    }
}

/// Identifies a file. All paths of a file and all symbolic links to it give equal values. On Unix,
/// hard links do, too.
#[derive(Debug, PartialEq, Eq, Hash)]
enum FileId {
    /// A file that exists: the number of its disk (device), and its number there (inode). Hard
    /// links to a file have equal numbers.
    #[cfg(unix)]
    Number(u64, u64),
    Path(PathBuf),
}

impl FileId {
    fn of(path: &Path) -> Self {
        #[cfg(unix)]
        if let Ok(found) = path.metadata() {
            use std::os::unix::fs::MetadataExt;
            return Self::Number(found.dev(), found.ino());
        }
        Self::Path(resolved(path))
    }
}

/// Returns an absolute path of a file, with symbolic links resolved. The file need not exist.
fn resolved(path: &Path) -> PathBuf {
    if let Ok(place) = path.canonicalize() {
        return place;
    }
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    match (folder.canonicalize(), path.file_name()) {
        (Ok(folder), Some(name)) => folder.join(name),
        _ => std::path::absolute(path).unwrap_or_else(|_| path.to_owned()),
    }
}
