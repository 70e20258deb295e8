//! Errors of the pipeline.

use std::error::Error;
use std::fmt;

use conv_core::ConvError;
use psf_types::{Cancelled, DataError};

/// An error of a simulation, or of a step before it, such as the fit of the PSF. It has a kind, and
/// a message that says what was expected, what was found and what to do.
///
/// The error of the stage that failed is the [`source`](Error::source). Use [`cause`](Self::cause)
/// to match on it. If another value of a setting can avoid the problem, [`setting`](Self::setting)
/// names this setting. A program that offers the setting under another name can add this name to
/// the message.
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
    /// A setting is out of range, has no effect here, or contradicts another setting.
    Setting,
    /// Values, shapes or counts that break a rule.
    Data,
    /// A file could not be read or written. The cause is a [`psf_io::IoError`].
    Io,
    /// A PSF file lacks a value, or a file format cannot hold a property of the PSF.
    Format,
    /// The PSF is not known at a position, or not over the whole frame.
    Field,
    /// The basis could not be computed, or its coefficients could not be interpolated.
    Fit,
    /// A PSF could not be sampled over its field, or a PSF source or a telescope could not be used.
    Sampling,
    /// No PSF samples could be made from the stars of a frame.
    Stars,
    /// The convolution failed.
    Convolution,
    /// The progress object cancelled the work.
    Cancelled,
    /// A GPU cannot be used. Discard simulators that ran on it.
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

    /// An error that another value of this setting can avoid.
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

    /// The error for an operation that only methods with a plan offer. `what` is the start of the
    /// message.
    pub(crate) fn needs_plan(what: &str) -> Self {
        let message = format!("{what} only by the methods auto and lowrank: choose one of them");
        Self::of_setting("method", message)
    }

    /// Wraps the error of a stage and keeps its text.
    fn of_stage(kind: ErrorKind, error: impl Error + Send + Sync + 'static) -> Self {
        Self::new(kind, error.to_string()).because(error)
    }

    /// The kind of the problem.
    pub fn kind(&self) -> ErrorKind {
        self.kind
    }

    /// The name of the setting that can avoid the problem, as this library spells it: a field such
    /// as [`SimulateOptions::frame`](crate::SimulateOptions::frame), or an argument such as
    /// `overwrite`. `hdu` stands for the choice of an image in a file, and `table` for the choice
    /// of a table.
    pub fn setting(&self) -> Option<&'static str> {
        self.setting
    }

    /// Returns the first cause that has the type `E`: the error of a stage, or one of its causes.
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

/// Converts the errors of the stages to [`PsfieldError`].
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

impl From<psf_sample::SampleError> for PsfieldError {
    fn from(error: psf_sample::SampleError) -> Self {
        let kind = match error {
            psf_sample::SampleError::Cancelled(_) => ErrorKind::Cancelled,
            _ => ErrorKind::Sampling,
        };
        Self::of_stage(kind, error)
    }
}

impl From<ConvError> for PsfieldError {
    fn from(error: ConvError) -> Self {
        let (kind, setting) = match error {
            ConvError::Tolerance { .. } => (ErrorKind::Setting, Some("tolerance")),
            ConvError::Floor { .. } => (ErrorKind::Setting, Some("floor")),
            ConvError::PatchSize => (ErrorKind::Setting, Some("method")),
            ConvError::StampSize => (ErrorKind::Setting, Some("stamp_size")),
            ConvError::RegionOutsideFrame { .. } => (ErrorKind::Setting, Some("region")),
            ConvError::GalaxyTransform { .. } => (ErrorKind::TooLarge, None),
            ConvError::Cancelled(_) => (ErrorKind::Cancelled, None),
            ConvError::Field(_) => (ErrorKind::Field, None),
            #[cfg(feature = "gpu")]
            ConvError::Gpu(_) => (ErrorKind::Gpu, None),
            _ => (ErrorKind::Convolution, None),
        };
        Self::of_stage(kind, error).with_setting(setting)
    }
}

/// Words of Rust's own errors about numbers and types, each with the plain words that replace them.
const PLAIN: [(&str, &str); 13] = [
    ("invalid digit found in string", "a whole number is needed"),
    (
        "cannot parse integer from empty string",
        "a whole number is needed",
    ),
    ("invalid float literal", "a number is needed"),
    ("cannot parse float from empty string", "a number is needed"),
    (
        "number too large to fit in target type",
        "the number is too large",
    ),
    (
        "number too small to fit in target type",
        "the number is too small",
    ),
    (
        "stream did not contain valid UTF-8",
        "the file is not a text in UTF-8",
    ),
    (
        "number would be zero for non-zero type",
        "a number above 0 is needed",
    ),
    (" as i128", ""),
    ("expected usize", "expected a whole number, 0 or above"),
    ("expected u64", "expected a whole number, 0 or above"),
    ("expected u32", "expected a whole number, 0 or above"),
    ("expected f64", "expected a number"),
];

/// Replaces words of Rust's own errors about numbers and types by plain ones.
pub fn in_plain_words(text: &str) -> String {
    let replaced = |text: String, (rust, plain): (&str, &str)| text.replace(rust, plain);
    let mut text = PLAIN.into_iter().fold(text.to_owned(), replaced);
    if let Some((before, after)) = text.split_once("expected struct ") {
        text = format!(
            "{before}expected a table{}",
            after.trim_start_matches(char::is_alphanumeric)
        );
    }
    text
}

/// Formats an error with its causes in one line, `problem: cause: cause of the cause`. A cause is
/// left out if the text before it already contains its text. Words of Rust's own errors about
/// numbers and types are replaced by plain ones.
///
/// ```
/// use psfield::{Psf, error::error_text};
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
    in_plain_words(&all)
}
