//! Errors of the library as exceptions of Python.

use std::error::Error;

use psfield::PsfieldError;
use psfield::psf_io::IoErrorKind;
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
        let cause = cause_of::<PyErr>(&*error);
        let clone = |cause: &PyErr| Python::attach(|py| cause.clone_ref(py));
        let asks_for_an_end = |cause: &&PyErr| Python::attach(|py| !cause.is_instance_of::<PyException>(py));
        if let Some(end) = cause.filter(asks_for_an_end) {
            // KeyboardInterrupt and SystemExit pass through as they are.
            return clone(end);
        }
        let text = psfield::error_text(&*error);
        let text = argument.map_or_else(|| text.clone(), |argument| format!("{argument}: {text}"));
        let raised = match &*error {
            PsfieldError::Io(error) if error.kind() == IoErrorKind::Exists => PyFileExistsError::new_err(text),
            PsfieldError::Io(error) if error.kind() == IoErrorKind::NotFound => PyFileNotFoundError::new_err(text),
            error if error.is_of_gpu() => PyOSError::new_err(text),
            error => match (kind_of(error), error) {
                (Some(std::io::ErrorKind::NotFound), _) => PyFileNotFoundError::new_err(text),
                (Some(std::io::ErrorKind::PermissionDenied), _) => PyPermissionError::new_err(text),
                (Some(_), _) | (None, PsfieldError::Io(_)) => PyOSError::new_err(text),
                (None, _) => PyValueError::new_err(text),
            },
        };
        // An exception raised by a function of the caller.
        if let Some(cause) = cause {
            Python::attach(|py| raised.set_cause(py, Some(clone(cause))));
        }
        raised
    }
}

/// The kind of the first error of the operating system among the causes.
fn kind_of(error: &PsfieldError) -> Option<std::io::ErrorKind> {
    cause_of::<std::io::Error>(error).map(std::io::Error::kind)
}

/// The first cause of this type.
fn cause_of<'a, E: Error + 'static>(error: &'a (dyn Error + 'static)) -> Option<&'a E> {
    std::iter::successors(error.source(), |&cause| cause.source()).find_map(|cause| cause.downcast_ref())
}

/// A `ValueError` for an argument.
pub(crate) fn invalid(text: impl Into<String>) -> PyErr {
    PyValueError::new_err(text.into())
}
