//! Pictures of images: limits, brightness and colours. The command `psfield preview` writes them.
//!
//! The steps are separate types, so that pictures that are compared can share them:
//!
//! 1. [`BinnedImage`]: averages square bins of pixels to limit the image's size. A bin without
//!    finite pixels becomes NaN.
//! 2. [`LimitRule`]: chooses the [`Limits`], the values that are shown darkest and brightest.
//! 3. [`Stretch`] and [`Colormap`]: turn a value between the limits into a colour.
//! 4. [`Picture`]: combines these steps, and gives the PNG.
//!
//! The formulas are those of `astropy.visualization`. Arrays are `[y, x]`. Pictures have row 0 at
//! the bottom, as in FITS viewers.
//!
//! ```
//! use ndarray::Array2;
//! use psfield_lab::preview::{BinnedImage, Colormap, LimitRule, Percentiles, Picture, Stretch};
//!
//! let image = Array2::from_shape_fn((300, 400), |(y, x)| (x * y) as f64);
//! let shown = BinnedImage::of(image.view(), 100);
//! let limits = LimitRule::Percentile(Percentiles::new(1.0, 99.0)?).limits(shown.pixels())?;
//! let picture = Picture::new(shown.pixels(), limits, Stretch::Asinh, Colormap::Viridis)?;
//! assert_eq!((picture.width(), picture.height()), (100, 75));
//! assert!(picture.png().starts_with(b"\x89PNG"));
//! # Ok::<(), psfield_lab::preview::PreviewError>(())
//! ```

mod binned_image;
mod limits;
mod picture;

use psfield::readable;
use thiserror::Error;

use limits::FIGURES;

pub use binned_image::BinnedImage;
pub use limits::{LimitRule, Limits, Percentiles};
pub use picture::{Colormap, Picture, Stretch};

/// The error of a picture that could not be made.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum PreviewError {
    /// Limits, percentiles or a name that are not possible. The sentence says what is.
    #[error("{0}")]
    Setting(String),
    /// An image (binned, if it is large) without any finite pixel.
    #[error("none of the {pixels} pixels of the picture has a finite value: there is nothing to show")]
    NoFinitePixel {
        /// Number of pixels of the image.
        pixels: usize,
    },
    /// An image whose finite pixels are all equal.
    #[error("every finite pixel is {}, so there is no contrast to show: give limits around this value", readable(*value, FIGURES))]
    Constant {
        /// The value.
        value: f64,
    },
    /// A rule that gives two equal limits for an image whose pixels differ.
    #[error(
        "{rule} puts both limits at {}, because so many pixels have this value, while the pixels range from {} to {}: choose wider \
         percentiles, or give the two limits yourself",
        readable(*value, FIGURES), readable(range[0], FIGURES), readable(range[1], FIGURES)
    )]
    EqualLimits {
        /// The rule, as the subject of a sentence.
        rule: String,
        /// Both limits.
        value: f64,
        /// The lowest and the highest pixel.
        range: [f64; 2],
    },
    /// An image that is empty, or has too many pixels along an axis for a picture.
    #[error("an image of {nx} x {ny} pixels cannot be a picture: 1 to {limit} are needed along each axis")]
    Size {
        /// Columns.
        nx: usize,
        /// Rows.
        ny: usize,
        /// The largest number of pixels along an axis.
        limit: usize,
    },
}
