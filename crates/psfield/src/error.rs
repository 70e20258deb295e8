//! Errors of the pipeline.

use std::error::Error;
use std::fmt;

use conv_core::ConvError;
use psf_types::{Cancelled, DataError};

/// Why a simulation, or a step on the way to it, failed: the kind of the problem, and what was
/// expected, what was found and what to do.
///
/// The error of the stage that failed is the [`source`](Error::source). Use
/// [`cause`](Self::cause) to match on it. If a setting of this library can mend the problem,
/// [`setting`](Self::setting) names it. The program that offers the setting to its users adds a
/// hint in its own terms.
///
/// ```
/// use psfield::psf_io::{IoError, IoErrorKind};
/// use psfield::{ErrorKind, Psf, SimulateOptions};
/// let error = Psf::open("no such file.fits").unwrap_err();
/// assert_eq!(error.kind(), ErrorKind::Io);
/// let file = error.cause::<IoError>().expect("a file could not be read");
/// assert_eq!(file.kind(), IoErrorKind::NotFound);
/// let error = "slow".parse::<psfield::Method>().unwrap_err();
/// assert_eq!((error.kind(), error.setting()), (ErrorKind::Setting, Some("method")));
/// ```
#[derive(Debug)]
pub struct PsfieldError {
    kind: ErrorKind,
    message: String,
    setting: Option<&'static str>,
    source: Option<Box<dyn Error + Send + Sync>>,
}

/// The kind of a [`PsfieldError`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ErrorKind {
    /// A setting that is out of range, without effect here, or at odds with another one.
    Setting,
    /// Values, shapes or counts that break a rule.
    Data,
    /// A file could not be read or written. The cause is a [`psf_io::IoError`].
    Io,
    /// A PSF file that does not say something, or a format that cannot hold something.
    Format,
    /// The PSF is not known at a position, or not over the whole frame.
    Field,
    /// Making the basis, or interpolating its coefficients, failed.
    Fit,
    /// A PSF could not be sampled over its field, or a source or a telescope could not be used.
    Sampling,
    /// The stars of a frame gave no samples.
    Stars,
    /// The convolution failed.
    Convolution,
    /// The progress object cancelled the work.
    Cancelled,
    /// A GPU cannot be used. Do not use again what was handed to it.
    Gpu,
    /// The result would take more memory than is allowed.
    TooLarge,
    /// A detector that is not valid, or an image that it cannot expose.
    Detector,
    /// A measurement failed.
    Measurement,
}

impl PsfieldError {
    pub(crate) fn new(kind: ErrorKind, message: impl Into<String>) -> Self {
        Self {
            kind,
            message: message.into(),
            setting: None,
            source: None,
        }
    }

    /// An error that the setting of this name mends.
    pub(crate) fn of_setting(setting: &'static str, message: impl Into<String>) -> Self {
        Self::new(ErrorKind::Setting, message).with_setting(setting)
    }

    pub(crate) fn with_setting(self, setting: impl Into<Option<&'static str>>) -> Self {
        let setting = setting.into();
        Self { setting, ..self }
    }

    pub(crate) fn because(self, source: impl Error + Send + Sync + 'static) -> Self {
        let source: Option<Box<dyn Error + Send + Sync>> = Some(Box::new(source));
        Self { source, ..self }
    }

    /// The error for an operation that only methods with a plan offer.
    pub(crate) fn needs_plan(what: &str) -> Self {
        let message = format!("{what} only by the methods auto and lowrank: choose one of them");
        Self::of_setting("method", message)
    }

    /// The error of a stage, with its own text.
    fn of_stage(kind: ErrorKind, error: impl Error + Send + Sync + 'static) -> Self {
        Self::new(kind, error.to_string()).because(error)
    }

    /// The kind of the problem.
    pub fn kind(&self) -> ErrorKind {
        self.kind
    }

    /// The name of the setting that mends the problem, as this library spells it: a field such as
    /// [`SimulateOptions::frame`](crate::SimulateOptions::frame), or an argument such as
    /// `overwrite`. `hdu` and `table` stand for the choice of an image and of a table.
    pub fn setting(&self) -> Option<&'static str> {
        self.setting
    }

    /// The first cause of this type: the error of a stage, or what caused it.
    pub fn cause<E: Error + 'static>(&self) -> Option<&E> {
        std::iter::successors(self.source(), |&cause| cause.source()).find_map(|cause| cause.downcast_ref())
    }
}

impl fmt::Display for PsfieldError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl Error for PsfieldError {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        let source = self.source.as_deref()?;
        Some(source)
    }
}

/// Makes the errors of a stage errors of the pipeline.
macro_rules! of_stages {
    ($($error:ty => $kind:ident),+ $(,)?) => {$(
        impl From<$error> for PsfieldError {
            fn from(error: $error) -> Self {
                Self::of_stage(ErrorKind::$kind, error)
            }
        }
    )+};
}

of_stages!(
    psf_basis::BasisError => Fit,
    coeff_field::CoeffFieldError => Fit,
    psf_types::FieldError => Field,
    psf_types::SourceError => Sampling,
    psf_sample::SampleError => Sampling,
    psf_optics::OpticsError => Sampling,
    psf_stars::StarError => Stars,
    psf_io::CardError => Data,
    detector::DetectorError => Detector,
    metrics::MetricsError => Measurement,
    Cancelled => Cancelled,
);

impl From<DataError> for PsfieldError {
    fn from(error: DataError) -> Self {
        let kind = match error {
            DataError::Setting { .. } => ErrorKind::Setting,
            _ => ErrorKind::Data,
        };
        Self::of_stage(kind, error)
    }
}

impl From<psf_io::IoError> for PsfieldError {
    fn from(error: psf_io::IoError) -> Self {
        let setting = error.setting();
        Self::of_stage(ErrorKind::Io, error).with_setting(setting)
    }
}

impl From<ConvError> for PsfieldError {
    fn from(error: ConvError) -> Self {
        let (kind, setting) = match error {
            ConvError::Tolerance { .. } => (ErrorKind::Setting, Some("tolerance")),
            ConvError::PatchSize => (ErrorKind::Setting, Some("method")),
            ConvError::RegionOutsideFrame { .. } => (ErrorKind::Setting, Some("region")),
            ConvError::Cancelled(_) => (ErrorKind::Cancelled, None),
            ConvError::Field(_) => (ErrorKind::Field, None),
            #[cfg(feature = "gpu")]
            ConvError::Gpu(_) => (ErrorKind::Gpu, None),
            _ => (ErrorKind::Convolution, None),
        };
        Self::of_stage(kind, error).with_setting(setting)
    }
}

/// An error with its causes in one line, `problem: cause: cause of the cause`. A cause whose text
/// the error before it already contains is left out.
///
/// ```
/// use psfield::{Psf, error_text};
/// let error = Psf::open("no such file.fits").unwrap_err();
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
