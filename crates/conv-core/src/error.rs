//! Errors of convolutions and of GPUs.

use psf_types::{Cancelled, DataError, FieldError, FrameShape, PixelRegion};
use thiserror::Error;

/// Errors of the convolution methods.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ConvError {
    /// The stamps are not at the scale of the image's pixels.
    #[error(
        "the PSF stamps have {oversampling} pixels per frame pixel, but an image can only be convolved with stamps at the \
         frame's own scale. Resample the stamps first"
    )]
    StampScale {
        /// Stamp pixels per frame pixel.
        oversampling: f64,
    },
    /// The centre of the stamps lies between pixels.
    #[error(
        "the PSF stamps are centred at index ({x}, {y}), but an image can only be convolved with stamps centred on a pixel. \
         Resample the stamps first"
    )]
    StampCentre {
        /// Column index.
        x: f64,
        /// Row index.
        y: f64,
    },
    /// The stamps do not include the pixel response.
    #[error(
        "an image needs PSF stamps that include the pixel response, but these stamps do not: resample them to a grid that includes it"
    )]
    PixelResponse,
    /// An output-anchored plan for a PSF with wings.
    #[error(
        "a PSF with wings can only be drawn with the PSF of the source's position: choose the anchor source"
    )]
    WingsAtOutput,
    /// The patch size is zero.
    #[error("the patch size must be at least 1 pixel")]
    PatchSize,
    /// The size to which stars are truncated is zero.
    #[error("the stamp size of stars must be at least 1 pixel")]
    StampSize,
    /// The image differs in shape from the frame, or from the region of the frame to be computed.
    #[error("the image has {got} pixels, but the frame (or the region of it to be computed) has {expected}")]
    FrameShape {
        /// The shape of the frame or of the region.
        expected: FrameShape,
        /// The shape of the image.
        got: FrameShape,
    },
    /// The frame does not lie within its scene.
    #[error(transparent)]
    Frame(DataError),
    /// The tolerance is not a number of at least 0 and below 1.
    #[error("the tolerance is {got}: it must be a number of at least 0 and below 1")]
    Tolerance {
        /// The tolerance given.
        got: f64,
    },
    /// The floor is not a number of at least 0.
    #[error("the floor is {got}: it must be a number of at least 0")]
    Floor {
        /// The floor given.
        got: f64,
    },
    /// The plan does not accept light of this shape.
    #[error("the light has {got} pixels, but the plan accepts {expected}")]
    LightShape {
        /// The shapes that the plan accepts: the whole scene, or its part that reaches the image.
        expected: String,
        /// The shape of the light.
        got: FrameShape,
    },
    /// The models of layers do not belong together, or a plan has another number of layers.
    #[error("layers of light: {0}")]
    Layers(&'static str),
    /// The region reaches beyond the frame.
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
    /// A galaxy needs transforms that are too large.
    #[error(
        "the galaxy at ({x}, {y}) needs transforms of {points} x {points} points, which are too large: use PSF stamps with \
         less oversampling, or with softer edges"
    )]
    GalaxyTransform {
        /// The position along x.
        x: f64,
        /// The position along y.
        y: f64,
        /// Points along each axis.
        points: usize,
    },
    /// Sources cannot be drawn photon by photon.
    #[error("photons cannot be shot: {0}")]
    Photons(&'static str),
    /// Sources have no derivatives.
    #[error("derivatives with respect to sources: {0}")]
    Derivatives(&'static str),
    /// The progress object cancelled the work ([`psf_types::Progress::cancelled`]).
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// The pixel lies outside the frame.
    #[error("pixel ({column}, {row}) lies outside the frame of {frame} pixels")]
    PixelOutsideFrame {
        /// Column given.
        column: usize,
        /// Row given.
        row: usize,
        /// The frame.
        frame: FrameShape,
    },
    /// The PSF has no value at a position where it is needed.
    #[error(transparent)]
    Field(#[from] FieldError),
    /// The GPU that executes the plan failed.
    #[cfg(feature = "gpu")]
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// An image, a frame or a position is not valid. The source says why.
    #[error("{}", match .0 {
        DataError::NonFinite { .. } => "the result is not a valid image: are fluxes beyond the range of f32 or f64?",
        _ => "the data are not valid",
    })]
    Result(#[source] DataError),
}

/// Errors of GPUs. An adapter is a GPU, or a driver that runs shaders on the processor.
///
/// A call that fails returns no image. If the call adds light to an image of the caller, this image
/// may already hold part of the light.
#[cfg(feature = "gpu")]
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum GpuError {
    /// No adapter was found.
    #[error("there is no GPU that Vulkan, Metal, DirectX 12 or OpenGL can drive. Is its driver installed?")]
    NoAdapter,
    /// No adapter matches the name.
    #[error("no GPU matches the name {wanted:?}. Available: {}", present.join(", "))]
    NoSuchAdapter {
        /// The name asked for.
        wanted: String,
        /// The adapters found.
        present: Vec<String>,
    },
    /// The adapter cannot be used.
    #[error("{adapter} cannot be used: {reason}")]
    Unusable {
        /// The adapter.
        adapter: String,
        /// The reason.
        reason: String,
    },
    /// GPUs compute only in f32.
    #[error("GPUs compute in f32, but this plan is in {precision}: choose f32, or use the CPU")]
    Precision {
        /// The plan's precision.
        precision: &'static str,
    },
    /// The plan is for several layers of light, which only the processor convolves together.
    #[error("a plan for several layers of light cannot run on a GPU: use the CPU")]
    Layers,
    /// The plan's transforms are too large.
    #[error("{adapter} supports transforms of length {most} at most, but the plan needs {size}: use the CPU")]
    TransformSize {
        /// The adapter.
        adapter: String,
        /// The length needed.
        size: usize,
        /// The longest length that the adapter supports.
        most: usize,
    },
    /// A piece of work needs more memory than the adapter allows, and cannot be divided further.
    #[error("{adapter} can use only {limit} bytes at once, but {needed} are needed for {what}: use the CPU")]
    TooLarge {
        /// The adapter.
        adapter: String,
        /// The piece of work or buffer that does not fit.
        what: &'static str,
        /// Bytes needed.
        needed: u64,
        /// The adapter's limit, in bytes.
        limit: u64,
    },
    /// The memory of the adapter is full.
    #[error(
        "{adapter} is out of memory. Set a smaller memory limit, or stop other programs that use the GPU"
    )]
    OutOfMemory {
        /// The adapter.
        adapter: String,
    },
    /// The adapter was closed, was unplugged, was reset by its driver, was taken by the system, or
    /// no longer responds.
    #[error("{adapter} was lost: {reason}")]
    Lost {
        /// The adapter.
        adapter: String,
        /// The reason, usually the driver's message.
        reason: String,
    },
    /// Any other error of the driver.
    #[error("the driver of {adapter} reports an error: {reason}")]
    Driver {
        /// The adapter.
        adapter: String,
        /// The driver's message.
        reason: String,
    },
}
