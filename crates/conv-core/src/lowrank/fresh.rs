//! Fresh memory for images.

use ndarray::Array2;
use rayon::prelude::*;

use crate::ConvReal;

/// Bytes of a page, or less.
const PAGE: usize = 4096;

/// An image of zeros whose every page has been written to, on many threads.
///
/// The system hands out pages when they are first used. A page that is first read, as additions do, is handed out twice: the
/// common page of zeros, then one to write to, and every processor is interrupted to forget the first. For a large image
/// that costs several times the convolution.
pub(crate) fn zeros<T: ConvReal>((rows, columns): (usize, usize)) -> Array2<T> {
    let mut image = Array2::zeros((rows, columns));
    let pixels: &mut [T] = image.as_slice_mut().expect("new arrays are row-major");
    pixels
        .par_chunks_mut(PAGE / size_of::<T>())
        .with_min_len(256)
        .for_each(|page| page[0] = T::zero());
    image
}
