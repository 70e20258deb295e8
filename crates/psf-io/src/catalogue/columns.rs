//! The roles of the columns of a catalogue, and the options for reading it.

use std::path::Path;

use psf_types::DataError;

use crate::catalogue::column_units::{
    ARCSECONDS, DEGREES, KILOMETRES_PER_SECOND, MAGNITUDES, MAS, MAS_PER_YEAR, NONE, PIXELS, YEARS,
};
use crate::catalogue::sky_coordinates::SkyCoordinates;
use crate::catalogue::sky_motion::ObservationDate;
use crate::error::IoError;
use crate::fits::columns::missing_column;
use crate::fits::hdu::HduChoice;

/// The columns of a catalogue by role, with default or chosen names.
///
/// | role | default column | meaning |
/// |---|---|---|
/// | `x`, `y` | `x`, `y` (or `x_0`, `y_0`) | position in pixels of the frame |
/// | `ra`, `dec` | `ra`, `dec` | position on the sky in degrees, instead of `x` and `y` |
/// | `flux` | `flux` | total flux |
/// | `mag` | `mag` | magnitude instead of flux: `flux = 10^(-0.4 (mag - zero point))` |
/// | `pmra`, `pmdec` | `pmra`, `pmdec` | proper motion in mas per year, with the factor `cos(dec)` in `pmra` |
/// | `parallax` | `parallax` | parallax in mas |
/// | `radial_velocity` | `radial_velocity` | km/s away from the Sun |
/// | `epoch` | `epoch` or `ref_epoch` | Julian year at which `ra` and `dec` hold |
/// | `re` | `re` | galaxies: half-light radius along the major axis, in pixels |
/// | `re_arcsec` | `re_arcsec` | galaxies: this radius in arcseconds on the sky, instead of `re` |
/// | `pa_deg` | `pa_deg` | galaxies with `re_arcsec`: position angle of the major axis, from north towards east; 0 without such a column |
/// | `n` | `n` | galaxies: Sersic index, 0.3 to 8 |
/// | `q` | `q` | galaxies: minor over major axis, 0.001 to 1; 1 without such a column |
/// | `angle` | `angle` | galaxies: angle of the major axis in degrees, from +x towards +y; 0 without such a column |
/// | `g1`, `g2` | `g1`, `g2` | galaxies: reduced shear, `sqrt(g1^2 + g2^2)` below 1; no shear without such columns |
///
/// A unit that the table states (`TUNIT` in FITS, `unit` in ECSV, `[unit]` in SExtractor's comments) is
/// converted to the unit of the role, or refused: angles and sky coordinates to degrees (from `rad`,
/// `arcmin`, `arcsec`, `mas` or `hourangle`), fluxes to the unit of the image
/// ([`CatalogOptions::with_flux_unit`]). A position or `re` in arcseconds is an error.
///
/// With `re_arcsec`, the shape is that on the sky: `pa_deg` takes the place of `angle`, and `g1 > 0` stretches
/// east-west, `g2 > 0` along the diagonal between north and west, as for a galaxy that GalSim draws through world
/// coordinates. The world coordinates of the frame map it to pixels at the source's position
/// ([`SkyCoordinates::pixels_per_arcsec`](crate::SkyCoordinates::pixels_per_arcsec)).
///
/// Sources with `ra` and `dec` are moved from the epoch of the catalogue to the date of the frame, if both are known: the
/// epoch from its column or by [`CatalogOptions::with_epoch`], the date by [`CatalogOptions::with_date`] or else from the
/// header of the world coordinates. Otherwise the columns of motions are not read. Empty or NaN motions and
/// parallaxes count as 0, as Gaia leaves those of many stars empty.
///
/// The spectra of sources are in a column `sed` or `teff`, which is read only on request
/// ([`CatalogOptions::with_colours`]). So are the columns `vx` and `vy` with the velocities of sources
/// ([`CatalogOptions::with_velocities`]).
///
/// The caller may choose the column of a role. A role without a choice uses its default column, if
/// that column exists. If the default columns of `x`, `y`, `ra` and `dec` all exist, `x` and `y`
/// are used. Likewise, `flux` is used rather than `mag`. A zero point together with fluxes is an
/// error. So if a table has the columns `flux` and `mag` and a zero point is set, choose the column
/// of the role `mag`. A catalogue with a column for `re` has galaxies and needs a column for `n`.
/// Case is ignored in names.
///
/// The shear is applied to the galaxy that `re`, `n`, `q` and `angle` describe, and keeps its area
/// ([`SersicProfile::sheared`](psf_types::SersicProfile::sheared), as GalSim's
/// `shear(g1=, g2=)`). With `g1` and `g2` in place of `q` and `angle`, `re` is thus the half-light
/// radius of the round galaxy. `g1 > 0` stretches along x, `g2 > 0` along the diagonal between +x
/// and +y. `angle`, `g1` and `g2` refer to the axes of the pixels, also in a catalogue with sky
/// coordinates.
///
/// Text form: `role=COLUMN`, separated by commas.
///
/// ```
/// use psf_io::CatalogColumns;
/// let columns: CatalogColumns = "x=X_IMAGE,y=Y_IMAGE,flux=FLUX_AUTO".parse()?;
/// assert_eq!(columns.to_string(), "x=X_IMAGE,y=Y_IMAGE,flux=FLUX_AUTO");
/// assert!("x=X_IMAGE".parse::<CatalogColumns>().is_err()); // y is missing
/// # Ok::<(), psf_types::DataError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct CatalogColumns {
    /// The column given for each role, or `None` for the default.
    given: [Option<String>; ROLES.len()],
}

