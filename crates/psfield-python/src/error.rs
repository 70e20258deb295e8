//! Converts errors of the library to Python exceptions.

use std::borrow::Cow;
use std::io::ErrorKind;

use psfield::PsfieldError;
use psfield::psf_io::{IoError, IoErrorKind};
use pyo3::exceptions::{
    PyException, PyFileExistsError, PyFileNotFoundError, PyOSError, PyPermissionError, PyValueError,
};
use pyo3::prelude::*;

/// An error of the library that becomes a Python exception.
#[derive(Debug)]
pub(crate) struct Failure {
    error: Box<PsfieldError>,
    /// The argument that caused the error.
    argument: Option<Cow<'static, str>>,
}

impl<E: Into<PsfieldError>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self {
            error: Box::new(error.into()),
            argument: None,
        }
    }
}

impl Failure {
    /// Returns a function for `map_err`, which turns an error into a failure caused by this argument.
    pub(crate) fn of<E: Into<PsfieldError>>(
        argument: impl Into<Cow<'static, str>>,
    ) -> impl FnOnce(E) -> Self {
        |error| Self {
            error: Box::new(error.into()),
            argument: Some(argument.into()),
        }
    }

    /// Returns the same failure, caused by this argument.
    pub(crate) fn caused_by(self, argument: impl Into<Cow<'static, str>>) -> Self {
        Self {
            argument: Some(argument.into()),
            ..self
        }
    }
}

impl From<Failure> for PyErr {
    /// Returns an `OSError` if the cause is a file or a device, else a `ValueError`, with the text
    /// of the library.
    fn from(Failure { error, argument }: Failure) -> Self {
        let cause = error.cause::<PyErr>();
        let clone = |cause: &PyErr| Python::attach(|py| cause.clone_ref(py));
        let is_exit = |cause: &&PyErr| Python::attach(|py| !cause.is_instance_of::<PyException>(py));
        if let Some(exit) = cause.filter(is_exit) {
            // KeyboardInterrupt and SystemExit are passed on unchanged.
            return clone(exit);
        }
        let text = with_argument(psfield::error::error_text(&*error), error.setting());
        let text = argument.map_or_else(|| text.clone(), |argument| format!("{argument}: {text}"));
        let of_file = error.cause().map(IoError::kind);
        let raised = match (error.kind(), of_file, error.cause().map(std::io::Error::kind)) {
            (_, Some(IoErrorKind::Exists), _) => PyFileExistsError::new_err(text),
            (_, Some(IoErrorKind::NotFound), _) | (.., Some(ErrorKind::NotFound)) => {
                PyFileNotFoundError::new_err(text)
            }
            (.., Some(ErrorKind::PermissionDenied)) => PyPermissionError::new_err(text),
            (psfield::ErrorKind::Gpu | psfield::ErrorKind::Io, ..) | (.., Some(_)) => {
                PyOSError::new_err(text)
            }
            _ => PyValueError::new_err(text),
        };
        // A function of the caller raised this exception.
        if let Some(cause) = cause {
            Python::attach(|py| raised.set_cause(py, Some(clone(cause))));
        }
        raised
    }
}

/// Appends the name of a Python argument to a message of the library. `setting` is the library's
/// name for this argument.
pub(crate) fn with_argument(text: String, setting: Option<&str>) -> String {
    let argument = match setting {
        None => return text,
        Some("hdu") => "wcs_extension",
        Some("sky") => "wcs",
        Some("grid") => "pixels",
        Some("at") => "grid_shape",
        Some("normalisation") => "normalise",
        Some("invalid_skipped") => "skip_invalid",
        Some(unchanged) => unchanged,
    };
    format!("{text} ({argument}=)")
}

/// Makes the `ValueError` for an invalid argument.
pub(crate) fn invalid(text: impl Into<String>) -> PyErr {
    PyValueError::new_err(text.into())
}
