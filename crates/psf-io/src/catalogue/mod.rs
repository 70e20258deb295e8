//! Reads catalogues and lists of positions from tables.
//!
//! # Layout
//!
//! A file holds a text table, or it is a FITS file with a binary table. The content of the file
//! decides which, not its name.
//!
//! | column | meaning |
//! |---|---|
//! | `x`, `y` | position in pixels of the frame, 0-based; a whole number is the centre of a pixel, fractions and positions outside the frame are allowed |
//! | `flux` | total flux of the source (catalogues only) |
//!
//! Case is ignored in names, columns may be in any order, and further columns are ignored.
//! For other names, 1-based pixels, magnitudes, sky coordinates and galaxies see
//! [`read_catalog_with`] and [`CatalogColumns`](crate::CatalogColumns).
//!
//! - **Text**: fields are separated by commas, tabs or blanks, and may be quoted. The names of
//!   the columns are in the first line that does not start with `#`. If that line is a row of
//!   numbers, the names are in the last comment before it. SExtractor's `ASCII_HEAD` is supported
//!   too. Empty lines and later lines that start with `#` are skipped. If the first column is not read, such a
//!   line that looks like a row is an error.
//! - **FITS**: the binary table that has the columns, such as `LDAC_OBJECTS` of a `FITS_LDAC`
//!   catalogue. Each column holds one number per row, of any integer or float type. If several
//!   tables have the columns, one must be chosen.
//!
//! A catalogue made in Python:
//!
//! ```python
//! from astropy.table import Table
//! catalogue = Table({"x": x, "y": y, "flux": flux})    # 0-based pixels
//! catalogue.write("stars.csv")                         # or "stars.fits"
//! ```

use std::path::Path;

use psf_types::{DataError, PointSource, Position, SersicSource};

use crate::error::{IoError, IoErrorKind};
use crate::fits::columns::Table;
use crate::fits::structure::FitsStructure;
use columns::CatalogOptions;
use memory_table::MemoryTable;
use read_columns::ReadColumns;
use rows::Rows;
use table_file::AnyTable;

mod column_units;
pub(crate) mod columns;
pub(crate) mod curves;
mod ecsv;
pub(crate) mod memory_table;
mod read_columns;
mod rows;
pub(crate) mod sky_catalog;
pub(crate) mod sky_coordinates;
pub(crate) mod sky_motion;
pub(crate) mod sky_pointing;
pub(crate) mod table_file;
mod text_table;
pub(crate) mod world_header;

/// Reads a catalogue of point sources from the columns x, y and flux. Other columns are ignored.
/// Use [`read_catalog_with`] to read galaxies too.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("stars.csv");
/// std::fs::write(&path, "# two stars\nid,Flux,x,y\n1,1e5,10.25,3\n2,20,-4,7.5\n")?;
/// let stars = psf_io::read_catalog(&path)?;
/// assert_eq!((stars[1].position().x(), stars[0].flux()), (-4.0, 1e5));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`IoErrorKind::Table`] for a missing column or a malformed text table, [`IoErrorKind::Setting`]
/// if several tables of a FITS file have the columns, [`IoErrorKind::Data`] with the row and column
/// of a value that is not a finite number or of a flux of 0, and the [errors of any FITS
/// file](crate#bad-files).
pub fn read_catalog(path: impl AsRef<Path>) -> Result<Vec<PointSource>, IoError> {
    let options = CatalogOptions::new();
    let path = path.as_ref();
    let read = ReadColumns::of_file(path, &options, "x, y, flux", |path, names| {
        options.columns.points(path, names)
    })?;
    let rows = Rows::new(path, &options, &read)?;
    let mut catalog = Catalog::default();
    for row in 0..rows.count() {
        rows.add_source(row, &mut catalog)?;
    }
    Ok(catalog.stars)
}

/// Reads a list of positions from the columns x and y.
///
/// # Errors
/// The errors of [`read_positions_with`].
pub fn read_positions(path: impl AsRef<Path>) -> Result<Vec<Position>, IoError> {
    read_positions_with(path, &CatalogOptions::new())
}

/// Returns whether a file has a binary table with the columns x and y.
pub(crate) fn has_points(structure: &FitsStructure) -> bool {
    let has = |table: Table| ["x", "y"].iter().all(|name| table.column(name).is_ok());
    structure.tables().any(|hdu| Table::new(hdu).is_ok_and(has))
}

/// The sources of a catalogue: stars and galaxies, each in the order of their rows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Catalog {
    stars: Vec<PointSource>,
    galaxies: Vec<SersicSource>,
    colours: Option<SourceColours>,
    /// Of the stars, then of the galaxies.
    rows: Vec<usize>,
    velocities: Option<Vec<[f64; 2]>>,
    invalid_rows: usize,
    rows_off_projection: usize,
    ignored_columns: Vec<String>,
}

