//! Output files that appear complete or not at all.

mod lock;
pub(crate) mod temporary;

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

pub use lock::OutputLock;
use temporary::{Entries, Temporary, directory_of, entries};

use crate::error::{IoError, IoErrorKind, unwritable};
use crate::fits::structure::NOT_A_FILE;

/// Writes a file under a temporary name in the directory of the final file, and renames it when it
/// is complete.
///
/// `write` gets the temporary name. An empty file of this name exists already, which `write` may
/// open, truncate or replace. The name ends like `path`, so that libraries which look at the
/// extension choose the right format. When `write` fails, the temporary file is removed and an old
/// file at `path` stays untouched. The content is flushed to the disk (fsync) before the renaming.
/// So a loss of power leaves either the old file or the new one. On Unix, temporary files that
/// killed processes have left in the directory are removed, if the file system supports locks. A
/// program that handles signals should call [`remove_unfinished`](crate::remove_unfinished) before
/// it ends. The new file has the permissions of any new file (umask). A symbolic link to a file is
/// followed: this file is replaced, and the link stays.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("note.json");
/// psf_io::write_atomically(&path, false, |temporary| {
///     std::fs::write(temporary, "{}").map_err(|source| {
///         psf_io::IoError::new(&path, psf_io::IoErrorKind::Write, "cannot write the note").because(source)
///     })
/// })?;
/// let exists = psf_io::write_text(&path, "{}", false).unwrap_err();
/// assert_eq!(exists.kind(), psf_io::IoErrorKind::Exists);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// The errors of [`check_output`], [`IoErrorKind::Write`], and any error that `write` returns.
pub fn write_atomically<R, E: From<IoError>>(
    path: impl AsRef<Path>,
    overwrite: bool,
    write: impl FnOnce(&Path) -> Result<R, E>,
) -> Result<R, E> {
    let (file, ()) = PendingFile::create(path.as_ref(), overwrite, |_| Ok(()))?;
    let result = write(file.temporary())?;
    file.commit()?;
    Ok(result)
}

/// Writes a text file atomically: it appears complete or not at all.
///
/// # Errors
/// The errors of [`write_atomically`].
pub fn write_text(path: impl AsRef<Path>, content: &str, overwrite: bool) -> Result<(), IoError> {
    write_bytes(path, content.as_bytes(), overwrite)
}

/// Writes bytes, such as a picture, to a file, which appears complete or not at all.
///
/// # Errors
/// The errors of [`write_atomically`].
pub fn write_bytes(path: impl AsRef<Path>, content: &[u8], overwrite: bool) -> Result<(), IoError> {
    let path = path.as_ref();
    write_atomically(path, overwrite, |temporary| {
        fs::write(temporary, content).map_err(unwritable(path))
    })
}

thread_local! {
    /// The complete files that wait for the end of [`write_together`], if it runs on this thread.
    static TOGETHER: RefCell<Option<Vec<PendingFile>>> = const { RefCell::new(None) };
}

/// Writes several files that belong together. No file appears before all of them are complete.
///
/// `write` calls functions of this crate that write files. Until `write` returns, files that are
/// complete keep their temporary names. Then all files get their final names, in the order in which
/// they were written. [`remove_unfinished`](crate::remove_unfinished) waits meanwhile. If `write`
/// fails, or if the process ends before `write` returns, no file appears. Files get their names one
/// after the other, so a process that is killed in this moment may leave only the first ones: write
/// the main file last. `write` must not read these files, and must write them on the thread that
/// called `write_together`.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let [image, truth] = ["image.txt", "truth.txt"].map(|name| directory.path().join(name));
/// psf_io::write_together(|| {
///     psf_io::write_text(&truth, "1", false)?;
///     assert!(!truth.exists());
///     psf_io::write_text(&image, "2", false)
/// })?;
/// assert!(image.exists() && truth.exists());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Any error of `write`, and [`IoErrorKind::Write`] or [`IoErrorKind::Exists`] if a file cannot get
/// its final name. Files that already have their final names remain in that case, and the others do
/// not appear.
pub fn write_together<R, E: From<IoError>>(write: impl FnOnce() -> Result<R, E>) -> Result<R, E> {
    /// Ends the group, also after an error or a panic. Files that still wait are removed.
    struct End;
    impl Drop for End {
        fn drop(&mut self) {
            drop(TOGETHER.take());
        }
    }

    // A group inside another one is a part of it.
    if TOGETHER.with_borrow(Option::is_some) {
        return write();
    }
    TOGETHER.set(Some(Vec::new()));
    let end = End;
    let result = write()?;
    let files = TOGETHER.take().unwrap_or_default();
    drop(end);
    PendingFile::rename_all(files)?;
    Ok(result)
}

