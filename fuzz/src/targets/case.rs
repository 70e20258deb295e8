//! Bytes as a file.

use std::path::{Path, PathBuf};

use psf_io::IoError;

use crate::limits::within_limits;
use crate::support::{chain, names};

/// A file in memory where the system has such files, else in the folder for temporary ones. It goes when the case has gone well.
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

    /// Reads the file within the limits. A refusal must name the file.
    pub(super) fn read<T>(&mut self, read: impl FnOnce(&Path) -> Result<T, IoError>) -> Option<T> {
        match within_limits(|| read(&self.path)) {
            Ok(value) => {
                self.reads += 1;
                Some(value)
            }
            Err(error) => {
                assert!(names(&error, &self.path), "the file is not named: {error}");
                assert!(!chain(&error).is_empty());
                None
            }
        }
    }

    /// What was read, written and read again, is the same.
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
            Ok(again) => assert!(again == *value, "what was written is not what comes back"),
            Err(error) => panic!("what was read cannot be written and read: {}", chain(&error)),
        }
    }

    /// How many reads succeeded.
    pub(super) fn reads(self) -> usize {
        self.reads
    }
}

impl Drop for Case {
    fn drop(&mut self) {
        std::fs::remove_file(&self.path).ok();
    }
}
