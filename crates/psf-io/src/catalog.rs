//! Catalogues of stars and galaxies with columns by name.

use std::path::Path;

use psf_types::{DataError, PointSource, Position, SersicProfile, SersicSource};

use crate::catalog_columns::{LightColumn, PositionColumns, ShapeColumns, SourceColumns};
use crate::number_columns::{Gaps, NumberColumns};
use crate::table_file::TableFile;
use crate::{CatalogOptions, IoError, SkyCoordinates};

/// The sources of a catalogue, in the order of its rows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Catalog {
    stars: Vec<PointSource>,
    galaxies: Vec<SersicSource>,
    invalid_rows: usize,
    rows_off_projection: usize,
}

impl Catalog {
    /// The point sources.
    pub fn stars(&self) -> &[PointSource] {
        &self.stars
    }

    /// The sources with a Sersic profile.
    pub fn galaxies(&self) -> &[SersicSource] {
        &self.galaxies
    }

    /// Stars and galaxies, without a copy.
    pub fn into_parts(self) -> (Vec<PointSource>, Vec<SersicSource>) {
        (self.stars, self.galaxies)
    }

    /// Rows left out because they make no source; 0 unless
    /// [`with_invalid_skipped`](CatalogOptions::with_invalid_skipped) allows it.
    pub fn invalid_rows(&self) -> usize {
        self.invalid_rows
    }

    /// Rows left out because the frame's projection does not show their place on the sky: they lie far off the frame.
    pub fn rows_off_projection(&self) -> usize {
        self.rows_off_projection
    }
}

/// Reads a catalogue of stars and galaxies: see [`CatalogColumns`](crate::CatalogColumns) for its columns and
/// [`points`](crate::points) for the kinds of files.
///
/// In a catalogue with galaxies a row is a star where `re` is 0, empty or NaN; a galaxy that lacks its `n` is an invalid row.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("sources.csv");
/// use psf_io::{CatalogOptions, read_catalog_with};
/// std::fs::write(&path, "x,y,mag,re,n,q,angle\n10.5,3,20,,,,\n40,50,17.5,3.2,4,0.8,30\n")?;
/// let catalog = read_catalog_with(&path, &CatalogOptions::new().with_zero_point(25.0)?)?;
/// assert_eq!((catalog.stars().len(), catalog.galaxies().len()), (1, 1));
/// assert!((catalog.stars()[0].flux() - 100.0).abs() < 1e-9);
/// assert_eq!(catalog.galaxies()[0].profile().index(), 4.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`IoError::MissingColumn`]; [`IoError::Value`] with the row and column of a position or brightness that is missing or not finite;
/// [`IoError::Source`] with the row of a galaxy that is out of range; [`IoError::ZeroPoint`] for magnitudes without one;
/// [`IoError::UnusedZeroPoint`] for one without magnitudes; [`IoError::OneBasedSky`] for sky coordinates counted from 1;
/// [`IoError::NoWorldCoordinates`] for sky coordinates without [`with_sky`](CatalogOptions::with_sky); [`IoError::SeveralHdus`] when more than one table of a FITS file has the columns; and the
/// errors of any FITS or text table.
pub fn read_catalog_with(path: impl AsRef<Path>, options: &CatalogOptions) -> Result<Catalog, IoError> {
    let path = path.as_ref();
    let file = TableFile::open(path)?;
    let (columns, table) = file.pick(options.table.as_ref(), "x, y, flux", |names| {
        options.columns.sources(path, names)
    })?;
    let layout = Layout::new(path, options, &columns)?;
    let rows = Rows {
        path,
        numbers: table.read(&layout.names(), Gaps::Kept)?,
        layout,
    };
    let mut catalog = Catalog::default();
    for row in 0..rows.numbers.rows() {
        match rows.source(row) {
            Ok(Some(Source::Star(star))) => catalog.stars.push(star),
            Ok(Some(Source::Galaxy(galaxy))) => catalog.galaxies.push(galaxy),
            Ok(None) => catalog.rows_off_projection += 1,
            Err(_) if options.skip_invalid => catalog.invalid_rows += 1,
            Err(error) => return Err(error),
        }
    }
    Ok(catalog)
}

