//! Columns of numbers, and the binary tables that hold them.

use std::path::Path;

use psf_types::Position;

use crate::error::{IoError, IoErrorKind, Place, Row, invalid};
use crate::fits::cfitsio::Fits;
use crate::fits::hdu::Hdu;

/// Column names and values in error messages are cut to this many characters.
const QUOTED: usize = 40;
/// The largest number of column names in an error message.
const LISTED: usize = 20;

/// A column of a binary table.
#[derive(Debug)]
pub(crate) struct Column {
    /// Counted from 1, as in CFITSIO.
    pub(crate) number: usize,
    pub(crate) name: String,
    form: String,
    /// Number of values per row.
    repeat: usize,
    /// True if each row holds one text and nothing else.
    is_text: bool,
    /// The type letter of TFORM.
    pub(crate) code: u8,
}

/// A binary table. The widths of its columns add up to the length of a row, so the length of the
/// file bounds the memory for their values.
#[derive(Debug)]
pub(crate) struct Table<'a> {
    hdu: &'a Hdu,
    pub(crate) columns: Vec<Column>,
    /// Number of rows.
    pub(crate) rows: usize,
}

impl<'a> Table<'a> {
    pub(crate) fn new(hdu: &'a Hdu) -> Result<Self, IoError> {
        let &[row_bytes, rows] = hdu.axes.as_slice() else {
            return Err(hdu.header_error("NAXIS", "must be 2 for a table"));
        };
        let columns = columns(hdu, row_bytes)?;
        Ok(Self { hdu, columns, rows })
    }

    pub(crate) fn names(&self) -> Vec<String> {
        self.columns.iter().map(|column| column.name.clone()).collect()
    }

    /// The column with this name, in upper or lower case.
    pub(crate) fn column(&self, name: &str) -> Result<&Column, IoError> {
        let names = self.columns.iter().map(|column| &column.name);
        Ok(&self.columns[find(self.hdu.path(), names, name)?])
    }

    /// Returns whether there is a column with this name, in upper or lower case.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.columns
            .iter()
            .any(|column| column.name.eq_ignore_ascii_case(name))
    }

    /// The unit of a column (`TUNITn`). Empty if the file does not state it.
    pub(crate) fn unit(&self, name: &str) -> Result<String, IoError> {
        let keyword = format!("TUNIT{}", self.column(name)?.number);
        Ok(self.hdu.text(&keyword).unwrap_or_default())
    }

    /// Reads a column that has `repeat` numbers in each row. NaN and infinities are errors.
    pub(crate) fn read(&self, name: &str, repeat: usize) -> Result<Vec<f64>, IoError> {
        self.read_with(name, repeat, Nans::Refused)
    }

    /// Reads a column that has one text in each row.
    pub(crate) fn read_texts(&self, name: &str) -> Result<Vec<String>, IoError> {
        let column = self.column(name)?;
        // CFITSIO takes the width of a text from TDIM, too. It divides by it, and reads texts of this width.
        let dimensions = self.hdu.text(&format!("TDIM{}", column.number));
        let folds = dimensions.filter(|text| text.trim() != format!("({})", column.repeat));
        if !column.is_text || folds.is_some() {
            let problem = format!(
                "the column has the format {}{}, but texts are needed, one in each row (format A)",
                column.form,
                folds.map_or_else(String::new, |text| format!(" and the dimensions {text}"))
            );
            let place = Place::Column(column.name.clone());
            return Err(self.hdu.error(IoErrorKind::Table, problem).at(place));
        }
        let mut fits = Fits::open(&self.hdu.source)?;
        fits.move_to(self.hdu.index)?;
        if self.rows == 0 {
            return Ok(Vec::new());
        }
        fits.read_texts(column.number, self.rows, column.repeat)
    }

    /// Works like [`read`](Self::read), but `nans` may allow values that are missing or not finite.
    pub(crate) fn read_with(&self, name: &str, repeat: usize, nans: Nans) -> Result<Vec<f64>, IoError> {
        let column = self.column(name)?;
        if !b"BIJKED".contains(&column.code) || column.repeat != repeat {
            let problem = format!(
                "the column {:?} has the format {}, but {repeat} number(s) per row are needed (format {repeat}D, for example)",
                column.name, column.form
            );
            return Err(self.hdu.error(IoErrorKind::Table, problem));
        }
        let mut values = vec![0.0; self.rows * repeat];
        let mut fits = Fits::open(&self.hdu.source)?;
        fits.move_to(self.hdu.index)?;
        let null = !b"ED".contains(&column.code)
            && self.hdu.header.get(&format!("TNULL{}", column.number)).is_some();
        if !values.is_empty() {
            fits.read_column(column.number, &mut values, null)?;
        }
        let refused = |value: &f64| nans == Nans::Refused && !value.is_finite();
        match values.iter().position(refused) {
            None => Ok(values),
            Some(flat) => {
                let (row, got) = (Row::Index(flat / repeat), values[flat].to_string());
                Err(bad_value(self.hdu.path(), row, &column.name, &got))
            }
        }
    }
}

