//! Temporary files of processes that were killed.
//!
//! A temporary file is called `.psfield-PROCESS-RANDOM-OUTPUT` and stands beside its output. Whoever writes it holds an advisory lock on
//! it, which the system lets go when the process ends in whatever way, on this machine or on another that shares the folder. So a file
//! that nobody has locked belongs to nobody.

use std::collections::HashMap;
use std::ffi::{OsStr, OsString};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use crate::atomic::directory_of;

const MARK: &str = ".psfield-";
/// Characters that [`tempfile`] puts between prefix and suffix.
pub(crate) const RANDOM: usize = 6;
/// A longer name is not repeated in the temporary one: some file systems take no more than 143 bytes.
const LONGEST_REPEATED: usize = 100;

/// What the names of this process' temporary files begin with.
pub(crate) fn prefix() -> String {
    format!("{MARK}{}-", std::process::id())
}

/// What the name of an output's temporary file ends with: its own name, or what is like it in its extension.
pub(crate) fn suffix(target: &Path) -> OsString {
    let name = target.file_name().unwrap_or_default();
    let mut suffix = OsString::from("-");
    if name.len() <= LONGEST_REPEATED {
        suffix.push(name);
    } else if let Some(extension) = target.extension().filter(|e| e.len() <= LONGEST_REPEATED) {
        suffix.push("long-name.");
        suffix.push(extension);
    }
    suffix
}

/// Locks a new temporary file for as long as the handle is open. Where the file system knows no locks, its file just stays when the
/// process is killed.
pub(crate) fn claim(temporary: &Path) -> Option<File> {
    // Elsewhere than on Unix a lock would keep CFITSIO, which opens the file a second time, from writing.
    if cfg!(unix) {
        let file = File::open(temporary).ok()?;
        file.try_lock_shared().ok()?;
        Some(file)
    } else {
        None
    }
}

/// Removes what processes that were killed have left of `target`. What cannot be removed does no harm.
pub(crate) fn remove(target: &Path) {
    /// The temporary files that stood in a folder when this process first wrote there: a folder may hold ten thousands of files, too many
    /// to look at for every one that is written.
    static SEEN: Mutex<Option<HashMap<PathBuf, Vec<OsString>>>> = Mutex::new(None);

    if !cfg!(unix) {
        return;
    }
    let directory = directory_of(target);
    let Ok(absolute) = std::path::absolute(directory) else {
        return;
    };
    let mut seen = SEEN.lock().unwrap_or_else(PoisonError::into_inner);
    let names = seen
        .get_or_insert_default()
        .entry(absolute)
        .or_insert_with(|| temporaries_in(directory));
    let suffix = suffix(target);
    names.retain(|name| {
        let ours = is_of(name, &suffix);
        if ours {
            remove_if_abandoned(&directory.join(name));
        }
        !ours
    });
}

fn temporaries_in(directory: &Path) -> Vec<OsString> {
    fs::read_dir(directory)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.file_name())
        .filter(|name| name.as_encoded_bytes().starts_with(MARK.as_bytes()))
        .collect()
}

/// Whether a name is `.psfield-PROCESS-RANDOM` and this suffix.
fn is_of(name: &OsStr, suffix: &OsStr) -> bool {
    let rest = name.as_encoded_bytes().strip_prefix(MARK.as_bytes());
    let Some(middle) = rest.and_then(|rest| rest.strip_suffix(suffix.as_encoded_bytes())) else {
        return false;
    };
    let digits = middle.iter().take_while(|c| c.is_ascii_digit()).count();
    let random = middle[digits..].strip_prefix(b"-");
    digits > 0 && random.is_some_and(|r| r.len() == RANDOM && r.iter().all(u8::is_ascii_alphanumeric))
}

fn remove_if_abandoned(temporary: &Path) {
    let is_file = fs::symlink_metadata(temporary).is_ok_and(|found| found.is_file());
    if !is_file {
        return;
    }
    // Network file systems want a file open for writing for a lock that excludes others, and for reading for one that does not.
    let opened = File::options().read(true).write(true).open(temporary);
    if opened.is_ok_and(|file| file.try_lock().is_ok()) {
        let _ = fs::remove_file(temporary);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_tell_the_output() {
        let suffix = suffix(Path::new("night/image.fits"));
        for (name, ours) in [
            (".psfield-4711-aB3xYz-image.fits", true),
            (".psfield-4711-aB3xYz-other.fits", false),
            (".psfield-4711-aB3xYz-my-image.fits", false),
            (".psfield-aB3xYz-image.fits", false),
            (".psfield-4711-aB3-image.fits", false),
            (".psfield-image.fits", false),
            ("psfield-4711-aB3xYz-image.fits", false),
        ] {
            assert_eq!(is_of(OsStr::new(name), &suffix), ours, "{name}");
        }
        let long = PathBuf::from("n".repeat(200) + ".fits");
        assert_eq!(super::suffix(&long), "-long-name.fits");
    }

    #[cfg(unix)]
    #[test]
    fn what_nobody_holds_is_removed_and_nothing_else() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        let names = [
            ".psfield-99-abcdef-a.fits",
            ".psfield-99-ghijkl-a.fits",
            ".psfield-99-abcdef-b.fits",
            "a.fits",
        ];
        for name in names {
            fs::write(at(name), "half").unwrap();
        }
        let held = claim(&at(names[1])).unwrap();
        remove(&at("a.fits"));
        assert_eq!(names.map(|name| at(name).exists()), [false, true, true, true]);
        drop(held);
    }
}
