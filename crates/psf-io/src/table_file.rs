//! A table in a file of any kind, and the choice of it.

use std::path::Path;

use crate::columns::Table;
use crate::number_columns::{Gaps, NumberColumns};
use crate::structure::{FitsStructure, Magic, magic};
use crate::text_table::TextTable;
use crate::{HduChoice, IoError};

/// A file that holds tables.
#[derive(Debug)]
pub(crate) enum TableFile {
    Text(TextTable),
    Fits(FitsStructure),
}

/// One table of a file.
#[derive(Debug)]
pub(crate) enum AnyTable<'a> {
    Text(&'a TextTable),
    Fits(Table<'a>),
}

impl TableFile {
    pub(crate) fn open(path: &Path) -> Result<Self, IoError> {
        Ok(if magic(path)? == Magic::Fits {
            Self::Fits(FitsStructure::scan(path)?)
        } else {
            Self::Text(TextTable::open(path)?)
        })
    }

    /// The table chosen, or else the only one whose column names a function takes, and what the function makes of them. `needed` says what
    /// the function looks for, for the error of a file without tables.
    pub(crate) fn pick<R>(
        &self,
        choice: Option<&HduChoice>,
        needed: &str,
        take: impl Fn(&[String]) -> Result<R, IoError>,
    ) -> Result<(R, AnyTable<'_>), IoError> {
        let structure = match self {
            Self::Text(table) => return Ok((take(table.names())?, AnyTable::Text(table))),
            Self::Fits(structure) => structure,
        };
        if let Some(choice) = choice {
            let table = Table::new(structure, structure.chosen_table(choice)?)?;
            return Ok((take(&table.names())?, AnyTable::Fits(table)));
        }
        let mut taken = Vec::new();
        // The refusal to report is that of the widest table: small ones beside it hold headers and the like.
        let mut refused: Option<(usize, IoError)> = None;
        for hdu in structure.tables() {
            let table = Table::new(structure, hdu)?;
            match take(&table.names()) {
                Ok(result) => taken.push((hdu, result, table)),
                Err(error) => {
                    if refused
                        .as_ref()
                        .is_none_or(|&(width, _)| table.columns.len() > width)
                    {
                        refused = Some((table.columns.len(), error));
                    }
                }
            }
        }
        if taken.len() > 1 {
            return Err(structure.several("tables that fit", taken.iter().map(|&(hdu, ..)| hdu)));
        }
        match (taken.pop(), refused) {
            (Some((_, result, table)), _) => Ok((result, AnyTable::Fits(table))),
            (None, Some((_, error))) => Err(error),
            (None, None) => Err(structure.no_table(needed)),
        }
    }
}

impl AnyTable<'_> {
    /// Reads columns by name, upper and lower case being the same.
    pub(crate) fn read(&self, names: &[&str], gaps: Gaps) -> Result<NumberColumns, IoError> {
        match self {
            Self::Text(table) => table.read(names, gaps),
            Self::Fits(table) => {
                let columns = names.iter().map(|name| table.read_with(name, 1, gaps));
                Ok(NumberColumns::of_fits(
                    columns.collect::<Result<_, _>>()?,
                    table.rows(),
                ))
            }
        }
    }
}
