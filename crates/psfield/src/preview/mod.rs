//! Pictures of images, as [`psfield preview`](crate) writes them: which values are shown, how bright, in which colours.
//!
//! The steps are types of their own, so that pictures which are compared can share them:
//!
//! 1. [`BinnedImage`]: at most so many pixels, by means; what is not a number stays apart.
//! 2. [`LimitRule`] gives [`Limits`]: the value at the dark end of the scale and that at the bright end.
//! 3. [`Stretch`] and [`Colormap`]: from a value between the limits to a colour.
//! 4. [`Picture`]: all of it, and its PNG.
//!
//! The formulas are those of `astropy.visualization`. Arrays are `[y, x]`; pictures have row 0 at the bottom, as FITS viewers show it.
//!
//! ```
//! use ndarray::Array2;
//! use psfield::preview::{BinnedImage, Colormap, LimitRule, Percentiles, Picture, Stretch};
//!
//! let image = Array2::from_shape_fn((300, 400), |(y, x)| (x * y) as f64);
//! let shown = BinnedImage::of(image.view(), 100);
//! let limits = LimitRule::Percentile(Percentiles::new(1.0, 99.0)?).limits(shown.pixels())?;
//! let picture = Picture::new(shown.pixels(), limits, Stretch::Asinh, Colormap::Viridis)?;
//! assert_eq!((picture.width(), picture.height()), (100, 75));
//! assert!(picture.png().starts_with(b"\x89PNG"));
//! # Ok::<(), psfield::preview::PreviewError>(())
//! ```

mod binned_image;
mod colormap;
mod error;
mod limit_rule;
mod limits;
mod picture;
mod stretch;
mod zscale;

pub use binned_image::BinnedImage;
pub use colormap::Colormap;
pub use error::PreviewError;
pub use limit_rule::{LimitRule, Percentiles};
pub use limits::Limits;
pub use picture::Picture;
pub use stretch::Stretch;
