//! A file that is being written and does not yet stand under its name.

use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::atomic::{checked_target, directory_of};
use crate::unfinished::{Temporary, entries};
use crate::{IoError, leftovers};

/// A file under a temporary name in its own directory: [`commit`](Self::commit) renames it, dropping it removes it.
#[derive(Debug)]
pub(crate) struct PendingFile {
    temporary: Temporary,
    /// Tells other processes that the file is not abandoned.
    claim: Option<File>,
    /// As the caller named it, for error messages.
    path: PathBuf,
    /// What is replaced in the end: `path`, or what it links to.
    target: PathBuf,
    overwrite: bool,
}

impl PendingFile {
    /// Creates the temporary file, empty, after the checks of [`check_output`](crate::check_output).
    pub(crate) fn create(path: &Path, overwrite: bool) -> Result<Self, IoError> {
        Ok(Self::create_with(path, overwrite, |_| Ok(()))?.0)
    }

    /// The same, with what `open` makes of it, which may replace the empty file by another.
    pub(crate) fn create_with<R>(
        path: &Path,
        overwrite: bool,
        open: impl FnOnce(&Path) -> Result<R, IoError>,
    ) -> Result<(Self, R), IoError> {
        let target = checked_target(path, overwrite)?;
        leftovers::remove(&target);
        let mut entries = entries();
        let temporary = tempfile::Builder::new()
            .prefix(&leftovers::prefix())
            .rand_bytes(leftovers::RANDOM)
            .suffix(&leftovers::suffix(&target))
            // Not `tempfile_in`: its files can be read by their owner alone, and stay so after the renaming.
            .make_in(directory_of(&target), |at| {
                File::options().write(true).create_new(true).open(at)
            })
            .map_err(|source| write_failed(path, source))?
            .into_temp_path();
        let opened = open(&temporary)?;
        let claim = leftovers::claim(&temporary);
        let file = Self {
            temporary: entries.keep(temporary, Some(path)),
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

    /// Gives the file its name, once its content is on the disk. One that has appeared there in the meantime is kept, unless it may be
    /// replaced.
    pub(crate) fn commit(self) -> Result<(), IoError> {
        let Self {
            temporary,
            claim,
            path,
            target,
            overwrite,
        } = self;
        // Else a loss of power after the renaming could leave an empty file where the old one was. A disk that fills up may say so only
        // here.
        File::options()
            .write(true)
            .open(temporary.path())
            .and_then(|file| file.sync_all())
            .map_err(|source| write_failed(&path, source))?;
        let renamed = temporary.rename(|temporary| {
            let renamed = if overwrite {
                temporary.persist(&target)
            } else {
                temporary.persist_noclobber(&target)
            };
            // What could not be renamed is removed here.
            renamed.map_err(|failed| failed.error)
        });
        drop(claim);
        match renamed {
            Ok(()) => {
                sync_directory(directory_of(&target));
                Ok(())
            }
            Err(e) if e.kind() == ErrorKind::AlreadyExists => Err(IoError::Exists { path }),
            Err(e) => Err(write_failed(&path, e)),
        }
    }
}

/// Writes the names in a directory to the disk. Where it cannot be done, a loss of power may bring the old file back: whole as well, so
/// that it is no error.
fn sync_directory(directory: &Path) {
    if cfg!(unix) {
        let _ = File::open(directory).and_then(|directory| directory.sync_all());
    }
}

pub(crate) fn write_failed(path: &Path, source: std::io::Error) -> IoError {
    IoError::Write {
        path: path.to_owned(),
        source,
    }
}
