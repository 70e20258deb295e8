//! Tables out.

use std::path::Path;

use serde::Serialize;

use crate::pending_file::write_failed;
use crate::{IoError, write_atomically};

/// Writes rows as a CSV file with a line of column names; the file appears whole or not at all.
///
/// A row is a tuple, an array or a struct with one field a column; `None` is an empty field. Numbers are written with as many digits
/// as bring back the same bits.
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
/// [`IoError::Csv`] when a row does not have one field a column, [`IoError::Exists`] unless `overwrite`,
/// [`IoError::MissingDirectory`] or [`IoError::Write`].
pub fn write_csv<R: Serialize>(
    path: impl AsRef<Path>,
    columns: &[&str],
    rows: impl IntoIterator<Item = R>,
    overwrite: bool,
) -> Result<(), IoError> {
    let path = path.as_ref();
    let failed = |source: csv::Error| {
        if source.is_io_error() {
            return write_failed(path, source.into());
        }
        IoError::Csv {
            path: path.to_owned(),
            source,
        }
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
        writer.flush().map_err(|source| write_failed(path, source))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_must_have_one_field_a_column() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.csv");
        let failed = write_csv(&path, &["a", "b"], [(1, 2, 3)], false);
        assert!(matches!(failed, Err(IoError::Csv { .. })));
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
            crate::read_columns(&path, ["x", "y"]).unwrap(),
            [vec![0.1, -1.0 / 3.0], vec![5e-324, f64::MAX]]
        );
    }
}
