//! A table of numbers in memory.

use std::path::{Path, PathBuf};

use crate::error::{IoError, IoErrorKind, Place, Row};
use crate::fits::columns::{Nans, NumberColumns, bad_value, find};

/// A table in memory, of columns of numbers. A missing value is NaN.
///
/// ```
/// use psf_io::{CatalogOptions, NumberTable, catalog_of};
/// let table = NumberTable::new("my stars")
///     .with_column("x", vec![3.0, 4.5])?
///     .with_column("y", vec![7.0, 1.0])?
///     .with_column("flux", vec![100.0, f64::NAN])?;
/// let error = catalog_of(&table, &CatalogOptions::new()).unwrap_err();
/// assert!(error.to_string().starts_with("my stars: row 1 (0-based), column \"flux\""));
/// # Ok::<(), psf_io::IoError>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct NumberTable {
    /// Stands for the path of a file in messages.
    name: PathBuf,
    columns: Vec<(String, Vec<f64>)>,
    rows: Option<usize>,
}

impl NumberTable {
    /// A table without columns. `name` begins its messages.
    pub fn new(name: impl Into<PathBuf>) -> Self {
        Self {
            name: name.into(),
            ..Self::default()
        }
    }

    /// Adds a column.
    ///
    /// # Errors
    /// [`IoErrorKind::Table`] for a column with more or fewer rows than the others.
    pub fn with_column(mut self, name: &str, values: Vec<f64>) -> Result<Self, IoError> {
        let rows = *self.rows.get_or_insert(values.len());
        if values.len() != rows {
            let problem = format!("the column has {} rows, but the others have {rows}", values.len());
            let place = Place::Column(name.to_owned());
            return Err(IoError::new(&self.name, IoErrorKind::Table, problem).at(place));
        }
        self.columns.push((name.to_owned(), values));
        Ok(self)
    }

    pub(super) fn name(&self) -> &Path {
        &self.name
    }

    pub(super) fn names(&self) -> Vec<String> {
        self.columns.iter().map(|(name, _)| name.clone()).collect()
    }

    /// The error for a column that is needed as texts.
    pub(super) fn holds_numbers(&self, name: &str) -> IoError {
        const NUMBERS: &str = "texts are needed, but a table in memory holds numbers only";
        IoError::new(&self.name, IoErrorKind::Table, NUMBERS).at(Place::Column(name.to_owned()))
    }

    /// Reads the columns with these names. Case is ignored.
    pub(super) fn read(&self, names: &[&str], nans: Nans) -> Result<NumberColumns, IoError> {
        let column = |name: &&str| {
            let place = find(&self.name, self.columns.iter().map(|(name, _)| name), name)?;
            let (name, values) = &self.columns[place];
            match values.iter().position(|value| !value.is_finite()) {
                Some(row) if nans == Nans::Refused => {
                    let got = values[row].to_string();
                    Err(bad_value(&self.name, Row::Index(row), name, &got))
                }
                _ => Ok(values.clone()),
            }
        };
        Ok(NumberColumns {
            values: names.iter().map(column).collect::<Result<_, _>>()?,
            rows: self.rows.unwrap_or(0),
            lines: None,
        })
    }
}