/// The names of the roles, in the order of [`Role`].
pub(crate) const ROLES: [&str; 19] = [
    "x",
    "y",
    "ra",
    "dec",
    "flux",
    "mag",
    "re",
    "n",
    "q",
    "angle",
    "g1",
    "g2",
    "re_arcsec",
    "pa_deg",
    "pmra",
    "pmdec",
    "parallax",
    "radial_velocity",
    "epoch",
];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Role {
    X,
    Y,
    Ra,
    Dec,
    Flux,
    Mag,
    Re,
    N,
    Q,
    Angle,
    G1,
    G2,
    ReArcsec,
    PaDeg,
    PmRa,
    PmDec,
    Parallax,
    RadialVelocity,
    Epoch,
}

/// The roles that tell how sources move on the sky.
pub(crate) const MOTION: [Role; 5] = [
    Role::PmRa,
    Role::PmDec,
    Role::Parallax,
    Role::RadialVelocity,
    Role::Epoch,
];

impl Role {
    /// The unit of the values. `None` for a flux, which has the unit of the image.
    pub(crate) fn unit(self) -> Option<&'static str> {
        match self {
            Self::X | Self::Y | Self::Re => Some(PIXELS),
            Self::Ra | Self::Dec | Self::Angle | Self::PaDeg => Some(DEGREES),
            Self::ReArcsec => Some(ARCSECONDS),
            Self::PmRa | Self::PmDec => Some(MAS_PER_YEAR),
            Self::Parallax => Some(MAS),
            Self::RadialVelocity => Some(KILOMETRES_PER_SECOND),
            Self::Epoch => Some(YEARS),
            Self::Mag => Some(MAGNITUDES),
            Self::N | Self::Q | Self::G1 | Self::G2 => Some(NONE),
            Self::Flux => None,
        }
    }
}

/// The columns to read from a table, each with its role.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Picked {
    columns: Vec<(Role, String)>,
}

impl Picked {
    /// The names of the columns, in the order of reading.
    pub(crate) fn names(&self) -> Vec<&str> {
        self.columns.iter().map(|(_, name)| name.as_str()).collect()
    }

    /// The index of the column of a role among the names.
    pub(crate) fn place(&self, role: Role) -> Option<usize> {
        self.columns.iter().position(|(r, _)| *r == role)
    }

    /// The index of the column of each role.
    pub(crate) fn places(&self) -> [Option<usize>; ROLES.len()] {
        let mut places = [None; ROLES.len()];
        for (place, (role, _)) in self.columns.iter().enumerate() {
            places[*role as usize] = Some(place);
        }
        places
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = (Role, &str)> {
        self.columns.iter().map(|(role, name)| (*role, name.as_str()))
    }

    pub(crate) fn name(&self, role: Role) -> Option<&String> {
        self.place(role).map(|place| &self.columns[place].1)
    }
}

/// A column that a catalogue needs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NeededColumn {
    /// Its meaning: `x`, `flux` and so on.
    pub role: &'static str,
    /// Its name in the table.
    pub name: String,
    /// The unit of its values: `pix`, `deg`, `mag`, an empty text for numbers without a unit, or `None` for a
    /// flux, which has the unit of the image, and for `sed`, which holds texts.
    pub unit: Option<&'static str>,
}

