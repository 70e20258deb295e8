//! Catalogues and lists of positions: tables in.
//!
//! # Layout
//!
//! A CSV file or a binary table of a FITS file, told apart by content, not by name.
//!
//! | column | meaning |
//! |---|---|
//! | `x`, `y` | position in pixels of the frame, 0-based, an integer is the centre of a pixel; sub-pixel, also outside the frame |
//! | `flux` | total flux of the source (catalogues only) |
//!
//! Upper and lower case are the same, columns stand in any order, and further columns are ignored.
//!
//! * **CSV**: commas; the first line that does not start with `#` names the columns; later lines with `#` and empty lines are
//!   skipped; values may be quoted.
//! * **FITS**: the first binary table that has the columns, each of one number (any integer or float type) a row.
//!
//! A catalogue from Python:
//!
//! ```python
//! from astropy.table import Table
//! catalogue = Table({"x": x, "y": y, "flux": flux})    # 0-based pixels
//! catalogue.write("stars.csv")                         # or "stars.fits"
//! ```

use std::path::Path;

use psf_types::{PointSource, Position};

use crate::IoError;
use crate::columns::Table;
use crate::csv_in::read_csv_columns;
use crate::error::invalid;
use crate::structure::{FitsStructure, Magic, magic};

/// Reads a catalogue of point sources: the columns x, y and flux.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("stars.csv");
/// std::fs::write(&path, "# two stars\nid,Flux,x,y\n1,1e5,10.25,3\n2,20,-4,7.5\n")?;
/// let stars = psf_io::read_catalog(&path)?;
/// assert_eq!((stars[1].position().x(), stars[0].flux()), (-4.0, 1e5));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`IoError::MissingColumn`], [`IoError::Value`] with the row and column of what is not a finite number, and the errors of any
/// FITS or CSV file.
pub fn read_catalog(path: impl AsRef<Path>) -> Result<Vec<PointSource>, IoError> {
    let path = path.as_ref();
    let [x, y, flux] = read_columns(path, ["x", "y", "flux"])?;
    let positions = positions(path, x, y)?;
    let sources = positions.into_iter().zip(flux);
    sources
        .map(|(position, flux)| PointSource::new(position, flux).map_err(invalid(path)))
        .collect()
}

/// Reads a list of positions: the columns x and y.
///
/// # Errors
/// As [`read_catalog`].
pub fn read_positions(path: impl AsRef<Path>) -> Result<Vec<Position>, IoError> {
    let path = path.as_ref();
    let [x, y] = read_columns(path, ["x", "y"])?;
    positions(path, x, y)
}

/// Reads columns of finite numbers, by name, from a CSV file or the first binary table of a FITS file that has them all.
///
/// # Errors
/// As [`read_catalog`].
pub fn read_columns<const N: usize>(
    path: impl AsRef<Path>,
    names: [&str; N],
) -> Result<[Vec<f64>; N], IoError> {
    let path = path.as_ref();
    if magic(path)? != Magic::Fits {
        return read_csv_columns(path, names);
    }
    let structure = FitsStructure::scan(path)?;
    let Some(table) = table_with(&structure, &names)? else {
        return Err(structure.missing(&format!("binary table (columns needed: {})", names.join(", "))));
    };
    let mut columns = [const { Vec::new() }; N];
    for (column, name) in columns.iter_mut().zip(names) {
        *column = table.read(name, 1)?;
    }
    Ok(columns)
}

/// Whether a file has a binary table with the columns x and y.
pub(crate) fn has_points(structure: &FitsStructure) -> bool {
    matches!(table_with(structure, &["x", "y"]), Ok(Some(table)) if ["x", "y"].iter().all(|name| table.column(name).is_ok()))
}

/// The first binary table with these columns; failing that, the first at all, whose columns an error can list.
fn table_with<'a>(structure: &'a FitsStructure, names: &[&str]) -> Result<Option<Table<'a>>, IoError> {
    let mut first = None;
    for hdu in structure.tables() {
        let table = Table::new(structure, hdu)?;
        if names.iter().all(|name| table.column(name).is_ok()) {
            return Ok(Some(table));
        }
        first.get_or_insert(table);
    }
    Ok(first)
}

fn positions(path: &Path, x: Vec<f64>, y: Vec<f64>) -> Result<Vec<Position>, IoError> {
    x.into_iter()
        .zip(y)
        .map(|(x, y)| Position::new(x, y).map_err(invalid(path)))
        .collect()
}
