//! Reference methods, with which the fast engine is compared, and the trait of all convolution
//! methods.

mod basis;
mod direct;
mod patch;

pub use basis::BasisConvolution;
pub use direct::Direct;
pub use patch::PatchConvolution;
use psf_types::{Anchor, Image, ImageView, PixelRegion, Progress, PsfModel};

use crate::{ConvError, ConvReal};

/// Convolves light with a PSF that varies over the field.
///
/// The trait is object-safe. Results of an implementation are the same, bit by bit, for any number
/// of threads.
pub trait ConvolutionMethod<T: ConvReal>: std::fmt::Debug + Send + Sync {
    /// The position at which the PSF is evaluated: source or output pixel.
    fn anchor(&self) -> Anchor;

    /// Convolves `light` with the PSFs of `model`. Returns the image in `frame`, which is a region
    /// in pixels of the light. The result has the frame's shape, and the frame's first pixel is the
    /// origin of field positions. Point sources are drawn separately
    /// ([`SourcePlan`](crate::SourcePlan), [`StarPainter`](crate::StarPainter)).
    ///
    /// `progress` receives the steps and may cancel the work.
    ///
    /// # Errors
    /// [`ConvError`] if the frame reaches beyond the light, if the model's stamps do not suit an
    /// image, if the PSF has no value where it is needed, if the image has values that are not
    /// finite, or if `progress` cancels the work.
    fn convolve(
        &self,
        model: &PsfModel,
        light: &ImageView<'_, T>,
        frame: PixelRegion,
        progress: &dyn Progress,
    ) -> Result<Image<T>, ConvError>;
}
