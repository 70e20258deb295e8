//! The files that a command reads and writes: which arguments name them, and the check that no
//! output replaces an input or another output.

use std::any::TypeId;
use std::collections::HashMap;
use std::ffi::OsString;
use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::ArgMatches;
use psfield::WingsSource;
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

/// The use of a file that an argument names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Use {
    Input,
    Output,
    /// A folder in which outputs are written.
    Folder,
}

/// A type of arguments that name a file. Each such type is in [`FileType::ALL`], which decides how its files
/// are protected, and where a relative path in a file of settings begins.
trait NamesFile: Clone + Send + Sync + 'static {
    const USE: Use;

    /// The files that the argument names.
    fn files(&self) -> Vec<PathBuf>;

    /// The text of the argument, with its file in a folder if its path is relative.
    fn within(folder: &Path, text: &str) -> OsString {
        folder.join(text).into_os_string()
    }
}

/// A type of arguments that name a file.
pub(crate) struct FileType {
    type_id: fn() -> TypeId,
    pub(crate) used: Use,
    files: fn(&ArgMatches, &clap::Arg) -> Vec<PathBuf>,
    pub(crate) within: fn(&Path, &str) -> OsString,
}

impl FileType {
    const ALL: [Self; 8] = [
        Self::of::<PathBuf>(),
        Self::of::<OutputFile>(),
        Self::of::<OutputFolder>(),
        Self::of::<JsonTo>(),
        Self::of::<BandpassName>(),
        Self::of::<SpectrumName>(),
        Self::of::<Layer>(),
        Self::of::<WingsSource>(),
    ];

    const fn of<T: NamesFile>() -> Self {
        Self {
            type_id: TypeId::of::<T>,
            used: T::USE,
            files: files_of::<T>,
            within: T::within,
        }
    }

    /// The type of an argument that names files. `None` for any other argument.
    pub(crate) fn of_argument(arg: &clap::Arg) -> Option<&'static Self> {
        let id = arg.get_value_parser().type_id();
        Self::ALL.iter().find(|known| id == (known.type_id)())
    }
}

/// The files among the values of an argument.
fn files_of<T: NamesFile>(matches: &ArgMatches, arg: &clap::Arg) -> Vec<PathBuf> {
    let values = matches.get_many::<T>(arg.get_id().as_str());
    values.into_iter().flatten().flat_map(NamesFile::files).collect()
}

/// A file to read, or the log of a batch.
impl NamesFile for PathBuf {
    const USE: Use = Use::Input;
    fn files(&self) -> Vec<PathBuf> {
        vec![self.clone()]
    }
}

impl<const IS_FOLDER: bool> NamesFile for OutputPath<IS_FOLDER> {
    const USE: Use = if IS_FOLDER { Use::Folder } else { Use::Output };
    fn files(&self) -> Vec<PathBuf> {
        vec![self.0.clone()]
    }
}

impl NamesFile for JsonTo {
    const USE: Use = Use::Output;
    fn files(&self) -> Vec<PathBuf> {
        self.file().map(Path::to_owned).into_iter().collect()
    }
}

impl NamesFile for BandpassName {
    const USE: Use = Use::Input;
    fn files(&self) -> Vec<PathBuf> {
        vec![psfield::colours::bandpass_file(&self.0).into()]
    }
}

impl NamesFile for SpectrumName {
    const USE: Use = Use::Input;
    fn files(&self) -> Vec<PathBuf> {
        psfield::colours::spectrum_file(&self.0)
            .map(PathBuf::from)
            .into_iter()
            .collect()
    }
    fn within(folder: &Path, text: &str) -> OsString {
        psfield::colours::spectrum_in(folder, text).into()
    }
}

impl NamesFile for WingsSource {
    const USE: Use = Use::Input;
    fn files(&self) -> Vec<PathBuf> {
        match self {
            Self::File(path) => vec![path.clone()],
            _ => Vec::new(),
        }
    }
    fn within(folder: &Path, text: &str) -> OsString {
        match text.parse() {
            Ok(Self::File(path)) => folder.join(path).into(),
            _ => text.into(),
        }
    }
}

