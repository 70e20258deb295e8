//! One case: bytes as a file.

use std::path::{Path, PathBuf};

use psf_io::IoError;

use crate::limits::within_limits;
use crate::support::{chain, names};

/// A file in memory if the system supports it, else in the folder for temporary files. It is
/// removed when the case succeeds.
pub(super) struct Case {
    path: PathBuf,
    reads: usize,
}

impl Case {
    pub(super) fn new(target: &str, data: &[u8]) -> Self {
        let memory = Path::new("/dev/shm");
        let folder = if memory.is_dir() {
            memory.to_owned()
        } else {
            std::env::temp_dir()
        };
        let path = folder.join(format!("psfield-fuzz-{target}-{}", std::process::id()));
        std::fs::write(&path, data).expect("a temporary file can be written");
        Self { path, reads: 0 }
    }

    /// Reads the file within the limits. An error must name the file.
    pub(super) fn read<T>(&mut self, read: impl FnOnce(&Path) -> Result<T, IoError>) -> Option<T> {
        match within_limits(|| read(&self.path)) {
            Ok(value) => {
                self.reads += 1;
                Some(value)
            }
            Err(error) => {
                assert!(
                    names(&error, &self.path),
                    "the error does not name the file: {error}"
                );
                assert!(!chain(&error).is_empty());
                None
            }
        }
    }

    /// Checks that a value written to a file is read back unchanged.
    pub(super) fn comes_back<T: PartialEq>(
        &self,
        value: &T,
        write: impl FnOnce(&Path, &T) -> Result<(), IoError>,
        read: impl FnOnce(&Path) -> Result<T, IoError>,
    ) {
        let path = self.path.with_extension("again");
        let again = write(&path, value).and_then(|()| read(&path));
        std::fs::remove_file(&path).ok();
        match again {
            Ok(again) => assert!(again == *value, "the data read back differ from the data written"),
            Err(error) => panic!(
                "data that were read cannot be written and read again: {}",
                chain(&error)
            ),
        }
    }

    /// The number of reads that succeeded.
    pub(super) fn reads(self) -> usize {
        self.reads
    }
}

impl Drop for Case {
    fn drop(&mut self) {
        std::fs::remove_file(&self.path).ok();
    }
}
