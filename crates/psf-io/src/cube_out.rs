//! Cubes out.

use std::path::Path;

use ndarray::ArrayView3;

use crate::new_fits::{write_fits, write_image_hdu};
use crate::{Card, HeaderCards, IoError};

/// Writes a stack `[plane, y, x]` in single precision, with `cards` in its header; the file appears whole or not at all.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("cube.fits");
/// use ndarray::Array3;
/// let cube = Array3::from_elem((2, 3, 4), 1.5);
/// psf_io::write_cube(&path, cube.view(), &[], false)?;
/// assert_eq!(psf_io::read_cube::<f64>(&path)?, cube);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`IoError::Overflow`] for a value beyond single precision, [`IoError::Exists`] unless `overwrite`,
/// [`IoError::MissingDirectory`], or what the file system and CFITSIO report.
pub fn write_cube(
    path: impl AsRef<Path>,
    cube: ArrayView3<'_, f64>,
    cards: &[Card],
    overwrite: bool,
) -> Result<(), IoError> {
    let path = path.as_ref();
    let values: Vec<f32> = cube.iter().map(|&v| v as f32).collect();
    if values.iter().any(|v| !v.is_finite()) {
        return Err(IoError::Overflow {
            path: path.to_owned(),
        });
    }
    let cards = HeaderCards::new().with(cards);
    write_fits(path, overwrite, |fits| {
        write_image_hdu(fits, cube.shape(), &values, &cards)
    })
}
