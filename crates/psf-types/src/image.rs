//! Images, owned and borrowed, in the two working precisions.

use ndarray::{Array, Array2, ArrayView, ArrayView2, CowArray, Dimension, Ix2, NdFloat};

use crate::frame::{DataError, FrameShape, Quantity};
use crate::maths::unravel;

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
    /// [`DataError::EmptyFrame`], [`DataError::FrameTooLarge`] or [`DataError::NonFinite`].
    pub fn new(pixels: Array2<T>) -> Result<Self, DataError> {
        let (ny, nx) = pixels.dim();
        let shape = FrameShape::new(nx, ny)?;
        DataError::check_finite(Quantity::Pixel, pixels.view())?;
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
/// Any memory layout is accepted. The view borrows the pixels if the pixels of each row are
/// adjacent in memory. The rows may be any distance apart, in ascending or descending order. Pixels
/// with another layout are copied to row-major memory.
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
    /// In each row, the pixels are adjacent in memory.
    pixels: CowArray<'a, T, Ix2>,
    shape: FrameShape,
}

impl<'a, T: Real> ImageView<'a, T> {
    /// An image from borrowed pixels `[y, x]`.
    ///
    /// # Errors
    /// [`DataError::EmptyFrame`], [`DataError::FrameTooLarge`] or [`DataError::NonFinite`].
    pub fn new(pixels: ArrayView2<'a, T>) -> Result<Self, DataError> {
        let (ny, nx) = pixels.dim();
        let shape = FrameShape::new(nx, ny)?;
        let pixels = if pixels.row(0).as_slice().is_some() {
            CowArray::from(pixels)
        } else {
            CowArray::from(pixels.as_standard_layout().into_owned())
        };
        DataError::check_finite(Quantity::Pixel, pixels.view())?;
        Ok(Self { pixels, shape })
    }

    /// Borrows an image. Its pixels were checked when it was made.
    pub(crate) fn of_image(image: &'a Image<T>) -> Self {
        Self {
            pixels: image.pixels().into(),
            shape: image.shape(),
        }
    }

    /// Returns another view of the pixels, without a copy.
    pub fn view(&self) -> ImageView<'_, T> {
        ImageView {
            pixels: self.pixels.view().into(),
            shape: self.shape,
        }
    }

    /// The pixels `[y, x]`. The pixels of a row are adjacent in memory. The rows need not be.
    pub fn pixels(&self) -> ArrayView2<'_, T> {
        self.pixels.view()
    }

    /// Columns and rows.
    pub fn shape(&self) -> FrameShape {
        self.shape
    }

    /// Returns whether the view borrows its pixels. If not, they were copied because of their
    /// layout, or they come from an [`Image`] that was moved into the view.
    pub fn is_borrowed(&self) -> bool {
        self.pixels.is_view()
    }
}

/// A working precision: `f32` or `f64`. Other crates cannot implement this trait (it is sealed).
pub trait Real: NdFloat + Default + sealed::Sealed {
    /// The name of the type: `f32` or `f64`.
    const NAME: &'static str;
    /// Returns the value of this type that is nearest to `value`.
    fn nearest(value: f64) -> Self;
    /// Returns this value in double precision.
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

/// The number of values tested in one loop. The loop has no early exit, so the compiler can
/// vectorise it.
const VALUES_PER_TEST: usize = 1024;

/// Returns whether all values are finite. The speed is limited only by the memory.
fn all_finite<T: Real>(values: &[T]) -> bool {
    values
        .chunks(VALUES_PER_TEST)
        .all(|some| some.iter().fold(true, |finite, v| finite & v.is_finite()))
}

impl DataError {
    /// Checks that all values are finite. `quantity` names what they are.
    ///
    /// # Errors
    /// [`DataError::NonFinite`] with the index of the first other value.
    pub fn check_finite<T: Real, D: Dimension>(
        quantity: Quantity,
        values: ArrayView<'_, T, D>,
    ) -> Result<(), Self> {
        let finite = match values.as_slice() {
            Some(values) => all_finite(values),
            None => values
                .rows()
                .into_iter()
                .all(|row| row.to_slice().is_some_and(all_finite)),
        };
        if finite {
            return Ok(());
        }
        match values.iter().enumerate().find(|(_, v)| !v.is_finite()) {
            None => Ok(()),
            Some((i, v)) => Err(Self::NonFinite {
                quantity,
                index: unravel(i, values.shape()),
                value: v.as_f64(),
            }),
        }
    }
}

/// Returns the array in row-major order. Copies it only if its order differs.
pub(crate) fn row_major<T: Clone, D: Dimension>(array: Array<T, D>) -> Array<T, D> {
    if array.is_standard_layout() {
        array
    } else {
        array.as_standard_layout().into_owned()
    }
}

impl<T: Real> From<Image<T>> for ImageView<'_, T> {
    /// Moves the image into the view, which then owns the pixels.
    fn from(image: Image<T>) -> Self {
        Self {
            shape: image.shape(),
            pixels: image.into_pixels().into(),
        }
    }
}
