//! The columns of tables that give the positions and the states of samples.

use std::path::Path;

use psf_types::{FrameShape, Position, SamplePositions, SampleStates, StateKind};

use crate::error::{IoError, IoErrorKind, Place, invalid};
use crate::fits::card::Card;
use crate::fits::cfitsio::Fits;
use crate::fits::columns::{Table, positions};
use crate::fits::header_cards::HeaderCards;
use crate::fits::image_out::write_cards;
use crate::units::{in_unit, time_in_s, wavelength_in_um};

/// A column with the states of samples.
struct StateColumn {
    name: &'static str,
    kind: StateKind,
    /// The units in which it may be, for messages.
    units: &'static str,
    factor: fn(&str) -> Option<f64>,
}

const STATE_COLUMNS: [StateColumn; 4] = [
    StateColumn {
        name: "WAVELENGTH",
        kind: StateKind::Wavelength,
        units: "um, nm, Angstrom, mm or m",
        factor: wavelength_in_um,
    },
    StateColumn {
        name: "TIME",
        kind: StateKind::Time,
        units: "s, min, h or d",
        factor: time_in_s,
    },
    StateColumn {
        name: "FRAME",
        kind: StateKind::Frame,
        units: "none",
        factor: number_of,
    },
    StateColumn {
        name: "SPECTRUM",
        kind: StateKind::Spectrum,
        units: "none",
        factor: number_of,
    },
];

/// The factor of plain numbers: they have no unit.
fn number_of(unit: &str) -> Option<f64> {
    unit.trim().is_empty().then_some(1.0)
}

/// Reads positions from the columns `X` and `Y`, and states from the columns of [`STATE_COLUMNS`].
pub(crate) fn read_positions_of(
    table: &Table<'_>,
    path: &Path,
    field: Option<FrameShape>,
) -> Result<SamplePositions, IoError> {
    let at = positions(path, table.read("X", 1)?, table.read("Y", 1)?)?;
    let found: Vec<_> = STATE_COLUMNS
        .iter()
        .filter(|column| table.has(column.name))
        .collect();
    let states = match found[..] {
        [] => None,
        [column] => Some(read_states(table, path, column)?),
        [first, second, ..] => {
            let problem = format!(
                "there is also the column {}: a PSF may depend on only one of WAVELENGTH, TIME, FRAME and SPECTRUM, so remove one",
                second.name
            );
            let place = Place::Column(first.name.to_owned());
            return Err(IoError::new(path, IoErrorKind::Table, problem).at(place));
        }
    };
    SamplePositions::with_states(at, field, states).map_err(invalid(path))
}

fn read_states(table: &Table<'_>, path: &Path, column: &StateColumn) -> Result<SampleStates, IoError> {
    let unit = table.unit(column.name)?;
    let factor = (column.factor)(&unit).ok_or_else(|| {
        let got = if unit.trim().is_empty() {
            "has no unit".to_owned()
        } else {
            format!("has the unit {unit:?}")
        };
        let problem = format!("the column {got}: set its TUNIT keyword ({})", column.units);
        IoError::new(path, IoErrorKind::Table, problem).at(Place::Column(column.name.to_owned()))
    })?;
    let values: Vec<f64> = table
        .read(column.name, 1)?
        .iter()
        .map(|&v| in_unit(v, factor))
        .collect();
    SampleStates::new(column.kind, &values).map_err(invalid(path))
}

fn column_of(kind: StateKind) -> &'static StateColumn {
    let found = STATE_COLUMNS.iter().find(|column| column.kind == kind);
    found.expect("every kind of state has a column")
}

/// The columns for the positions and states of samples, with their formats. They come first in a
/// table.
pub(crate) fn position_columns(positions: &SamplePositions) -> Vec<(&'static str, String)> {
    let state = positions.states().map(|states| column_of(states.kind()).name);
    ["X", "Y"]
        .into_iter()
        .chain(state)
        .map(|name| (name, "D".to_owned()))
        .collect()
}

/// Writes the first columns of the table just created ([`position_columns`]).
pub(crate) fn write_positions_of(fits: &mut Fits, positions: &SamplePositions) -> Result<(), IoError> {
    let coordinate =
        |of: fn(Position) -> f64| positions.as_slice().iter().map(|&p| of(p)).collect::<Vec<_>>();
    fits.write_column(1, &coordinate(Position::x))?;
    fits.write_column(2, &coordinate(Position::y))?;
    if let Some(states) = positions.states() {
        fits.write_column(3, &states.per_sample().collect::<Vec<_>>())?;
        if !states.kind().unit().is_empty() {
            let unit = Card::new("TUNIT3", states.kind().unit(), "").expect("a short text");
            write_cards(fits, &HeaderCards::new().with(&[unit]))?;
        }
    }
    Ok(())
}
