//! Errors of files.

use std::ops::Range;
use std::path::{Path, PathBuf};

use psf_types::DataError;
use thiserror::Error;

/// Why a file could not be read or written.
///
/// Every variant names the file. As is usual for errors with a
/// [`source`](std::error::Error::source), the text of the cause is not repeated in the text of the
/// error: print the whole chain.
///
/// HDUs are counted from 0 (the primary), as astropy does; so are rows of FITS tables, pixels and
/// planes. Lines of a text file are counted from 1.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum IoError {
    /// The file cannot be opened or read.
    #[error("{path}: cannot read the file")]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The file cannot be written.
    #[error("{path}: cannot write the file")]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The output exists and may not be replaced.
    #[error("{path}: the file exists: choose another name, or allow it to be replaced with --overwrite")]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The output's directory does not exist.
    #[error("{path}: there is no directory {}: create it first", directory.display())]
    MissingDirectory {
        /// The file.
        path: PathBuf,
        /// Its directory.
        directory: PathBuf,
    },
    /// A directory, a device or a pipe where a file is needed.
    #[error("{path}: this is not a regular file")]
    NotAFile {
        /// The path given.
        path: PathBuf,
    },
    /// A file of another format.
    #[error("{path}: this is not a FITS file (a FITS file starts with \"SIMPLE  =\")")]
    NotFits {
        /// The file.
        path: PathBuf,
    },
    /// A file whose content cannot be used: compressed or written in a way that is not read, or
    /// with rows or columns that do not fit.
    #[error("{path}: {problem}")]
    Content {
        /// The file.
        path: PathBuf,
        /// The problem, and what to do.
        problem: String,
    },
    /// A request that does not go with the file, or a value that it cannot hold.
    #[error("{path}: {problem}")]
    Request {
        /// The file.
        path: PathBuf,
        /// The problem, and what to do.
        problem: String,
    },
    /// A tile of a compressed image that does not hold what its lengths say.
    #[error(
        "{path}: HDU {hdu}: tile {tile} (0-based) of the compressed image is damaged: fetch or write it again"
    )]
    Tile {
        /// The file.
        path: PathBuf,
        /// The HDU.
        hdu: usize,
        /// The tile, a row of the table.
        tile: usize,
    },
    /// Data compressed by gzip that cannot be unpacked.
    #[error(
        "{path}: the gzip data are damaged or cut short after {at} bytes of the FITS file: fetch or write it again"
    )]
    Gzip {
        /// The file.
        path: PathBuf,
        /// Bytes unpacked up to there.
        at: u64,
        /// The problem.
        source: std::io::Error,
    },
    /// A gzip file that would unpack to more than its size lets expect.
    #[error(
        "{path}: {length} bytes of gzip data would unpack to more than {allowed}: if this is right, run gunzip first"
    )]
    UnpacksTooLarge {
        /// The file.
        path: PathBuf,
        /// Its bytes.
        length: u64,
        /// The most bytes that it may unpack to.
        allowed: u64,
    },
    /// The temporary copy of an unpacked file cannot be written.
    #[error("{path}: cannot unpack to the folder for temporary files: set TMPDIR to one with room")]
    Unpacking {
        /// The compressed file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A file that ends before its data do.
    #[error(
        "{path}: the file is cut short: HDU {hdu} needs at least {needed} bytes, there are {length}: fetch or write it again"
    )]
    Truncated {
        /// The file.
        path: PathBuf,
        /// The HDU that is not complete.
        hdu: usize,
        /// Bytes of the file up to the end of what is missing.
        needed: u64,
        /// Bytes there are.
        length: u64,
    },
    /// A header that breaks the FITS standard, so that the data cannot be found.
    #[error("{path}: HDU {hdu}: {keyword}: {problem}")]
    Header {
        /// The file.
        path: PathBuf,
        /// The HDU.
        hdu: usize,
        /// The keyword in question.
        keyword: String,
        /// The problem with it.
        problem: &'static str,
    },
    /// No HDU of the kind needed.
    #[error("{path}: the file has no {what}")]
    MissingHdu {
        /// The file.
        path: PathBuf,
        /// The kind looked for.
        what: String,
    },
    /// Several HDUs that could be meant.
    #[error("{path}: the file has {} {what}, in the HDUs {}: choose one with {option}", found.len(), found.join(", "))]
    SeveralHdus {
        /// The file.
        path: PathBuf,
        /// Their content.
        what: &'static str,
        /// The option of the command line that chooses.
        option: &'static str,
        /// Number and name of each.
        found: Vec<String>,
    },
    /// A choice that is none of the HDUs that could be meant.
    #[error("{path}: HDU {wanted} is none of the {what} in the file, which are in the HDUs {}", found.join(", "))]
    NoSuchHdu {
        /// The file.
        path: PathBuf,
        /// The kind looked for.
        what: &'static str,
        /// The choice.
        wanted: String,
        /// Number and name of each HDU that there is.
        found: Vec<String>,
    },
    /// A keyword that must be there.
    #[error("{path}: HDU {hdu} has no keyword {keyword} ({expected})")]
    MissingKeyword {
        /// The file.
        path: PathBuf,
        /// The HDU.
        hdu: usize,
        /// The keyword.
        keyword: &'static str,
        /// The value that it would hold.
        expected: &'static str,
    },
    /// A keyword whose value is not what it must be.
    #[error("{path}: HDU {hdu}: keyword {keyword} must be {expected}, got {got}")]
    Keyword {
        /// The file.
        path: PathBuf,
        /// The HDU.
        hdu: usize,
        /// The keyword.
        keyword: &'static str,
        /// The values that it may have.
        expected: &'static str,
        /// Its value.
        got: String,
    },
    /// An image with the wrong number of axes.
    #[error("{path}: HDU {hdu} is {got:?} (axes in array order, x last), {expected} is needed")]
    Axes {
        /// The file.
        path: PathBuf,
        /// The HDU.
        hdu: usize,
        /// The shape needed, in words.
        expected: &'static str,
        /// The shape in array order: `NAXIS1` last.
        got: Vec<usize>,
    },
    /// NaN or infinite pixels.
    #[error(
        "{path}: HDU {hdu} has {count} pixel(s) that are NaN, infinite or BLANK; the first is {value} at {index:?} (0-based, x last): replace them by numbers"
    )]
    NonFinitePixels {
        /// The file.
        path: PathBuf,
        /// The HDU.
        hdu: usize,
        /// The first such pixel, `[y, x]` or `[plane, y, x]`.
        index: Vec<usize>,
        /// NaN or an infinity.
        value: f64,
        /// How many there are, in the rows asked for when the image is read by bands.
        count: usize,
    },
    /// Rows that the image does not have.
    #[error("{path}: rows {} to {} (not included, 0-based) are not all in an image of {ny} rows", rows.start, rows.end)]
    Rows {
        /// The file.
        path: PathBuf,
        /// The rows to be read or written.
        rows: Range<usize>,
        /// Rows of the image.
        ny: usize,
    },
    /// Values that single precision cannot hold.
    #[error("{path}: a value is beyond the range of single precision: use double precision")]
    Overflow {
        /// The file.
        path: PathBuf,
    },
    /// A table without a column that is needed.
    #[error("{path}: there is no column {column:?}; the columns are {}", found.join(", "))]
    MissingColumn {
        /// The file.
        path: PathBuf,
        /// The column looked for, upper or lower case.
        column: String,
        /// The columns there are.
        found: Vec<String>,
    },
    /// A value of a table that is not a finite number.
    #[error("{path}: {row}: {column} is {got:?}, a finite number is needed")]
    Value {
        /// The file.
        path: PathBuf,
        /// Where.
        row: Row,
        /// The column.
        column: String,
        /// The text or the value there.
        got: String,
    },
    /// A row of a catalogue that does not make a source.
    #[error("{path}: {row} is not a valid source")]
    Source {
        /// The file.
        path: PathBuf,
        /// Where.
        row: Row,
        /// The problem.
        source: DataError,
    },
    /// Sky coordinates without the world coordinates of the frame.
    #[error(
        "{path}: the columns {ra:?} and {dec:?} are sky coordinates, and no world coordinates of the frame are given: give a scene whose header has them, or positions in pixels"
    )]
    NoWorldCoordinates {
        /// The file.
        path: PathBuf,
        /// The column of right ascensions.
        ra: String,
        /// The column of declinations.
        dec: String,
    },
    /// A text table that is not well formed, or a row that cannot be written.
    #[error("{path}: not a well-formed CSV table")]
    Csv {
        /// The file.
        path: PathBuf,
        /// The problem, and its line.
        source: csv::Error,
    },
    /// Data that break an invariant of their type.
    #[error("{path}: the data are not valid")]
    Data {
        /// The file.
        path: PathBuf,
        /// Which invariant, and where.
        source: DataError,
    },
    /// A PSF library that cannot be read, or samples that cannot be written as one.
    #[error("{path}: the PSF library cannot be used")]
    Library {
        /// The file.
        path: PathBuf,
        /// The problem, and its place.
        source: LibraryError,
    },
    /// A header card that cannot be written.
    #[error("{path}: a header card cannot be written")]
    Card {
        /// The file.
        path: PathBuf,
        /// Why.
        source: CardError,
    },
    /// CFITSIO refused.
    #[error("{path}: {doing}: CFITSIO status {status}: {text}")]
    Cfitsio {
        /// The file.
        path: PathBuf,
        /// The action that failed.
        doing: &'static str,
        /// CFITSIO's status.
        status: i32,
        /// CFITSIO's explanation.
        text: String,
    },
}

