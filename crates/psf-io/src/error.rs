//! What goes wrong with files.

use std::ops::Range;
use std::path::{Path, PathBuf};

use psf_types::DataError;
use thiserror::Error;

use crate::{CardError, GriddedError, HduChoice, Row};

/// Why a file could not be read or written.
///
/// Every variant names the file. As is usual for errors with a [`source`](std::error::Error::source), the text of the
/// cause is not repeated in the text of the error: print the whole chain.
///
/// HDUs are counted from 0 (the primary), as astropy does; so are rows of FITS tables, pixels and planes. Lines of a text
/// file are counted from 1.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum IoError {
    /// The file cannot be opened or read.
    #[error("{}: cannot read the file", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file cannot be written.
    #[error("{}: cannot write the file", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The output exists and may not be replaced.
    #[error("{}: the file exists: choose another name, or allow it to be replaced with --overwrite", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The output's directory does not exist.
    #[error("{}: there is no directory {}: create it first", path.display(), directory.display())]
    MissingDirectory {
        /// The file.
        path: PathBuf,
        /// Its directory.
        directory: PathBuf,
    },
    /// A directory, a device or a pipe where a file is needed.
    #[error("{}: this is not a regular file", path.display())]
    NotAFile {
        /// What was given.
        path: PathBuf,
    },
    /// A name that CFITSIO cannot take.
    #[error(
        "{}: CFITSIO takes file names of at most {limit} bytes, with their directories and without NUL: use a shorter one",
        path.display()
    )]
    FileName {
        /// The file.
        path: PathBuf,
        /// The longest name.
        limit: usize,
    },
    /// A file of another format.
    #[error("{}: this is not a FITS file (a FITS file starts with \"SIMPLE  =\")", path.display())]
    NotFits {
        /// The file.
        path: PathBuf,
    },
    /// A file compressed in a way that is not read.
    #[error("{}: {what}: {remedy}", path.display())]
    Compressed {
        /// The file.
        path: PathBuf,
        /// How it is compressed.
        what: &'static str,
        /// What undoes it.
        remedy: &'static str,
    },
    /// A tile of a compressed image that does not hold what its lengths say.
    #[error("{}: HDU {hdu}: tile {tile} (0-based) of the compressed image is damaged: fetch or write it again", path.display())]
    Tile {
        /// The file.
        path: PathBuf,
        /// The HDU.
        hdu: usize,
        /// The tile, a row of the table.
        tile: usize,
    },
    /// Data compressed by gzip that cannot be unpacked.
    #[error("{}: the gzip data are damaged or cut short after {at} bytes of the FITS file: fetch or write it again", path.display())]
    Gzip {
        /// The file.
        path: PathBuf,
        /// Bytes unpacked up to there.
        at: u64,
        /// What is wrong.
        source: std::io::Error,
    },
    /// A gzip file that would unpack to more than its size lets expect.
    #[error(
        "{}: {length} bytes of gzip data would unpack to more than {allowed}: if this is right, run gunzip first",
        path.display()
    )]
    UnpacksTooLarge {
        /// The file.
        path: PathBuf,
        /// Its bytes.
        length: u64,
        /// What it may unpack to.
        allowed: u64,
    },
    /// The temporary copy of an unpacked file cannot be written.
    #[error("{}: cannot unpack to the folder for temporary files: set TMPDIR to one with room", path.display())]
    Unpacking {
        /// The compressed file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A file that ends before its data do.
    #[error(
        "{}: the file is cut short: HDU {hdu} needs at least {needed} bytes, there are {length}: fetch or write it again",
        path.display()
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
    #[error("{}: HDU {hdu}: {keyword}: {problem}", path.display())]
    Header {
        /// The file.
        path: PathBuf,
        /// The HDU.
        hdu: usize,
        /// The keyword in question.
        keyword: String,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// No HDU of the kind needed.
    #[error("{}: the file has no {what}", path.display())]
    MissingHdu {
        /// The file.
        path: PathBuf,
        /// What was looked for.
        what: String,
    },
    /// Several HDUs that could be meant.
    #[error(
        "{}: the file has {} {what}, in the HDUs {}: choose one with {option}",
        path.display(), found.len(), found.join(", ")
    )]
    SeveralHdus {
        /// The file.
        path: PathBuf,
        /// What they hold.
        what: &'static str,
        /// The option of the command line that chooses.
        option: &'static str,
        /// Number and name of each.
        found: Vec<String>,
    },
    /// A choice that is none of the HDUs that could be meant.
    #[error("{}: HDU {wanted} is none of the {what} in the file, which are in the HDUs {}", path.display(), found.join(", "))]
    NoSuchHdu {
        /// The file.
        path: PathBuf,
        /// What is looked for.
        what: &'static str,
        /// What was asked for.
        wanted: HduChoice,
        /// Number and name of each HDU that there is.
        found: Vec<String>,
    },
    /// A FITS table of text.
    #[error(
        "{}: HDU {hdu} is an ASCII table (XTENSION = 'TABLE'), which is not read: write it as a binary table or as CSV, as astropy's \
         Table.read(FILE).write(OTHER) does",
        path.display()
    )]
    AsciiTable {
        /// The file.
        path: PathBuf,
        /// The HDU.
        hdu: usize,
    },
    /// A keyword that must be there.
    #[error("{}: HDU {hdu} has no keyword {keyword} ({expected})", path.display())]
    MissingKeyword {
        /// The file.
        path: PathBuf,
        /// The HDU.
        hdu: usize,
        /// The keyword.
        keyword: &'static str,
        /// What it would hold.
        expected: &'static str,
    },
    /// A keyword whose value is not what it must be.
    #[error("{}: HDU {hdu}: keyword {keyword} must be {expected}, got {got}", path.display())]
    Keyword {
        /// The file.
        path: PathBuf,
        /// The HDU.
        hdu: usize,
        /// The keyword.
        keyword: &'static str,
        /// What it must be.
        expected: &'static str,
        /// What it is.
        got: String,
    },
    /// A file written by a later version of the format.
    #[error(
        "{}: this is a {format} file of version {got}; versions 1 to {supported} can be read: update psfield",
        path.display()
    )]
    Version {
        /// The file.
        path: PathBuf,
        /// The format.
        format: &'static str,
        /// Its version.
        got: i64,
        /// The newest version that can be read.
        supported: i64,
    },
    /// An image with the wrong number of axes.
    #[error("{}: HDU {hdu} is {got:?} (axes in array order, x last), {expected} is needed", path.display())]
    Axes {
        /// The file.
        path: PathBuf,
        /// The HDU.
        hdu: usize,
        /// What is needed, in words.
        expected: &'static str,
        /// The shape in array order: `NAXIS1` last.
        got: Vec<usize>,
    },
    /// NaN or infinite pixels.
    #[error(
        "{}: HDU {hdu} has {count} pixel(s) that are NaN, infinite or BLANK; the first is {value} at {index:?} (0-based, x \
         last): replace them by numbers",
        path.display()
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
    #[error(
        "{}: rows {} to {} (not included, 0-based) are not all in an image of {ny} rows",
        path.display(), rows.start, rows.end
    )]
    Rows {
        /// The file.
        path: PathBuf,
        /// The rows to be read or written.
        rows: Range<usize>,
        /// Rows of the image.
        ny: usize,
    },
    /// A plane that a cube does not have.
    #[error("{}: there is no plane {plane}: the image has {planes}, counted from 0", path.display())]
    Plane {
        /// The file.
        path: PathBuf,
        /// The plane asked for.
        plane: usize,
        /// Planes of the cube.
        planes: usize,
    },
    /// A band of rows that is not as wide as the image.
    #[error("{}: a band of rows must be as wide as the image, {expected} columns, got {got}", path.display())]
    BandWidth {
        /// The file.
        path: PathBuf,
        /// Columns of the image.
        expected: usize,
        /// Columns of the band.
        got: usize,
    },
    /// An image that is finished before all its rows are written.
    #[error("{}: the image has {expected} rows, only {got} were written: write the rest first", path.display())]
    Incomplete {
        /// The file.
        path: PathBuf,
        /// Rows of the image.
        expected: usize,
        /// Rows written.
        got: usize,
    },
    /// A value that an image of whole numbers cannot hold.
    #[error(
        "{}: the pixel {index:?} ([y, x]) is {value}: a whole number from {lowest} to {highest} is needed",
        path.display()
    )]
    NotWhole {
        /// The file.
        path: PathBuf,
        /// The pixel.
        index: [usize; 2],
        /// Its value.
        value: f64,
        /// The lowest number allowed.
        lowest: i32,
        /// The highest number allowed.
        highest: i32,
    },
    /// Values that single precision cannot hold.
    #[error("{}: a value is beyond the range of single precision: use double precision", path.display())]
    Overflow {
        /// The file.
        path: PathBuf,
    },
    /// A table without a column that is needed.
    #[error("{}: there is no column {column:?}; the columns are {}", path.display(), found.join(", "))]
    MissingColumn {
        /// The file.
        path: PathBuf,
        /// The column looked for, upper or lower case.
        column: String,
        /// The columns there are.
        found: Vec<String>,
    },
    /// Two columns of one name, upper and lower case being the same.
    #[error("{}: the column {column:?} is there more than once: rename or remove one", path.display())]
    AmbiguousColumn {
        /// The file.
        path: PathBuf,
        /// The column.
        column: String,
    },
    /// A column of a FITS table that does not hold one number (or as many as needed) a row.
    #[error("{}: HDU {hdu}: the column {column:?} has the format {got}, {expected} is needed", path.display())]
    ColumnFormat {
        /// The file.
        path: PathBuf,
        /// The HDU.
        hdu: usize,
        /// The column.
        column: String,
        /// What is needed, in words.
        expected: String,
        /// Its TFORM.
        got: String,
    },
    /// A value of a table that is not a finite number.
    #[error("{}: {row}: {column} is {got:?}, a finite number is needed", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// Where.
        row: Row,
        /// The column.
        column: String,
        /// What stands there.
        got: String,
    },
    /// A row of a text table that does not have one field a column.
    #[error("{}: {row} has {got} fields, the column names say {expected}", path.display())]
    RowLength {
        /// The file.
        path: PathBuf,
        /// Where.
        row: Row,
        /// Number of columns.
        expected: u64,
        /// Number of fields.
        got: u64,
    },
    /// A row of a catalogue that does not make a source.
    #[error("{}: {row} is not a valid source", path.display())]
    Source {
        /// The file.
        path: PathBuf,
        /// Where.
        row: Row,
        /// What is wrong.
        source: DataError,
    },
    /// Magnitudes without the magnitude of flux 1.
    #[error(
        "{}: the column {column:?} holds magnitudes: give the magnitude of flux 1 with --zero-point",
        path.display()
    )]
    ZeroPoint {
        /// The file.
        path: PathBuf,
        /// The column.
        column: String,
    },
    /// The magnitude of flux 1 where fluxes are read.
    #[error(
        "{}: the column {column:?} holds fluxes, for which --zero-point has no meaning: leave it out, or name the column of magnitudes \
         with --columns mag=COLUMN",
        path.display()
    )]
    UnusedZeroPoint {
        /// The file.
        path: PathBuf,
        /// The column.
        column: String,
    },
    /// Positions counted from 1 where they are on the sky.
    #[error(
        "{}: the columns {ra:?} and {dec:?} are sky coordinates, for which --one-based has no meaning: leave it out, or name columns of \
         pixels with --columns x=COLUMN,y=COLUMN",
        path.display()
    )]
    OneBasedSky {
        /// The file.
        path: PathBuf,
        /// The column of right ascensions.
        ra: String,
        /// The column of declinations.
        dec: String,
    },
    /// Sky coordinates without the world coordinates of the frame.
    #[error(
        "{}: the columns {ra:?} and {dec:?} are sky coordinates, and no world coordinates of the frame are given: give a scene whose \
         header has them, or positions in pixels",
        path.display()
    )]
    NoWorldCoordinates {
        /// The file.
        path: PathBuf,
        /// The column of right ascensions.
        ra: String,
        /// The column of declinations.
        dec: String,
    },
    /// A position that the frame's projection does not show.
    #[error("{}: {row} is a place on the sky that the projection of the frame does not show: remove the row", path.display())]
    OffProjection {
        /// The file.
        path: PathBuf,
        /// Where.
        row: Row,
    },
    /// A text table that is not well formed, or a row that cannot be written.
    #[error("{}: not a well-formed CSV table", path.display())]
    Csv {
        /// The file.
        path: PathBuf,
        /// What is wrong, and in which line.
        source: csv::Error,
    },
    /// Data that break an invariant of their type.
    #[error("{}: the data are not valid", path.display())]
    Data {
        /// The file.
        path: PathBuf,
        /// Which invariant, and where.
        source: DataError,
    },
    /// A PSF library that cannot be read, or samples that cannot be written as one.
    #[error("{}: the PSF library cannot be used", path.display())]
    Library {
        /// The file.
        path: PathBuf,
        /// What is wrong, and where.
        source: GriddedError,
    },
    /// A header card that cannot be written.
    #[error("{}: a header card cannot be written", path.display())]
    Card {
        /// The file.
        path: PathBuf,
        /// Why.
        source: CardError,
    },
    /// CFITSIO refused.
    #[error("{}: {doing}: CFITSIO status {status}: {text}", path.display())]
    Cfitsio {
        /// The file.
        path: PathBuf,
        /// What was being done.
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
            | Self::Exists { path }
            | Self::MissingDirectory { path, .. }
            | Self::NotAFile { path }
            | Self::FileName { path, .. }
            | Self::NotFits { path }
            | Self::Compressed { path, .. }
            | Self::Tile { path, .. }
            | Self::Gzip { path, .. }
            | Self::UnpacksTooLarge { path, .. }
            | Self::Unpacking { path, .. }
            | Self::Truncated { path, .. }
            | Self::Header { path, .. }
            | Self::MissingHdu { path, .. }
            | Self::SeveralHdus { path, .. }
            | Self::NoSuchHdu { path, .. }
            | Self::Source { path, .. }
            | Self::ZeroPoint { path, .. }
            | Self::NoWorldCoordinates { path, .. }
            | Self::OffProjection { path, .. }
            | Self::MissingKeyword { path, .. }
            | Self::Keyword { path, .. }
            | Self::Version { path, .. }
            | Self::Axes { path, .. }
            | Self::NonFinitePixels { path, .. }
            | Self::Rows { path, .. }
            | Self::Plane { path, .. }
            | Self::BandWidth { path, .. }
            | Self::Incomplete { path, .. }
            | Self::NotWhole { path, .. }
            | Self::Overflow { path }
            | Self::AsciiTable { path, .. }
            | Self::UnusedZeroPoint { path, .. }
            | Self::OneBasedSky { path, .. }
            | Self::MissingColumn { path, .. }
            | Self::AmbiguousColumn { path, .. }
            | Self::ColumnFormat { path, .. }
            | Self::Value { path, .. }
            | Self::RowLength { path, .. }
            | Self::Csv { path, .. }
            | Self::Data { path, .. }
            | Self::Library { path, .. }
            | Self::Card { path, .. }
            | Self::Cfitsio { path, .. } => path,
        }
    }
}

/// `map_err` for data that do not make the type they should.
pub(crate) fn invalid(path: &Path) -> impl FnOnce(DataError) -> IoError + '_ {
    move |source| IoError::Data {
        path: path.to_owned(),
        source,
    }
}

/// `map_err` for cards that cannot be written.
pub(crate) fn bad_card(path: &Path) -> impl FnOnce(CardError) -> IoError + '_ {
    move |source| IoError::Card {
        path: path.to_owned(),
        source,
    }
}

/// `map_err` for PSF libraries that are not what they should be.
pub(crate) fn unsuitable(path: &Path) -> impl Fn(GriddedError) -> IoError + Copy + '_ {
    move |source| IoError::Library {
        path: path.to_owned(),
        source,
    }
}
