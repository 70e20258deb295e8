//! The trait of convolution methods.

use psf_types::{Image, Progress, PsfModel, Real, Scene};
use rustfft::FftNum;

use crate::ConvError;
use crate::simd::SimdReal;

/// The working precisions of this crate: `f32` and `f64`.
pub trait ConvReal: Real + FftNum + SimdReal {}
impl<T: Real + FftNum + SimdReal> ConvReal for T {}

/// Makes the image of a scene through a PSF that varies over the field.
///
/// Object-safe. The result has the shape of the scene's frame. Implementations give the same bytes on any number of
/// threads.
pub trait ConvolutionMethod<T: ConvReal>: std::fmt::Debug {
    /// The image of `scene` through `model`.
    ///
    /// # Errors
    /// [`ConvError`] when the model's stamps do not suit an image, or the PSF has no value somewhere in the scene.
    fn convolve(&self, model: &PsfModel, scene: &Scene<T>) -> Result<Image<T>, ConvError>;

    /// Like [`convolve`](Self::convolve), telling how far it has come. The provided method tells when it is done.
    ///
    /// # Errors
    /// As [`convolve`](Self::convolve).
    fn convolve_with_progress(
        &self,
        model: &PsfModel,
        scene: &Scene<T>,
        progress: &dyn Progress,
    ) -> Result<Image<T>, ConvError> {
        progress.start(1);
        let image = self.convolve(model, scene)?;
        progress.advance(1);
        Ok(image)
    }
}
