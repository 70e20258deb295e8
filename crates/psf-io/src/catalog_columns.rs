//! Which columns of a catalogue mean what.

use std::path::Path;

use psf_types::DataError;

use crate::IoError;
use crate::text_table::listed;

/// The columns of a catalogue by what they mean: the default names, or others.
///
/// | role | default column | meaning |
/// |---|---|---|
/// | `x`, `y` | `x`, `y` | position in pixels of the frame |
/// | `ra`, `dec` | `ra`, `dec` | position on the sky in degrees, instead of `x` and `y` |
/// | `flux` | `flux` | total flux |
/// | `mag` | `mag` | magnitude instead of flux: `flux = 10^(-0.4 (mag - zero point))` |
/// | `re` | `re` | galaxies: half-light radius along the major axis, in pixels |
/// | `n` | `n` | galaxies: Sersic index, 0.3 to 8 |
/// | `q` | `q` | galaxies: minor over major axis, 0.001 to 1; 1 where there is no such column |
/// | `angle` | `angle` | galaxies: degrees of the major axis from +x towards +y; 0 where there is no such column |
///
/// A role that is given a column uses that one; the others use the column of their own name where there is one. Positions in
/// pixels go before those on the sky, flux before magnitude (unless a zero point is given, which
/// fluxes have no use for: then the columns must be chosen). A catalogue has galaxies when it has the column of `re`, and then needs that
/// of `n`. Upper and lower case are the same.
///
/// As text: `role=COLUMN`, separated by commas.
///
/// ```
/// use psf_io::CatalogColumns;
/// let columns: CatalogColumns = "x=X_IMAGE,y=Y_IMAGE,flux=FLUX_AUTO".parse()?;
/// assert_eq!(columns.to_string(), "x=X_IMAGE,y=Y_IMAGE,flux=FLUX_AUTO");
/// assert!("x=X_IMAGE".parse::<CatalogColumns>().is_err()); // and y?
/// # Ok::<(), psf_types::DataError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct CatalogColumns {
    /// By role; `None` for the default.
    given: [Option<String>; ROLES.len()],
}

/// The roles by name, in the order of [`Role`].
const ROLES: [&str; 10] = ["x", "y", "ra", "dec", "flux", "mag", "re", "n", "q", "angle"];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Role {
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
}

/// The two columns of positions.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum PositionColumns {
    Pixels { x: String, y: String },
    Sky { ra: String, dec: String },
}

/// The column of brightness.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum LightColumn {
    Flux(String),
    Magnitude(String),
}

/// The columns of galaxies.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ShapeColumns {
    pub(crate) re: String,
    pub(crate) n: String,
    pub(crate) q: Option<String>,
    pub(crate) angle: Option<String>,
}

/// The columns that a table of sources has.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct SourceColumns {
    pub(crate) position: PositionColumns,
    pub(crate) light: LightColumn,
    pub(crate) shape: Option<ShapeColumns>,
}

impl CatalogColumns {
    /// The columns of positions in a table with these columns.
    pub(crate) fn positions(&self, path: &Path, names: &[String]) -> Result<PositionColumns, IoError> {
        let found = Found {
            columns: self,
            path,
            names,
        };
        let pair = |first, second| Ok((found.needed(first)?, found.needed(second)?));
        let in_pixels = self.is_given(Role::X) || (found.has(Role::X) && found.has(Role::Y));
        let on_sky = self.is_given(Role::Ra) || (!in_pixels && found.has(Role::Ra) && found.has(Role::Dec));
        if on_sky {
            pair(Role::Ra, Role::Dec).map(|(ra, dec)| PositionColumns::Sky { ra, dec })
        } else {
            pair(Role::X, Role::Y).map(|(x, y)| PositionColumns::Pixels { x, y })
        }
    }

    /// The columns of sources in a table with these columns.
    pub(crate) fn sources(&self, path: &Path, names: &[String]) -> Result<SourceColumns, IoError> {
        let found = Found {
            columns: self,
            path,
            names,
        };
        let by_magnitude = self.is_given(Role::Mag)
            || (!self.is_given(Role::Flux) && !found.has(Role::Flux) && found.has(Role::Mag));
        let light = if by_magnitude {
            LightColumn::Magnitude(found.needed(Role::Mag)?)
        } else {
            LightColumn::Flux(found.needed(Role::Flux)?)
        };
        let shape_given = [Role::Re, Role::N, Role::Q, Role::Angle]
            .iter()
            .any(|&role| self.is_given(role));
        let shape = if shape_given || found.has(Role::Re) {
            Some(ShapeColumns {
                re: found.needed(Role::Re)?,
                n: found.needed(Role::N)?,
                q: found.if_there(Role::Q)?,
                angle: found.if_there(Role::Angle)?,
            })
        } else {
            None
        };
        Ok(SourceColumns {
            position: self.positions(path, names)?,
            light,
            shape,
        })
    }

