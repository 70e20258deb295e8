//! The layout of images in memory.

use ndarray::{Array2, ArrayViewMut2, LinalgScalar};
use psf_types::FrameShape;
use rayon::prelude::*;

use crate::{ConvError, ConvReal};

/// Checks that an image `[y, x]` has the expected shape.
pub(crate) fn check_shape(expected: FrameShape, (rows, columns): (usize, usize)) -> Result<(), ConvError> {
    if (rows, columns) == (expected.ny(), expected.nx()) {
        return Ok(());
    }
    let got = FrameShape::new(columns, rows).map_err(ConvError::Result)?;
    Err(ConvError::FrameShape { expected, got })
}

/// Calls `work` with an image in which the pixels of each row are contiguous in memory. This is the
/// image itself or, if its pixels have another layout, a copy. The copy is written back unless
/// there is an error.
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

/// The assumed size of a memory page in bytes. It must not be larger than the system's pages,
/// because [`zeros`] would then skip some of them.
const PAGE: usize = 4096;

/// Returns an image `[y, x]` of zeros. Its memory pages are already allocated, because threads have
/// written to each page.
///
/// The operating system allocates a page when it is first used. An addition reads a page before it
/// writes to it. The system then works twice: for the read it lends a page of zeros that all
/// programs share, and for the write it allocates a new page. It also interrupts every processor
/// core, so that the core forgets the shared page. For a large image, these interrupts take several
/// times as long as the convolution.
pub fn zeros<T: LinalgScalar + Send>((rows, columns): (usize, usize)) -> Array2<T> {
    let mut image = Array2::zeros((rows, columns));
    let pixels: &mut [T] = image.as_slice_mut().expect("new arrays are row-major");
    pixels
        .par_chunks_mut(PAGE / size_of::<T>())
        .with_min_len(256)
        .for_each(|page| page[0] = T::zero());
    image
}
