//! Errors of the library as exceptions of Python.

use std::io::ErrorKind;

use psfield::PsfieldError;
use psfield::psf_io::{IoError, IoErrorKind};
use pyo3::exceptions::{
    PyException, PyFileExistsError, PyFileNotFoundError, PyOSError, PyPermissionError, PyValueError,
};
use pyo3::prelude::*;

/// An error of the library on its way to Python.
#[derive(Debug)]
pub(crate) struct Failure {
    error: Box<PsfieldError>,
    /// The argument that caused the error.
    argument: Option<&'static str>,
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
    /// An error caused by this argument.
    pub(crate) fn of<E: Into<PsfieldError>>(argument: &'static str) -> impl FnOnce(E) -> Self {
        move |error| Self {
            error: Box::new(error.into()),
            argument: Some(argument),
        }
    }
}

impl From<Failure> for PyErr {
    /// `OSError` if the cause is a file or a device, else `ValueError`. The text is the library's.
    fn from(Failure { error, argument }: Failure) -> Self {
        let cause = error.cause::<PyErr>();
        let clone = |cause: &PyErr| Python::attach(|py| cause.clone_ref(py));
        let asks_for_an_end = |cause: &&PyErr| Python::attach(|py| !cause.is_instance_of::<PyException>(py));
        if let Some(end) = cause.filter(asks_for_an_end) {
            // KeyboardInterrupt and SystemExit pass through as they are.
            return clone(end);
        }
        let text = with_argument(psfield::error_text(&*error), error.setting());
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
        // An exception raised by a function of the caller.
        if let Some(cause) = cause {
            Python::attach(|py| raised.set_cause(py, Some(clone(cause))));
        }
        raised
    }
}

/// A message of the library, and the argument of Python for the setting that it names.
pub(crate) fn with_argument(text: String, setting: Option<&str>) -> String {
    let argument = match setting {
        None => return text,
        Some("hdu") => "wcs_extension",
        Some("sky") => "wcs",
        Some("grid") => "pixels",
        Some("at") => "grid_shape",
        Some("normalisation") => "normalise",
        Some(same) => same,
    };
    format!("{text} ({argument}=)")
}

/// A `ValueError` for an argument.
pub(crate) fn invalid(text: impl Into<String>) -> PyErr {
    PyValueError::new_err(text.into())
}
