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
//! [`read_catalog_with`] and [`CatalogColumns`].
//!
//! - **Text**: fields are separated by commas (values may be quoted), tabs or blanks. The names of
//!   the columns are in the first line that does not start with `#`. If that line is a row of
//!   numbers, the names are in the last comment before it. SExtractor's `ASCII_HEAD` is supported
//!   too. Empty lines and later lines that start with `#` are skipped.
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

use psf_types::{DataError, PointSource, Position, SersicProfile, SersicSource};

use crate::error::{IoError, IoErrorKind, Place};
use crate::fits::columns::{Nans, NumberColumns, Table, bad_value, missing_column};
use crate::fits::structure::FitsStructure;
use columns::{CatalogColumns, CatalogOptions, Picked, Role};
use table_file::{AnyTable, TableFile};

pub(crate) mod columns;
pub(crate) mod curves;

pub(crate) mod sky_coordinates;
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
    let rows = Rows::read(path.as_ref(), &options, "x, y, flux", CatalogColumns::points)?;
    let mut catalog = Catalog::default();
    for row in 0..rows.numbers.rows {
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

    /// Returns the stars and galaxies without a copy.
    pub fn into_parts(self) -> (Vec<PointSource>, Vec<SersicSource>) {
        (self.stars, self.galaxies)
    }
}

/// Reads a catalogue of stars and galaxies. See [`CatalogColumns`] for its columns and [this
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
    let rows = Rows::read(path.as_ref(), options, "x, y, flux", CatalogColumns::sources)?;
    let mut catalog = Catalog::default();
    // The rows of the stars and of the galaxies.
    let (mut of_stars, mut of_galaxies) = (Vec::new(), Vec::new());
    for row in 0..rows.numbers.rows {
        let (stars, galaxies) = (catalog.stars.len(), catalog.galaxies.len());
        match rows
            .check_colour(row)
            .and_then(|()| rows.check_velocity(row))
            .and_then(|()| rows.add_source(row, &mut catalog))
        {
            Ok(()) => {}
            Err(_) if options.skip_invalid => catalog.invalid_rows += 1,
            Err(error) => return Err(error),
        }
        if catalog.stars.len() > stars {
            of_stars.push(row);
        }
        if catalog.galaxies.len() > galaxies {
            of_galaxies.push(row);
        }
    }
    let order = || of_stars.iter().chain(&of_galaxies);
    catalog.colours = rows.colours.as_ref().map(|colours| match colours {
        SourceColours::Names(all) => SourceColours::Names(order().map(|&row| all[row].clone()).collect()),
        SourceColours::Temperatures(all) => {
            SourceColours::Temperatures(order().map(|&row| all[row]).collect())
        }
    });
    let of = |velocities: &[Vec<f64>; 2], row: usize| [velocities[0][row], velocities[1][row]];
    catalog.velocities = rows
        .velocities
        .as_ref()
        .map(|velocities| order().map(|&row| of(velocities, row)).collect());
    catalog.rows = order().copied().collect();
    Ok(catalog)
}

/// Reads the columns of the velocities, if both exist.
fn velocities_of(path: &Path, table: &AnyTable<'_>) -> Result<Option<[Vec<f64>; 2]>, IoError> {
    let names = table.names();
    let has = |column: &&str| names.iter().any(|name| name.eq_ignore_ascii_case(column));
    match VELOCITIES.iter().filter(|column| has(column)).count() {
        0 => return Ok(None),
        1 => {
            let missing = VELOCITIES.iter().find(|column| !has(column)).expect("one of two");
            return Err(missing_column(path, &names, missing));
        }
        _ => {}
    }
    let columns = table.read(&VELOCITIES, Nans::Kept)?.values;
    Ok(columns.try_into().ok())
}

/// The columns of the velocities of sources.
const VELOCITIES: [&str; 2] = ["vx", "vy"];

/// Reads the spectra of all rows of a table: the column `sed` or, without it, the column `teff`.
fn colours_of(table: &AnyTable<'_>) -> Result<Option<SourceColours>, IoError> {
    let has = |column: &str| table.names().iter().any(|name| name.eq_ignore_ascii_case(column));
    if has(SED) {
        return Ok(Some(SourceColours::Names(table.read_texts(SED)?)));
    }
    if !has(TEFF) {
        return Ok(None);
    }
    let mut columns = table.read(&[TEFF], Nans::Kept)?.values;
    Ok(columns.pop().map(SourceColours::Temperatures))
}

