//! Outputs that appear whole or not at all.

pub(crate) mod temporary;

use std::fs::{self, File};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use temporary::{Temporary, directory_of, entries};

use crate::error::{IoError, unwritable};

/// Writes a file under a temporary name in its own directory and renames it when it is complete.
///
/// `write` gets the temporary name, where an empty file stands that it may open, truncate or
/// remove. The name ends like `path`, so that libraries which look at the extension do the right
/// thing. When `write` fails, the temporary file is removed and what stood at `path` before is
/// untouched. The content reaches the disk (fsync) before the renaming, so that also a loss of
/// power leaves the old file or the new one. Leftovers of the same output from a process that was
/// killed are removed, unless the file system knows no locks;
/// [`remove_unfinished`](crate::remove_unfinished) is for programs that are told to stop. The new
/// file has the permissions of any new file (umask). A symbolic link is followed: the file it
/// points to is replaced.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("note.json");
/// psf_io::write_atomically(&path, false, |temporary| {
///     std::fs::write(temporary, "{}").map_err(|source| psf_io::IoError::Write { path: path.clone(), source })
/// })?;
/// assert!(psf_io::write_atomically(&path, false, |_| Ok::<(), psf_io::IoError>(())).is_err()); // it exists
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// The errors of [`check_output`], [`IoError::Write`], and whatever `write` returns.
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

/// Writes a text file, whole or not at all.
///
/// # Errors
/// As [`write_atomically`].
pub fn write_text(path: impl AsRef<Path>, content: &str, overwrite: bool) -> Result<(), IoError> {
    write_bytes(path, content.as_bytes(), overwrite)
}

/// Writes a file of any bytes, such as a picture, whole or not at all.
///
/// # Errors
/// As [`write_atomically`].
pub fn write_bytes(path: impl AsRef<Path>, content: &[u8], overwrite: bool) -> Result<(), IoError> {
    let path = path.as_ref();
    write_atomically(path, overwrite, |temporary| {
        fs::write(temporary, content).map_err(unwritable(path))
    })
}

/// Whether `path` can be written, as far as can be told before the work is done: its directory
/// exists, and it is not there yet, or is a regular file that may be replaced.
///
/// # Errors
/// [`IoError::MissingDirectory`], [`IoError::NotAFile`], [`IoError::Exists`] or [`IoError::Write`].
pub fn check_output(path: impl AsRef<Path>, overwrite: bool) -> Result<(), IoError> {
    checked_target(path.as_ref(), overwrite).map(drop)
}

/// The file that is written in the end: `path`, or what it links to.
pub(crate) fn checked_target(path: &Path, overwrite: bool) -> Result<PathBuf, IoError> {
    let owned = || path.to_owned();
    if path.file_name().is_none() {
        return Err(IoError::NotAFile { path: owned() });
    }
    let directory = directory_of(path);
    if !directory.is_dir() {
        return Err(IoError::MissingDirectory {
            path: owned(),
            directory: directory.to_owned(),
        });
    }
    match fs::metadata(path) {
        Ok(found) if !found.is_file() => Err(IoError::NotAFile { path: owned() }),
        Ok(_) if !overwrite => Err(IoError::Exists { path: owned() }),
        Ok(_) => fs::canonicalize(path).map_err(unwritable(path)),
        // A link to nothing counts as a file that exists.
        Err(e) if e.kind() == ErrorKind::NotFound && fs::symlink_metadata(path).is_ok() && !overwrite => {
            Err(IoError::Exists { path: owned() })
        }
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(owned()),
        Err(source) => Err(unwritable(path)(source)),
    }
}

/// A file under a temporary name in its own directory: [`commit`](Self::commit) renames it,
/// dropping it removes it.
#[derive(Debug)]
pub(crate) struct PendingFile {
    temporary: Temporary,
    /// Tells other processes that the file is not abandoned.
    claim: Option<File>,
    /// As the caller named it, for error messages.
    path: PathBuf,
    /// The file that is replaced in the end: `path`, or the file that it links to.
    target: PathBuf,
    overwrite: bool,
}

