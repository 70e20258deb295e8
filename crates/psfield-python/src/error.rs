//! Errors as Python knows them.

use std::error::Error;

use psfield::PsfieldError;
use psfield::psf_io::IoError;
use pyo3::exceptions::{
    PyException, PyFileExistsError, PyFileNotFoundError, PyOSError, PyPermissionError, PyValueError,
};
use pyo3::prelude::*;

/// An error of the library on its way to Python.
#[derive(Debug)]
pub(crate) struct Failure {
    error: Box<PsfieldError>,
    /// The argument to blame.
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
    /// An error that an argument is to blame for.
    pub(crate) fn of<E: Into<PsfieldError>>(argument: &'static str) -> impl FnOnce(E) -> Self {
        move |error| Self {
            error: Box::new(error.into()),
            argument: Some(argument),
        }
    }
}

impl From<Failure> for PyErr {
    /// `OSError` where a file or a device is to blame, else `ValueError`; the text is that of the command line.
    fn from(Failure { error, argument }: Failure) -> Self {
        let cause = cause_of::<PyErr>(&*error);
        let clone = |cause: &PyErr| Python::attach(|py| cause.clone_ref(py));
        let asks_for_an_end = |cause: &&PyErr| Python::attach(|py| !cause.is_instance_of::<PyException>(py));
        if let Some(end) = cause.filter(asks_for_an_end) {
            // KeyboardInterrupt and SystemExit are no errors of the function that they were raised in.
            return clone(end);
        }
        let text = psfield::error_text(&*error);
        let text = argument.map_or_else(|| text.clone(), |argument| format!("{argument}: {text}"));
        let raised = match &*error {
            PsfieldError::Io(IoError::Exists { .. }) => PyFileExistsError::new_err(text),
            PsfieldError::Io(IoError::MissingDirectory { .. }) => PyFileNotFoundError::new_err(text),
            error if error.is_of_gpu() => PyOSError::new_err(text),
            error => match (kind_of(error), error) {
                (Some(std::io::ErrorKind::NotFound), _) => PyFileNotFoundError::new_err(text),
                (Some(std::io::ErrorKind::PermissionDenied), _) => PyPermissionError::new_err(text),
                (Some(_), _) | (None, PsfieldError::Io(_)) => PyOSError::new_err(text),
                (None, _) => PyValueError::new_err(text),
            },
        };
        // What a function of the caller's raised.
        if let Some(cause) = cause {
            Python::attach(|py| raised.set_cause(py, Some(clone(cause))));
        }
        raised
    }
}

/// What the system said, if it was asked.
fn kind_of(error: &PsfieldError) -> Option<std::io::ErrorKind> {
    cause_of::<std::io::Error>(error).map(std::io::Error::kind)
}

/// The first cause of a type.
fn cause_of<'a, E: Error + 'static>(error: &'a (dyn Error + 'static)) -> Option<&'a E> {
    std::iter::successors(error.source(), |&cause| cause.source()).find_map(|cause| cause.downcast_ref())
}

/// A `ValueError` for an argument.
pub(crate) fn invalid(text: impl Into<String>) -> PyErr {
    PyValueError::new_err(text.into())
}
