//! Bad pixels: their flags, masks given by the caller, and bad pixels drawn at random.

use ndarray::{Array2, ArrayView2};
use psf_types::{FrameShape, Real};
use rand::RngExt;

use crate::noise::{Step, noise_stream};
use crate::{DetectorError, DetectorParams};

/// The flags of a pixel. A quality image or a bad-pixel mask holds, for each pixel, the sum of its
/// flags as `u8`.
#[derive(Debug, Clone, Copy)]
pub struct PixelFlags;

impl PixelFlags {
    /// The pixel never holds charge.
    pub const DEAD: u8 = 1;
    /// The pixel has a higher dark current than the others.
    pub const HOT: u8 = 2;
    /// The pixel's column holds no charge.
    pub const BAD_COLUMN: u8 = 4;
    /// The pixel is at its full well or at the upper end of the converter. This flag belongs to an
    /// exposure, not to the sensor.
    pub const SATURATED: u8 = 8;
    /// The sum of all flags that belong to the sensor.
    pub const BAD: u8 = Self::DEAD | Self::HOT | Self::BAD_COLUMN;
    /// The sum of all flags.
    pub const ALL: u8 = Self::BAD | Self::SATURATED;
    /// The sum of the flags of pixels without charge.
    pub(crate) const NO_CHARGE: u8 = Self::DEAD | Self::BAD_COLUMN;
}

/// A mask `[y, x]` of bad pixels. Each value is the sum of a pixel's [`PixelFlags`], 0 for a good
/// pixel.
///
/// ```
/// use psf_detector::{BadPixelMask, PixelFlags};
/// use ndarray::array;
/// let mask = BadPixelMask::new(array![[0.0_f32, 1.0], [6.0, 0.0]].view())?;
/// assert_eq!(mask.flags()[[1, 0]], PixelFlags::HOT | PixelFlags::BAD_COLUMN);
/// assert!(BadPixelMask::new(array![[0.5_f32]].view()).is_err());
/// # Ok::<(), psf_detector::DetectorError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BadPixelMask {
    flags: Array2<u8>,
    shape: FrameShape,
}

impl BadPixelMask {
    /// A mask from the values of an image. [`PixelFlags::SATURATED`] belongs to an exposure, not to
    /// the sensor, and is ignored.
    ///
    /// # Errors
    /// [`DetectorError::MaskValue`] for the first value that is not a sum of flags.
    /// [`DetectorError::Data`] for a mask without pixels.
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

    /// Returns whether any pixel is hot.
    pub(crate) fn has_hot(&self) -> bool {
        self.flags.iter().any(|flag| flag & PixelFlags::HOT != 0)
    }
}

/// Draws the bad columns and returns the flag of each column. Bad columns belong to the sensor and
/// do not change between exposures.
pub(crate) fn bad_columns(params: &DetectorParams, nx: usize) -> Vec<u8> {
    let mut rng = noise_stream(params.pattern_seed, Step::BadColumns, 0);
    let mut flag = || {
        if rng.random::<f64>() < params.bad_pixels.bad_column_fraction {
            PixelFlags::BAD_COLUMN
        } else {
            0
        }
    };
    (0..nx).map(|_| flag()).collect()
}

/// Draws the single dead and hot pixels of a row and adds their flags. Like the bad columns, they
/// belong to the sensor and do not change between exposures.
pub(crate) fn mark_bad_pixels(params: &DetectorParams, row: usize, flags: &mut [u8]) {
    let dead = params.bad_pixels.dead_fraction;
    let dead_or_hot = dead + params.bad_pixels.hot_fraction;
    if dead_or_hot == 0.0 {
        return;
    }
    let mut rng = noise_stream(params.pattern_seed, Step::BadPixels, row);
    for flag in flags {
        let chance: f64 = rng.random();
        if chance < dead {
            *flag |= PixelFlags::DEAD;
        } else if chance < dead_or_hot {
            *flag |= PixelFlags::HOT;
        }
    }
}