/// Why a column is needed, for the message that it is missing.
fn purpose(role: Role) -> &'static str {
    match role {
        Role::X | Role::Y | Role::Ra | Role::Dec => ", but positions need x and y, or ra and dec",
        Role::N => ", but galaxies need their Sersic index",
        Role::G1 | Role::G2 => ", but a shear needs both columns g1 and g2",
        Role::PmRa | Role::PmDec => ", but a proper motion needs both columns pmra and pmdec",
        _ => "",
    }
}

impl CatalogColumns {
    /// The columns of positions in a table with these column names: [`Role::X`] and [`Role::Y`], or
    /// [`Role::Ra`] and [`Role::Dec`].
    pub(crate) fn positions(&self, path: &Path, names: &[String]) -> Result<Picked, IoError> {
        let has = |role| self.is_in(names, role);
        let in_pixels = self.is_given(Role::X) || (has(Role::X) && has(Role::Y));
        let on_sky = self.is_given(Role::Ra) || (!in_pixels && has(Role::Ra) && has(Role::Dec));
        let roles = if on_sky {
            [Role::Ra, Role::Dec]
        } else {
            [Role::X, Role::Y]
        };
        self.picked(path, names, &roles)
    }

    /// The columns [`Role::X`], [`Role::Y`] and [`Role::Flux`] in a table with these column names.
    pub(crate) fn points(&self, path: &Path, names: &[String]) -> Result<Picked, IoError> {
        self.picked(path, names, &[Role::X, Role::Y, Role::Flux])
    }

    /// The columns of sources in a table with these column names: the position, [`Role::Flux`] or
    /// [`Role::Mag`], and the columns of galaxies.
    pub(crate) fn sources(&self, path: &Path, names: &[String]) -> Result<Picked, IoError> {
        let has = |role| self.is_in(names, role);
        let by_magnitude =
            self.is_given(Role::Mag) || (!self.is_given(Role::Flux) && !has(Role::Flux) && has(Role::Mag));
        let mut roles = vec![if by_magnitude { Role::Mag } else { Role::Flux }];
        // A table without a brightness is refused for that first.
        self.picked(path, names, &roles)?;
        let mut all = self.positions(path, names)?;
        let on_sky = all.place(Role::Ra).is_some();
        let is_wanted = |role| has(role) || self.is_given(role);
        let size_on_sky = self.size_is_on_sky(names, on_sky);
        let shape = if size_on_sky {
            [Role::ReArcsec, Role::N, Role::Q, Role::PaDeg, Role::G1, Role::G2]
        } else {
            [Role::Re, Role::N, Role::Q, Role::Angle, Role::G1, Role::G2]
        };
        if has(shape[0]) || shape.iter().any(|&role| self.is_given(role)) {
            let optional = |&role: &Role| is_wanted(role);
            roles.extend(&shape[..2]);
            roles.extend(shape[2..4].iter().copied().filter(optional));
            if shape[4..].iter().any(optional) {
                roles.extend(&shape[4..]);
            }
        }
        all.columns.extend(self.picked(path, names, &roles)?.columns);
        Ok(all)
    }

    /// Returns whether the sizes of galaxies are those on the sky. They are preferred on the side on which positions
    /// are.
    fn size_is_on_sky(&self, names: &[String], on_sky: bool) -> bool {
        let has = |role| self.is_in(names, role);
        self.is_given(Role::ReArcsec)
            || (!self.is_given(Role::Re) && has(Role::ReArcsec) && (on_sky || !has(Role::Re)))
    }

