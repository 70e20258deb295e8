//! Every setting of a simulation.

use std::str::FromStr;

use conv_core::{
    BasisConvolution, ConvReal, ConvolutionMethod, Direct, PatchConvolution, Paths, PlanOptions,
};
use psf_types::{Anchor, PixelRegion, named};

use crate::PsfieldError;

/// Every setting of a simulation. The command line's options and the Python package's keywords have these names and these
/// defaults. The working precision is the type parameter of [`Simulator`](crate::Simulator): `f32` or `f64`.
///
/// ```
/// use psfield::{Method, SimulateOptions};
/// let options = SimulateOptions { tolerance: 1e-3, ..SimulateOptions::default() };
/// assert_eq!(options.method, Method::Auto);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct SimulateOptions {
    /// How scenes are convolved.
    pub method: Method,
    /// The largest relative L2 error that the engine may add to the PSF of any single pixel or star, from 0 to below 1
    /// ([`PlanOptions::new`]). Applies to the methods with a plan.
    pub tolerance: f64,
    /// Whose PSF applies: that of each source, or that of each pixel of the image.
    pub anchor: Anchor,
    /// Bytes that a plan keeps at most ([`PlanOptions::with_memory`]). Applies to the methods with a plan.
    pub memory: usize,
    /// Pixels of the scene's image along each side of a pixel of the frame, 1 to
    /// [`MAX_OVERSAMPLE`](Self::MAX_OVERSAMPLE). Pixel `i` of the frame has its centre at
    /// `oversample i + (oversample - 1) / 2` of the scene.
    pub oversample: usize,
    /// Cuts or pads the stamps of images, and cuts those of stars, to so many pixels of the frame along each side, centred
    /// at `stamp_size / 2`. None: as large as the stamps are.
    pub stamp_size: Option<usize>,
    /// The part of the scene that the image shows, in pixels of the frame counted from the scene's first. None: all of it.
    /// Field positions of the PSF count from the first pixel of the frame.
    pub frame: Option<PixelRegion>,
    /// The part of the frame that is made, in pixels of the frame counted from the frame's first. None: all of it. Pieces
    /// put together are the image of the whole frame but for rounding. Applies to the methods with a plan.
    pub region: Option<PixelRegion>,
    /// Where images are convolved. Stars are drawn on the processor.
    pub device: Device,
    /// The only GPU to be considered, by a part of its name or its backend. None: the preferred one.
    pub gpu_adapter: Option<String>,
    /// Bytes that a plan keeps on a GPU at most. None: conv-core's default.
    pub gpu_memory: Option<u64>,
}

impl Default for SimulateOptions {
    fn default() -> Self {
        Self {
            method: Method::default(),
            tolerance: PlanOptions::DEFAULT_TOLERANCE,
            anchor: Anchor::default(),
            memory: PlanOptions::DEFAULT_MEMORY_BYTES,
            oversample: 1,
            stamp_size: None,
            frame: None,
            region: None,
            device: Device::default(),
            gpu_adapter: None,
            gpu_memory: None,
        }
    }
}

impl SimulateOptions {
    /// The finest scenes: so many pixels along each side of a frame pixel.
    pub const MAX_OVERSAMPLE: usize = 64;

    /// The options of the engine; none for methods without a plan.
    ///
    /// # Errors
    /// [`ErrorKind::Setting`](crate::ErrorKind::Setting) for a tolerance out of range.
    pub fn plan_options(&self) -> Result<Option<PlanOptions>, PsfieldError> {
        let options = PlanOptions::new(self.tolerance)?
            .with_anchor(self.anchor)
            .with_memory(self.memory);
        Ok(match self.method {
            Method::Auto => Some(options.with_paths(Paths::Cheapest)),
            Method::LowRank => Some(options.with_paths(Paths::Transforms)),
            _ => None,
        })
    }
}

/// Where images are convolved. Written as `auto`, `cpu` or `gpu`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Device {
    /// On a GPU where the plan is predicted to be faster there, else on the processor; never by a driver that runs shaders
    /// on the processor.
    #[default]
    Auto,
    /// On the processor.
    Cpu,
    /// On a GPU; an error where that is not possible.
    Gpu,
}

named!(Device, "device", "auto, cpu or gpu", "auto" => Auto, "cpu" => Cpu, "gpu" => Gpu);

/// How a scene is convolved. Written as `auto`, `lowrank`, `basis`, `patch=N` or `direct`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Method {
    /// The fast engine, each tile in the cheapest way: transforms, the direct sum, single stamps, nothing.
    #[default]
    Auto,
    /// The fast engine by transforms alone.
    LowRank,
    /// One whole-image convolution per component ([`BasisConvolution`]).
    Basis,
    /// One PSF per patch of so many pixels ([`PatchConvolution`]); not exact.
    Patch(usize),
    /// The double sum in f64 ([`Direct`]).
    Direct,
    /// A method of the caller's own, given to [`Psf::simulator_by`](crate::Psf::simulator_by).
    Own,
}

impl Method {
    /// Whether the method plans, so that it has a tolerance, can stream, and can run on a GPU.
    pub fn has_plan(self) -> bool {
        matches!(self, Self::Auto | Self::LowRank)
    }

    pub(crate) fn refused(got: impl std::fmt::Display) -> PsfieldError {
        let message =
            format!("the method must be auto, lowrank, basis, patch=N (N at least 1) or direct, got {got}");
        PsfieldError::of_setting("method", message)
    }

    /// The method, where it has no plan.
    ///
    /// # Errors
    /// [`ErrorKind::Setting`](crate::ErrorKind::Setting) for a patch of no size.
    pub(crate) fn without_plan<T: ConvReal>(
        self,
        anchor: Anchor,
    ) -> Result<Option<Box<dyn ConvolutionMethod<T>>>, PsfieldError> {
        Ok(match self {
            Self::Auto | Self::LowRank | Self::Own => None,
            Self::Basis => Some(Box::new(BasisConvolution::new(anchor))),
            Self::Patch(size) => Some(Box::new(PatchConvolution::new(size, anchor)?)),
            Self::Direct => Some(Box::new(Direct::new(anchor))),
        })
    }
}

impl std::fmt::Display for Method {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::LowRank => f.write_str("lowrank"),
            Self::Basis => f.write_str("basis"),
            Self::Patch(size) => write!(f, "patch={size}"),
            Self::Direct => f.write_str("direct"),
            Self::Own => f.write_str("own"),
        }
    }
}

impl FromStr for Method {
    type Err = PsfieldError;
    fn from_str(text: &str) -> Result<Self, PsfieldError> {
        let size = || text.strip_prefix("patch=")?.parse().ok().filter(|&size| size > 0);
        match text {
            "auto" => Ok(Self::Auto),
            "lowrank" => Ok(Self::LowRank),
            "basis" => Ok(Self::Basis),
            "direct" => Ok(Self::Direct),
            _ => size().map(Self::Patch).ok_or_else(|| Self::refused(text)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_forms_round_trip() {
        for text in ["auto", "lowrank", "basis", "patch=64", "direct"] {
            assert_eq!(text.parse::<Method>().unwrap().to_string(), text);
        }
        for text in ["", "patch", "patch=0", "patch=-1", "low-rank"] {
            assert!(text.parse::<Method>().is_err(), "{text}");
        }
    }
}
