//! How the pixels of somebody else's images lie in memory.

use ndarray::ArrayViewMut2;
use psf_types::FrameShape;

use crate::{ConvError, ConvReal};

/// Whether an image `[y, x]` has the shape asked for.
pub(crate) fn check_shape(expected: FrameShape, (rows, columns): (usize, usize)) -> Result<(), ConvError> {
    if (rows, columns) == (expected.ny(), expected.nx()) {
        return Ok(());
    }
    let got = FrameShape::new(columns, rows).map_err(ConvError::Result)?;
    Err(ConvError::FrameShape { expected, got })
}

/// Lends an image in which the pixels of a row are neighbours in memory: the image itself or, where they are not, a copy that is copied
/// back unless there is an error.
pub(crate) fn with_rows_in_memory<T: ConvReal, R>(
    mut image: ArrayViewMut2<'_, T>,
    work: impl FnOnce(ArrayViewMut2<'_, T>) -> Result<R, ConvError>,
) -> Result<R, ConvError> {
    if image.nrows() == 0 || image.row(0).as_slice().is_some() {
        return work(image);
    }
    let mut copy = image.as_standard_layout().into_owned();
    let result = work(copy.view_mut())?;
    image.assign(&copy);
    Ok(result)
}