    /// The angle of galaxies that does not belong to their sizes, if it is the only one in the table: `angle` beside
    /// `re_arcsec`, or `pa_deg` beside `re`.
    pub(crate) fn unused_angle(&self, names: &[String]) -> Option<&'static str> {
        let has = |role| self.is_in(names, role) || self.is_given(role);
        let on_sky = self.size_is_on_sky(names, has(Role::Ra) && !has(Role::X));
        let (size, used, other) = if on_sky {
            (Role::ReArcsec, Role::PaDeg, Role::Angle)
        } else {
            (Role::Re, Role::Angle, Role::PaDeg)
        };
        (has(size) && !has(used) && has(other)).then_some(ROLES[other as usize])
    }

    /// The columns of sources, and those of their motion if positions are on the sky.
    pub(crate) fn moving_sources(&self, path: &Path, names: &[String]) -> Result<Picked, IoError> {
        let mut all = self.sources(path, names)?;
        if all.place(Role::Ra).is_some() {
            let is_wanted = |role| self.is_in(names, role) || self.is_given(role);
            let mut roles: Vec<Role> = MOTION.into_iter().filter(|&role| is_wanted(role)).collect();
            if is_wanted(Role::PmRa) != is_wanted(Role::PmDec) {
                roles.extend([Role::PmRa, Role::PmDec]);
            }
            all.columns.extend(self.picked(path, names, &roles)?.columns);
        }
        Ok(all)
    }

    /// The columns of these roles. A missing one is an error.
    fn picked(&self, path: &Path, names: &[String], roles: &[Role]) -> Result<Picked, IoError> {
        let needed = |&role: &Role| {
            self.found(names, role)
                .map(|column| (role, column.to_owned()))
                .ok_or_else(|| missing_column(path, names, self.names(role)[0], purpose(role)))
        };
        let columns = roles.iter().map(needed).collect::<Result<_, _>>()?;
        Ok(Picked { columns })
    }

    /// The chosen name of the column of a role, or the default names. Photutils calls positions `x_0`
    /// and `y_0`.
    fn names(&self, role: Role) -> Vec<&str> {
        match (&self.given[role as usize], role) {
            (Some(name), _) => vec![name],
            (None, Role::X) => vec!["x", "x_0"],
            (None, Role::Y) => vec!["y", "y_0"],
            (None, Role::Mag) => vec!["mag", "phot_g_mean_mag"],
            (None, Role::Epoch) => vec!["epoch", "ref_epoch"],
            (None, _) => vec![ROLES[role as usize]],
        }
    }

    /// The column of a role, if it is among these names. Case is ignored, unless it decides between
    /// several columns.
    fn found<'a>(&'a self, names: &'a [String], role: Role) -> Option<&'a str> {
        self.names(role).into_iter().find_map(|wanted| {
            let mut same = names.iter().filter(|name| name.eq_ignore_ascii_case(wanted));
            let first = same.clone().next()?;
            let exact = names.iter().any(|name| name == wanted);
            Some(if exact || same.nth(1).is_some() {
                wanted
            } else {
                first.as_str()
            })
        })
    }

    /// Returns whether a table with these column names has the epochs of its rows.
    pub(crate) fn has_epoch(&self, names: &[String]) -> bool {
        self.is_in(names, Role::Epoch) || self.is_given(Role::Epoch)
    }

    fn is_in(&self, names: &[String], role: Role) -> bool {
        self.found(names, role).is_some()
    }

    fn is_given(&self, role: Role) -> bool {
        self.given[role as usize].is_some()
    }

    /// Returns the rule that the given roles break, or `None` if they fit together.
    fn conflict(&self) -> Option<&'static str> {
        let given = |role| self.is_given(role);
        if given(Role::X) != given(Role::Y) {
            return Some("given for both x and y");
        }
        if given(Role::Ra) != given(Role::Dec) {
            return Some("given for both ra and dec");
        }
        if given(Role::X) && given(Role::Ra) {
            return Some("given either for x and y or for ra and dec");
        }
        if given(Role::Flux) && given(Role::Mag) {
            return Some("given either for flux or for mag");
        }
        let in_pixels = given(Role::Re) || given(Role::Angle);
        (in_pixels && (given(Role::ReArcsec) || given(Role::PaDeg)))
            .then_some("given either for re and angle or for re_arcsec and pa_deg")
    }
}

impl std::str::FromStr for CatalogColumns {
    type Err = DataError;
    fn from_str(text: &str) -> Result<Self, DataError> {
        let refused = |allowed| DataError::setting("the columns", allowed, text);
        let mut columns = Self::default();
        for part in text.split(',') {
            let (role, column) = part
                .split_once('=')
                .map(|(role, column)| (role.trim(), column.trim()))
                .filter(|(_, column)| !column.is_empty())
                .ok_or_else(|| refused("role=COLUMN, separated by commas, such as x=X_IMAGE,y=Y_IMAGE"))?;
            let place = ROLES
                .iter()
                .position(|name| name.eq_ignore_ascii_case(role))
                .ok_or_else(|| {
                    refused(
                        "role=COLUMN, with a role out of x, y, ra, dec, flux, mag, re, n, q, angle, g1, g2, re_arcsec, pa_deg, \
                         pmra, pmdec, parallax, radial_velocity and epoch",
                    )
                })?;
            if columns.given[place].replace(column.to_owned()).is_some() {
                return Err(refused("given once per role"));
            }
        }
        match columns.conflict() {
            Some(allowed) => Err(refused(allowed)),
            None => Ok(columns),
        }
    }
}

