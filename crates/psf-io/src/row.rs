//! Rows of tables, as errors name them.

/// Where a value stands in a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Row {
    /// The line of a text file, from 1.
    Line(u64),
    /// The row of a FITS table, from 0.
    Index(usize),
}

impl std::fmt::Display for Row {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Line(line) => write!(f, "line {line}"),
            Self::Index(row) => write!(f, "row {row} (0-based)"),
        }
    }
}
