//! Catalogues of the sky, from which many frames take their sources.

use std::path::{Path, PathBuf};

use super::columns::{CatalogOptions, ROLES, Role};
use super::memory_table::MemoryTable;
use super::read_columns::ReadColumns;
use super::rows::Rows;
use super::sky_coordinates::{dot, unit_vector};
use super::table_file::AnyTable;
use super::{Catalog, sources_of};
use crate::error::{IoError, IoErrorKind};

/// A catalogue with positions on the sky. It is read once, and each frame takes the sources near it.
///
/// ```
/// use psf_io::{Card, CatalogOptions, HeaderCards, MemoryTable, SkyCatalog, SkyCoordinates};
/// let table = MemoryTable::new("sky")
///     .with_column("ra", vec![150.0, 150.1, 10.0])?
///     .with_column("dec", vec![2.0, 2.0, -40.0])?
///     .with_column("flux", vec![100.0, 5.0, 7.0])?;
/// let all = SkyCatalog::of_table(&table, CatalogOptions::new(), |_| 0.0)?;
/// # let mut header = HeaderCards::new();
/// # for (keyword, value) in [("CRPIX1", 50.5), ("CRPIX2", 40.5), ("CRVAL1", 150.0), ("CRVAL2", 2.0), ("CDELT1", -1e-4), ("CDELT2", 1e-4)] {
/// #     header.push(Card::new(keyword, value, "")?);
/// # }
/// # for (keyword, value) in [("CTYPE1", "RA---TAN"), ("CTYPE2", "DEC--TAN")] {
/// #     header.push(Card::new(keyword, value, "")?);
/// # }
/// let frame = CatalogOptions::new().with_sky(SkyCoordinates::from_header(&header)?);
/// let near = all.within(&frame, (150.0, 2.0), 0.01)?; // degrees
/// assert_eq!((near.stars().len(), near.rows()), (1, &[0][..]));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct SkyCatalog {
    path: PathBuf,
    read: ReadColumns,
    /// The rows with positions, in the order of their declinations.
    by_declination: Vec<usize>,
    /// Rows without a valid position. Every frame refuses them.
    invalid: Vec<usize>,
    /// How far the light of each row reaches, in degrees.
    reach_deg: Vec<f32>,
    /// How fast each row moves, in degrees per year, and its parallax in degrees. Empty if nothing moves.
    motion_deg: Vec<[f32; 2]>,
    farthest_deg: f64,
    fastest_deg: [f64; 2],
}

fn for_frames(options: CatalogOptions) -> CatalogOptions {
    CatalogOptions {
        for_frames: true,
        ..options
    }
}

/// Degrees in a milliarcsecond.
const MAS_DEG: f64 = 1.0 / 3.6e6;

impl SkyCatalog {
    /// Reads a catalogue. `options` choose its columns, table and epoch. `reach` gives the distance to which a galaxy
    /// of a Sersic index is drawn, as a multiple of its half-light radius.
    ///
    /// # Errors
    /// The errors of [`read_catalog_with`](crate::read_catalog_with), and [`IoErrorKind::Table`] for positions or
    /// sizes in pixels.
    pub fn read(
        path: impl AsRef<Path>,
        options: CatalogOptions,
        reach: impl Fn(f64) -> f64,
    ) -> Result<Self, IoError> {
        let options = for_frames(options);
        let path = path.as_ref();
        let read = ReadColumns::of_file(path, &options, "ra, dec, flux", |path, names| {
            options.sources(path, names)
        })?;
        Self::new(path, read, reach)
    }

    /// Takes a table in memory, whose values have the units of their roles
    /// ([`CatalogOptions::columns_of`]).
    ///
    /// # Errors
    /// The errors of [`read`](Self::read), except those of files.
    pub fn of_table(
        table: &MemoryTable,
        options: CatalogOptions,
        reach: impl Fn(f64) -> f64,
    ) -> Result<Self, IoError> {
        let options = for_frames(options);
        let path = table.name();
        let columns = options.sources(path, &table.names())?;
        let read = ReadColumns::of_table(path, &options, columns, &AnyTable::Memory(table))?;
        Self::new(path, read, reach)
    }