impl NamesFile for Layer {
    const USE: Use = Use::Input;
    fn files(&self) -> Vec<PathBuf> {
        let spectrum = psfield::colours::spectrum_file(&self.spectrum).map(PathBuf::from);
        std::iter::once(self.image.clone()).chain(spectrum).collect()
    }
    fn within(folder: &Path, text: &str) -> OsString {
        let Ok(layer) = text.parse::<Self>() else {
            return text.into();
        };
        let mut within = folder.join(layer.image).into_os_string();
        within.push(SPECTRUM_OF_LAYER);
        within.push(psfield::colours::spectrum_in(folder, &layer.spectrum));
        within
    }
}

/// The name of a bandpass: a file, and perhaps a unit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct BandpassName(pub(crate) String);

/// The name of a spectrum, which may be a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct SpectrumName(pub(crate) String);

/// An image and its spectrum.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Layer {
    pub(crate) image: PathBuf,
    pub(crate) spectrum: String,
}

const SPECTRUM_OF_LAYER: &str = ":sed=";

impl FromStr for Layer {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once(SPECTRUM_OF_LAYER) {
            Some((image, spectrum)) if !image.is_empty() && !spectrum.is_empty() => Ok(Self {
                image: image.into(),
                spectrum: spectrum.to_owned(),
            }),
            _ => Err("an image and its spectrum are needed, as in red.fits:sed=blackbody:4000".to_owned()),
        }
    }
}

/// An argument that names a file to write, or a folder to write files in.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(transparent)]
pub(crate) struct OutputPath<const IS_FOLDER: bool>(PathBuf);

pub(crate) type OutputFile = OutputPath<false>;
pub(crate) type OutputFolder = OutputPath<true>;

impl<const IS_FOLDER: bool> From<OsString> for OutputPath<IS_FOLDER> {
    fn from(path: OsString) -> Self {
        Self(path.into())
    }
}

impl<const IS_FOLDER: bool> Deref for OutputPath<IS_FOLDER> {
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
            let Some(file_type) = FileType::of_argument(arg) else {
                continue;
            };
            let files = (file_type.files)(matches, arg);
            if files.iter().any(|path| path.as_os_str().is_empty()) {
                return Err(UsageError(format!("{arg}: the name is empty")));
            }
            let list = match file_type.used {
                Use::Input => &mut named.inputs,
                Use::Output => &mut named.outputs,
                Use::Folder => &mut named.folders,
            };
            list.extend(files);
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

#[cfg(test)]
mod tests {
    use std::any::TypeId;

    use clap::CommandFactory;

    use super::*;

    /// Options whose texts never name a file, by name. Every option whose value is neither a number, nor a
    /// choice, nor of a type that names files must be here. (`--set` of a batch names an option, which is
    /// checked as that option.)
    const WITHOUT_FILES: &[&str] = &[
        "start",
        "uniform",
        "extension",
        "registration",
        "rank",
        "centring",
        "interpolation",
        "outside",
        "normalise",
        "psf_extension",
        "psf_context",
        "psf_order",
        "field_centre",
        "psf_centre",
        "to",
        "grid",
        "columns",
        "date",
        "table",
        "shape",
        "scene_pixels",
        "frame",
        "dispersion",
        "tolerance_on",
        "floor",
        "shoot_below",
        "method",
        "anchor",
        "gpu_adapter",
        "set",
        "percentile",
        "range",
        "reference_extension",
        "real",
        "sizes",
        "grids",
        "patches",
        "ranks",
        "repeat",
    ];

    fn commands() -> Vec<clap::Command> {
        let mut all = crate::Cli::command();
        all.build();
        all.get_subcommands().cloned().collect()
    }