impl std::fmt::Display for CatalogColumns {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let given = ROLES.iter().zip(&self.given);
        let parts = given.filter_map(|(role, column)| Some(format!("{role}={}", column.as_ref()?)));
        f.write_str(&parts.collect::<Vec<_>>().join(","))
    }
}

/// Options for reading a catalogue: its columns, the origin of its pixels, its zero point, its
/// table, the world coordinates of the frame, and whether invalid rows are skipped.
///
/// ```
/// use psf_io::CatalogOptions;
/// // A catalogue as SExtractor writes it
/// let options = CatalogOptions::new()
///     .with_columns("x=X_IMAGE,y=Y_IMAGE,mag=MAG_AUTO".parse()?)
///     .with_one_based(true)
///     .with_zero_point(25.0)?;
/// # let _ = options;
/// # Ok::<(), psf_types::DataError>(())
/// ```
#[derive(Debug, Clone, Default)]
#[allow(
    clippy::struct_excessive_bools,
    reason = "independent choices, each with a default of false"
)]
pub struct CatalogOptions {
    pub(crate) columns: CatalogColumns,
    pub(crate) one_based: bool,
    pub(crate) zero_point: Option<f64>,
    pub(crate) skip_invalid: bool,
    pub(crate) with_colours: bool,
    pub(crate) with_velocities: bool,
    pub(crate) table: Option<HduChoice>,
    pub(crate) sky: Option<SkyCoordinates>,
    pub(crate) flux_unit: Option<String>,
    pub(crate) date: Option<ObservationDate>,
    pub(crate) epoch: Option<f64>,
    /// The table is read for frames with dates of their own.
    pub(crate) for_frames: bool,
}

impl CatalogOptions {
    /// The default options: the default columns, 0-based pixels, no zero point, no world
    /// coordinates, an error for an invalid row, and the only table with the needed columns.
    pub fn new() -> Self {
        Self::default()
    }

    /// Sets the columns.
    #[must_use]
    pub fn with_columns(self, columns: CatalogColumns) -> Self {
        Self { columns, ..self }
    }

    /// Sets whether pixels are counted from 1 (`true`), as in SExtractor and FITS, or from 0.
    #[must_use]
    pub fn with_one_based(self, one_based: bool) -> Self {
        Self { one_based, ..self }
    }

    /// Sets the world coordinates of the frame, for catalogues of positions on the sky.
    #[must_use]
    pub fn with_sky(self, sky: SkyCoordinates) -> Self {
        Self {
            sky: Some(sky),
            ..self
        }
    }

    /// Sets the date of the frame, to which sources with sky coordinates are moved. By default, it is that of the world
    /// coordinates ([`SkyCoordinates::date`]).
    #[must_use]
    pub fn with_date(self, date: ObservationDate) -> Self {
        Self {
            date: Some(date),
            ..self
        }
    }

    /// Sets the Julian year at which the positions of the catalogue hold, if it has no column `epoch`.
    #[must_use]
    pub fn with_epoch(self, julian_year: f64) -> Self {
        Self {
            epoch: Some(julian_year),
            ..self
        }
    }

    /// Sets the unit of the image, such as `electron` or `Jy`. Fluxes of a column with another unit are
    /// converted to it, or refused.
    #[must_use]
    pub fn with_flux_unit(self, unit: impl Into<String>) -> Self {
        Self {
            flux_unit: Some(unit.into()),
            ..self
        }
    }

    /// Sets whether invalid rows are skipped and counted (`true`) or are errors. A row is invalid
    /// if its position or brightness is missing or not finite, if its flux is 0, if its `re` is
    /// missing, or if its declination or the parameters of its galaxy are out of range. A text that
    /// is not a number is always an error.
    #[must_use]
    pub fn with_invalid_skipped(self, skip_invalid: bool) -> Self {
        Self { skip_invalid, ..self }
    }

    /// Sets whether the spectra of the sources are read
    /// ([`Catalog::colours`](crate::Catalog::colours)).
    #[must_use]
    pub fn with_colours(self, with_colours: bool) -> Self {
        Self { with_colours, ..self }
    }