/// The columns of a binary table. It is an error if they do not fill its rows exactly.
pub(crate) fn columns(hdu: &Hdu, row_bytes: usize) -> Result<Vec<Column>, IoError> {
    let count = hdu.structural("TFIELDS", None)?;
    let mut width = 0_usize;
    let mut columns = Vec::new();
    for number in 1..=count as usize {
        let keyword = format!("TFORM{number}");
        let form = hdu
            .text(&keyword)
            .ok_or_else(|| hdu.header_error(&keyword, "must exist and be a string"))?;
        let column = Column::new(
            number,
            hdu.text(&format!("TTYPE{number}")).unwrap_or_default(),
            form,
        );
        let column = column.ok_or_else(|| hdu.header_error(&keyword, "must be a format such as 1D"))?;
        let bytes = column.bytes().and_then(|bytes| width.checked_add(bytes));
        width = bytes.ok_or_else(|| {
            hdu.header_error(
                &keyword,
                "the columns up to this one are wider than any table can be",
            )
        })?;
        columns.push(column);
    }
    hdu.ensure(
        width == row_bytes,
        "NAXIS1",
        "the columns do not add up to the length of a row",
    )?;
    Ok(columns)
}

impl Column {
    /// Makes a column with the TFORM `form`. Returns `None` if `form` is not a format of binary
    /// tables.
    fn new(number: usize, name: String, form: String) -> Option<Self> {
        let text = form.trim();
        let digits = text.bytes().take_while(u8::is_ascii_digit).count();
        let repeat: usize = if digits == 0 {
            1
        } else {
            text[..digits].parse().ok()?
        };
        let code = text.as_bytes().get(digits)?.to_ascii_uppercase();
        // `60A12` is several texts in one row, each of this width.
        let width = text.get(digits + 1..)?.trim();
        let one = width.is_empty() || width.parse() == Ok(repeat);
        let is_text = code == b'A' && repeat > 0 && one;
        let column = Self {
            number,
            name: name.trim().to_owned(),
            repeat,
            is_text,
            code,
            form,
        };
        b"LXBIJKAEDCMPQ".contains(&code).then_some(column)
    }

    /// The type letter of the elements of a variable-length array column.
    pub(crate) fn element(&self) -> Option<u8> {
        let (_, element) = self.form.trim().split_once(['P', 'Q', 'p', 'q'])?;
        element.bytes().next().map(|letter| letter.to_ascii_uppercase())
    }

    /// Length in bytes per row, or `None` if it overflows.
    pub(crate) fn bytes(&self) -> Option<usize> {
        let size = match self.code {
            b'X' => return Some(self.repeat.div_ceil(8)),
            b'I' => 2,
            b'J' | b'E' => 4,
            b'K' | b'D' | b'C' | b'P' => 8,
            b'M' | b'Q' => 16,
            _ => 1,
        };
        self.repeat.checked_mul(size)
    }
}

/// Makes positions from their coordinates.
pub(crate) fn positions(path: &Path, x: Vec<f64>, y: Vec<f64>) -> Result<Vec<Position>, IoError> {
    x.into_iter()
        .zip(y)
        .map(|(x, y)| Position::new(x, y).map_err(invalid(path)))
        .collect()
}

/// The index of the column with this name, in upper or lower case. Of several such columns, one must have
/// exactly this name.
pub(crate) fn find<'a>(
    path: &Path,
    names: impl Iterator<Item = &'a String> + Clone,
    name: &str,
) -> Result<usize, IoError> {
    if let Some(exact) = names.clone().position(|n| n == name) {
        let again = names.clone().skip(exact + 1).any(|n| n == name);
        if !again {
            return Ok(exact);
        }
    }
    let mut found = names
        .clone()
        .enumerate()
        .filter(|(_, n)| n.eq_ignore_ascii_case(name));
    match (found.next(), found.next()) {
        (Some((place, _)), None) => Ok(place),
        (None, _) => Err(missing_column(path, names, name, "")),
        (Some(_), Some(_)) => {
            const TWICE: &str = "the column exists more than once: rename or remove one";
            Err(IoError::new(path, IoErrorKind::Table, TWICE).at(Place::Column(name.to_owned())))
        }
    }
}