    fn is_number(arg: &clap::Arg) -> bool {
        let id = arg.get_value_parser().type_id();
        let numbers = [
            TypeId::of::<bool>(),
            TypeId::of::<u8>(),
            TypeId::of::<u16>(),
            TypeId::of::<u32>(),
            TypeId::of::<u64>(),
            TypeId::of::<usize>(),
            TypeId::of::<f64>(),
        ];
        numbers.iter().any(|number| id == *number)
    }

    /// A new option cannot escape the protection of files.
    #[test]
    fn every_option_names_files_or_none() {
        let (mut unknown, mut known) = (Vec::new(), Vec::new());
        for command in commands() {
            for arg in command.get_arguments() {
                let name = arg.get_id().to_string();
                let is_choice = !arg.get_possible_values().is_empty();
                if ["help", "version"].contains(&name.as_str()) || is_choice || is_number(arg) {
                    continue;
                }
                match (FileType::of_argument(arg), WITHOUT_FILES.contains(&name.as_str())) {
                    (None, true) => known.push(name),
                    (Some(_), false) => {}
                    _ => unknown.push(format!("{} {name}", command.get_name())),
                }
            }
        }
        assert!(unknown.is_empty(), "do these options name files? {unknown:?}");
        let unused = WITHOUT_FILES
            .iter()
            .find(|name| !known.contains(&(**name).to_owned()));
        assert_eq!(unused, None);
    }

    /// Each option that names files is protected as an input or as an output, and begins in a given folder
    /// if it stands in a file of settings.
    #[test]
    fn every_option_with_files_is_collected() {
        let texts: [(FileType, &str, &[&str]); 8] = [
            (FileType::of::<PathBuf>(), "a.fits", &["a.fits"]),
            (FileType::of::<OutputFile>(), "a.fits", &["a.fits"]),
            (FileType::of::<OutputFolder>(), "a.fits", &["a.fits"]),
            (FileType::of::<JsonTo>(), "a.fits", &["a.fits"]),
            (FileType::of::<BandpassName>(), "a.fits:nm", &["a.fits"]),
            (FileType::of::<WingsSource>(), "a.fits", &["a.fits"]),
            (
                FileType::of::<SpectrumName>(),
                "a.fits:nm:photons@z=1",
                &["a.fits"],
            ),
            (
                FileType::of::<Layer>(),
                "a.fits:sed=b.csv@z=1",
                &["a.fits", "b.csv"],
            ),
        ];
        let mut seen = 0;
        for command in commands() {
            for arg in command.get_arguments() {
                let Some(file_type) = FileType::of_argument(arg) else {
                    continue;
                };
                let id = arg.get_value_parser().type_id();
                let (_, text, files) = texts
                    .iter()
                    .find(|(known, ..)| id == (known.type_id)())
                    .expect("every type of files has a text here");
                let within = (file_type.within)(Path::new("folder"), text);
                for (text, folder) in [(OsString::from(text), ""), (within, "folder")] {
                    let alone = clap::Command::new("alone").no_binary_name(true).arg(lonely(arg));
                    let Ok(matches) = alone.clone().try_get_matches_from([text]) else {
                        // A flag such as --json, or a file with a fixed ending.
                        continue;
                    };
                    let named = NamedFiles::of(&alone, &matches).unwrap();
                    let found = [&named.inputs, &named.outputs, &named.folders].map(Vec::as_slice);
                    let expected: Vec<PathBuf> =
                        files.iter().map(|file| Path::new(folder).join(file)).collect();
                    assert_eq!(
                        found.concat(),
                        expected,
                        "{} {}",
                        command.get_name(),
                        arg.get_id()
                    );
                    seen += 1;
                }
            }
        }
        assert!(seen > 60, "{seen}");
    }

    /// The argument, without the others that it needs, as a positional one.
    fn lonely(arg: &clap::Arg) -> clap::Arg {
        clap::Arg::new(arg.get_id().clone())
            .index(1)
            .value_parser(arg.get_value_parser().clone())
    }
}
