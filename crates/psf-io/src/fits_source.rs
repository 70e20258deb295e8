//! Where the bytes of a FITS file are.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::unfinished::Temporary;

/// A FITS file that can be read at any place: the file itself, or an unpacked copy of it, which goes with the last of its users.
#[derive(Debug, Clone)]
pub(crate) struct FitsSource {
    path: PathBuf,
    unpacked: Option<Arc<Temporary>>,
}

impl FitsSource {
    /// The file itself.
    pub(crate) fn plain(path: &Path) -> Self {
        Self {
            path: path.to_owned(),
            unpacked: None,
        }
    }

    /// An unpacked copy of a file.
    pub(crate) fn unpacked(path: &Path, copy: Temporary) -> Self {
        Self {
            path: path.to_owned(),
            unpacked: Some(Arc::new(copy)),
        }
    }

    /// The name for error messages.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// The file to open.
    pub(crate) fn file(&self) -> &Path {
        self.unpacked.as_ref().map_or(&self.path, |copy| copy.path())
    }
}