    fn is_given(&self, role: Role) -> bool {
        self.given[role as usize].is_some()
    }

    /// Why roles do not go together.
    fn conflict(&self) -> Option<&'static str> {
        let given = |role| self.is_given(role);
        if given(Role::X) != given(Role::Y) {
            return Some("x and y together");
        }
        if given(Role::Ra) != given(Role::Dec) {
            return Some("ra and dec together");
        }
        if given(Role::X) && given(Role::Ra) {
            return Some("either x and y or ra and dec");
        }
        (given(Role::Flux) && given(Role::Mag)).then_some("either flux or mag")
    }
}

/// A table's columns, seen through the roles.
struct Found<'a> {
    columns: &'a CatalogColumns,
    path: &'a Path,
    names: &'a [String],
}

impl Found<'_> {
    fn column(&self, role: Role) -> &str {
        self.columns.given[role as usize]
            .as_deref()
            .unwrap_or(ROLES[role as usize])
    }

    fn has(&self, role: Role) -> bool {
        let column = self.column(role);
        self.names.iter().any(|name| name.eq_ignore_ascii_case(column))
    }

    fn needed(&self, role: Role) -> Result<String, IoError> {
        if self.has(role) {
            return Ok(self.column(role).to_owned());
        }
        Err(IoError::MissingColumn {
            path: self.path.to_owned(),
            column: self.column(role).to_owned(),
            found: listed(self.names),
        })
    }

    /// The column where there is one; one that was asked for must be there.
    fn if_there(&self, role: Role) -> Result<Option<String>, IoError> {
        if self.has(role) || self.columns.is_given(role) {
            self.needed(role).map(Some)
        } else {
            Ok(None)
        }
    }
}

impl std::str::FromStr for CatalogColumns {
    type Err = DataError;
    fn from_str(text: &str) -> Result<Self, DataError> {
        let refused = |allowed| DataError::Setting {
            name: "the columns",
            allowed,
            got: text.to_owned(),
        };
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
                .ok_or_else(|| refused("for the roles x, y, ra, dec, flux, mag, re, n, q and angle"))?;
            if columns.given[place].replace(column.to_owned()).is_some() {
                return Err(refused("one column for a role"));
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

#[cfg(test)]
mod tests {
    use super::*;

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
    fn pixels_go_before_the_sky_and_flux_before_magnitude() {
        let path = Path::new("a.csv");
        let of = |columns: &str, table: &str| {
            let columns: CatalogColumns = if columns.is_empty() {
                CatalogColumns::default()
            } else {
                columns.parse().unwrap()
            };
            columns.sources(path, &names(table))
        };
        let all = of("", "X Y RA DEC Flux Mag").unwrap();
        assert_eq!(
            all.position,
            PositionColumns::Pixels {
                x: "x".into(),
                y: "y".into()
            }
        );
        assert_eq!((all.light, all.shape), (LightColumn::Flux("flux".into()), None));
        let sky = of("ra=ALPHA,dec=DELTA,mag=M", "x y flux alpha delta m").unwrap();
        assert_eq!(
            sky.position,
            PositionColumns::Sky {
                ra: "ALPHA".into(),
                dec: "DELTA".into()
            }
        );
        assert_eq!(sky.light, LightColumn::Magnitude("M".into()));
        assert!(matches!(
            of("", "x ra dec mag").unwrap().position,
            PositionColumns::Sky { .. }
        ));
        let galaxies = of("re=R", "x y flux r n angle").unwrap().shape.unwrap();
        assert_eq!(
            (galaxies.re, galaxies.q, galaxies.angle),
            ("R".into(), None, Some("angle".into()))
        );
    }

    #[test]
    fn missing_columns_are_named() {
        let missing = |columns: &str, table: &str| {
            let columns: CatalogColumns = columns.parse().unwrap_or_default();
            match columns.sources(Path::new("a.csv"), &names(table)) {
                Err(IoError::MissingColumn { column, .. }) => column,
                other => panic!("{other:?}"),
            }
        };
        assert_eq!(missing("", "x flux"), "y");
        assert_eq!(missing("", "x y"), "flux");
        assert_eq!(missing("", "ra flux"), "x");
        assert_eq!(missing("", "x y flux re"), "n");
        assert_eq!(missing("q=BA", "x y flux re n"), "BA");
        assert_eq!(missing("n=SERSIC", "x y flux sersic"), "re");
        assert_eq!(missing("x=X_IMAGE,y=Y_IMAGE", "x y ra dec flux"), "X_IMAGE");
    }
}
