//! PSFEx models in the rows of a table, as legacypipe writes them: one row for each CCD of an exposure, with
//! the keywords of PSFEx as columns.

use crate::error::{IoError, IoErrorKind, Row};
use crate::fits::card::{Card, CardValue};
use crate::fits::columns::{Nans, Table, bad_value};
use crate::fits::hdu::{Hdu, HduChoice};

use super::COLUMN;

/// The column with the name of a row.
const NAME: &str = "CCDNAME";
/// Columns whose names begin so are keywords of PSFEx.
const KEYWORDS: [&str; 5] = ["POL", "PSF", "LOADED", "ACCEPTED", "CHI2"];

/// The length of the longest keyword.
const LONGEST: usize = 8;

/// Returns whether a table holds models in its rows.
pub(super) fn has_models(hdu: &Hdu) -> bool {
    hdu.has_column(COLUMN) && hdu.has_column("PSF_SAMP")
}

/// Chooses a row by its `CCDNAME` or its number from 0. Returns the header that PSFEx would have written for
/// it (without the structure of the table), and the number of the row. Without a choice, the table must have
/// one row.
pub(super) fn chosen(hdu: &Hdu, choice: Option<&HduChoice>) -> Result<(Hdu, usize), IoError> {
    let table = Table::new(hdu)?;
    let names = if table.has(NAME) {
        table.read_texts(NAME)?
    } else {
        Vec::new()
    };
    let row = match choice {
        None if table.rows == 1 => Some(0),
        None => None,
        Some(HduChoice::Number(number)) => Some(*number).filter(|&row| row < table.rows),
        Some(HduChoice::Name { name, .. }) => names
            .iter()
            .position(|found| found.trim().eq_ignore_ascii_case(name)),
    };
    let Some(row) = row else {
        let names: Vec<&str> = names.iter().map(|name| name.trim()).collect();
        let problem = format!(
            "the table has {} PSFEx models, one in each row: choose one by its CCDNAME or its number from 0. The CCDs are [{}]",
            table.rows,
            names.join(", ")
        );
        return Err(hdu.error(IoErrorKind::Setting, problem).with_setting("extension"));
    };
    let mut cards = Vec::new();
    for column in &table.columns {
        let name = column.name.to_ascii_uppercase();
        let is_keyword = name.len() <= LONGEST && KEYWORDS.iter().any(|start| name.starts_with(start));
        if !is_keyword || name == COLUMN {
            continue;
        }
        let value = if column.code == b'A' {
            CardValue::Text(table.read_texts(&column.name)?[row].trim().to_owned())
        } else {
            // Other rows may lack the value.
            let value = table.read_with(&column.name, 1, Nans::Kept)?[row];
            if !value.is_finite() {
                continue;
            }
            if b"ED".contains(&column.code) {
                CardValue::Real(value)
            } else {
                CardValue::Integer(value as i64)
            }
        };
        let card = Card::new(&name, value, "");
        cards.push(card.map_err(|_| bad_value(hdu.path(), Row::Index(row), &column.name, "another value"))?);
    }
    let header = hdu.header.with(&cards);
    Ok((
        Hdu {
            source: hdu.source.clone(),
            header,
            axes: hdu.axes.clone(),
            ..*hdu
        },
        row,
    ))
}