impl IoError {
    /// The file that the error is about.
    pub fn path(&self) -> &Path {
        match self {
            Self::Read { path, .. }
            | Self::Write { path, .. }
            | Self::Exists { path, .. }
            | Self::MissingDirectory { path, .. }
            | Self::NotAFile { path, .. }
            | Self::NotFits { path, .. }
            | Self::Content { path, .. }
            | Self::Request { path, .. }
            | Self::Tile { path, .. }
            | Self::Gzip { path, .. }
            | Self::UnpacksTooLarge { path, .. }
            | Self::Unpacking { path, .. }
            | Self::Truncated { path, .. }
            | Self::Header { path, .. }
            | Self::MissingHdu { path, .. }
            | Self::SeveralHdus { path, .. }
            | Self::NoSuchHdu { path, .. }
            | Self::MissingKeyword { path, .. }
            | Self::Keyword { path, .. }
            | Self::Axes { path, .. }
            | Self::NonFinitePixels { path, .. }
            | Self::Rows { path, .. }
            | Self::Overflow { path, .. }
            | Self::MissingColumn { path, .. }
            | Self::Value { path, .. }
            | Self::Source { path, .. }
            | Self::NoWorldCoordinates { path, .. }
            | Self::Csv { path, .. }
            | Self::Data { path, .. }
            | Self::Library { path, .. }
            | Self::Card { path, .. }
            | Self::Cfitsio { path, .. } => path,
        }
    }
}

