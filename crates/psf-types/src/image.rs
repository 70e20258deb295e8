//! Images, owned and borrowed, in the two working precisions.

use ndarray::{Array, Array2, ArrayView2, ArrayView3, CowArray, Dimension, Ix2, NdFloat};

use crate::frame::{DataError, FrameShape, Quantity};

/// An image `[y, x]` in flux per pixel. It is not empty, and every pixel is finite.
#[derive(Debug, Clone, PartialEq)]
pub struct Image<T = f64> {
    pixels: Array2<T>,
    shape: FrameShape,
}

impl<T: Real> Image<T> {
    /// An image from its pixels `[y, x]`.
    ///
    /// # Errors
    /// [`DataError::EmptyFrame`] or [`DataError::NonFinite`].
    pub fn new(pixels: Array2<T>) -> Result<Self, DataError> {
        let (ny, nx) = pixels.dim();
        let shape = FrameShape::new(nx, ny)?;
        finite2(Quantity::Pixel, pixels.view())?;
        Ok(Self {
            pixels: row_major(pixels),
            shape,
        })
    }

    /// An image of zeros.
    pub fn zeros(shape: FrameShape) -> Self {
        Self {
            pixels: Array2::zeros((shape.ny(), shape.nx())),
            shape,
        }
    }

    /// The pixels `[y, x]`, row-major.
    pub fn pixels(&self) -> ArrayView2<'_, T> {
        self.pixels.view()
    }

    /// Columns and rows.
    pub fn shape(&self) -> FrameShape {
        self.shape
    }

    /// Borrows the image.
    pub fn view(&self) -> ImageView<'_, T> {
        ImageView::of_image(self)
    }

    /// Returns the pixels without copying them.
    pub fn into_pixels(self) -> Array2<T> {
        self.pixels
    }
}

/// An image `[y, x]` in flux per pixel with borrowed pixels, the counterpart of [`Image`]. It is
/// not empty, and every pixel is finite.
///
/// Any memory layout is accepted. The view borrows the pixels if those of each row are adjacent in
/// memory. The rows may have any distance and either order. Other layouts are copied to row-major
/// memory.
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
    /// The pixels of a row are adjacent in memory.
    pixels: CowArray<'a, T, Ix2>,
    shape: FrameShape,
}

impl<'a, T: Real> ImageView<'a, T> {
    /// An image from borrowed pixels `[y, x]`.
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
        finite2(Quantity::Pixel, pixels.view())?;
        Ok(Self { pixels, shape })
    }

    /// A view of an image, which was checked when it was made.
    pub(crate) fn of_image(image: &'a Image<T>) -> Self {
        Self {
            pixels: image.pixels().into(),
            shape: image.shape(),
        }
    }

    /// Borrows the pixels again.
    pub fn view(&self) -> ImageView<'_, T> {
        ImageView {
            pixels: self.pixels.view().into(),
            shape: self.shape,
        }
    }

    /// The pixels `[y, x]`. Pixels of a row are adjacent in memory, while rows may be apart.
    pub fn pixels(&self) -> ArrayView2<'_, T> {
        self.pixels.view()
    }

    /// Columns and rows.
    pub fn shape(&self) -> FrameShape {
        self.shape
    }

    /// Returns whether the pixels are borrowed, not copied because of their layout.
    pub fn is_borrowed(&self) -> bool {
        self.pixels.is_view()
    }
}

/// A working precision: `f32` or `f64`. Sealed.
pub trait Real: NdFloat + Default + sealed::Sealed {
    /// `f32` or `f64`.
    const NAME: &'static str;
    /// The nearest value of this type.
    fn nearest(value: f64) -> Self;
    /// This value in double precision.
    fn as_f64(self) -> f64;
}

impl Real for f32 {
    const NAME: &'static str = "f32";
    fn nearest(value: f64) -> Self {
        value as Self
    }
    fn as_f64(self) -> f64 {
        f64::from(self)
    }
}

impl Real for f64 {
    const NAME: &'static str = "f64";
    fn nearest(value: f64) -> Self {
        value
    }
    fn as_f64(self) -> f64 {
        self
    }
}

mod sealed {
    pub trait Sealed {}
    impl Sealed for f32 {}
    impl Sealed for f64 {}
}

/// Values tested in one loop before the first early exit. Enough values let the compiler vectorise
/// the loop. Few enough values stay in the first-level cache.
const AT_ONCE: usize = 1024;

/// Returns whether all values are finite, at the speed of memory.
fn all_finite<T: Real>(values: &[T]) -> bool {
    values
        .chunks(AT_ONCE)
        .all(|some| some.iter().fold(true, |finite, v| finite & v.is_finite()))
}

pub(crate) fn finite2<T: Real>(quantity: Quantity, values: ArrayView2<'_, T>) -> Result<(), DataError> {
    // This loop without indices runs at the speed of memory and nearly always decides.
    let finite = match values.as_slice() {
        Some(values) => all_finite(values),
        None => values
            .outer_iter()
            .all(|row| row.to_slice().is_some_and(all_finite)),
    };
    if finite {
        return Ok(());
    }
    match values.indexed_iter().find(|(_, v)| !v.is_finite()) {
        None => Ok(()),
        Some(((i, j), v)) => Err(DataError::NonFinite {
            quantity,
            index: vec![i, j],
            value: v.as_f64(),
        }),
    }
}

pub(crate) fn finite3(quantity: Quantity, values: ArrayView3<'_, f64>) -> Result<(), DataError> {
    match values.indexed_iter().find(|(_, v)| !v.is_finite()) {
        None => Ok(()),
        Some(((i, j, k), &value)) => Err(DataError::NonFinite {
            quantity,
            index: vec![i, j, k],
            value,
        }),
    }
}

/// Returns the array in row-major order, and copies it only if its order differs.
pub(crate) fn row_major<T: Clone, D: Dimension>(array: Array<T, D>) -> Array<T, D> {
    if array.is_standard_layout() {
        array
    } else {
        array.as_standard_layout().into_owned()
    }
}

impl<T: Real> From<Image<T>> for ImageView<'_, T> {
    /// An image that the view owns.
    fn from(image: Image<T>) -> Self {
        Self {
            shape: image.shape(),
            pixels: image.into_pixels().into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::s;

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
        // Values tested in one loop, the ends of such loops, and rows that are apart.
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
        // A NaN next to the part that the view shows.
        let mut pixels = Array2::zeros((4, 6));
        pixels[[1, 5]] = f64::NAN;
        assert!(ImageView::new(pixels.slice(s![.., ..5])).is_ok());
        assert!(matches!(
            ImageView::new(pixels.slice(s![.., ..0])),
            Err(DataError::EmptyFrame { nx: 0, ny: 4 })
        ));
    }
}
