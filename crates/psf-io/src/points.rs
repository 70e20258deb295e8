//! Catalogues and lists of positions: tables in.
//!
//! # Layout
//!
//! A text table or a binary table of a FITS file, told apart by content, not by name.
//!
//! | column | meaning |
//! |---|---|
//! | `x`, `y` | position in pixels of the frame, 0-based, an integer is the centre of a pixel; sub-pixel, also outside the frame |
//! | `flux` | total flux of the source (catalogues only) |
//!
//! Upper and lower case are the same, columns stand in any order, and further columns are ignored. Other names, 1-based pixels, magnitudes,
//! sky coordinates and galaxies: [`read_catalog_with`](crate::read_catalog_with) and [`CatalogColumns`](crate::CatalogColumns).
//!
//! * **Text**: fields separated by commas (values may be quoted), tabs or blanks. The first line that does not start with `#` names the
//!   columns, or, when it is a row of numbers, the last comment ahead of it; SExtractor's `ASCII_HEAD` is known too. Later
//!   lines with `#` and empty lines are skipped.
//! * **FITS**: the binary table that has the columns, each of one number (any integer or float type) a row, such as
//!   `LDAC_OBJECTS` of a `FITS_LDAC` catalogue; where several have them, one must be chosen.
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

use crate::columns::Table;
use crate::error::invalid;
use crate::number_columns::{Gaps, NumberColumns};
use crate::structure::FitsStructure;
use crate::table_file::TableFile;
use crate::text_table::listed;
use crate::{CatalogOptions, IoError, read_positions_with};

/// Reads a catalogue of point sources: the columns x, y and flux. Others are not looked at: [`read_catalog_with`](crate::read_catalog_with)
/// knows galaxies too.
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
    read_positions_with(path, &CatalogOptions::new())
}

/// Reads columns of finite numbers, by name, from a text table or the binary table of a FITS file that has them all.
///
/// # Errors
/// As [`read_catalog`].
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
        match missing {
            None => Ok(()),
            Some(name) => Err(IoError::MissingColumn {
                path: path.to_owned(),
                column: (*name).to_owned(),
                found: listed(found),
            }),
        }
    })?;
    let columns = table
        .read(&names, Gaps::Refused)
        .map(NumberColumns::into_values)?;
    Ok(columns.try_into().expect("a column for each name"))
}

/// Whether a file has a binary table with the columns x and y.
pub(crate) fn has_points(structure: &FitsStructure) -> bool {
    let has = |hdu, names: [&str; 2]| {
        Table::new(structure, hdu).is_ok_and(|table| names.iter().all(|name| table.column(name).is_ok()))
    };
    structure.tables().any(|hdu| has(hdu, ["x", "y"]))
}

fn positions(path: &Path, x: Vec<f64>, y: Vec<f64>) -> Result<Vec<Position>, IoError> {
    x.into_iter()
        .zip(y)
        .map(|(x, y)| Position::new(x, y).map_err(invalid(path)))
        .collect()
}