/// `map_err` for a file that cannot be read.
pub(crate) fn unreadable(path: &Path) -> impl Fn(std::io::Error) -> IoError + Copy + '_ {
    move |source| IoError::Read {
        path: path.to_owned(),
        source,
    }
}

/// `map_err` for a file that cannot be written.
pub(crate) fn unwritable(path: &Path) -> impl Fn(std::io::Error) -> IoError + Copy + '_ {
    move |source| IoError::Write {
        path: path.to_owned(),
        source,
    }
}

/// `map_err` for data that do not make the type they should.
pub(crate) fn invalid(path: &Path) -> impl Fn(DataError) -> IoError + Copy + '_ {
    move |source| IoError::Data {
        path: path.to_owned(),
        source,
    }
}

/// `map_err` for cards that cannot be written.
pub(crate) fn bad_card(path: &Path) -> impl Fn(CardError) -> IoError + Copy + '_ {
    move |source| IoError::Card {
        path: path.to_owned(),
        source,
    }
}

/// The error for a PSF library that is not what it should be.
pub(crate) fn unsuitable(path: &Path, problem: impl Into<String>) -> IoError {
    IoError::Library {
        path: path.to_owned(),
        source: LibraryError(problem.into()),
    }
}

/// The error for content that cannot be used.
pub(crate) fn content(path: &Path, problem: impl Into<String>) -> IoError {
    IoError::Content {
        path: path.to_owned(),
        problem: problem.into(),
    }
}

/// The error for a request that does not go with the file.
pub(crate) fn request(path: &Path, problem: impl Into<String>) -> IoError {
    IoError::Request {
        path: path.to_owned(),
        problem: problem.into(),
    }
}

/// Why a header card cannot be made.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum CardError {
    /// A keyword that FITS does not allow.
    #[error("{keyword:?} is not a FITS keyword: 1 to 8 of the characters A-Z, 0-9, - and _")]
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

/// Why a PSF library cannot be read, or why samples cannot be written as one, in a sentence.
///
/// It reaches the caller as the source of [`IoError::Library`], which names the file. HDUs, planes
/// and pixels are counted from 0.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct LibraryError(String);

/// Where a value stands in a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Row {
    /// The line of a text file, from 1.
    Line(u64),
    /// The row of a FITS table, from 0.
    Index(usize),
}

impl std::fmt::Display for Row {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Line(line) => write!(f, "line {line}"),
            Self::Index(row) => write!(f, "row {row} (0-based)"),
        }
    }
}