/// Checks that `path` can be written. Call it before long work.
///
/// Its directory must exist. The file must be new, or a regular file that may be replaced. A write
/// may still fail later, for example because the disk is full.
///
/// # Errors
/// [`IoErrorKind::Request`] for `-` (standard output) or the name of a compressed file (`.gz`,
/// `.fz`, `.bz2`, `.xz`), [`IoErrorKind::NotFound`] if the directory does not exist,
/// [`IoErrorKind::Format`] if `path` is not a regular file, [`IoErrorKind::Exists`] if the file
/// exists and `overwrite` is false, or [`IoErrorKind::Write`] if the system does not tell whether
/// the file exists.
pub fn check_output(path: impl AsRef<Path>, overwrite: bool) -> Result<(), IoError> {
    checked_target(path.as_ref(), overwrite).map(drop)
}

/// Does the checks of [`check_output`]. Returns the file that the output will replace: `path`, or
/// the target of a symbolic link.
pub(crate) fn checked_target(path: &Path, overwrite: bool) -> Result<PathBuf, IoError> {
    if let Some(problem) = unsupported(path) {
        return Err(IoError::new(path, IoErrorKind::Request, problem));
    }
    let not_a_file = || Err(IoError::new(path, IoErrorKind::Format, NOT_A_FILE));
    if path.file_name().is_none() {
        return not_a_file();
    }
    let directory = directory_of(path);
    if !directory.is_dir() {
        let message = format!("there is no directory {}: create it first", directory.display());
        return Err(IoError::new(path, IoErrorKind::NotFound, message));
    }
    match fs::metadata(path) {
        Ok(found) if !found.is_file() => not_a_file(),
        Ok(_) if !overwrite => Err(exists(path)),
        Ok(_) => fs::canonicalize(path).map_err(unwritable(path)),
        // A link whose target does not exist counts as an existing file.
        Err(e) if e.kind() == ErrorKind::NotFound && fs::symlink_metadata(path).is_ok() && !overwrite => {
            Err(exists(path))
        }
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(path.to_owned()),
        Err(source) => Err(unwritable(path)(source)),
    }
}

/// The reason why this crate cannot write a file of this name, if there is one.
fn unsupported(path: &Path) -> Option<String> {
    const COMPRESSORS: [(&str, &str); 4] = [("gz", "gzip"), ("fz", "fpack"), ("bz2", "bzip2"), ("xz", "xz")];
    if path.as_os_str() == "-" {
        return Some("standard output is not supported: give the name of a file".to_owned());
    }
    let ending = path.extension()?;
    let (_, tool) = COMPRESSORS
        .iter()
        .find(|(packed, _)| ending.eq_ignore_ascii_case(packed))?;
    let plain = path.with_extension("");
    Some(format!(
        "compressed files cannot be written: write {} and run {tool} on it",
        plain.display()
    ))
}

fn exists(path: &Path) -> IoError {
    const EXISTS: &str = "the file exists: choose another name, or allow it to be replaced";
    IoError::new(path, IoErrorKind::Exists, EXISTS).with_setting("overwrite")
}