    /// Sets whether the velocities of the sources are read
    /// ([`Catalog::velocities`](crate::Catalog::velocities)).
    #[must_use]
    pub fn with_velocities(self, with_velocities: bool) -> Self {
        Self {
            with_velocities,
            ..self
        }
    }

    /// Chooses a table of a FITS file. For a text file, which holds one table, a choice is an
    /// error.
    #[must_use]
    pub fn with_table(self, table: HduChoice) -> Self {
        Self {
            table: Some(table),
            ..self
        }
    }

    /// Sets the zero point, the magnitude of flux 1.
    ///
    /// # Errors
    /// [`DataError::Setting`] if `zero_point` is not finite.
    pub fn with_zero_point(self, zero_point: f64) -> Result<Self, DataError> {
        if !zero_point.is_finite() {
            return Err(DataError::setting(
                "the zero point",
                "a finite magnitude",
                zero_point,
            ));
        }
        Ok(Self {
            zero_point: Some(zero_point),
            ..self
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Place;

    fn names(text: &str) -> Vec<String> {
        text.split_whitespace().map(str::to_owned).collect()
    }

    #[test]
    fn texts_that_are_no_columns_are_refused() {
        for bad in [
            "",
            "x",
            "x=",
            "=X",
            "x=A,y=B,x=C",
            "x=A",
            "dec=A",
            "x=A,y=B,ra=C,dec=D",
            "flux=A,mag=B",
            "fwhm=A",
        ] {
            assert!(bad.parse::<CatalogColumns>().is_err(), "{bad}");
        }
        let columns: CatalogColumns = " MAG = MAG_AUTO , re=R ".parse().unwrap();
        assert_eq!(columns.to_string(), "mag=MAG_AUTO,re=R");
    }

    #[test]
    fn pixels_precede_the_sky_and_flux_precedes_magnitude() {
        let path = Path::new("a.csv");
        let of = |columns: &str, table: &str| {
            let columns: CatalogColumns = if columns.is_empty() {
                CatalogColumns::default()
            } else {
                columns.parse().unwrap()
            };
            columns.sources(path, &names(table))
        };
        let picked = |table: &[(Role, &str)]| Picked {
            columns: table
                .iter()
                .map(|&(role, name)| (role, name.to_owned()))
                .collect(),
        };
        let all = of("", "X Y RA DEC Flux Mag").unwrap();
        assert_eq!(
            all,
            picked(&[(Role::X, "X"), (Role::Y, "Y"), (Role::Flux, "Flux")])
        );
        let sky = of("ra=ALPHA,dec=DELTA,mag=M", "x y flux alpha delta m").unwrap();
        let expected = [(Role::Ra, "alpha"), (Role::Dec, "delta"), (Role::Mag, "m")];
        assert_eq!(sky, picked(&expected));
        assert_eq!(of("", "x ra dec mag").unwrap().place(Role::Ra), Some(0));
        let galaxies = of("re=R", "x y flux r n angle").unwrap();
        let of = |role| galaxies.name(role).map(String::as_str);
        assert_eq!(
            (of(Role::Re), of(Role::Q), of(Role::Angle)),
            (Some("r"), None, Some("angle"))
        );
    }

    #[test]
    fn missing_columns_are_named() {
        let missing = |columns: &str, table: &str| {
            let columns: CatalogColumns = columns.parse().unwrap_or_default();
            let error = columns.sources(Path::new("a.csv"), &names(table)).unwrap_err();
            match error.place() {
                Some(Place::Column(column)) => column.clone(),
                _ => panic!("{error:?}"),
            }
        };
        assert_eq!(missing("", "x flux"), "y");
        assert_eq!(missing("", "x y"), "flux");
        assert_eq!(missing("", "ra flux"), "x");
        assert_eq!(missing("", "x y flux re"), "n");
        assert_eq!(missing("q=BA", "x y flux re n"), "BA");
        assert_eq!(missing("n=SERSIC", "x y flux sersic"), "re");
        assert_eq!(missing("", "x y flux re n g2"), "g1");
        assert_eq!(missing("g1=GAMMA1", "x y flux re n gamma1"), "g2");
        assert_eq!(missing("x=X_IMAGE,y=Y_IMAGE", "x y ra dec flux"), "X_IMAGE");
    }
}
