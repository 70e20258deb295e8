//! Columns of binary tables.

use crate::cfitsio::Fits;
use crate::hdu::Hdu;
use crate::number_columns::Gaps;
use crate::structure::FitsStructure;
use crate::text_table::listed;
use crate::{IoError, Row};

/// A column of a binary table.
#[derive(Debug)]
pub(crate) struct Column {
    /// Counted from 1, as CFITSIO does.
    number: usize,
    pub(crate) name: String,
    form: String,
    /// Values in a row.
    repeat: usize,
    /// The type letter of TFORM.
    pub(crate) code: u8,
}

/// A binary table whose columns fill its rows exactly, so that its row count is bounded by the file's length.
#[derive(Debug)]
pub(crate) struct Table<'a> {
    structure: &'a FitsStructure,
    hdu: &'a Hdu,
    pub(crate) columns: Vec<Column>,
    rows: usize,
}

impl<'a> Table<'a> {
    pub(crate) fn new(structure: &'a FitsStructure, hdu: &'a Hdu) -> Result<Self, IoError> {
        let &[row_bytes, rows] = hdu.axes.as_slice() else {
            return Err(hdu.header_error("NAXIS", "a table has 2 axes"));
        };
        let columns = columns(hdu, row_bytes)?;
        Ok(Self {
            structure,
            hdu,
            columns,
            rows,
        })
    }

    /// Number of rows.
    pub(crate) fn rows(&self) -> usize {
        self.rows
    }

    /// The names of the columns.
    pub(crate) fn names(&self) -> Vec<String> {
        self.columns.iter().map(|column| column.name.clone()).collect()
    }

    /// The column of this name, upper or lower case.
    pub(crate) fn column(&self, name: &str) -> Result<&Column, IoError> {
        let path = &self.structure.path;
        let mut found = self
            .columns
            .iter()
            .filter(|column| column.name.eq_ignore_ascii_case(name));
        match (found.next(), found.next()) {
            (Some(column), None) => Ok(column),
            (None, _) => Err(IoError::MissingColumn {
                path: path.clone(),
                column: name.to_owned(),
                found: listed(self.columns.iter().map(|column| &column.name)),
            }),
            (Some(_), Some(_)) => Err(IoError::AmbiguousColumn {
                path: path.clone(),
                column: name.to_owned(),
            }),
        }
    }

    /// All values of a column of numbers that has `repeat` of them in each row; NaN and infinities are refused.
    pub(crate) fn read(&self, name: &str, repeat: usize) -> Result<Vec<f64>, IoError> {
        self.read_with(name, repeat, Gaps::Refused)
    }

    /// The same, where undefined values may be allowed.
    pub(crate) fn read_with(&self, name: &str, repeat: usize, gaps: Gaps) -> Result<Vec<f64>, IoError> {
        let column = self.column(name)?;
        if !b"BIJKED".contains(&column.code) || column.repeat != repeat {
            return Err(IoError::ColumnFormat {
                path: self.structure.path.clone(),
                hdu: self.hdu.index,
                column: column.name.clone(),
                expected: format!("{repeat} number(s) in a row (such as {repeat}D)"),
                got: column.form.clone(),
            });
        }
        let mut values = vec![0.0; self.rows * repeat];
        let mut fits = Fits::open(self.hdu.source())?;
        fits.move_to(self.hdu.index)?;
        let null = !b"ED".contains(&column.code)
            && self.hdu.header.get(&format!("TNULL{}", column.number)).is_some();
        if !values.is_empty() {
            fits.read_column(column.number, &mut values, null)?;
        }
        let refused = |value: &f64| gaps == Gaps::Refused && !value.is_finite();
        match values.iter().position(refused) {
            None => Ok(values),
            Some(flat) => Err(IoError::Value {
                path: self.structure.path.clone(),
                row: Row::Index(flat / repeat),
                column: column.name.clone(),
                got: values[flat].to_string(),
            }),
        }
    }
}

/// The columns of a binary table, which fill its rows.
pub(crate) fn columns(hdu: &Hdu, row_bytes: usize) -> Result<Vec<Column>, IoError> {
    let count = hdu.structural("TFIELDS", None)?;
    let mut width = 0_usize;
    let mut columns = Vec::new();
    for number in 1..=count as usize {
        let keyword = format!("TFORM{number}");
        let form = hdu
            .text(&keyword)
            .ok_or_else(|| hdu.header_error(&keyword, "must be a text"))?;
        let column = Column::new(
            number,
            hdu.text(&format!("TTYPE{number}")).unwrap_or_default(),
            form,
        );
        let column = column.ok_or_else(|| hdu.header_error(&keyword, "is no column format"))?;
        let bytes = column.bytes().and_then(|bytes| width.checked_add(bytes));
        width = bytes.ok_or_else(|| hdu.header_error(&keyword, "the column is wider than any table"))?;
        columns.push(column);
    }
    if width != row_bytes {
        return Err(hdu.header_error("NAXIS1", "the columns do not add up to the length of a row"));
    }
    Ok(columns)
}

impl Column {
    /// `None` when the form is not one of a binary table.
    fn new(number: usize, name: String, form: String) -> Option<Self> {
        let text = form.trim();
        let digits = text.bytes().take_while(u8::is_ascii_digit).count();
        let repeat = if digits == 0 {
            1
        } else {
            text[..digits].parse().ok()?
        };
        let code = text.as_bytes().get(digits)?.to_ascii_uppercase();
        let column = Self {
            number,
            name: name.trim().to_owned(),
            repeat,
            code,
            form,
        };
        b"LXBIJKAEDCMPQ".contains(&code).then_some(column)
    }

    /// The type letter of what the descriptors of a column of arrays stand for.
    pub(crate) fn element(&self) -> Option<u8> {
        let (_, element) = self.form.trim().split_once(['P', 'Q', 'p', 'q'])?;
        element.bytes().next().map(|letter| letter.to_ascii_uppercase())
    }

    /// Bytes in a row.
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

#[cfg(test)]
mod tests {
    use super::*;

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
        for bad in ["", "7", "Z", "99999999999999999999999D"] {
            assert!(of(bad).is_none(), "{bad}");
        }
        assert_eq!(width("9999999999999999999D"), None);
    }
}
