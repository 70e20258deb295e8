//! Bad pixels that the caller knows.

use ndarray::{Array2, ArrayView2};
use psf_types::{FrameShape, Real};

use crate::{DetectorError, PixelFlags};

/// A mask `[y, x]` of bad pixels: sums of [`PixelFlags`], 0 for good ones.
///
/// ```
/// use detector::{BadPixelMask, PixelFlags};
/// use ndarray::array;
/// let mask = BadPixelMask::new(array![[0.0_f32, 1.0], [6.0, 0.0]].view())?;
/// assert_eq!(mask.flags()[[1, 0]], PixelFlags::HOT | PixelFlags::BAD_COLUMN);
/// assert!(BadPixelMask::new(array![[0.5_f32]].view()).is_err());
/// # Ok::<(), detector::DetectorError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BadPixelMask {
    flags: Array2<u8>,
    shape: FrameShape,
}

impl BadPixelMask {
    /// A mask from the values of an image. [`PixelFlags::SATURATED`] is of an exposure, not of the sensor, and is left out.
    ///
    /// # Errors
    /// [`DetectorError::MaskValue`] for the first value that is no sum of flags, [`DetectorError::Data`] for a mask without pixels.
    pub fn new<T: Real>(values: ArrayView2<'_, T>) -> Result<Self, DetectorError> {
        let (ny, nx) = values.dim();
        let shape = FrameShape::new(nx, ny)?;
        let mut flags = Array2::zeros((ny, nx));
        for (((y, x), value), flag) in values.indexed_iter().zip(&mut flags) {
            let value = value.as_f64();
            if !((0.0..=f64::from(PixelFlags::ALL)).contains(&value) && value.fract() == 0.0) {
                return Err(DetectorError::MaskValue { index: [y, x], value });
            }
            *flag = value as u8 & PixelFlags::BAD;
        }
        Ok(Self { flags, shape })
    }

    /// The flags `[y, x]`.
    pub fn flags(&self) -> ArrayView2<'_, u8> {
        self.flags.view()
    }

    /// Columns and rows.
    pub fn shape(&self) -> FrameShape {
        self.shape
    }

    /// Whether a pixel is hot.
    pub(crate) fn has_hot(&self) -> bool {
        self.flags.iter().any(|flag| flag & PixelFlags::HOT != 0)
    }
}
