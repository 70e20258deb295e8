//! What can go wrong in a convolution.

use psf_types::{Cancelled, DataError, FieldError, FrameShape, PixelRegion};
use thiserror::Error;

/// Errors of the convolution methods.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ConvError {
    /// Stamps at another scale than the image's pixels.
    #[error(
        "the PSF stamps have {oversampling} pixels a frame pixel: an image can only be convolved with stamps at the frame's own \
         scale; resample them first"
    )]
    StampScale {
        /// Stamp pixels a frame pixel.
        oversampling: f64,
    },
    /// Stamps whose centre lies between pixels.
    #[error(
        "the PSF stamps are centred at index ({x}, {y}): an image can only be convolved with stamps centred on a pixel; \
         resample them first"
    )]
    StampCentre {
        /// Column index.
        x: f64,
        /// Row index.
        y: f64,
    },
    /// Stamps without the response of a pixel.
    #[error(
        "the PSF stamps do not include the pixel response: a scene cannot be imaged with them as they are"
    )]
    PixelResponse,
    /// A patch of no size.
    #[error("the patch size must be at least 1 pixel")]
    PatchSize,
    /// An image of another shape than the frame, or the region of it, that it stands for.
    #[error("the image is {got} pixels: the frame, or the region of it that is made, is {expected}")]
    FrameShape {
        /// The frame, or the region.
        expected: FrameShape,
        /// The image.
        got: FrameShape,
    },
    /// A frame that does not lie within its scene.
    #[error(transparent)]
    Frame(DataError),
    /// A tolerance that bounds nothing.
    #[error("the tolerance is {got}: it must be a number of at least 0 and below 1")]
    Tolerance {
        /// The tolerance asked for.
        got: f64,
    },
    /// A scene of another shape or frame than the plan's.
    #[error(
        "the plan is for a scene of {expected} pixels with the frame {expected_frame}, not {got} with {got_frame}"
    )]
    PlanShape {
        /// The plan's scene.
        expected: FrameShape,
        /// The plan's frame.
        expected_frame: String,
        /// The scene.
        got: FrameShape,
        /// Its frame.
        got_frame: String,
    },
    /// Light of another shape than the plan's scene.
    #[error("the light is {got} pixels: the plan takes {expected}")]
    LightShape {
        /// What the plan takes: the whole scene, or the part of it that reaches the frame.
        expected: String,
        /// The light.
        got: FrameShape,
    },
    /// A region that reaches beyond the frame.
    #[error(
        "the region of {} pixels at ({}, {}) reaches beyond the frame of {frame} pixels",
        region.shape(),
        region.x0(),
        region.y0()
    )]
    RegionOutsideFrame {
        /// The region, in pixels of the frame.
        region: PixelRegion,
        /// The frame.
        frame: FrameShape,
    },
    /// Somebody wanted the work to stop ([`psf_types::Progress::cancelled`]).
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// A pixel off the frame.
    #[error("pixel ({column}, {row}) lies outside the frame of {frame} pixels")]
    PixelOutsideFrame {
        /// Column asked for.
        column: usize,
        /// Row asked for.
        row: usize,
        /// The frame.
        frame: FrameShape,
    },
    /// The PSF has no value somewhere.
    #[error(transparent)]
    Field(#[from] FieldError),
    /// The GPU that a plan runs on fails.
    #[cfg(feature = "gpu")]
    #[error(transparent)]
    Gpu(#[from] crate::gpu::GpuError),
    /// The result is not a valid image.
    #[error("the result is not a valid image: are fluxes beyond the range of the working precision?")]
    Result(#[source] DataError),
}
