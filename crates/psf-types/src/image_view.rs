//! Images that belong to somebody else.

use ndarray::{ArrayView2, CowArray, Ix2};

use crate::check::{self, Quantity};
use crate::{DataError, FrameShape, Image, Real};

/// An image `[y, x]` in flux per pixel whose pixels are borrowed: the twin of [`Image`]. Not empty, every pixel finite.
///
/// Any layout is taken. Where the pixels of a row are neighbours in memory nothing is copied, however far apart the rows are and
/// whichever way they follow each other; other layouts are copied to row-major memory.
///
/// ```
/// use ndarray::{Array2, s};
/// use psf_types::ImageView;
/// let sky = Array2::<f32>::ones((60, 80));
/// let part = ImageView::new(sky.slice(s![10..50, 20..]))?;
/// assert_eq!((part.shape().nx(), part.shape().ny()), (60, 40));
/// assert!(part.is_borrowed());
/// assert!(!ImageView::new(sky.t())?.is_borrowed());
/// # Ok::<(), psf_types::DataError>(())
/// ```
#[derive(Debug, Clone)]
pub struct ImageView<'a, T = f64> {
    /// The pixels of a row are neighbours.
    pixels: CowArray<'a, T, Ix2>,
    shape: FrameShape,
}

impl<'a, T: Real> ImageView<'a, T> {
    /// An image from somebody else's pixels `[y, x]`.
    ///
    /// # Errors
    /// [`DataError::EmptyFrame`] or [`DataError::NonFinite`].
    pub fn new(pixels: ArrayView2<'a, T>) -> Result<Self, DataError> {
        let (ny, nx) = pixels.dim();
        let shape = FrameShape::new(nx, ny)?;
        let pixels = if pixels.row(0).as_slice().is_some() {
            CowArray::from(pixels)
        } else {
            CowArray::from(pixels.as_standard_layout().into_owned())
        };
        check::finite2(Quantity::Pixel, pixels.view())?;
        Ok(Self { pixels, shape })
    }

    /// An image, which was checked before.
    pub(crate) fn of_image(image: &'a Image<T>) -> Self {
        Self {
            pixels: image.pixels().into(),
            shape: image.shape(),
        }
    }

    /// The pixels `[y, x]`. Those of a row are neighbours in memory; rows may be apart.
    pub fn pixels(&self) -> ArrayView2<'_, T> {
        self.pixels.view()
    }

    /// Columns and rows.
    pub fn shape(&self) -> FrameShape {
        self.shape
    }

    /// Whether the pixels are where they were, rather than copied because of their layout.
    pub fn is_borrowed(&self) -> bool {
        self.pixels.is_view()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, s};

    fn numbered() -> Array2<f64> {
        Array2::from_shape_fn((7, 5), |(y, x)| (10 * y + x) as f64)
    }

    #[test]
    fn any_layout_shows_the_same_pixels() {
        let whole = numbered();
        for (pixels, borrowed) in [
            (whole.view(), true),
            (whole.slice(s![2..5, 1..4]), true),
            (whole.slice(s![..;2, ..]), true),
            (whole.slice(s![..;-1, ..]), true),
            (whole.slice(s![3..4, ..]), true),
            (whole.slice(s![.., 2..3]), true),
            (whole.slice(s![.., ..;2]), false),
            (whole.slice(s![.., ..;-1]), false),
            (whole.t(), false),
            (
                whole
                    .row(3)
                    .insert_axis(ndarray::Axis(0))
                    .broadcast((4, 5))
                    .unwrap(),
                true,
            ),
        ] {
            let view = ImageView::new(pixels).unwrap();
            assert_eq!(view.pixels(), pixels);
            assert_eq!(
                view.is_borrowed(),
                borrowed,
                "{:?} {:?}",
                pixels.dim(),
                pixels.strides()
            );
            assert!(view.pixels().outer_iter().all(|row| row.to_slice().is_some()));
        }
        let image = Image::new(whole.clone()).unwrap();
        assert_eq!(image.view().pixels(), whole);
    }

    #[test]
    fn nothing_gets_by_that_is_no_number() {
        // Pieces that are looked at together, their ends, and rows that are apart.
        for (ny, nx) in [(1, 1), (3, 1023), (2, 1025), (5, 700)] {
            for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                for (y, x) in [(0, 0), (ny - 1, nx - 1), (ny / 2, nx / 2)] {
                    let mut pixels = Array2::from_elem((ny + 1, nx + 2), f32::MAX);
                    pixels[[y, x]] = bad;
                    for part in [pixels.view(), pixels.slice(s![..ny, ..nx])] {
                        match ImageView::new(part) {
                            Err(DataError::NonFinite { index, value, .. }) => {
                                assert_eq!(index, [y, x]);
                                assert!(!value.is_finite());
                            }
                            other => panic!("{bad} at ({x}, {y}) of {nx} x {ny}: {other:?}"),
                        }
                    }
                }
            }
        }
        // Beside the part that is shown.
        let mut pixels = Array2::zeros((4, 6));
        pixels[[1, 5]] = f64::NAN;
        assert!(ImageView::new(pixels.slice(s![.., ..5])).is_ok());
        assert!(matches!(
            ImageView::new(pixels.slice(s![.., ..0])),
            Err(DataError::EmptyFrame { nx: 0, ny: 4 })
        ));
    }
}
