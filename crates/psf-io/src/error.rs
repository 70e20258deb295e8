//! Errors of files.

use std::error::Error;
use std::fmt;
use std::path::{Path, PathBuf};

use psf_types::DataError;

/// The reason why a file could not be read or written: the file, the place in it, the kind of the
/// problem, and what was expected, what was found and what to do.
///
/// The text of the error does not repeat the text of its [`source`](Error::source), so print the
/// whole chain. If a setting of this library can solve the problem, [`setting`](Self::setting)
/// names it. The program that offers the setting to its users adds a hint in its own terms.
///
/// ```
/// use psf_io::{IoErrorKind, write_text};
/// let error = write_text("Cargo.toml", "", false).unwrap_err();
/// assert_eq!((error.kind(), error.setting()), (IoErrorKind::Exists, Some("overwrite")));
/// ```
#[derive(Debug)]
pub struct IoError(Box<Parts>);

#[derive(Debug)]
struct Parts {
    path: PathBuf,
    place: Option<Place>,
    kind: IoErrorKind,
    message: String,
    setting: Option<&'static str>,
    source: Option<Box<dyn Error + Send + Sync>>,
}

/// The kind of an [`IoError`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum IoErrorKind {
    /// The file, or the directory of an output, does not exist.
    NotFound,
    /// The file cannot be opened or read. The source is the error of the operating system, if there
    /// is one.
    Read,
    /// The file cannot be written. The source is the error of the operating system, if there is
    /// one.
    Write,
    /// The output exists and may not be replaced.
    Exists,
    /// The file is not a regular file, has another format, a newer version or an unsupported
    /// compression, or lacks an image or a table that is needed.
    Format,
    /// The file is cut short, or its compressed data are damaged.
    Damaged,
    /// A keyword is missing, or its value is not valid or not supported.
    Header,
    /// An image has the wrong number of axes, or an axis of the wrong length.
    Axes,
    /// A value breaks a rule, or several values together do. Examples are NaN, a PSF without flux,
    /// and a galaxy whose parameters are out of range.
    Data,
    /// A table lacks a column that is needed, holds a column twice or in another format, or has
    /// rows of the wrong length.
    Table,
    /// A setting is missing, is not valid for this file, or has no effect on it.
    Setting,
    /// A size or a value is beyond a limit of this library or of CFITSIO, or a value is beyond the
    /// range of single precision.
    Limit,
    /// The call does not suit the file. For example, it asks for rows that the file does not have,
    /// or gives pixels or samples that the file cannot hold.
    Request,
}

/// A place in a file. HDUs, tiles and pixels are counted from 0. HDU 0 is the primary one, as in
/// astropy.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Place {
    /// An HDU.
    Hdu(usize),
    /// A keyword in the header of an HDU.
    Keyword {
        /// The HDU.
        hdu: usize,
        /// The keyword.
        keyword: String,
    },
    /// A tile of a compressed image.
    Tile {
        /// The HDU.
        hdu: usize,
        /// The number of the tile, which is also the number of its row in the HDU's table.
        tile: usize,
    },
    /// A pixel of an image.
    Pixel {
        /// The HDU.
        hdu: usize,
        /// The index, `[y, x]` or `[plane, y, x]`.
        index: Vec<usize>,
    },
    /// A column of a table.
    Column(String),
    /// A row of a table.
    Row(Row),
    /// A value of a table.
    Value {
        /// The row.
        row: Row,
        /// The column.
        column: String,
    },
}

/// A row of a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Row {
    /// The line of a text file, from 1.
    Line(u64),
    /// The row of a FITS table, from 0.
    Index(usize),
}

impl IoError {
    /// An error about a file.
    pub fn new(path: impl AsRef<Path>, kind: IoErrorKind, message: impl Into<String>) -> Self {
        Self(Box::new(Parts {
            path: path.as_ref().to_owned(),
            place: None,
            kind,
            message: message.into(),
            setting: None,
            source: None,
        }))
    }

    /// Adds the place in the file.
    #[must_use]
    pub fn at(mut self, place: Place) -> Self {
        self.0.place = Some(place);
        self
    }

