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
    Gpu(#[from] GpuError),
    /// The result is not a valid image.
    #[error("the result is not a valid image: are fluxes beyond the range of the working precision?")]
    Result(#[source] DataError),
}

/// Errors of GPUs. None of them comes with an image: what was not computed is not returned. (An image that light was to be added to holds some of it then.)
#[cfg(feature = "gpu")]
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum GpuError {
    /// There is no adapter.
    #[error(
        "there is no GPU that Vulkan, Metal, DirectX 12 or OpenGL could drive here; is its driver installed?"
    )]
    NoAdapter,
    /// There is none of this name.
    #[error("no GPU answers to {wanted:?}; there is {}", present.join(", "))]
    NoSuchAdapter {
        /// The name asked for.
        wanted: String,
        /// The adapters that are there.
        present: Vec<String>,
    },
    /// The adapter cannot be used.
    #[error("{adapter} cannot be used: {reason}")]
    Unusable {
        /// The adapter.
        adapter: String,
        /// Why.
        reason: String,
    },
    /// GPUs compute in f32 alone.
    #[error("GPUs compute in f32, this plan is in {precision}")]
    Precision {
        /// The plan's precision.
        precision: &'static str,
    },
    /// The plan's transforms are too large.
    #[error("{adapter}: transforms of {size} values are too large for it, {most} is the most")]
    TransformSize {
        /// The adapter.
        adapter: String,
        /// The length asked for.
        size: usize,
        /// The longest that it can do.
        most: usize,
    },
    /// A piece of work that cannot be made smaller does not fit.
    #[error("{adapter}: {what} takes {needed} bytes at once, {limit} is the most that it can see")]
    TooLarge {
        /// The adapter.
        adapter: String,
        /// What does not fit.
        what: &'static str,
        /// Bytes.
        needed: u64,
        /// The adapter's limit, in bytes.
        limit: u64,
    },
    /// Its memory is full.
    #[error("{adapter} is out of memory; a smaller memory limit may help, or what else uses the GPU")]
    OutOfMemory {
        /// The adapter.
        adapter: String,
    },
    /// It is gone: unplugged, reset by its driver, or taken by the system.
    #[error("{adapter} was lost: {reason}")]
    Lost {
        /// The adapter.
        adapter: String,
        /// What the driver says.
        reason: String,
    },
    /// Anything else: the driver refused something.
    #[error("{adapter}: {reason}")]
    Driver {
        /// The adapter.
        adapter: String,
        /// What it says.
        reason: String,
    },
}
