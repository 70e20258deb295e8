//! The files that are being written, so that a program that is told to stop can remove them.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use tempfile::TempPath;

/// A temporary file of this process.
#[derive(Debug)]
struct Entry {
    number: u64,
    /// Absolute.
    temporary: PathBuf,
    /// What it will be, as the caller named it; none for a copy that is only read.
    output: Option<PathBuf>,
}

/// All temporary files of this process.
#[derive(Debug)]
pub(crate) struct Entries {
    list: Vec<Entry>,
    next: u64,
}

static ENTRIES: Mutex<Entries> = Mutex::new(Entries {
    list: Vec::new(),
    next: 0,
});

/// The list, locked: what is done while it is held is done before or after [`remove_unfinished`], never meanwhile.
pub(crate) fn entries() -> MutexGuard<'static, Entries> {
    // Every change of the list is a single step, which a panic elsewhere cannot leave undone.
    ENTRIES.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Entries {
    /// Takes a temporary file that has just been created, under this lock, into the list.
    pub(crate) fn keep(&mut self, temporary: TempPath, output: Option<&Path>) -> Temporary {
        let number = self.next;
        self.next += 1;
        self.list.push(Entry {
            number,
            temporary: std::path::absolute(&temporary).unwrap_or_else(|_| temporary.to_path_buf()),
            output: output.map(Path::to_owned),
        });
        Temporary {
            file: Some(temporary),
            number,
        }
    }

    fn forget(&mut self, number: u64) {
        self.list.retain(|entry| entry.number != number);
    }
}

/// A temporary file in the list: removed from the disk and from the list when it is dropped.
#[derive(Debug)]
pub(crate) struct Temporary {
    /// Always there until it is dropped or renamed.
    file: Option<TempPath>,
    number: u64,
}

impl Temporary {
    pub(crate) fn path(&self) -> &Path {
        self.file.as_ref().expect("there until it is renamed")
    }

    /// Lets `rename` give the file its name; one that fails has removed it.
    pub(crate) fn rename<R>(mut self, rename: impl FnOnce(TempPath) -> R) -> R {
        let mut entries = entries();
        let renamed = rename(self.file.take().expect("there until it is renamed"));
        entries.forget(self.number);
        drop(entries);
        std::mem::forget(self);
        renamed
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        let mut entries = entries();
        drop(self.file.take());
        entries.forget(self.number);
    }
}

/// Removes the temporary files of all outputs that this process has not finished, and calls `then` with the names of the outputs.
///
/// For a program that is about to end because it was told to, such as by Ctrl-C: this crate installs no signal handlers. It may be called
/// from any thread, also while others write. While `then` runs no output is begun and none gets its name, so that a program which ends
/// there leaves each output as it was or whole. Writers that go on afterwards fail when they finish.
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
    for entry in entries.list.drain(..) {
        // Nothing can be done about one that stays; the next run that writes the same output tries again.
        let _ = std::fs::remove_file(&entry.temporary);
        outputs.extend(entry.output);
    }
    then(&outputs)
}