/// Reads the positions of a catalogue, one for each row.
///
/// # Errors
/// As [`read_catalog_with`]; no row may be invalid, whatever the options say, nor off the projection ([`IoError::OffProjection`]).
pub fn read_positions_with(
    path: impl AsRef<Path>,
    options: &CatalogOptions,
) -> Result<Vec<Position>, IoError> {
    let path = path.as_ref();
    let file = TableFile::open(path)?;
    let (columns, table) = file.pick(options.table.as_ref(), "x, y", |names| {
        options.columns.positions(path, names)
    })?;
    let layout = Layout {
        place: Place::new(path, options, &columns)?,
        light: None,
        shape: None,
    };
    let rows = Rows {
        path,
        numbers: table.read(&layout.names(), Gaps::Kept)?,
        layout,
    };
    let position = |row| {
        rows.position(row)?.ok_or_else(|| IoError::OffProjection {
            path: path.to_owned(),
            row: rows.numbers.place(row),
        })
    };
    (0..rows.numbers.rows()).map(position).collect()
}

/// What the columns to be read mean: those of the place come first, then that of the light, then those of the shape.
struct Layout<'a> {
    place: Place<'a>,
    light: Option<Light<'a>>,
    shape: Option<&'a ShapeColumns>,
}

/// How a position is made from two columns.
struct Place<'a> {
    columns: [&'a str; 2],
    kind: PlaceKind<'a>,
}

enum PlaceKind<'a> {
    /// Pixels, the first of which has this number.
    Pixels {
        first: f64,
    },
    Sky(&'a SkyCoordinates),
}

/// How a flux is made from a column.
struct Light<'a> {
    column: &'a str,
    /// For magnitudes.
    zero_point: Option<f64>,
}

impl<'a> Place<'a> {
    fn new(path: &Path, options: &'a CatalogOptions, columns: &'a PositionColumns) -> Result<Self, IoError> {
        let first = if options.one_based { 1.0 } else { 0.0 };
        match (columns, &options.sky) {
            (PositionColumns::Pixels { x, y }, _) => Ok(Self {
                columns: [x, y],
                kind: PlaceKind::Pixels { first },
            }),
            (PositionColumns::Sky { ra, dec }, _) if options.one_based => Err(IoError::OneBasedSky {
                path: path.to_owned(),
                ra: ra.clone(),
                dec: dec.clone(),
            }),
            (PositionColumns::Sky { ra, dec }, Some(sky)) => Ok(Self {
                columns: [ra, dec],
                kind: PlaceKind::Sky(sky),
            }),
            (PositionColumns::Sky { ra, dec }, None) => Err(IoError::NoWorldCoordinates {
                path: path.to_owned(),
                ra: ra.clone(),
                dec: dec.clone(),
            }),
        }
    }
}

impl<'a> Layout<'a> {
    fn new(path: &Path, options: &'a CatalogOptions, columns: &'a SourceColumns) -> Result<Self, IoError> {
        let light = match (&columns.light, options.zero_point) {
            (LightColumn::Flux(column), None) => Light {
                column,
                zero_point: None,
            },
            (LightColumn::Flux(column), Some(_)) => {
                return Err(IoError::UnusedZeroPoint {
                    path: path.to_owned(),
                    column: column.clone(),
                });
            }
            (LightColumn::Magnitude(column), Some(zero_point)) => Light {
                column,
                zero_point: Some(zero_point),
            },
            (LightColumn::Magnitude(column), None) => {
                return Err(IoError::ZeroPoint {
                    path: path.to_owned(),
                    column: column.clone(),
                });
            }
        };
        Ok(Self {
            place: Place::new(path, options, &columns.position)?,
            light: Some(light),
            shape: columns.shape.as_ref(),
        })
    }

