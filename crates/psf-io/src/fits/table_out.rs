//! Writes FITS tables.

use std::path::Path;

use crate::error::{IoError, IoErrorKind, bad_card};
use crate::fits::card::Card;
use crate::fits::cfitsio::Fits;
use crate::fits::header_cards::HeaderCards;
use crate::fits::image_out::{write_cards, write_fits};

/// A column of a table that is written ([`write_table`]).
#[derive(Debug, Clone, PartialEq)]
pub struct TableColumn {
    /// Its name.
    pub name: &'static str,
    /// The unit of its values, or an empty text.
    pub unit: &'static str,
    /// One value for each row.
    pub values: ColumnValues,
}

/// The values of a [`TableColumn`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ColumnValues {
    /// Doubles (`D`). A missing value is NaN.
    Numbers(Vec<f64>),
    /// Whole numbers (`K`).
    Integers(Vec<i64>),
    /// Logical values (`L`).
    Flags(Vec<bool>),
}

impl ColumnValues {
    fn len(&self) -> usize {
        match self {
            Self::Numbers(values) => values.len(),
            Self::Integers(values) => values.len(),
            Self::Flags(values) => values.len(),
        }
    }

    fn form(&self) -> &'static str {
        match self {
            Self::Numbers(_) => "D",
            Self::Integers(_) => "K",
            Self::Flags(_) => "L",
        }
    }
}

/// Writes a FITS file with one binary table, called `name`. `cards` stand in the header of the primary HDU, which
/// has no pixels. The file appears complete or not at all.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("table.fits");
/// use psf_io::{CatalogOptions, ColumnValues, TableColumn, read_catalog_with, write_table};
/// let numbers = |name, unit, values| TableColumn { name, unit, values: ColumnValues::Numbers(values) };
/// let columns = [
///     numbers("x", "pix", vec![1.5, 2.0]),
///     numbers("y", "pix", vec![0.0, 7.0]),
///     numbers("flux", "", vec![100.0, 20.0]),
///     TableColumn { name: "in_frame", unit: "", values: ColumnValues::Flags(vec![true, false]) },
/// ];
/// write_table(&path, "TRUTH", &columns, &[], false)?;
/// assert_eq!(read_catalog_with(&path, &CatalogOptions::new())?.stars().len(), 2);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`IoErrorKind::Table`] for columns of different lengths, and the errors of
/// [`write_image`](crate::write_image).
pub fn write_table(
    path: impl AsRef<Path>,
    name: &str,
    columns: &[TableColumn],
    cards: &[Card],
    overwrite: bool,
) -> Result<(), IoError> {
    let path = path.as_ref();
    let rows = columns.first().map_or(0, |column| column.values.len());
    if let Some(other) = columns.iter().find(|column| column.values.len() != rows) {
        let (name, got) = (other.name, other.values.len());
        let problem = format!("the column {name} has {got} rows, but the first column has {rows}");
        return Err(IoError::new(path, IoErrorKind::Table, problem));
    }
    let unit = |(place, column): (usize, &TableColumn)| {
        let keyword = format!("TUNIT{}", place + 1);
        let card = Card::new(&keyword, column.unit, "").map_err(bad_card(path));
        (!column.unit.is_empty()).then_some(card)
    };
    let units = columns.iter().enumerate().filter_map(unit);
    let units: Vec<Card> = units.collect::<Result<_, _>>()?;
    write_fits(path, overwrite, |fits| {
        fits.create_image(&[], 8)?;
        write_cards(fits, &HeaderCards::new().with(cards))?;
        let forms = columns
            .iter()
            .map(|column| (column.name, column.values.form().to_owned()));
        fits.create_table(name, rows, &forms.collect::<Vec<_>>())?;
        units.iter().try_for_each(|unit| fits.write_card(unit))?;
        let mut columns = columns.iter().enumerate();
        columns.try_for_each(|(place, column)| write_values(fits, place + 1, &column.values))
    })
}

/// Writes the values of a column, which is counted from 1.
fn write_values(fits: &mut Fits, column: usize, values: &ColumnValues) -> Result<(), IoError> {
    match values {
        _ if values.len() == 0 => Ok(()),
        ColumnValues::Numbers(values) => fits.write_column(column, values),
        ColumnValues::Integers(values) => fits.write_column(column, values),
        ColumnValues::Flags(values) => fits.write_flags(column, values),
    }
}