/// The columns of the names of spectra and of the temperatures of black bodies.
const SED: &str = "sed";
const TEFF: &str = "teff";

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
    let rows = Rows::read(path.as_ref(), options, "x, y", CatalogColumns::positions)?;
    let position = |row| {
        rows.position(row)?.ok_or_else(|| {
            const OUTSIDE: &str =
                "the position on the sky is outside the projection of the frame: remove the row";
            IoError::new(rows.path, IoErrorKind::Data, OUTSIDE).at(Place::Row(rows.numbers.place(row)))
        })
    };
    (0..rows.numbers.rows).map(position).collect()
}

struct Rows<'a> {
    path: &'a Path,
    options: &'a CatalogOptions,
    columns: Picked,
    numbers: NumberColumns,
    colours: Option<SourceColours>,
    velocities: Option<[Vec<f64>; 2]>,
}

impl<'a> Rows<'a> {
    /// Reads the columns that `pick` chooses from a table. If the file has no tables, the error
    /// lists the columns in `needed`.
    fn read(
        path: &'a Path,
        options: &'a CatalogOptions,
        needed: &str,
        pick: fn(&CatalogColumns, &Path, &[String]) -> Result<Picked, IoError>,
    ) -> Result<Self, IoError> {
        let file = TableFile::open(path)?;
        let (columns, table) = file.pick(options.table.as_ref(), needed, |names| {
            pick(&options.columns, path, names)
        })?;
        check_options(path, options, &columns)?;
        Ok(Self {
            path,
            options,
            numbers: table.read(&columns.names(), Nans::Kept)?,
            colours: if options.with_colours {
                colours_of(&table)?
            } else {
                None
            },
            velocities: if options.with_velocities {
                velocities_of(path, &table)?
            } else {
                None
            },
            columns,
        })
    }

    /// Adds the source of a row to the catalogue. A source that the projection does not reach is
    /// only counted.
    fn add_source(&self, row: usize, catalog: &mut Catalog) -> Result<(), IoError> {
        let position = self.position(row)?;
        let flux = self.flux(row)?;
        let invalid = |source| self.invalid(row, source);
        match (position, self.profile(row)?) {
            (None, _) => catalog.rows_off_projection += 1,
            (Some(at), None) => catalog.stars.push(PointSource::new(at, flux).map_err(invalid)?),
            (Some(at), Some(profile)) => {
                catalog
                    .galaxies
                    .push(SersicSource::new(at, flux, profile).map_err(invalid)?);
            }
        }
        Ok(())
    }

    /// Returns an error for a source without a spectrum.
    fn check_colour(&self, row: usize) -> Result<(), IoError> {
        let problem = match &self.colours {
            Some(SourceColours::Names(names)) if names[row].is_empty() => {
                "the name of the spectrum is missing"
            }
            // A black body outside this range has no light at any wavelength of a telescope.
            Some(SourceColours::Temperatures(all)) if !(100.0..=1e9).contains(&all[row]) => {
                "the temperature must be from 100 to 1e9 kelvin"
            }
            _ => return Ok(()),
        };
        let column = match self.colours {
            Some(SourceColours::Names(_)) => SED,
            _ => TEFF,
        };
        let (row, column) = (self.numbers.place(row), column.to_owned());
        let error = IoError::new(self.path, IoErrorKind::Data, problem).at(Place::Value { row, column });
        Err(error.with_setting("invalid_skipped"))
    }

    /// Returns an error for a source whose velocity is missing.
    fn check_velocity(&self, row: usize) -> Result<(), IoError> {
        for (column, values) in VELOCITIES.iter().zip(self.velocities.iter().flatten()) {
            if !values[row].is_finite() {
                let problem =
                    "the velocity must be a finite number of pixels per second, 0 for a source at rest";
                let (row, column) = (self.numbers.place(row), (*column).to_owned());
                let error =
                    IoError::new(self.path, IoErrorKind::Data, problem).at(Place::Value { row, column });
                return Err(error.with_setting("invalid_skipped"));
            }
        }
        Ok(())
    }

    /// The flux of a source. A flux of 0 is refused, because it often stands for a missing value.
    fn flux(&self, row: usize) -> Result<f64, IoError> {
        let (role, flux) = match self.options.zero_point {
            None => (Role::Flux, self.finite(row, Role::Flux)?),
            Some(zero_point) => {
                let magnitude = self.finite(row, Role::Mag)?;
                (Role::Mag, 10.0_f64.powf(-0.4 * (magnitude - zero_point)))
            }
        };
        if flux == 0.0 {
            const ZERO: &str = "the flux of the source is 0: remove the row, or skip invalid rows";
            return Err(self.refused(row, role, ZERO));
        }
        Ok(flux)
    }

