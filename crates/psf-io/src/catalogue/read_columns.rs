//! The columns of a catalogue's table: which are needed, and their values in the units of their roles.

use std::path::Path;

use super::SourceColours;
use super::column_units::{KELVIN, PIXELS_PER_SECOND, factor, is_logarithmic};
use super::columns::{CatalogOptions, NeededColumn, Picked, ROLES};
use super::sky_motion::ObservationDate;
use super::table_file::{AnyTable, TableFile};
use crate::error::{IoError, IoErrorKind, Place};
use crate::fits::columns::{Nans, NumberColumns, find, missing_column};

/// The columns of a catalogue's table that are needed.
#[derive(Debug, Clone)]
pub(super) struct ReadColumns {
    pub(super) columns: Picked,
    /// The place of the column of each role.
    pub(super) places: [Option<usize>; ROLES.len()],
    pub(super) numbers: NumberColumns,
    /// The columns that change a source and are not read.
    pub(super) ignored: Vec<String>,
    pub(super) colours: Option<SourceColours>,
    pub(super) velocities: Option<[Vec<f64>; 2]>,
}

impl ReadColumns {
    /// Reads the columns that `pick` chooses from a table. If the file has no tables, the error
    /// lists the columns in `needed`.
    pub(super) fn of_file(
        path: &Path,
        options: &CatalogOptions,
        needed: &str,
        pick: impl Fn(&Path, &[String]) -> Result<Picked, IoError>,
    ) -> Result<Self, IoError> {
        let file = TableFile::open(path)?;
        let (columns, table) = file.pick(options.table.as_ref(), needed, |names| pick(path, names))?;
        Self::of_table(path, options, columns, &table)
    }

    /// Reads these columns of a table, in the units of their roles.
    pub(super) fn of_table(
        path: &Path,
        options: &CatalogOptions,
        columns: Picked,
        table: &AnyTable<'_>,
    ) -> Result<Self, IoError> {
        let mut numbers = table.read(&columns.names(), Nans::Kept)?;
        for ((role, name), values) in columns.iter().zip(&mut numbers.values) {
            let wanted = role.unit().or(options.flux_unit.as_deref());
            in_unit(path, table, name, wanted, values)?;
        }
        Ok(Self {
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

/// Columns that change where a source is, and are read only if the date of the frame and the epoch are known.
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
        if self.moves(names) {
            self.columns.moving_sources(table, names)
        } else {
            self.columns.sources(table, names)
        }
    }

    /// Returns whether sources of a table with these column names are moved to the date of the frame.
    fn moves(&self, names: &[String]) -> bool {
        let known = || self.epoch.is_some() || self.columns.has_epoch(names);
        self.date.is_some() || ((self.for_frames || self.date().is_some()) && known())
    }

    /// The date of the frame.
    pub(super) fn date(&self) -> Option<ObservationDate> {
        self.date.or_else(|| self.sky.as_ref()?.date())
    }

    /// The columns among `names` that may change a source and are not read.
    pub fn ignored_columns(&self, names: &[String]) -> Vec<String> {
        let is = |name: &str, of: &[&str]| of.iter().any(|other| name.eq_ignore_ascii_case(other));
        let unused_angle = self.columns.unused_angle(names);
        let unread = |name: &&String| {
            (!self.moves(names) && is(name, &OF_MOTION))
                || unused_angle.is_some_and(|angle| is(name, &[angle]))
                || (!self.with_colours && is(name, &[SED, TEFF]))
                || (!self.with_velocities && is(name, &VELOCITIES))
        };
        names.iter().filter(unread).cloned().collect()
    }
}

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

/// The columns of the velocities of sources.
pub(super) const VELOCITIES: [&str; 2] = ["vx", "vy"];
/// The columns of the names of spectra and of the temperatures of black bodies.
pub(super) const SED: &str = "sed";
pub(super) const TEFF: &str = "teff";
