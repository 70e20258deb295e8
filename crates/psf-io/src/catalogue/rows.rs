//! The rows of a catalogue: what their values mean, and which of them are valid.

use std::path::Path;

use psf_types::{DataError, PointSource, Position, SersicProfile, SersicSource};

use super::column_units::{KELVIN, PIXELS_PER_SECOND, factor, is_logarithmic};
use super::columns::{CatalogOptions, MOTION, NeededColumn, Picked, ROLES, Role};
use super::sky_motion::SkyMotion;
use super::table_file::{AnyTable, TableFile};
use super::{Catalog, SourceColours};
use crate::error::{IoError, IoErrorKind, Place};
use crate::fits::columns::{Nans, NumberColumns, bad_value, find, missing_column};

/// The rows of a catalogue's table, with the columns that are needed.
pub(super) struct Rows<'a> {
    pub(super) path: &'a Path,
    options: &'a CatalogOptions,
    columns: Picked,
    /// The place of the column of each role.
    places: [Option<usize>; ROLES.len()],
    pub(super) numbers: NumberColumns,
    /// The columns that change a source and are not read.
    pub(super) ignored: Vec<String>,
    pub(super) colours: Option<SourceColours>,
    pub(super) velocities: Option<[Vec<f64>; 2]>,
}

impl<'a> Rows<'a> {
    /// Reads the columns that `pick` chooses from a table. If the file has no tables, the error
    /// lists the columns in `needed`.
    pub(super) fn read(
        path: &'a Path,
        options: &'a CatalogOptions,
        needed: &str,
        pick: impl Fn(&Path, &[String]) -> Result<Picked, IoError>,
    ) -> Result<Self, IoError> {
        let file = TableFile::open(path)?;
        let (columns, table) = file.pick(options.table.as_ref(), needed, |names| pick(path, names))?;
        Self::of_table(path, options, columns, &table)
    }

    /// Reads these columns of a table, in the units of their roles.
    pub(super) fn of_table(
        path: &'a Path,
        options: &'a CatalogOptions,
        columns: Picked,
        table: &AnyTable<'_>,
    ) -> Result<Self, IoError> {
        check_options(path, options, &columns)?;
        let mut numbers = table.read(&columns.names(), Nans::Kept)?;
        for ((role, name), values) in columns.iter().zip(&mut numbers.values) {
            let wanted = role.unit().or(options.flux_unit.as_deref());
            in_unit(path, table, name, wanted, values)?;
        }
        Ok(Self {
            path,
            options,
            numbers,
            places: columns.places(),
            ignored: options.ignored_columns(&table.names()),
            colours: if options.with_colours {
                colours_of(path, table)?
            } else {
                None
            },
            velocities: if options.with_velocities {
                velocities_of(path, table)?
            } else {
                None
            },
            columns,
        })
    }

    /// Adds the source of a row to the catalogue. A source that the projection does not reach is
    /// only counted.
    pub(super) fn add_source(&self, row: usize, catalog: &mut Catalog) -> Result<(), IoError> {
        self.check_colour(row)?;
        self.check_velocity(row)?;
        let place = self.place(row)?;
        let flux = self.flux(row)?;
        let invalid = |source| self.invalid(row, source);
        let Some(place) = place else {
            catalog.rows_off_projection += 1;
            return Ok(());
        };
        let at = place.pixel;
        match self.profile(row, &place)? {
            None => catalog.stars.push(PointSource::new(at, flux).map_err(invalid)?),
            Some(profile) => {
                let galaxy = SersicSource::new(at, flux, profile).map_err(invalid)?;
                catalog.galaxies.push(galaxy);
            }
        }
        Ok(())
    }

    /// Returns an error for a source without a spectrum.
    fn check_colour(&self, row: usize) -> Result<(), IoError> {
        let (column, problem) = match &self.colours {
            Some(SourceColours::Names(names)) if names[row].is_empty() => {
                (SED, "the name of the spectrum is missing")
            }
            // A black body outside this range has no light at any wavelength of a telescope.
            Some(SourceColours::Temperatures(all)) if !(100.0..=1e9).contains(&all[row]) => {
                (TEFF, "the temperature must be from 100 to 1e9 kelvin")
            }
            _ => return Ok(()),
        };
        Err(self.refused(row, column, problem))
    }

