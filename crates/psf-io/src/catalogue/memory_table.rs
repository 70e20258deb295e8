//! A table in memory.

use std::hash::Hasher as _;
use std::path::{Path, PathBuf};

use fnv::FnvHasher;

use crate::error::{IoError, IoErrorKind, Place, Row};
use crate::fits::columns::{Nans, NumberColumns, bad_value, find};

/// A table in memory, of columns of numbers and of texts. A missing number is NaN.
///
/// ```
/// use psf_io::{CatalogOptions, MemoryTable, catalog_of};
/// let table = MemoryTable::new("my stars")
///     .with_column("x", vec![3.0, 4.5])?
///     .with_column("y", vec![7.0, 1.0])?
///     .with_column("flux", vec![100.0, f64::NAN])?;
/// let error = catalog_of(&table, &CatalogOptions::new()).unwrap_err();
/// assert!(error.to_string().starts_with("my stars: row 1 (0-based), column \"flux\""));
/// # Ok::<(), psf_io::IoError>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct MemoryTable {
    /// Stands for the path of a file in messages.
    name: PathBuf,
    columns: Vec<(String, Column)>,
    /// The units of some columns, by their names.
    units: Vec<(String, String)>,
    rows: Option<usize>,
}

#[derive(Debug, Clone)]
enum Column {
    Numbers(Vec<f64>),
    Texts(Vec<String>),
}

impl MemoryTable {
    /// A table without columns. `name` begins its messages.
    pub fn new(name: impl Into<PathBuf>) -> Self {
        Self {
            name: name.into(),
            ..Self::default()
        }
    }

    /// Adds a column of numbers.
    ///
    /// # Errors
    /// [`IoErrorKind::Table`] for a column with more or fewer rows than the others.
    pub fn with_column(self, name: &str, values: Vec<f64>) -> Result<Self, IoError> {
        self.with(name, values.len(), Column::Numbers(values))
    }

    /// States the unit of a column, as a file does. Without one, its values have the unit of its role.
    #[must_use]
    pub fn with_unit(mut self, name: &str, unit: &str) -> Self {
        self.units.push((name.to_owned(), unit.to_owned()));
        self
    }

    /// Adds a column of texts.
    ///
    /// # Errors
    /// [`IoErrorKind::Table`] for a column with more or fewer rows than the others.
    pub fn with_texts(self, name: &str, texts: Vec<String>) -> Result<Self, IoError> {
        self.with(name, texts.len(), Column::Texts(texts))
    }

    fn with(mut self, name: &str, count: usize, column: Column) -> Result<Self, IoError> {
        let rows = *self.rows.get_or_insert(count);
        if count != rows {
            return Err(self.error(
                name,
                format!("the column has {count} rows, but the others have {rows}"),
            ));
        }
        self.columns.push((name.to_owned(), column));
        Ok(self)
    }

    fn error(&self, column: &str, problem: impl Into<String>) -> IoError {
        IoError::new(&self.name, IoErrorKind::Table, problem).at(Place::Column(column.to_owned()))
    }

    /// The column of a name, and how the table spells it. Case is ignored.
    fn column(&self, name: &str) -> Result<&(String, Column), IoError> {
        let place = find(&self.name, self.columns.iter().map(|(name, _)| name), name)?;
        Ok(&self.columns[place])
    }

    /// A digest of all names, units and values. It is the same on all machines and in all releases.
    pub fn digest(&self) -> u64 {
        let mut hasher = FnvHasher::default();
        let add = |hasher: &mut FnvHasher, text: &str| {
            hasher.write(text.as_bytes());
            // A separator after each text keeps ("ab", "c") apart from ("a", "bc").
            hasher.write(&[0xff]);
        };
        for (name, column) in &self.columns {
            add(&mut hasher, name);
            add(&mut hasher, &self.unit(name));
            match column {
                Column::Numbers(values) => values.iter().for_each(|value| hasher.write(&value.to_le_bytes())),
                Column::Texts(texts) => texts.iter().for_each(|text| add(&mut hasher, text)),
            }
        }
        hasher.finish()
    }

    /// The unit of a column. Empty if it is not stated.
    pub(super) fn unit(&self, name: &str) -> String {
        let found = self.units.iter().find(|(of, _)| of.eq_ignore_ascii_case(name));
        found.map_or_else(String::new, |(_, unit)| unit.clone())
    }

    pub(super) fn name(&self) -> &Path {
        &self.name
    }

    pub(super) fn names(&self) -> Vec<String> {
        self.columns.iter().map(|(name, _)| name.clone()).collect()
    }

    /// Reads a column of texts. Case is ignored in its name.
    pub(super) fn read_texts(&self, name: &str) -> Result<Vec<String>, IoError> {
        match self.column(name)? {
            (_, Column::Texts(texts)) => Ok(texts.clone()),
            (name, Column::Numbers(_)) => Err(self.error(name, "the column must hold texts, not numbers")),
        }
    }

    /// Reads the columns with these names. Case is ignored.
    pub(super) fn read(&self, names: &[&str], nans: Nans) -> Result<NumberColumns, IoError> {
        let column = |name: &&str| {
            let (name, values) = match self.column(name)? {
                (name, Column::Numbers(values)) => (name, values),
                (name, Column::Texts(_)) => {
                    return Err(self.error(name, "the column must hold numbers, not texts"));
                }
            };
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
