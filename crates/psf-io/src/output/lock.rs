//! Locks on outputs, for programs that share a list of work.

use std::fs::{File, TryLockError};
use std::hash::Hasher as _;
use std::path::Path;
use std::thread::sleep;
use std::time::Duration;

use tempfile::TempPath;

use super::checked_target;
use super::temporary::{LOCK_MARK, Temporary, directory_of, entries, is_at};
use crate::error::{IoError, unwritable};

/// A lock on an output file, from before the work until the file is written. Other processes that
/// try to lock the output learn that it is in progress. The system releases the lock when the
/// process ends for any reason.
///
/// The lock is an empty hidden file next to the output. Dropping this value removes the file.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("image.fits");
/// use psf_io::OutputLock;
/// let lock = OutputLock::acquire(&path)?;
/// assert!(lock.is_some());
/// assert!(OutputLock::acquire(&path)?.is_none());
/// drop(lock);
/// assert!(OutputLock::acquire(&path)?.is_some());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct OutputLock {
    // Fields are dropped in this order, so the file is removed before it is unlocked.
    _temporary: Temporary,
    _locked: File,
}

/// Number of times that a locked file is tried again. A process that removes the files of killed
/// processes holds such a lock for a moment.
const ATTEMPTS: usize = 5;
const PAUSE: Duration = Duration::from_millis(20);

impl OutputLock {
    /// Locks an output, which need not exist. Returns `None` if another lock on it exists. On a
    /// file system without locks, no other lock is noticed.
    ///
    /// # Errors
    /// The errors of [`check_output`](crate::check_output) with `overwrite` true, and
    /// [`IoErrorKind::Write`](crate::IoErrorKind::Write) if the file of the lock cannot be created.
    pub fn acquire(output: impl AsRef<Path>) -> Result<Option<Self>, IoError> {
        let output = output.as_ref();
        let target = checked_target(output, true)?;
        // The hash FNV-1a is the same on all machines and in all releases.
        let mut hasher = fnv::FnvHasher::default();
        hasher.write(target.file_name().unwrap_or_default().as_encoded_bytes());
        let path = directory_of(&target).join(format!("{LOCK_MARK}{:016x}", hasher.finish()));
        for attempt in 0.. {
            let mut entries = entries();
            let options = File::options()
                .read(true)
                .write(true)
                .create(true)
                .truncate(false)
                .open(&path);
            let file = options.map_err(unwritable(output))?;
            match file.try_lock() {
                Err(TryLockError::WouldBlock) if attempt >= ATTEMPTS => break,
                Err(TryLockError::WouldBlock) => {
                    drop(entries);
                    sleep(PAUSE);
                }
                // Another process may have removed the file after it was opened here.
                Ok(()) if !is_at(&file, &path) => {}
                Ok(()) | Err(TryLockError::Error(_)) => {
                    let file_name = TempPath::try_from_path(&path).map_err(unwritable(output))?;
                    return Ok(Some(Self {
                        _temporary: Temporary::new(file_name, None, &mut entries),
                        _locked: file,
                    }));
                }
            }
        }
        Ok(None)
    }
}
