//! Columns of numbers, from whatever kind of table.

use crate::Row;

/// What becomes of values that are missing or not finite.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Gaps {
    /// They are errors.
    Refused,
    /// What is missing becomes NaN, infinities stay; text that is no number is an error all the same.
    Kept,
}

/// Columns of numbers and where their rows stand in the file.
#[derive(Debug)]
pub(crate) struct NumberColumns {
    values: Vec<Vec<f64>>,
    rows: usize,
    /// The lines of a text table; those of a FITS table are counted.
    lines: Option<Vec<u64>>,
}

impl NumberColumns {
    /// Columns of a text table: the line of each row.
    pub(crate) fn of_text(values: Vec<Vec<f64>>, lines: Vec<u64>) -> Self {
        Self {
            values,
            rows: lines.len(),
            lines: Some(lines),
        }
    }

    /// Columns of a FITS table.
    pub(crate) fn of_fits(values: Vec<Vec<f64>>, rows: usize) -> Self {
        Self {
            values,
            rows,
            lines: None,
        }
    }

    /// Number of rows.
    pub(crate) fn rows(&self) -> usize {
        self.rows
    }

    /// Where a row stands in the file.
    pub(crate) fn place(&self, row: usize) -> Row {
        match &self.lines {
            Some(lines) => Row::Line(lines[row]),
            None => Row::Index(row),
        }
    }

    /// The columns in the order asked for.
    pub(crate) fn values(&self) -> &[Vec<f64>] {
        &self.values
    }

    /// The same, without a copy.
    pub(crate) fn into_values(self) -> Vec<Vec<f64>> {
        self.values
    }
}