/// The spectra of the sources of a catalogue: those of the stars, then those of the galaxies.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum SourceColours {
    /// The names of spectra, from a column `sed`.
    Names(Vec<String>),
    /// Temperatures of black bodies in kelvin, from a column `teff`.
    Temperatures(Vec<f64>),
}

impl Catalog {
    /// A catalogue of these stars and galaxies. The rows are counted through both, the stars first.
    pub fn new(stars: Vec<PointSource>, galaxies: Vec<SersicSource>) -> Self {
        Self {
            rows: (0..stars.len() + galaxies.len()).collect(),
            stars,
            galaxies,
            ..Self::default()
        }
    }

    /// The point sources.
    pub fn stars(&self) -> &[PointSource] {
        &self.stars
    }

    /// The sources with a Sersic profile.
    pub fn galaxies(&self) -> &[SersicSource] {
        &self.galaxies
    }

    /// The spectra of the sources. None if the catalogue has neither a column `sed` nor `teff`, or if
    /// they were not asked for ([`CatalogOptions::with_colours`]).
    pub fn colours(&self) -> Option<&SourceColours> {
        self.colours.as_ref()
    }

    /// The row of the table from which each source comes, counted from 0: of the stars, then of the
    /// galaxies.
    pub fn rows(&self) -> &[usize] {
        &self.rows
    }

    /// Returns this catalogue with the row numbers of a larger table: row `i` is row `rows[i]` there.
    ///
    /// # Panics
    /// Without a number for each row.
    #[must_use]
    pub fn with_rows_of(mut self, rows: &[usize]) -> Self {
        for row in &mut self.rows {
            *row = rows[*row];
        }
        self
    }

    /// The velocities of the stars, then of the galaxies, along x and y in pixels per second: the
    /// columns `vx` and `vy`. None without these columns, or if they were not asked for
    /// ([`CatalogOptions::with_velocities`]).
    pub fn velocities(&self) -> Option<&[[f64; 2]]> {
        self.velocities.as_deref()
    }

    /// Number of rows skipped because they are not valid sources. It is 0 unless
    /// [`with_invalid_skipped`](CatalogOptions::with_invalid_skipped) was set.
    pub fn invalid_rows(&self) -> usize {
        self.invalid_rows
    }

    /// Number of rows skipped because the projection of the frame does not reach their position on
    /// the sky. Such a position is far off the frame.
    pub fn rows_off_projection(&self) -> usize {
        self.rows_off_projection
    }

    /// The names of columns that change a source and were not read: proper motions, parallaxes, epochs,
    /// and spectra or velocities that were not asked for.
    pub fn ignored_columns(&self) -> &[String] {
        &self.ignored_columns
    }

    /// The text of a warning that names these columns, if there are any.
    pub fn ignored_warning(&self) -> Option<String> {
        let columns = self.ignored_columns.join(", ");
        (!columns.is_empty())
            .then(|| format!("not read, though they may change the sources: the columns {columns}"))
    }

    /// Returns this catalogue with all fluxes multiplied by a factor, such as an exposure time.
    ///
    /// # Errors
    /// [`DataError`] if a product is 0 or not finite.
    pub fn with_flux_times(mut self, factor: f64) -> Result<Self, DataError> {
        for star in &mut self.stars {
            *star = PointSource::new(star.position(), star.flux() * factor)?;
        }
        for galaxy in &mut self.galaxies {
            *galaxy = SersicSource::new(galaxy.position(), galaxy.flux() * factor, galaxy.profile())?;
        }
        Ok(self)
    }

    /// Returns the stars and galaxies without a copy.
    pub fn into_parts(self) -> (Vec<PointSource>, Vec<SersicSource>) {
        (self.stars, self.galaxies)
    }
}