    /// The columns to read, in order.
    fn names(&self) -> Vec<&'a str> {
        let shape = self.shape.iter().flat_map(|shape| {
            [
                Some(&shape.re),
                Some(&shape.n),
                shape.q.as_ref(),
                shape.angle.as_ref(),
            ]
        });
        let mut names = self.place.columns.to_vec();
        names.extend(self.light.as_ref().map(|light| light.column));
        names.extend(shape.flatten().map(String::as_str));
        names
    }
}

enum Source {
    Star(PointSource),
    Galaxy(SersicSource),
}

/// The rows of a catalogue.
struct Rows<'a> {
    path: &'a Path,
    layout: Layout<'a>,
    numbers: NumberColumns,
}

impl Rows<'_> {
    /// `None` off the projection.
    fn source(&self, row: usize) -> Result<Option<Source>, IoError> {
        let position = self.position(row)?;
        let invalid = |source| self.invalid(row, source);
        let light = self
            .layout
            .light
            .as_ref()
            .expect("sources have a column of light");
        let value = self.finite(row, 2, light.column)?;
        let flux = match light.zero_point {
            None => value,
            Some(zero_point) => 10.0_f64.powf(-0.4 * (value - zero_point)),
        };
        let profile = self.profile(row)?;
        let Some(position) = position else {
            return Ok(None);
        };
        let source = match profile {
            None => PointSource::new(position, flux).map(Source::Star),
            Some(profile) => SersicSource::new(position, flux, profile).map(Source::Galaxy),
        };
        source.map(Some).map_err(invalid)
    }

    /// `None` off the projection.
    fn position(&self, row: usize) -> Result<Option<Position>, IoError> {
        let place = &self.layout.place;
        let x = self.finite(row, 0, place.columns[0])?;
        let y = self.finite(row, 1, place.columns[1])?;
        match place.kind {
            PlaceKind::Pixels { first } => Position::new(x - first, y - first)
                .map(Some)
                .map_err(|source| self.invalid(row, source)),
            PlaceKind::Sky(_) if !(-90.0..=90.0).contains(&y) => Err(self.invalid(
                row,
                DataError::Setting {
                    name: "the declination",
                    allowed: "-90 to 90 degrees",
                    got: y.to_string(),
                },
            )),
            PlaceKind::Sky(sky) => Ok(sky.pixel(x, y)),
        }
    }

    /// The profile of a galaxy; `None` for a star.
    fn profile(&self, row: usize) -> Result<Option<SersicProfile>, IoError> {
        let Some(shape) = self.layout.shape else {
            return Ok(None);
        };
        let (re, n) = (self.value(row, 3), self.value(row, 4));
        if re == 0.0 || re.is_nan() {
            return Ok(None);
        }
        let q = if shape.q.is_some() {
            self.value(row, 5)
        } else {
            1.0
        };
        let angle = match &shape.angle {
            // A circle needs none.
            Some(_) if q == 1.0 => 0.0,
            Some(_) => self.value(row, 5 + usize::from(shape.q.is_some())),
            None => 0.0,
        };
        SersicProfile::new(re, n, q, angle)
            .map(Some)
            .map_err(|source| self.invalid(row, source))
    }

    fn value(&self, row: usize, column: usize) -> f64 {
        self.numbers.values()[column][row]
    }

    fn finite(&self, row: usize, column: usize, name: &str) -> Result<f64, IoError> {
        let value = self.value(row, column);
        if value.is_finite() {
            Ok(value)
        } else {
            Err(self.refused(row, name, value))
        }
    }

    fn refused(&self, row: usize, name: &str, value: f64) -> IoError {
        IoError::Value {
            path: self.path.to_owned(),
            row: self.numbers.place(row),
            column: name.to_owned(),
            got: if value.is_nan() {
                "NaN or nothing".to_owned()
            } else {
                value.to_string()
            },
        }
    }

    fn invalid(&self, row: usize, source: DataError) -> IoError {
        IoError::Source {
            path: self.path.to_owned(),
            row: self.numbers.place(row),
            source,
        }
    }
}