/// An output file that still has a temporary name, in the directory of its final name.
/// [`commit`](Self::commit) gives it the final name. A pending file that is dropped is removed.
#[derive(Debug)]
pub(crate) struct PendingFile {
    temporary: Temporary,
    /// The lock that tells other processes that the file is in use.
    claim: Option<File>,
    /// The path given by the caller, for error messages.
    path: PathBuf,
    /// The file that the output will replace: `path`, or the target of a symbolic link.
    target: PathBuf,
    overwrite: bool,
}

impl PendingFile {
    /// Does the checks of [`check_output`](crate::check_output), creates an empty temporary file
    /// and calls `open`, which may replace that file by another. Returns the pending file and the
    /// result of `open`.
    pub(crate) fn create<R>(
        path: &Path,
        overwrite: bool,
        open: impl FnOnce(&Path) -> Result<R, IoError>,
    ) -> Result<(Self, R), IoError> {
        let target = checked_target(path, overwrite)?;
        temporary::remove_left(&target);
        let mut entries = entries();
        let temporary = temporary::create(&target).map_err(unwritable(path))?;
        let opened = open(&temporary)?;
        let claim = temporary::claim(&temporary);
        let file = Self {
            temporary: Temporary::new(temporary, Some(path), &mut entries),
            claim,
            path: path.to_owned(),
            target,
            overwrite,
        };
        Ok((file, opened))
    }

    /// The temporary name, which ends like the final one.
    pub(crate) fn temporary(&self) -> &Path {
        self.temporary.path()
    }

    /// Flushes the content to the disk and gives the file its final name, at once or at the end of
    /// [`write_together`](crate::write_together).
    pub(crate) fn commit(self) -> Result<(), IoError> {
        // Without the flush a loss of power after the renaming could leave an empty file in the
        // place of the old one. A full disk may be reported only here.
        File::options()
            .write(true)
            .open(self.temporary())
            .and_then(|file| file.sync_all())
            .map_err(unwritable(&self.path))?;
        let alone = TOGETHER.with_borrow_mut(|together| match together {
            Some(files) => {
                files.push(self);
                None
            }
            None => Some(self),
        });
        alone.map_or(Ok(()), |file| Self::rename_all(vec![file]))
    }

    /// Gives files their final names. Nothing else happens between the first name and the last one.
    fn rename_all(files: Vec<Self>) -> Result<(), IoError> {
        let directories: BTreeSet<_> = files
            .iter()
            .map(|file| directory_of(&file.target).to_owned())
            .collect();
        // Dropped after the lock, because a file that is dropped needs it.
        let mut left = files.into_iter();
        let mut entries = entries();
        let renamed = left.by_ref().try_for_each(|file| file.rename(&mut entries));
        drop(entries);
        // After an error, this removes the other files.
        drop(left);
        for directory in &directories {
            sync_directory(directory);
        }
        renamed
    }

    /// Gives the file its final name. If another process has created a file of that name in the
    /// meantime, that file is kept unless `overwrite` is true.
    fn rename(self, entries: &mut Entries) -> Result<(), IoError> {
        let Self {
            temporary,
            claim: _claim,
            path,
            target,
            overwrite,
        } = self;
        let renamed = temporary.rename(entries, |temporary| {
            let renamed = if overwrite {
                temporary.persist(&target)
            } else {
                temporary.persist_noclobber(&target)
            };
            // A file that could not be renamed is removed when `failed` is dropped.
            renamed.map_err(|failed| failed.error)
        });
        renamed.map_err(|e| match e.kind() {
            ErrorKind::AlreadyExists => exists(&path),
            _ => unwritable(&path)(e),
        })
    }
}