/// Reads a catalogue of stars and galaxies. See [`CatalogColumns`](crate::CatalogColumns) for its columns and [this
/// module](self) for the kinds of files.
///
/// In a catalogue with galaxies, a row with `re` 0 is a star. A row whose `re` is empty or NaN is
/// invalid. So is a galaxy whose `n`, `q`, `g1` or `g2` is empty, and a galaxy whose `angle` is
/// empty, unless its `q` is 1. A flux of 0 is invalid, a negative flux is allowed.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("sources.csv");
/// use psf_io::{CatalogOptions, read_catalog_with};
/// std::fs::write(&path, "x,y,mag,re,n,q,angle\n10.5,3,20,0,,,\n40,50,17.5,3.2,4,0.8,30\n")?;
/// let catalog = read_catalog_with(&path, &CatalogOptions::new().with_zero_point(25.0)?)?;
/// assert_eq!((catalog.stars().len(), catalog.galaxies().len()), (1, 1));
/// assert!((catalog.stars()[0].flux() - 100.0).abs() < 1e-9);
/// assert_eq!(catalog.galaxies()[0].profile().index(), 4.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// - [`IoErrorKind::Table`] if a required column does not exist, or the rows of a text table do not
///   match the column names
/// - [`IoErrorKind::Data`] if a position, a brightness or an `re` is missing or not finite, if a
///   flux is 0, or if a text is not a number. The error names the row and the column of the table.
/// - [`IoErrorKind::Data`] if a declination or a galaxy parameter is out of range. The error names
///   the row of the table.
/// - [`IoErrorKind::Setting`] for magnitudes without a zero point, a zero point without magnitudes,
///   sky coordinates with [`with_one_based`](CatalogOptions::with_one_based), or sky coordinates
///   without [`with_sky`](CatalogOptions::with_sky)
/// - [`IoErrorKind::Setting`] if several tables of a FITS file have the columns and none is chosen
/// - the [errors of any FITS file](crate#bad-files)
pub fn read_catalog_with(path: impl AsRef<Path>, options: &CatalogOptions) -> Result<Catalog, IoError> {
    let path = path.as_ref();
    let read = ReadColumns::of_file(path, options, "x, y, flux", |path, names| {
        options.sources(path, names)
    })?;
    let rows = Rows::new(path, options, &read)?;
    sources_of(&rows, 0..rows.count())
}

/// Takes the stars and galaxies of a table in memory, as [`read_catalog_with`] takes those of a file. The
/// values have the units of their roles ([`CatalogOptions::columns_of`]).
///
/// # Errors
/// The errors of [`read_catalog_with`], except those of files.
pub fn catalog_of(table: &MemoryTable, options: &CatalogOptions) -> Result<Catalog, IoError> {
    let path = table.name();
    let columns = options.sources(path, &table.names())?;
    let read = ReadColumns::of_table(path, options, columns, &AnyTable::Memory(table))?;
    let rows = Rows::new(path, options, &read)?;
    sources_of(&rows, 0..rows.count())
}

/// The sources of some rows, in their order.
fn sources_of(rows: &Rows<'_>, chosen: impl IntoIterator<Item = usize>) -> Result<Catalog, IoError> {
    let mut catalog = Catalog::default();
    // The rows of the stars and of the galaxies.
    let (mut of_stars, mut of_galaxies) = (Vec::new(), Vec::new());
    for row in chosen {
        match rows.add_source(row, &mut catalog) {
            Ok(()) => {}
            Err(_) if rows.options.skip_invalid => catalog.invalid_rows += 1,
            Err(error) => return Err(error),
        }
        // The row has added at most one source.
        of_stars.resize(catalog.stars.len(), row);
        of_galaxies.resize(catalog.galaxies.len(), row);
    }
    let order = || of_stars.iter().chain(&of_galaxies);
    catalog.colours = rows.read.colours.as_ref().map(|colours| match colours {
        SourceColours::Names(all) => SourceColours::Names(order().map(|&row| all[row].clone()).collect()),
        SourceColours::Temperatures(all) => {
            SourceColours::Temperatures(order().map(|&row| all[row]).collect())
        }
    });
    let of = |velocities: &[Vec<f64>; 2], row: usize| [velocities[0][row], velocities[1][row]];
    catalog.velocities = rows
        .read
        .velocities
        .as_ref()
        .map(|velocities| order().map(|&row| of(velocities, row)).collect());
    catalog.rows = order().copied().collect();
    catalog.ignored_columns.clone_from(&rows.read.ignored);
    Ok(catalog)
}

/// Reads the positions of a catalogue, one per row.
///
/// # Errors
/// - the errors of [`read_catalog_with`], even for an invalid row that `options` would skip in a
///   catalogue
/// - [`IoErrorKind::Data`] for a position that the projection of the frame does not reach
pub fn read_positions_with(
    path: impl AsRef<Path>,
    options: &CatalogOptions,
) -> Result<Vec<Position>, IoError> {
    let path = path.as_ref();
    let read = ReadColumns::of_file(path, options, "x, y", |path, names| {
        options.columns.positions(path, names)
    })?;
    let rows = Rows::new(path, options, &read)?;
    let position = |row| {
        rows.position(row)?.ok_or_else(|| {
            const OUTSIDE: &str =
                "the position on the sky is outside the projection of the frame: remove the row";
            IoError::new(rows.path, IoErrorKind::Data, OUTSIDE).at(rows.row_place(row))
        })
    };
    (0..rows.count()).map(position).collect()
}
