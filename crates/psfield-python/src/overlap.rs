//! Planes that overlap.

use ndarray::{ArrayView2, ArrayViewMut2, s};
use psfield::conv_core::ConvReal;

/// Puts an image onto a plane, its first pixel at column and row `first` of the plane, as far as they overlap.
pub(crate) fn assign_overlap<T: ConvReal>(
    mut plane: ArrayViewMut2<'_, T>,
    image: ArrayView2<'_, T>,
    (x, y): (i64, i64),
) {
    // Where both begin, and for how long.
    let along = |first: i64, plane: usize, image: usize| {
        let (of_plane, of_image) = (first.clamp(0, plane as i64), (-first).clamp(0, image as i64));
        let length = (plane as i64 - of_plane).min(image as i64 - of_image).max(0);
        let range = |from: i64| from as usize..(from + length) as usize;
        (range(of_plane), range(of_image))
    };
    let (rows, image_rows) = along(y, plane.nrows(), image.nrows());
    let (columns, image_columns) = along(x, plane.ncols(), image.ncols());
    plane
        .slice_mut(s![rows, columns])
        .assign(&image.slice(s![image_rows, image_columns]));
}
