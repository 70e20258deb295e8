//! Methods that others are compared with, and the trait of them all.

mod basis;
mod direct;
mod fft2;
mod patch;

pub use basis::BasisConvolution;
pub use direct::Direct;
pub use patch::PatchConvolution;
use psf_types::{Anchor, Image, ImageView, PixelRegion, Progress, PsfModel};

use crate::{ConvError, ConvReal};

/// Makes the image of light through a PSF that varies over the field.
///
/// Object-safe. Implementations give the same bytes on any number of threads.
pub trait ConvolutionMethod<T: ConvReal>: std::fmt::Debug + Send + Sync {
    /// The anchoring.
    fn anchor(&self) -> Anchor;

    /// The image of `light` through `model`, seen through `frame`, a region of the light in its
    /// pixels: the result has the frame's shape, and the frame's first pixel is the origin of field
    /// positions. Point sources are drawn apart ([`StarPlan`](crate::StarPlan),
    /// [`StarPainter`](crate::StarPainter)).
    ///
    /// `progress` is told how far the work has come, and may cancel it.
    ///
    /// # Errors
    /// [`ConvError`] when the frame reaches beyond the light, the model's stamps do not suit an
    /// image, or the PSF has no value somewhere in the light; [`ConvError::Cancelled`].
    fn convolve(
        &self,
        model: &PsfModel,
        light: &ImageView<'_, T>,
        frame: PixelRegion,
        progress: &dyn Progress,
    ) -> Result<Image<T>, ConvError>;
}
