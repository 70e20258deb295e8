//! Reads tables of numbers from text files and FITS files, and writes CSV.

use std::path::Path;

use serde::Serialize;

use crate::catalogue::memory_table::MemoryTable;
use crate::catalogue::text_table::{NOT_CSV, TextTable};
use crate::error::{IoError, IoErrorKind, unwritable};
use crate::fits::columns::{Nans, NumberColumns, Table, missing_column};
use crate::fits::hdu::HduChoice;
use crate::fits::structure::{self, FitsStructure, is_fits};
use crate::output::write_atomically;

/// A text table, or a FITS file with any number of tables.
#[derive(Debug)]
pub(crate) enum TableFile {
    Text(TextTable),
    Fits(FitsStructure),
}

/// One table, of a file or in memory.
#[derive(Debug)]
pub(crate) enum AnyTable<'a> {
    Text(&'a TextTable),
    Fits(Table<'a>),
    Memory(&'a MemoryTable),
}

impl TableFile {
    pub(crate) fn open(path: &Path) -> Result<Self, IoError> {
        Ok(if is_fits(path)? {
            Self::Fits(FitsStructure::scan(path)?)
        } else {
            Self::Text(TextTable::open(path)?)
        })
    }

    /// Returns a table, and the result of `take` for its column names. The table is the chosen one,
    /// or without a choice the only one whose names `take` accepts. A text file holds one table, so
    /// a choice is an error. If a FITS file has no tables, the error lists the columns in `needed`.
    pub(crate) fn pick<R>(
        &self,
        choice: Option<&HduChoice>,
        needed: &str,
        take: impl Fn(&[String]) -> Result<R, IoError>,
    ) -> Result<(R, AnyTable<'_>), IoError> {
        let structure = match self {
            Self::Text(table) if choice.is_none() => return Ok((take(&table.names)?, AnyTable::Text(table))),
            Self::Text(table) => return Err(table.has_no_hdus()),
            Self::Fits(structure) => structure,
        };
        if let Some(choice) = choice {
            let table = Table::new(structure.chosen_table(choice)?)?;
            return Ok((take(&table.names())?, AnyTable::Fits(table)));
        }
        let mut taken = Vec::new();
        // Reports the error of the widest table, because smaller tables next to it often hold only
        // headers and similar data.
        let mut refused: Option<(usize, IoError)> = None;
        for hdu in structure.tables() {
            let table = Table::new(hdu)?;
            match take(&table.names()) {
                Ok(result) => taken.push((hdu, result, table)),
                Err(error) => {
                    if refused
                        .as_ref()
                        .is_none_or(|(width, _)| table.columns.len() > *width)
                    {
                        refused = Some((table.columns.len(), error));
                    }
                }
            }
        }
        if taken.len() > 1 {
            let hdus = taken.iter().map(|&(hdu, ..)| hdu);
            return Err(structure.several("tables with the needed columns", structure::TABLE, hdus));
        }
        match (taken.pop(), refused) {
            (Some((_, result, table)), _) => Ok((result, AnyTable::Fits(table))),
            (None, Some((_, error))) => Err(error),
            (None, None) => Err(structure.no_table(needed)),
        }
    }
}

impl AnyTable<'_> {
    /// The names of the columns.
    pub(crate) fn names(&self) -> Vec<String> {
        match self {
            Self::Text(table) => table.names.clone(),
            Self::Fits(table) => table.names(),
            Self::Memory(table) => table.names(),
        }
    }

    /// The unit of a column. Empty if the table does not state it.
    pub(crate) fn unit(&self, name: &str) -> Result<String, IoError> {
        match self {
            Self::Text(table) => table.unit(name),
            Self::Fits(table) => table.unit(name),
            Self::Memory(table) => Ok(table.unit(name)),
        }
    }

    /// Reads a column of texts. Case is ignored in its name.
    pub(crate) fn read_texts(&self, name: &str) -> Result<Vec<String>, IoError> {
        match self {
            Self::Text(table) => table.read_texts(name),
            Self::Fits(table) => table.read_texts(name),
            Self::Memory(table) => table.read_texts(name),
        }
    }

    /// Reads the columns with these names. Case is ignored.
    pub(crate) fn read(&self, names: &[&str], nans: Nans) -> Result<NumberColumns, IoError> {
        match self {
            Self::Text(table) => table.read(names, nans),
            Self::Fits(table) => {
                let columns = names.iter().map(|name| table.read_with(name, 1, nans));
                Ok(NumberColumns {
                    values: columns.collect::<Result<_, _>>()?,
                    rows: table.rows,
                    lines: None,
                })
            }
            Self::Memory(table) => table.read(names, nans),
        }
    }
}

/// Reads columns of finite numbers by name, from a text table or from the binary table of a FITS
/// file that has all of them.
///
/// # Errors
/// The errors of [`read_catalog`](crate::read_catalog).
pub fn read_columns<const N: usize>(
    path: impl AsRef<Path>,
    names: [&str; N],
) -> Result<[Vec<f64>; N], IoError> {
    let path = path.as_ref();
    let file = TableFile::open(path)?;
    let ((), table) = file.pick(None, &names.join(", "), |found| {
        let missing = names
            .iter()
            .find(|name| !found.iter().any(|f| f.eq_ignore_ascii_case(name)));
        missing.map_or(Ok(()), |name| Err(missing_column(path, found, name, "")))
    })?;
    let columns = table.read(&names, Nans::Refused)?.values;
    Ok(columns.try_into().expect("one column per name"))
}

/// Writes rows as a CSV file with a line of column names. The file appears complete or not at all.
///
/// A row is a tuple, an array or a struct with one field per column. `None` becomes an empty field.
/// Numbers are written with as many digits as are needed to read the same bits back.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("table.csv");
/// let rows = [(10.25, Some(2.1), ""), (3.0, None, "no light")];
/// psf_io::write_csv(&path, &["x", "fwhm_px", "note"], rows, false)?;
/// assert_eq!(std::fs::read_to_string(&path)?, "x,fwhm_px,note\n10.25,2.1,\n3.0,,no light\n");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`IoErrorKind::Table`] if a row does not have one field per column, and the errors of
/// [`write_atomically`].
pub fn write_csv<R: Serialize>(
    path: impl AsRef<Path>,
    columns: &[&str],
    rows: impl IntoIterator<Item = R>,
    overwrite: bool,
) -> Result<(), IoError> {
    let path = path.as_ref();
    let failed = |source: csv::Error| {
        if source.is_io_error() {
            return unwritable(path)(source.into());
        }
        IoError::new(path, IoErrorKind::Table, NOT_CSV).because(source)
    };
    write_atomically(path, overwrite, |temporary| {
        let mut writer = csv::WriterBuilder::new()
            .has_headers(false)
            .from_path(temporary)
            .map_err(failed)?;
        writer.write_record(columns).map_err(failed)?;
        for row in rows {
            writer.serialize(row).map_err(failed)?;
        }
        writer.flush().map_err(unwritable(path))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_must_have_one_field_per_column() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.csv");
        let failed = write_csv(&path, &["a", "b"], [(1, 2, 3)], false);
        assert_eq!(failed.unwrap_err().kind(), IoErrorKind::Table);
        assert!(!path.exists());
        write_csv(&path, &["a", "b"], std::iter::empty::<(f64, f64)>(), false).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "a,b\n");
    }

    #[test]
    fn numbers_come_back_bit_by_bit() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.csv");
        let values = [(0.1, 5e-324), (-1.0 / 3.0, f64::MAX)];
        write_csv(&path, &["x", "y"], values, false).unwrap();
        assert_eq!(
            read_columns(&path, ["x", "y"]).unwrap(),
            [vec![0.1, -1.0 / 3.0], vec![5e-324, f64::MAX]]
        );
    }
}
