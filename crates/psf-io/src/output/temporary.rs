//! The temporary files of outputs. A program that is told to stop can remove the temporary files of
//! its own process. On Unix, the next process that writes in the same folder removes the files of
//! killed processes.
//!
//! A temporary file is called `.psfield-PROCESS-RANDOM-OUTPUT`, where PROCESS is the number of the
//! process that writes it. It lies next to its output. On Unix, this process holds an advisory lock
//! on the file, if the file system has such locks. The system releases the lock when the process
//! ends for any reason, even if it ran on another machine that shares the folder. So an unlocked
//! file is left over from a process that has ended, with one exception: a process locks its file a
//! moment after it has created it. On Linux, psfield can see which processes of its own machine are
//! running. It never removes a file that has the number of such a process, locked or not.
//!
//! The locks of outputs ([`OutputLock`](super::OutputLock)) are temporary files too. Their names
//! are `.psfield-lock-HASH`.
//!
//! Unpacked copies of gzip files are temporary files too. They lie in the system's folder for
//! temporary files and have no lock, so the copy of a killed process stays there.

use std::collections::BTreeSet;
use std::ffi::{OsStr, OsString};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use tempfile::TempPath;

/// The temporary files of this process: the absolute name of each, and the path of its output as
/// the caller gave it. The path is `None` for a lock, and for a temporary copy that is only read.
pub(crate) type Entries = Vec<(PathBuf, Option<PathBuf>)>;

static ENTRIES: Mutex<Entries> = Mutex::new(Vec::new());

/// Locks the list of temporary files. [`remove_unfinished`] needs this lock too, so it waits while
/// a caller holds the guard.
pub(crate) fn entries() -> MutexGuard<'static, Entries> {
    // Each change of the list is a single step, so a panic elsewhere cannot leave it half done.
    ENTRIES.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A temporary file in the list. Dropping this value removes the file from the disk and from the
/// list.
#[derive(Debug)]
pub(crate) struct Temporary {
    /// `Some` until the file is renamed or removed.
    file: Option<TempPath>,
    /// The name of the file in the list.
    absolute: PathBuf,
}

impl Temporary {
    /// Adds a temporary file to the list. The caller must have locked the list before it created
    /// the file.
    pub(crate) fn new(file: TempPath, output: Option<&Path>, entries: &mut Entries) -> Self {
        let absolute = std::path::absolute(&file).unwrap_or_else(|_| file.to_path_buf());
        entries.push((absolute.clone(), output.map(Path::to_owned)));
        let file = Some(file);
        Self { file, absolute }
    }

    pub(crate) fn path(&self) -> &Path {
        self.file.as_ref().expect("the file exists until it is renamed")
    }

    /// Calls `rename`, which gives the file its final name. If `rename` fails, it must remove the
    /// file.
    pub(crate) fn rename<R>(mut self, entries: &mut Entries, rename: impl FnOnce(TempPath) -> R) -> R {
        self.finish(entries, rename)
    }

    /// Gives the file to `end` and removes its entry from the list.
    fn finish<R>(&mut self, entries: &mut Entries, end: impl FnOnce(TempPath) -> R) -> R {
        let ended = end(self.file.take().expect("the file exists until it is renamed"));
        entries.retain(|(absolute, _)| *absolute != self.absolute);
        ended
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        if self.file.is_some() {
            self.finish(&mut entries(), drop);
        }
    }
}

/// Removes the temporary files of this process: outputs that are not finished, locks, and unpacked
/// copies of gzip files. Calls `then` with the names of these outputs.
///
/// This crate installs no signal handlers. A program that is about to end, for example because of
/// Ctrl-C, calls this function from any thread, even while other threads write. While `then` runs,
/// no output is started and none gets its final name. So a program that ends inside `then` leaves
/// each output either as it was or complete. A writer that goes on afterwards fails when it
/// finishes.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("image.fits");
/// use psf_io::{HeaderCards, ImageWriter};
/// let shape = psf_types::FrameShape::new(30, 20)?;
/// let writer = ImageWriter::<f32>::create(&path, shape, &HeaderCards::new(), &[], false)?;
/// assert_eq!(std::fs::read_dir(directory.path())?.count(), 1);
/// psf_io::remove_unfinished(|outputs| assert!(outputs.contains(&path))); // end the program here
/// assert_eq!(std::fs::read_dir(directory.path())?.count(), 0);
/// # drop(writer);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn remove_unfinished<R>(then: impl FnOnce(&[PathBuf]) -> R) -> R {
    let mut entries = entries();
    let mut outputs = Vec::new();
    for (temporary, output) in entries.drain(..) {
        // A file that cannot be removed stays. The next run that writes in the folder tries again.
        let _ = fs::remove_file(temporary);
        outputs.extend(output);
    }
    then(&outputs)
}

const MARK: &str = ".psfield-";
/// The first part of the name of a lock ([`OutputLock`](super::OutputLock)).
pub(crate) const LOCK_MARK: &str = ".psfield-lock-";
/// Number of characters that [`tempfile`] puts between prefix and suffix.
const RANDOM: usize = 6;
/// The longest name of an output, in bytes, that the temporary name repeats. Some file systems
/// allow names of at most 143 bytes.
const LONGEST_REPEATED: usize = 100;

/// The directory of a file, or the current one for a bare name.
pub(crate) fn directory_of(path: &Path) -> &Path {
    match path.parent() {
        Some(directory) if !directory.as_os_str().is_empty() => directory,
        _ => Path::new("."),
    }
}

