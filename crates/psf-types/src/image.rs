//! Images.

use ndarray::{Array2, ArrayView2};

use crate::check::{self, Quantity};
use crate::{DataError, FrameShape, ImageView, Real};

/// An image `[y, x]` in flux per pixel; not empty, every pixel finite.
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
        check::finite2(Quantity::Pixel, pixels.view())?;
        Ok(Self {
            pixels: check::row_major(pixels),
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

    /// The image, borrowed.
    pub fn view(&self) -> ImageView<'_, T> {
        ImageView::of_image(self)
    }

    /// The pixels, without a copy.
    pub fn into_pixels(self) -> Array2<T> {
        self.pixels
    }

    /// Columns and rows.
    pub fn shape(&self) -> FrameShape {
        self.shape
    }
}