/// Flushes the names in a directory to the disk. A failure is ignored: the worst effect of a later
/// loss of power is that the old file is back, which is complete as well.
fn sync_directory(directory: &Path) {
    if cfg!(unix) {
        let _ = File::open(directory).and_then(|directory| directory.sync_all());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn put(path: &Path, text: &str, overwrite: bool) -> Result<(), IoError> {
        write_atomically(path, overwrite, |at| {
            fs::write(at, text).map_err(unwritable(path))
        })
    }

    #[test]
    fn a_failed_write_leaves_everything_as_it_was() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.png");
        put(&path, "old", false).unwrap();
        let failed = write_atomically(&path, true, |at| {
            assert_eq!((at.extension(), at.parent()), (path.extension(), path.parent()));
            fs::write(at, "half").unwrap();
            Err::<(), _>(IoError::new(&path, IoErrorKind::Format, "half"))
        });
        assert!(failed.is_err());
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn temporary_files_of_killed_processes_are_removed() {
        let directory = tempfile::tempdir().unwrap();
        // No process has a number of ten digits.
        let left = directory.path().join(".psfield-9999999999-abcdef-a.png");
        fs::write(&left, "half").unwrap();
        put(&directory.path().join("b.png"), "b", false).unwrap();
        assert!(!left.exists());
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 1);
    }

    #[test]
    fn files_of_one_group_appear_together_or_not_at_all() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        let count = || fs::read_dir(directory.path()).unwrap().count();
        let failed = write_together(|| {
            put(&at("a"), "a", false)?;
            put(Path::new("/"), "b", false)
        });
        assert!(failed.is_err());
        assert_eq!(count(), 0);
        write_together(|| {
            put(&at("a"), "a", false)?;
            write_together(|| put(&at("b"), "b", false))?;
            assert!(!at("a").exists() && !at("b").exists());
            Ok::<(), IoError>(())
        })
        .unwrap();
        assert!(at("a").exists() && at("b").exists());
        put(&at("c"), "c", false).unwrap();
        assert_eq!(count(), 3);
    }

    #[test]
    fn a_file_that_cannot_be_renamed_is_removed() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a");
        let failed = write_atomically(&path, true, |_| {
            fs::create_dir(&path).unwrap();
            Ok::<(), IoError>(())
        });
        assert_eq!(failed.unwrap_err().kind(), IoErrorKind::Write);
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 1);
    }

    #[test]
    fn files_are_replaced_only_when_allowed() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a");
        put(&path, "1", false).unwrap();
        assert_eq!(put(&path, "2", false).unwrap_err().kind(), IoErrorKind::Exists);
        put(&path, "3", true).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "3");
        // A file that another process creates during the work is kept as well.
        let late = directory.path().join("late");
        let result = write_atomically(&late, false, |_| {
            fs::write(&late, "theirs").unwrap();
            Ok::<(), IoError>(())
        });
        assert_eq!(result.unwrap_err().kind(), IoErrorKind::Exists);
        assert_eq!(fs::read_to_string(&late).unwrap(), "theirs");
    }

    #[test]
    fn places_that_cannot_hold_a_file_are_named() {
        let directory = tempfile::tempdir().unwrap();
        let missing = directory.path().join("none").join("a.fits");
        let error = put(&missing, "", false).unwrap_err();
        assert_eq!(error.kind(), IoErrorKind::NotFound);
        let named = format!("there is no directory {}:", missing.parent().unwrap().display());
        assert!(error.to_string().contains(&named), "{error}");
        for bad in [directory.path(), Path::new("/")] {
            let error = put(bad, "", true).unwrap_err();
            assert!(error.to_string().ends_with(NOT_A_FILE), "{error}");
        }
        assert!(check_output("Cargo.toml", false).is_err());
        assert!(check_output("not-there", false).is_ok());
    }

    #[cfg(unix)]
    #[test]
    fn new_files_have_ordinary_permissions_and_links_are_followed() {
        use std::os::unix::fs::PermissionsExt;
        let directory = tempfile::tempdir().unwrap();
        let (ours, plain) = (directory.path().join("ours"), directory.path().join("plain"));
        put(&ours, "", false).unwrap();
        fs::write(&plain, "").unwrap();
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&ours), mode(&plain));

        let link = directory.path().join("link");
        std::os::unix::fs::symlink(&ours, &link).unwrap();
        put(&link, "through", true).unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read_to_string(&ours).unwrap(), "through");
        let error = put(Path::new("/dev/null"), "", true).unwrap_err();
        assert!(error.to_string().ends_with(NOT_A_FILE), "{error}");
    }
}
