//! Finds outputs that would replace an input or another output.

use std::path::{Path, PathBuf};

use crate::{ErrorKind, PsfieldError};

/// Checks that all outputs of a run can be written, as far as this can be known before the work is
/// done.
///
/// # Errors
/// [`ErrorKind::Setting`] if two outputs are the same file, or if an output is among `inputs`.
/// Inputs are never replaced, even if `overwrite` is true. The errors of
/// [`check_output`](psf_io::check_output) for each output.
pub fn check_outputs(inputs: &[&Path], outputs: &[&Path], overwrite: bool) -> Result<(), PsfieldError> {
    let mut taken: Vec<PathBuf> = inputs.iter().map(|path| resolved(path)).collect();
    for path in outputs {
        let place = resolved(path);
        if taken.contains(&place) {
            let message = format!(
                "{} would be written over another file of this run: choose another name",
                path.display()
            );
            return Err(PsfieldError::new(ErrorKind::Setting, message));
        }
        psf_io::check_output(path, overwrite)?;
        taken.push(place);
    }
    Ok(())
}

/// Returns an absolute path of a file, which need not exist. Different spellings of its path give
/// equal results if its folder exists.
pub fn resolved(path: &Path) -> PathBuf {
    if let Ok(place) = path.canonicalize() {
        return place;
    }
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    match (folder.canonicalize(), path.file_name()) {
        (Ok(folder), Some(name)) => folder.join(name),
        _ => std::path::absolute(path).unwrap_or_else(|_| path.to_owned()),
    }
}