    /// Returns an error for a source whose velocity is missing.
    fn check_velocity(&self, row: usize) -> Result<(), IoError> {
        for (column, values) in VELOCITIES.iter().zip(self.velocities.iter().flatten()) {
            if !values[row].is_finite() {
                const MISSING: &str =
                    "the velocity must be a finite number of pixels per second, 0 for a source at rest";
                return Err(self.refused(row, column, MISSING));
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
            return Err(self.refused(row, self.column(role), ZERO));
        }
        Ok(flux)
    }

    /// The position of a source, or `None` if the projection does not reach it.
    pub(super) fn position(&self, row: usize) -> Result<Option<Position>, IoError> {
        Ok(self.place(row)?.map(|place| place.pixel))
    }

    /// The place of a source, or `None` if the projection does not reach it.
    fn place(&self, row: usize) -> Result<Option<SourcePlace>, IoError> {
        let Some(sky) = self
            .options
            .sky
            .as_ref()
            .filter(|_| self.places[Role::Ra as usize].is_some())
        else {
            let first = if self.options.one_based { 1.0 } else { 0.0 };
            let (x, y) = (self.finite(row, Role::X)?, self.finite(row, Role::Y)?);
            let pixel = Position::new(x - first, y - first);
            let pixel = pixel.map_err(|source| self.invalid(row, source))?;
            return Ok(Some(SourcePlace { pixel, sky: None }));
        };
        let (ra, dec) = (self.finite(row, Role::Ra)?, self.finite(row, Role::Dec)?);
        if !(-90.0..=90.0).contains(&dec) {
            let source = DataError::setting("the declination", "-90 to 90 degrees", dec);
            return Err(self.invalid(row, source));
        }
        let (ra, dec) = self.on_date(row, (ra, dec))?;
        let place = |pixel| SourcePlace {
            pixel,
            sky: Some((ra, dec)),
        };
        Ok(sky.pixel(ra, dec).map(place))
    }

    /// The position on the sky at the date of the frame.
    fn on_date(&self, row: usize, position: (f64, f64)) -> Result<(f64, f64), IoError> {
        let moves = [Role::PmRa, Role::Parallax, Role::RadialVelocity];
        let Some(date) = self
            .options
            .date
            .filter(|_| moves.iter().any(|&role| self.has(role)))
        else {
            return Ok(position);
        };
        let epoch = match self.has(Role::Epoch) {
            true => self.finite(row, Role::Epoch)?,
            false => self.options.epoch.expect("checked with the columns"),
        };
        let or_zero = |role| self.value(row, role).unwrap_or(0.0);
        let motion = SkyMotion {
            epoch,
            pmra: or_zero(Role::PmRa),
            pmdec: or_zero(Role::PmDec),
            parallax: or_zero(Role::Parallax),
            radial_velocity: or_zero(Role::RadialVelocity),
        };
        Ok(date.position(position, &motion))
    }

    /// The profile of a galaxy in pixels, or `None` for a star.
    fn profile(&self, row: usize, place: &SourcePlace) -> Result<Option<SersicProfile>, IoError> {
        let value = |role| self.value(row, role);
        let size = if self.has(Role::ReArcsec) {
            Role::ReArcsec
        } else {
            Role::Re
        };
        let (Some(re), Some(n)) = (value(size), value(Role::N)) else {
            return Ok(None);
        };
        if re == 0.0 {
            return Ok(None);
        }
        if re.is_nan() {
            const MISSING: &str =
                "the half-light radius is missing or NaN: write 0 for a star, or skip invalid rows";
            return Err(self.refused(row, self.column(size), MISSING));
        }
        let q = value(Role::Q).unwrap_or(1.0);
        let angle = match size {
            // From west towards north. North itself is at 90 degrees, and east at 180.
            Role::ReArcsec => value(Role::PaDeg).map(|angle| angle + 90.0),
            _ => value(Role::Angle),
        };
        // A circle needs no angle.
        let angle = angle.filter(|_| q != 1.0).unwrap_or(0.0);
        let g1 = value(Role::G1).unwrap_or(0.0);
        let g2 = value(Role::G2).unwrap_or(0.0);
        SersicProfile::new(re, n, q, angle)
            .and_then(|profile| profile.sheared(g1, g2))
            .and_then(|profile| match size {
                Role::ReArcsec => profile.mapped(self.pixels_per_arcsec(place)),
                _ => Ok(profile),
            })
            .map(Some)
            .map_err(|source| self.invalid(row, source))
    }

    /// The map from the sky to pixels at a source.
    fn pixels_per_arcsec(&self, place: &SourcePlace) -> [[f64; 2]; 2] {
        let sky = self.options.sky.as_ref().expect("checked with the columns");
        let at = place.sky.or_else(|| sky.sky(place.pixel));
        // A profile of size NaN is refused.
        at.and_then(|(ra, dec)| sky.pixels_per_arcsec(ra, dec))
            .unwrap_or([[f64::NAN; 2]; 2])
    }

    fn has(&self, role: Role) -> bool {
        self.places[role as usize].is_some()
    }

    /// The value in the column of a role, or `None` without such a column.
    fn value(&self, row: usize, role: Role) -> Option<f64> {
        self.places[role as usize].map(|column| self.numbers.values[column][row])
    }

    /// The name of the column of a role.
    fn column(&self, role: Role) -> &str {
        self.columns.name(role).map_or("", String::as_str)
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
        Err(bad_value(
            self.path,
            self.numbers.place(row),
            self.column(role),
            &got,
        ))
    }

    /// The error for a value that no source may have, but which stands in catalogues.
    fn refused(&self, row: usize, column: &str, problem: &str) -> IoError {
        let (row, column) = (self.numbers.place(row), column.to_owned());
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

/// Where a source is.
struct SourcePlace {
    pixel: Position,
    /// Right ascension and declination in degrees, at the date of the frame. `None` for positions in pixels.
    sky: Option<(f64, f64)>,
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
    if let Some(size) = columns.name(Role::ReArcsec)
        && options.sky.is_none()
    {
        let problem = format!(
            "the column {size:?} holds sizes on the sky, but the world coordinates of the frame are missing: give an image \
             whose header has them, or sizes in pixels (re)"
        );
        return refused("sky", problem);
    }
    let moves = MOTION.iter().find_map(|&role| columns.name(role));
    if let Some(motion) = moves
        && columns.name(Role::Epoch).is_none()
        && options.epoch.is_none()
    {
        let problem = format!(
            "the column {motion:?} moves the sources from the epoch of the catalogue to the date of the frame, but the epoch is \
             not known: give a column epoch, or the epoch of the catalogue"
        );
        return refused("epoch", problem);
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
             an image whose header has them, or positions in pixels"
        );
        return refused("sky", problem);
    }
    Ok(())
}

/// Reads the columns of the velocities, if both exist.
fn velocities_of(path: &Path, table: &AnyTable<'_>) -> Result<Option<[Vec<f64>; 2]>, IoError> {
    let names = table.names();
    let has = |column: &&str| names.iter().any(|name| name.eq_ignore_ascii_case(column));
    match VELOCITIES.iter().filter(|column| has(column)).count() {
        0 => return Ok(None),
        1 => {
            let missing = VELOCITIES.iter().find(|column| !has(column)).expect("one of two");
            return Err(missing_column(path, &names, missing, ""));
        }
        _ => {}
    }
    let mut columns = table.read(&VELOCITIES, Nans::Kept)?.values;
    for (name, values) in VELOCITIES.iter().zip(&mut columns) {
        in_unit(path, table, name, Some(PIXELS_PER_SECOND), values)?;
    }
    Ok(columns.try_into().ok())
}

/// Converts the values of a column to a unit, or without one keeps those of any flux.
fn in_unit(
    path: &Path,
    table: &AnyTable<'_>,
    name: &str,
    wanted: Option<&str>,
    values: &mut [f64],
) -> Result<(), IoError> {
    let unit = table.unit(name)?;
    let factor = match wanted {
        Some(wanted) => factor(&unit, wanted),
        None => (!is_logarithmic(&unit)).then_some(1.0),
    };
    let Some(factor) = factor else {
        let needed = match wanted {
            None => "a flux".to_owned(),
            Some("") => "a number without a unit".to_owned(),
            Some(wanted) => format!("a number in {wanted}"),
        };
        let problem = format!("the unit is {unit:?}, but {needed} is needed: convert the column");
        let place = Place::Column(name.to_owned());
        return Err(IoError::new(path, IoErrorKind::Table, problem).at(place));
    };
    if factor != 1.0 {
        for value in values {
            *value *= factor;
        }
    }
    Ok(())
}

/// Columns that change where a source is, and are read only with a date of the frame.
const OF_MOTION: [&str; 5] = ["pmra", "pmdec", "parallax", "epoch", "ref_epoch"];

impl CatalogOptions {
    /// The columns that a catalogue needs of a table with these column names. `table` is the path of the table,
    /// or its name in messages.
    ///
    /// # Errors
    /// [`IoErrorKind::Table`] for a column that does not exist.
    pub fn columns_of(
        &self,
        table: impl AsRef<Path>,
        names: &[String],
    ) -> Result<Vec<NeededColumn>, IoError> {
        let table = table.as_ref();
        let picked = self.sources(table, names)?;
        let mut wanted: Vec<(&'static str, &str, Option<&'static str>)> = picked
            .iter()
            .map(|(role, name)| (ROLES[role as usize], name, role.unit()))
            .collect();
        let has = |column: &str| names.iter().any(|name| name.eq_ignore_ascii_case(column));
        if self.with_colours && has(SED) {
            wanted.push((SED, SED, None));
        } else if self.with_colours && has(TEFF) {
            wanted.push((TEFF, TEFF, Some(KELVIN)));
        }
        if self.with_velocities {
            let velocities = VELOCITIES.into_iter().filter(|column| has(column));
            wanted.extend(velocities.map(|name| (name, name, Some(PIXELS_PER_SECOND))));
        }
        let of = |(role, name, unit)| {
            let name = names[find(table, names.iter(), name)?].clone();
            Ok(NeededColumn { role, name, unit })
        };
        wanted.into_iter().map(of).collect()
    }

    /// The columns of sources in a table with these column names.
    pub(super) fn sources(&self, table: &Path, names: &[String]) -> Result<Picked, IoError> {
        match self.date {
            Some(_) => self.columns.moving_sources(table, names),
            None => self.columns.sources(table, names),
        }
    }

    /// The columns among `names` that may change a source and are not read.
    pub fn ignored_columns(&self, names: &[String]) -> Vec<String> {
        let is = |name: &str, of: &[&str]| of.iter().any(|other| name.eq_ignore_ascii_case(other));
        let unread = |name: &&String| {
            (self.date.is_none() && is(name, &OF_MOTION))
                || (!self.with_colours && is(name, &[SED, TEFF]))
                || (!self.with_velocities && is(name, &VELOCITIES))
        };
        names.iter().filter(unread).cloned().collect()
    }
}

/// The columns of the velocities of sources.
const VELOCITIES: [&str; 2] = ["vx", "vy"];

/// Reads the spectra of all rows of a table: the column `sed` or, without it, the column `teff`.
fn colours_of(path: &Path, table: &AnyTable<'_>) -> Result<Option<SourceColours>, IoError> {
    let has = |column: &str| table.names().iter().any(|name| name.eq_ignore_ascii_case(column));
    if has(SED) {
        return Ok(Some(SourceColours::Names(table.read_texts(SED)?)));
    }
    if !has(TEFF) {
        return Ok(None);
    }
    let mut columns = table.read(&[TEFF], Nans::Kept)?.values;
    in_unit(path, table, TEFF, Some(KELVIN), &mut columns[0])?;
    Ok(columns.pop().map(SourceColours::Temperatures))
}

/// The columns of the names of spectra and of the temperatures of black bodies.
const SED: &str = "sed";
const TEFF: &str = "teff";