    fn new(path: &Path, read: ReadColumns, reach: impl Fn(f64) -> f64) -> Result<Self, IoError> {
        let refused = |problem: &str| IoError::new(path, IoErrorKind::Table, problem);
        let column = |role: Role| read.places[role as usize].map(|place| &read.numbers.values[place][..]);
        let (Some(ra), Some(dec)) = (column(Role::Ra), column(Role::Dec)) else {
            return Err(refused(
                "positions on the sky are needed, but those of the catalogue are pixels: name columns ra and dec",
            ));
        };
        if column(Role::Re).is_some() {
            return Err(refused(
                "the sizes of galaxies are needed on the sky, but the column re holds pixels: give re_arcsec",
            ));
        }
        let rows = read.numbers.rows;
        let is_valid = |row: usize| ra[row].is_finite() && (-90.0..=90.0).contains(&dec[row]);
        let (mut by_declination, invalid): (Vec<usize>, Vec<usize>) =
            (0..rows).partition(|&row| is_valid(row));
        by_declination.sort_by(|&a, &b| dec[a].total_cmp(&dec[b]));
        let reach_deg: Vec<f32> = match (column(Role::ReArcsec), column(Role::N)) {
            (Some(re), Some(n)) => {
                let shear = |row: usize| {
                    let of = |role| column(role).map_or(0.0, |values| values[row]);
                    let g = of(Role::G1).hypot(of(Role::G2)).min(0.99);
                    (1.0 + g) / (1.0 - g)
                };
                let reach = |row: usize| {
                    let deg = re[row] / 3600.0 * reach(n[row]) * shear(row);
                    if deg.is_finite() { deg.max(0.0) as f32 } else { 0.0 }
                };
                (0..rows).map(reach).collect()
            }
            _ => Vec::new(),
        };
        let of = |role: Role, row: usize| {
            let value = column(role).map_or(0.0, |values| values[row]).abs() * MAS_DEG;
            if value.is_finite() { value } else { 0.0 }
        };
        let moves = [Role::PmRa, Role::PmDec, Role::Parallax];
        let motion_deg: Vec<[f32; 2]> = if moves.into_iter().any(|role| column(role).is_some()) {
            let motion = |row| {
                let speed = of(Role::PmRa, row).hypot(of(Role::PmDec, row));
                [speed as f32, of(Role::Parallax, row) as f32]
            };
            (0..rows).map(motion).collect()
        } else {
            Vec::new()
        };
        let largest = |values: &mut dyn Iterator<Item = f32>| f64::from(values.fold(0.0_f32, f32::max));
        Ok(Self {
            path: path.to_owned(),
            farthest_deg: largest(&mut reach_deg.iter().copied()),
            fastest_deg: [0, 1].map(|i| largest(&mut motion_deg.iter().map(|motion| motion[i]))),
            read,
            by_declination,
            invalid,
            reach_deg,
            motion_deg,
        })
    }

    /// The number of rows.
    pub fn len(&self) -> usize {
        self.read.numbers.rows
    }

    /// Returns whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The sources whose light may come within `radius_deg` degrees of a position on the sky (right ascension and
    /// declination), in the order of their rows. `frame` says how they are read: the world coordinates of the frame,
    /// its date, the zero point.
    ///
    /// # Errors
    /// The errors of [`catalog_of`](crate::catalog_of) for these sources, and for rows without a valid position.
    pub fn within(
        &self,
        frame: &CatalogOptions,
        (ra_deg, dec_deg): (f64, f64),
        radius_deg: f64,
    ) -> Result<Catalog, IoError> {
        let rows = Rows::new(&self.path, frame, &self.read)?;
        let column = |role: Role| {
            let place = self.read.places[role as usize].expect("positions are on the sky");
            &self.read.numbers.values[place]
        };
        let (ra, dec) = (column(Role::Ra), column(Role::Dec));
        let epochs = self.read.places[Role::Epoch as usize].map(|place| &self.read.numbers.values[place][..]);
        let years = |row: usize| {
            let epoch = epochs.map_or(frame.epoch, |epochs| Some(epochs[row]));
            match (frame.date(), epoch) {
                (Some(date), Some(epoch)) if epoch.is_finite() => (date.julian_year() - epoch).abs(),
                _ => 0.0,
            }
        };
        let longest = match epochs {
            Some(_) => (0..self.motion_deg.len()).map(years).fold(0.0, f64::max),
            None => years(0),
        };
        let moved = |[speed, parallax]: [f64; 2], years: f64| speed * years + 2.0 * parallax;
        let farthest = radius_deg + self.farthest_deg + moved(self.fastest_deg, longest);
        let first = self
            .by_declination
            .partition_point(|&row| dec[row] < dec_deg - farthest);
        let end = self
            .by_declination
            .partition_point(|&row| dec[row] <= dec_deg + farthest);
        let centre = unit_vector(ra_deg, dec_deg);
        let is_near = |row: usize| {
            let reach = self.reach_deg.get(row).map_or(0.0, |&reach| f64::from(reach));
            let motion = self.motion_deg.get(row);
            let motion = motion.map_or(0.0, |motion| moved(motion.map(f64::from), years(row)));
            let limit = radius_deg + reach + motion;
            limit >= 180.0 || dot(centre, unit_vector(ra[row], dec[row])) >= limit.to_radians().cos()
        };
        let near = self.by_declination[first..end.max(first)].iter().copied();
        let mut chosen: Vec<usize> = near
            .filter(|&row| is_near(row))
            .chain(self.invalid.iter().copied())
            .collect();
        chosen.sort_unstable();
        sources_of(&rows, chosen)
    }

    /// The names of columns that change a source and are not read.
    pub fn ignored_columns(&self) -> &[String] {
        &self.read.ignored
    }

    /// The roles of the columns that are read, such as `ra` or `mag`.
    pub fn roles(&self) -> Vec<&'static str> {
        self.read
            .columns
            .iter()
            .map(|(role, _)| ROLES[role as usize])
            .collect()
    }
}
