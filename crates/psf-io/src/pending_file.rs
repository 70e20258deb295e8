//! A file that is being written and does not yet stand under its name.

use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use tempfile::TempPath;

use crate::IoError;
use crate::atomic::{checked_target, directory_of};

/// A file under a temporary name in its own directory: [`commit`](Self::commit) renames it, dropping it removes it.
#[derive(Debug)]
pub(crate) struct PendingFile {
    temporary: TempPath,
    /// As the caller named it, for error messages.
    path: PathBuf,
    /// What is replaced in the end: `path`, or what it links to.
    target: PathBuf,
    overwrite: bool,
}

impl PendingFile {
    /// Creates the temporary file, empty, after the checks of [`check_output`](crate::check_output).
    pub(crate) fn create(path: &Path, overwrite: bool) -> Result<Self, IoError> {
        let target = checked_target(path, overwrite)?;
        let suffix = target.extension().map_or_else(Default::default, |extension| {
            let mut suffix = std::ffi::OsString::from(".");
            suffix.push(extension);
            suffix
        });
        let temporary = tempfile::Builder::new()
            .prefix(".psfield-")
            .suffix(&suffix)
            // Not `tempfile_in`: its files can be read by their owner alone, and stay so after the renaming.
            .make_in(directory_of(&target), |at| {
                File::options().write(true).create_new(true).open(at)
            })
            .map_err(|source| write_failed(path, source))?
            .into_temp_path();
        Ok(Self {
            temporary,
            path: path.to_owned(),
            target,
            overwrite,
        })
    }

    /// The temporary name. It ends like the final one.
    pub(crate) fn temporary(&self) -> &Path {
        &self.temporary
    }

    /// Gives the file its name. One that has appeared there in the meantime is kept, unless it may be replaced.
    pub(crate) fn commit(self) -> Result<(), IoError> {
        let Self {
            temporary,
            path,
            target,
            overwrite,
        } = self;
        let renamed = if overwrite {
            temporary.persist(&target)
        } else {
            temporary.persist_noclobber(&target)
        };
        match renamed {
            Ok(()) => Ok(()),
            Err(e) if e.error.kind() == ErrorKind::AlreadyExists => Err(IoError::Exists { path }),
            Err(e) => Err(write_failed(&path, e.error)),
        }
    }
}

fn write_failed(path: &Path, source: std::io::Error) -> IoError {
    IoError::Write {
        path: path.to_owned(),
        source,
    }
}