    /// Adds the cause.
    #[must_use]
    pub fn because(mut self, source: impl Into<Box<dyn Error + Send + Sync>>) -> Self {
        self.0.source = Some(source.into());
        self
    }

    /// Adds the name of the setting that solves the problem.
    #[must_use]
    pub fn with_setting(mut self, setting: &'static str) -> Self {
        self.0.setting = Some(setting);
        self
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.0.path
    }

    /// The place in the file, if the problem has one.
    pub fn place(&self) -> Option<&Place> {
        self.0.place.as_ref()
    }

    /// The kind of the problem.
    pub fn kind(&self) -> IoErrorKind {
        self.0.kind
    }

    /// The name of the setting that solves the problem, as this library spells it: an argument such
    /// as `overwrite`, or a setter of an options type without its `with_`. `hdu` stands for the
    /// choice of an image, `table` for the choice of a table, `extension` for the choice of a PSF,
    /// and `plane_order` for the order of the planes of an STPSF library.
    pub fn setting(&self) -> Option<&'static str> {
        self.0.setting
    }
}

impl fmt::Display for IoError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: ", self.0.path.display())?;
        if let Some(place) = &self.0.place {
            write!(f, "{place}: ")?;
        }
        f.write_str(&self.0.message)
    }
}

impl Error for IoError {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        let source = self.0.source.as_deref()?;
        Some(source)
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Hdu(hdu) => write!(f, "HDU {hdu}"),
            Self::Keyword { hdu, keyword } => write!(f, "HDU {hdu}, keyword {keyword}"),
            Self::Tile { hdu, tile } => write!(f, "HDU {hdu}, tile {tile} (0-based)"),
            Self::Pixel { hdu, index } => write!(f, "HDU {hdu}, pixel {index:?} (0-based, x last)"),
            Self::Column(column) => write!(f, "column {column:?}"),
            Self::Row(row) => row.fmt(f),
            Self::Value { row, column } => write!(f, "{row}, column {column:?}"),
        }
    }
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(line) => write!(f, "line {line}"),
            Self::Index(row) => write!(f, "row {row} (0-based)"),
        }
    }
}

/// Returns a function for `map_err` that reports a file that cannot be read.
pub(crate) fn unreadable(path: &Path) -> impl Fn(std::io::Error) -> IoError + Copy + '_ {
    move |source| {
        let kind = match source.kind() {
            std::io::ErrorKind::NotFound => IoErrorKind::NotFound,
            _ => IoErrorKind::Read,
        };
        IoError::new(path, kind, "cannot read the file").because(source)
    }
}

/// Returns a function for `map_err` that reports a file that cannot be written.
pub(crate) fn unwritable(path: &Path) -> impl Fn(std::io::Error) -> IoError + Copy + '_ {
    move |source| IoError::new(path, IoErrorKind::Write, "cannot write the file").because(source)
}

/// Returns a function for `map_err` that reports data that break a rule of their type.
pub(crate) fn invalid(path: &Path) -> impl Fn(DataError) -> IoError + Copy + '_ {
    move |source| IoError::new(path, IoErrorKind::Data, "the data are not valid").because(source)
}

/// The error for a value that is too large for single precision, or NaN.
pub(crate) fn beyond_single(path: &Path) -> IoError {
    const BEYOND: &str =
        "a value is NaN or too large for single precision (3.4e38): use smaller values or double precision";
    IoError::new(path, IoErrorKind::Limit, BEYOND)
}

/// Returns a function for `map_err` that reports a header card that cannot be written.
pub(crate) fn bad_card(path: &Path) -> impl Fn(CardError) -> IoError + Copy + '_ {
    move |source| IoError::new(path, IoErrorKind::Header, "a header card cannot be written").because(source)
}

/// The reason why a header card cannot be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CardError {
    /// A keyword that FITS does not allow.
    #[error("{keyword:?} is not a FITS keyword, which has 1 to 8 of the characters A-Z, 0-9, - and _")]
    Keyword {
        /// The keyword given.
        keyword: String,
    },
    /// A NaN or an infinity, which FITS headers cannot hold.
    #[error("{keyword} is {value}: a FITS header holds finite numbers only")]
    NonFinite {
        /// The keyword.
        keyword: String,
        /// NaN or an infinity.
        value: f64,
    },
}