impl PendingFile {
    /// Creates the temporary file, empty, after the checks of
    /// [`check_output`](crate::check_output), and returns it with the result of `open`, which may
    /// replace the empty file by another.
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

    /// The temporary name. It ends like the final one.
    pub(crate) fn temporary(&self) -> &Path {
        self.temporary.path()
    }

    /// Gives the file its name, once its content is on the disk. One that has appeared there in the
    /// meantime is kept, unless it may be replaced.
    pub(crate) fn commit(self) -> Result<(), IoError> {
        let Self {
            temporary,
            claim,
            path,
            target,
            overwrite,
        } = self;
        // Else a loss of power after the renaming could leave an empty file where the old one was.
        // A disk that fills up may say so only here.
        File::options()
            .write(true)
            .open(temporary.path())
            .and_then(|file| file.sync_all())
            .map_err(unwritable(&path))?;
        let renamed = temporary.rename(|temporary| {
            let renamed = if overwrite {
                temporary.persist(&target)
            } else {
                temporary.persist_noclobber(&target)
            };
            // A file that could not be renamed is removed here.
            renamed.map_err(|failed| failed.error)
        });
        drop(claim);
        match renamed {
            Ok(()) => {
                sync_directory(directory_of(&target));
                Ok(())
            }
            Err(e) if e.kind() == ErrorKind::AlreadyExists => Err(IoError::Exists { path }),
            Err(e) => Err(unwritable(&path)(e)),
        }
    }
}

/// Writes the names in a directory to the disk. Where it cannot be done, a loss of power may bring
/// the old file back: whole as well, so that it is no error.
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
            Err::<(), _>(IoError::NotFits { path: path.clone() })
        });
        assert!(failed.is_err());
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn what_a_killed_process_has_left_goes() {
        let directory = tempfile::tempdir().unwrap();
        let left = directory.path().join(".psfield-99-abcdef-a.png");
        fs::write(&left, "half").unwrap();
        put(&directory.path().join("b.png"), "b", false).unwrap();
        assert!(left.exists());
        put(&directory.path().join("a.png"), "a", false).unwrap();
        assert!(!left.exists());
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 2);
    }

    #[test]
    fn what_cannot_be_renamed_goes() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a");
        let failed = write_atomically(&path, true, |_| {
            fs::create_dir(&path).unwrap();
            Ok::<(), IoError>(())
        });
        assert!(matches!(failed, Err(IoError::Write { .. })));
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 1);
    }

    #[test]
    fn files_are_replaced_only_when_allowed() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a");
        put(&path, "1", false).unwrap();
        assert!(matches!(put(&path, "2", false), Err(IoError::Exists { .. })));
        put(&path, "3", true).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "3");
        // One that appears while the work is done is kept as well.
        let late = directory.path().join("late");
        let result = write_atomically(&late, false, |_| {
            fs::write(&late, "theirs").unwrap();
            Ok::<(), IoError>(())
        });
        assert!(matches!(result, Err(IoError::Exists { .. })));
        assert_eq!(fs::read_to_string(&late).unwrap(), "theirs");
    }

    #[test]
    fn places_that_cannot_hold_a_file_are_named() {
        let directory = tempfile::tempdir().unwrap();
        let missing = directory.path().join("none").join("a.fits");
        match put(&missing, "", false) {
            Err(IoError::MissingDirectory { directory: named, .. }) => {
                assert_eq!(Some(&*named), missing.parent());
            }
            other => panic!("{other:?}"),
        }
        assert!(matches!(
            put(directory.path(), "", true),
            Err(IoError::NotAFile { .. })
        ));
        assert!(matches!(
            put(Path::new("/"), "", true),
            Err(IoError::NotAFile { .. })
        ));
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
        assert!(matches!(
            put(Path::new("/dev/null"), "", true),
            Err(IoError::NotAFile { .. })
        ));
    }
}
