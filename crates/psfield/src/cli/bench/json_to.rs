//! Where JSON goes.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Whether, and where to, a command writes JSON.
///
/// `--json` is an option of every command that takes no value; `bench` takes a file as well, under the same name. The parser wants
/// one type for both.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum JsonTo {
    Nowhere,
    Output,
    File(PathBuf),
}

impl JsonTo {
    /// Of `--json` without a value.
    #[allow(clippy::unnecessary_wraps, reason = "a parser of values")]
    pub(crate) fn of_flag(text: &str) -> Result<Self, String> {
        Ok(if text == "true" {
            Self::Output
        } else {
            Self::Nowhere
        })
    }

    /// Of `--json FILE`; `-` is standard output.
    pub(super) fn of_argument(text: OsString) -> Self {
        if text == "-" {
            Self::Output
        } else {
            Self::File(text.into())
        }
    }

    /// Whether JSON takes the place of text on standard output.
    pub(crate) fn is_output(&self) -> bool {
        *self == Self::Output
    }

    pub(super) fn file(&self) -> Option<&Path> {
        match self {
            Self::File(path) => Some(path),
            _ => None,
        }
    }
}