/// Creates the empty temporary file of an output.
pub(crate) fn create(target: &Path) -> std::io::Result<TempPath> {
    let file = tempfile::Builder::new()
        .prefix(&format!("{MARK}{}-", std::process::id()))
        .rand_bytes(RANDOM)
        .suffix(&suffix(target))
        // `tempfile_in` would create a file that only its owner can read, also after the renaming.
        .make_in(directory_of(target), |at| {
            File::options().write(true).create_new(true).open(at)
        })?;
    Ok(file.into_temp_path())
}

/// The last part of the name of a temporary file: the name of the output. A placeholder with the
/// same extension replaces a name that is too long.
fn suffix(target: &Path) -> OsString {
    let name = target.file_name().unwrap_or_default();
    let mut suffix = OsString::from("-");
    if name.len() <= LONGEST_REPEATED {
        suffix.push(name);
    } else if let Some(extension) = target.extension().filter(|e| e.len() <= LONGEST_REPEATED) {
        suffix.push("long-name.");
        suffix.push(extension);
    }
    suffix
}

/// Locks a new temporary file for as long as the returned handle is open. Returns `None` if the
/// system or the file system has no suitable locks. Without a lock, the temporary file of a killed
/// process is never removed.
pub(crate) fn claim(temporary: &Path) -> Option<File> {
    // CFITSIO opens the file a second time. On systems other than Unix, the lock would keep it from
    // writing.
    if cfg!(unix) {
        let file = File::open(temporary).ok()?;
        file.try_lock_shared().ok()?;
        Some(file)
    } else {
        None
    }
}

/// Removes the temporary files and locks that killed processes have left in the folder of `target`.
/// A file that cannot be removed does no harm.
pub(crate) fn remove_left(target: &Path) {
    /// The folders in which this process has already looked for such files. It looks only once in
    /// each folder, because a folder may hold tens of thousands of files.
    static SEEN: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

    let directory = directory_of(target);
    let Ok(absolute) = std::path::absolute(directory) else {
        return;
    };
    if !cfg!(unix)
        || !SEEN
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .insert(absolute)
    {
        return;
    }
    let names = fs::read_dir(directory).into_iter().flatten().flatten();
    for name in names.map(|entry| entry.file_name()) {
        if is_lock(&name) || process_of(&name).is_some_and(|process| !is_running(process)) {
            remove_if_abandoned(&directory.join(name));
        }
    }
}

fn is_lock(name: &OsStr) -> bool {
    name.as_encoded_bytes().starts_with(LOCK_MARK.as_bytes())
}

/// The number of the process in the name of a temporary file, `.psfield-PROCESS-RANDOM-OUTPUT`.
/// `None` if the name has another form.
fn process_of(name: &OsStr) -> Option<&str> {
    let rest = name.to_str()?.strip_prefix(MARK)?;
    let (process, rest) = rest.split_once('-')?;
    let random = rest.split('-').next()?;
    let is_random = random.len() == RANDOM && random.bytes().all(|c| c.is_ascii_alphanumeric());
    (is_random && !process.is_empty() && process.bytes().all(|c| c.is_ascii_digit())).then_some(process)
}

/// Returns whether a process of this machine has this number. A file of a running process may be in
/// use although it is not locked, because the process locks it a moment after its creation. Without
/// `/proc` (only Linux has it), no process counts as running.
fn is_running(process: &str) -> bool {
    Path::new("/proc").join(process).exists()
}

fn remove_if_abandoned(temporary: &Path) {
    let is_file = fs::symlink_metadata(temporary).is_ok_and(|found| found.is_file());
    if !is_file {
        return;
    }
    // On network file systems an exclusive lock needs a file that is open for writing, and a shared
    // lock needs a file that is open for reading.
    let opened = File::options().read(true).write(true).open(temporary);
    // Another process may have replaced the file after it was opened here.
    if opened.is_ok_and(|file| file.try_lock().is_ok() && is_at(&file, temporary)) {
        let _ = fs::remove_file(temporary);
    }
}

/// Returns whether `path` is the name of an open file.
pub(crate) fn is_at(file: &File, path: &Path) -> bool {
    #[cfg(unix)]
    if let (Ok(open), Ok(found)) = (file.metadata(), fs::metadata(path)) {
        use std::os::unix::fs::MetadataExt;
        return (open.dev(), open.ino()) == (found.dev(), found.ino());
    }
    path.exists()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_tell_the_process() {
        for (name, process) in [
            (".psfield-4711-aB3xYz-image.fits", Some("4711")),
            (".psfield-4711-aB3xYz-my-image.fits", Some("4711")),
            (".psfield-4711-aB3xYz", Some("4711")),
            (".psfield-aB3xYz-image.fits", None),
            (".psfield-4711-aB3-image.fits", None),
            (".psfield--aB3xYz-image.fits", None),
            (".psfield-image.fits", None),
            ("psfield-4711-aB3xYz-image.fits", None),
        ] {
            assert_eq!(process_of(OsStr::new(name)), process, "{name}");
        }
        let long = PathBuf::from("n".repeat(200) + ".fits");
        assert_eq!(suffix(&long), "-long-name.fits");
    }

    #[cfg(unix)]
    #[test]
    fn only_abandoned_files_are_removed() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        // No process has a number of ten digits.
        let running = format!(".psfield-{}-abcdef-a.fits", std::process::id());
        let names = [
            ".psfield-9999999999-abcdef-a.fits",
            ".psfield-9999999999-ghijkl-a.fits",
            ".psfield-9999999999-abcdef-b.fits",
            ".psfield-lock-0123",
            &running,
            "a.fits",
        ];
        for name in names {
            fs::write(at(name), "half").unwrap();
        }
        let held = claim(&at(names[1])).unwrap();
        remove_left(&at("a.fits"));
        let left = names.map(|name| at(name).exists());
        let expected = [false, true, false, false, cfg!(target_os = "linux"), true];
        assert_eq!(left, expected);
        drop(held);
    }
}
