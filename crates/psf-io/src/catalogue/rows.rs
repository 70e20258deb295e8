//! The rows of a catalogue: what their values mean, and which of them are valid.

use std::path::Path;

use psf_types::{DataError, PointSource, Position, SersicProfile, SersicSource};

use super::columns::{CatalogOptions, MOTION, Picked, Role};
use super::read_columns::{ReadColumns, SED, TEFF, VELOCITIES};
use super::sky_motion::SkyMotion;
use super::{Catalog, SourceColours};
use crate::error::{IoError, IoErrorKind, Place};
use crate::fits::columns::bad_value;

/// The rows of a catalogue's table.
pub(super) struct Rows<'a> {
    pub(super) path: &'a Path,
    pub(super) options: &'a CatalogOptions,
    pub(super) read: &'a ReadColumns,
}

impl<'a> Rows<'a> {
    /// Takes the columns of the table `path`.
    ///
    /// # Errors
    /// [`IoErrorKind::Setting`] for options that do not suit the columns.
    pub(super) fn new(
        path: &'a Path,
        options: &'a CatalogOptions,
        read: &'a ReadColumns,
    ) -> Result<Self, IoError> {
        check_options(path, options, &read.columns)?;
        Ok(Self { path, options, read })
    }

    /// The number of rows.
    pub(super) fn count(&self) -> usize {
        self.read.numbers.rows
    }

    /// The place of a row in the file.
    pub(super) fn row_place(&self, row: usize) -> Place {
        Place::Row(self.read.numbers.place(row))
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
        match self.shape(row, &place)? {
            Shape::Star => catalog.stars.push(PointSource::new(at, flux).map_err(invalid)?),
            Shape::Galaxy(profile) => {
                let galaxy = SersicSource::new(at, flux, profile).map_err(invalid)?;
                catalog.galaxies.push(galaxy);
            }
            Shape::OffProjection => catalog.rows_off_projection += 1,
        }
        Ok(())
    }

    /// Returns an error for a source without a spectrum.
    fn check_colour(&self, row: usize) -> Result<(), IoError> {
        let (column, problem) = match &self.read.colours {
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
        for (column, values) in VELOCITIES.iter().zip(self.read.velocities.iter().flatten()) {
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
            .filter(|_| self.read.places[Role::Ra as usize].is_some())
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
            .date()
            .filter(|_| moves.iter().any(|&role| self.has(role)))
        else {
            return Ok(position);
        };
        let epoch = if self.has(Role::Epoch) {
            let epoch = self.finite(row, Role::Epoch)?;
            if !EPOCHS.contains(&epoch) {
                return Err(self.refused(row, self.column(Role::Epoch), OF_EPOCH));
            }
            epoch
        } else {
            self.options.epoch.expect("checked with the columns")
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

    /// The shape of a source in pixels.
    fn shape(&self, row: usize, place: &SourcePlace) -> Result<Shape, IoError> {
        let value = |role| self.value(row, role);
        let size = if self.has(Role::ReArcsec) {
            Role::ReArcsec
        } else {
            Role::Re
        };
        let (Some(re), Some(n)) = (value(size), value(Role::N)) else {
            return Ok(Shape::Star);
        };
        if re == 0.0 {
            return Ok(Shape::Star);
        }
        if re.is_nan() {
            const MISSING: &str =
                "the half-light radius is missing or NaN: write 0 for a star, or skip invalid rows";
            return Err(self.refused(row, self.column(size), MISSING));
        }
        let q = value(Role::Q).unwrap_or(1.0);
        let on_sky = size == Role::ReArcsec;
        // From west towards north: north itself is at 90 degrees, and east at 180.
        let angle = match value(if on_sky { Role::PaDeg } else { Role::Angle }) {
            Some(angle) if on_sky => angle + 90.0,
            Some(angle) => angle,
            None if on_sky => 90.0,
            None => 0.0,
        };
        // A circle needs no angle.
        let angle = if q == 1.0 { 0.0 } else { angle };
        let g1 = value(Role::G1).unwrap_or(0.0);
        let g2 = value(Role::G2).unwrap_or(0.0);
        let profile = SersicProfile::new(re, n, q, angle).and_then(|profile| profile.sheared(g1, g2));
        let profile = profile.map_err(|source| self.invalid(row, source))?;
        if !on_sky {
            return Ok(Shape::Galaxy(profile));
        }
        // Far off the frame, the projection may turn an ellipse into a line.
        let mapped = self
            .pixels_per_arcsec(place)
            .and_then(|map| profile.mapped(map).ok());
        Ok(mapped.map_or(Shape::OffProjection, Shape::Galaxy))
    }

    /// The map from the sky to pixels at a source, if the projection has one there.
    fn pixels_per_arcsec(&self, place: &SourcePlace) -> Option<[[f64; 2]; 2]> {
        let sky = self.options.sky.as_ref().expect("checked with the columns");
        let (ra, dec) = place.sky.or_else(|| sky.sky(place.pixel))?;
        sky.pixels_per_arcsec(ra, dec)
    }

    fn has(&self, role: Role) -> bool {
        self.read.places[role as usize].is_some()
    }

    /// The value in the column of a role, or `None` without such a column.
    fn value(&self, row: usize, role: Role) -> Option<f64> {
        self.read.places[role as usize].map(|column| self.read.numbers.values[column][row])
    }

    /// The name of the column of a role.
    fn column(&self, role: Role) -> &str {
        self.read.columns.name(role).map_or("", String::as_str)
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
            self.read.numbers.place(row),
            self.column(role),
            &got,
        ))
    }

    /// The error for a value that no source may have, but which stands in catalogues.
    fn refused(&self, row: usize, column: &str, problem: &str) -> IoError {
        let (row, column) = (self.read.numbers.place(row), column.to_owned());
        IoError::new(self.path, IoErrorKind::Data, problem)
            .at(Place::Value { row, column })
            .with_setting("invalid_skipped")
    }

    fn invalid(&self, row: usize, source: DataError) -> IoError {
        IoError::new(self.path, IoErrorKind::Data, "the row is not valid")
            .at(Place::Row(self.read.numbers.place(row)))
            .because(source)
    }
}

/// The light of a source, in pixels.
enum Shape {
    Star,
    Galaxy(SersicProfile),
    /// The projection does not reach it.
    OffProjection,
}

/// Where a source is.
struct SourcePlace {
    pixel: Position,
    /// Right ascension and declination in degrees, at the date of the frame. `None` for positions in pixels.
    sky: Option<(f64, f64)>,
}

/// The Julian years that may be epochs of catalogues.
const EPOCHS: std::ops::RangeInclusive<f64> = 1800.0..=2200.0;
const OF_EPOCH: &str = "the epoch must be a Julian year from 1800 to 2200, as in 2016.0";

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
    if options.epoch.is_some_and(|epoch| !EPOCHS.contains(&epoch)) {
        return refused("epoch", OF_EPOCH.to_owned());
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
        let moved = [
            ("date", options.date.is_some()),
            ("epoch", options.epoch.is_some()),
        ];
        let Some((setting, _)) = moved.iter().find(|(_, is_given)| *is_given) else {
            return Ok(());
        };
        let problem = "the positions are pixels, which do not move: leave date and epoch out, or name columns of \
                       positions on the sky (ra and dec)";
        return refused(setting, problem.to_owned());
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