    /// The position of a source, or `None` if the projection does not reach it.
    fn position(&self, row: usize) -> Result<Option<Position>, IoError> {
        let Some(sky) = self
            .options
            .sky
            .as_ref()
            .filter(|_| self.columns.place(Role::Ra).is_some())
        else {
            let first = if self.options.one_based { 1.0 } else { 0.0 };
            let (x, y) = (self.finite(row, Role::X)?, self.finite(row, Role::Y)?);
            let position = Position::new(x - first, y - first);
            return position.map(Some).map_err(|source| self.invalid(row, source));
        };
        let (ra, dec) = (self.finite(row, Role::Ra)?, self.finite(row, Role::Dec)?);
        if (-90.0..=90.0).contains(&dec) {
            return Ok(sky.pixel(ra, dec));
        }
        let source = DataError::setting("the declination", "-90 to 90 degrees", dec);
        Err(self.invalid(row, source))
    }

    /// The profile of a galaxy, or `None` for a star.
    fn profile(&self, row: usize) -> Result<Option<SersicProfile>, IoError> {
        let value = |role| self.value(row, role);
        let (Some(re), Some(n)) = (value(Role::Re), value(Role::N)) else {
            return Ok(None);
        };
        if re == 0.0 {
            return Ok(None);
        }
        if re.is_nan() {
            const MISSING: &str =
                "the half-light radius is missing or NaN: write 0 for a star, or skip invalid rows";
            return Err(self.refused(row, Role::Re, MISSING));
        }
        let q = value(Role::Q).unwrap_or(1.0);
        // A circle needs no angle.
        let angle = value(Role::Angle).filter(|_| q != 1.0).unwrap_or(0.0);
        let g1 = value(Role::G1).unwrap_or(0.0);
        let g2 = value(Role::G2).unwrap_or(0.0);
        SersicProfile::new(re, n, q, angle)
            .and_then(|profile| profile.sheared(g1, g2))
            .map(Some)
            .map_err(|source| self.invalid(row, source))
    }

    /// The value in the column of a role, or `None` without such a column.
    fn value(&self, row: usize, role: Role) -> Option<f64> {
        self.columns
            .place(role)
            .map(|column| self.numbers.values[column][row])
    }

    fn finite(&self, row: usize, role: Role) -> Result<f64, IoError> {
        let value = self.value(row, role).expect("the column is read");
        if value.is_finite() {
            return Ok(value);
        }
        let got = if value.is_nan() {
            "missing or NaN".to_owned()
        } else {
            value.to_string()
        };
        let column = self.columns.name(role).map_or("", String::as_str);
        Err(bad_value(self.path, self.numbers.place(row), column, &got))
    }

    /// The error for a value that no source may have, but which stands in catalogues.
    fn refused(&self, row: usize, role: Role, problem: &str) -> IoError {
        let column = self.columns.name(role).cloned().unwrap_or_default();
        let row = self.numbers.place(row);
        IoError::new(self.path, IoErrorKind::Data, problem)
            .at(Place::Value { row, column })
            .with_setting("invalid_skipped")
    }

    fn invalid(&self, row: usize, source: DataError) -> IoError {
        IoError::new(self.path, IoErrorKind::Data, "the row is not valid")
            .at(Place::Row(self.numbers.place(row)))
            .because(source)
    }
}

/// Checks that the options suit the columns.
fn check_options(path: &Path, options: &CatalogOptions, columns: &Picked) -> Result<(), IoError> {
    let refused = |setting, problem: String| {
        Err(IoError::new(path, IoErrorKind::Setting, problem).with_setting(setting))
    };
    match (
        columns.name(Role::Flux),
        columns.name(Role::Mag),
        options.zero_point,
    ) {
        (Some(flux), _, Some(_)) => {
            let problem = format!(
                "the column {flux:?} holds fluxes, for which a zero point has no meaning: leave the zero point out, or name the \
                 column of magnitudes (mag)"
            );
            return refused("zero_point", problem);
        }
        (_, Some(magnitude), None) => {
            let problem = format!(
                "the column {magnitude:?} holds magnitudes: give the zero point, the magnitude of flux 1"
            );
            return refused("zero_point", problem);
        }
        _ => {}
    }
    let (Some(ra), Some(dec)) = (columns.name(Role::Ra), columns.name(Role::Dec)) else {
        return Ok(());
    };
    if options.one_based {
        let problem = format!(
            "the columns {ra:?} and {dec:?} are sky coordinates, which are not counted from 1: leave out the setting for 1-based pixels, or \
             name columns of pixels (x and y)"
        );
        return refused("one_based", problem);
    }
    if options.sky.is_none() {
        let problem = format!(
            "the columns {ra:?} and {dec:?} are sky coordinates, but the world coordinates of the frame are missing: give \
             positions in pixels, or (for the sources of a simulation) an image whose header has world coordinates"
        );
        return refused("sky", problem);
    }
    Ok(())
}
