//! Outputs that appear whole or not at all.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::IoError;
use crate::pending_file::{PendingFile, write_failed};

/// Writes a file under a temporary name in its own directory and renames it when it is complete.
///
/// `write` gets the temporary name, where an empty file stands that it may open, truncate or remove. The name ends like
/// `path`, so that libraries which look at the extension do the right thing. When `write` fails, the temporary file is
/// removed and what stood at `path` before is untouched. The content reaches the disk (fsync) before the renaming, so that also a loss
/// of power leaves the old file or the new one. What a process that was killed has left of the same output is removed, unless the file
/// system knows no locks; [`remove_unfinished`](crate::remove_unfinished) is for programs that are told to stop. The new file has the permissions of any new file (umask). A symbolic
/// link is followed: the file it points to is replaced.
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
/// Those of [`check_output`], [`IoError::Write`], and whatever `write` returns.
pub fn write_atomically<R, E: From<IoError>>(
    path: impl AsRef<Path>,
    overwrite: bool,
    write: impl FnOnce(&Path) -> Result<R, E>,
) -> Result<R, E> {
    let file = PendingFile::create(path.as_ref(), overwrite)?;
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
        fs::write(temporary, content).map_err(|source| write_failed(path, source))
    })
}

/// Whether `path` can be written, as far as can be told before the work is done: its directory exists, and it is not there
/// yet, or is a regular file that may be replaced.
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
        Ok(_) => fs::canonicalize(path).map_err(|source| IoError::Write {
            path: owned(),
            source,
        }),
        // A link to nothing counts as a file that exists.
        Err(e) if e.kind() == ErrorKind::NotFound && fs::symlink_metadata(path).is_ok() && !overwrite => {
            Err(IoError::Exists { path: owned() })
        }
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(owned()),
        Err(source) => Err(IoError::Write {
            path: owned(),
            source,
        }),
    }
}

/// The directory of a file; the current one for a bare name.
pub(crate) fn directory_of(path: &Path) -> &Path {
    match path.parent() {
        Some(directory) if !directory.as_os_str().is_empty() => directory,
        _ => Path::new("."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn put(path: &Path, text: &str, overwrite: bool) -> Result<(), IoError> {
        write_atomically(path, overwrite, |at| {
            fs::write(at, text).map_err(|source| IoError::Write {
                path: path.to_owned(),
                source,
            })
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
