//! An error with its causes.

use std::error::Error;

/// An error with its causes in one line, `what: why: why that`. Errors that show their cause themselves repeat it in the chain; everything is
/// said once.
///
/// ```
/// use psfield::{FitOptions, PsfInput, error_text};
/// let error = PsfInput::open("no such file.fits", FitOptions::default()).unwrap_err();
/// assert!(error_text(&error).starts_with("no such file.fits: cannot read the file: "));
/// ```
pub fn error_text(error: &dyn Error) -> String {
    let mut last = error.to_string();
    let mut all = last.clone();
    let mut cause = error.source();
    while let Some(error) = cause {
        let text = error.to_string();
        if !last.contains(&text) {
            all = format!("{all}: {text}");
            last = text;
        }
        cause = error.source();
    }
    all
}