/// The error for a table that lacks a required column. `why` ends the first sentence.
pub(crate) fn missing_column<'a>(
    path: &Path,
    names: impl IntoIterator<Item = &'a String>,
    name: &str,
    why: &str,
) -> IoError {
    let found = listed(names).join(", ");
    let message = match found.as_str() {
        "" => format!("there is no such column{why}. The table has no columns"),
        found => format!("there is no such column{why}. The columns are {found}"),
    };
    IoError::new(path, IoErrorKind::Table, message).at(Place::Column(name.to_owned()))
}

/// The error for a value of a table that is not a finite number.
pub(crate) fn bad_value(path: &Path, row: Row, column: &str, got: &str) -> IoError {
    let column = column.to_owned();
    IoError::new(
        path,
        IoErrorKind::Data,
        format!("a finite number is needed, got {got:?}"),
    )
    .at(Place::Value { row, column })
}

/// The names for an error message, without empty ones. If there are more than [`LISTED`] names, the
/// last entry is the number of the names left out: "and 3 more".
fn listed<'a>(names: impl IntoIterator<Item = &'a String>) -> Vec<String> {
    let mut named = names.into_iter().filter(|name| !name.is_empty());
    let quoted = |name: &String| format!("{:?}", shown(name.as_bytes()));
    let mut list: Vec<String> = named.by_ref().take(LISTED).map(quoted).collect();
    match named.count() {
        0 => {}
        more => list.push(format!("and {more} more")),
    }
    list
}

/// The first characters of a field, for an error message.
pub(crate) fn shown(field: &[u8]) -> String {
    String::from_utf8_lossy(field).chars().take(QUOTED).collect()
}

/// States whether missing or non-finite values are errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Nans {
    /// Such values are errors.
    Refused,
    /// Missing values become NaN and infinities are kept. Text that is not a number is still an
    /// error.
    Kept,
}

/// Columns of numbers from any kind of table, in the requested order.
#[derive(Debug, Clone)]
pub(crate) struct NumberColumns {
    pub(crate) values: Vec<Vec<f64>>,
    pub(crate) rows: usize,
    /// The line number of each row of a text table. `None` for a table in FITS or in memory, which has no lines.
    pub(crate) lines: Option<Vec<u64>>,
}

impl NumberColumns {
    /// The place of a row in the file.
    pub(crate) fn place(&self, row: usize) -> Row {
        self.lines
            .as_ref()
            .map_or(Row::Index(row), |lines| Row::Line(lines[row]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_lists_of_names_are_cut() {
        let names: Vec<String> = (0..300).map(|k| k.to_string()).collect();
        let list = listed(&names);
        assert_eq!((list.len(), list[LISTED].as_str()), (LISTED + 1, "and 280 more"));
    }

    #[test]
    fn forms_of_binary_tables_are_understood() {
        let of = |form: &str| Column::new(1, "X".into(), form.into());
        let width = |form: &str| of(form).and_then(|c| c.bytes());
        assert_eq!(
            [width("D"), width("1D"), width("12E"), width("9X"), width("20A")].map(Option::unwrap),
            [8, 8, 48, 2, 20]
        );
        assert_eq!(width("1PE(20)"), Some(8));
        assert_eq!(width("0D"), Some(0));
        let elements = ["1PB(20)", " qi", "1P", "1D"].map(|form| of(form).and_then(|c| c.element()));
        assert_eq!(elements, [Some(b'B'), Some(b'I'), None, None]);
        for one in ["20A", "A", " 8A8 "] {
            assert!(of(one).is_some_and(|c| c.is_text), "{one}");
        }
        for several in ["28A14", "0A", "60A0", "28A13", "60A(0)", "60A0x", "60A-3", "20E"] {
            assert!(of(several).is_some_and(|c| !c.is_text), "{several}");
        }
        for bad in ["", "7", "Z", "99999999999999999999999D"] {
            assert!(of(bad).is_none(), "{bad}");
        }
        assert_eq!(width("9999999999999999999D"), None);
    }
}
