//! Every setting of a simulation.

use std::num::NonZeroUsize;
use std::str::FromStr;

use conv_core::{
    BasisConvolution, ConvReal, ConvolutionMethod, Direct, PatchConvolution, Paths, PlanOptions,
};
use psf_types::{Anchor, PixelRegion, ToleranceOn, named, through_text};
use serde::{Deserialize, Deserializer, Serialize};

use crate::error::PsfieldError;

/// Every setting of a simulation. The options of the command line and the keywords of the Python
/// package have these names and these defaults, with two exceptions: the command line has no option
/// for `region`, and `psfield.dask.simulate` of Python uses the CPU by default. The working
/// precision is the type parameter of [`Simulator`](crate::Simulator): `f32` or `f64`.
///
/// ```
/// use psfield::{Method, SimulateOptions};
/// let options = SimulateOptions { tolerance: 1e-3, ..SimulateOptions::default() };
/// assert_eq!(options.method, Method::Auto);
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SimulateOptions {
    /// The convolution method.
    pub method: Method,
    /// The largest relative L2 error that a plan may add to the PSF of any single pixel, star
    /// or galaxy, from 0 to below 1 ([`PlanOptions::new`]). Applies to the methods with a plan
    /// ([`Method::has_plan`]).
    pub tolerance: f64,
    /// The errors that the tolerance bounds: only the L2 error of a PSF, or also the error of the
    /// flux in every circle about the source ([`PlanOptions::with_tolerance_on`]). Applies to the
    /// methods with a plan.
    pub tolerance_on: ToleranceOn,
    /// Light of stars and galaxies below this flux per pixel may be dropped, at least 0
    /// ([`PlanOptions::with_floor`]). [`Simulator::dropped_light`](crate::Simulator::dropped_light) says how
    /// much is. At 0 nothing is. Images in scenes and the adjoint do not depend on it. Applies to the methods
    /// with a plan.
    pub floor: f64,
    /// Chooses whether the PSF is evaluated at the position of each source or of each pixel of the
    /// image.
    pub anchor: Anchor,
    /// The largest number of bytes that a plan keeps in memory ([`PlanOptions::with_memory`]). None:
    /// it follows from the work ([`PlanOptions::memory_for`]). Applies to the methods with a plan.
    pub memory: Option<usize>,
    /// Pixels of the scene's image along each side of a pixel of the frame, 1 to
    /// [`MAX_OVERSAMPLE`](Self::MAX_OVERSAMPLE). Pixel `i` of the frame has its centre at
    /// the coordinate `oversample i + (oversample - 1) / 2` of the scene.
    #[serde(deserialize_with = "above_zero")]
    pub oversample: usize,
    /// The meaning of the values of the scene's image: light at points, or integrated over pixels.
    /// Stars and galaxies do not depend on it.
    pub scene_pixels: ScenePixels,
    /// Size of the stamps in pixels of the frame along each side, centred at `stamp_size / 2`.
    /// Stamps that convolve images are cut or padded to this size. Padding beyond the reach of the
    /// PSF, where all values are zero, is left out. For [`ScenePixels::Integrated`], the margin of
    /// the filter is added afterwards. Stamps that draw stars and galaxies are only cut. None: the
    /// stamps' own size.
    #[serde(deserialize_with = "above_zero_if_given")]
    pub stamp_size: Option<usize>,
    /// The part of the scene that the image shows, in pixels of the frame counted from the scene's
    /// first pixel. None: all of it. Field positions of the PSF count from the first pixel of the
    /// frame.
    pub frame: Option<PixelRegion>,
    /// The part of the frame that is computed, in pixels of the frame counted from the frame's
    /// first pixel. None: all of it. The images of all regions together equal the image of the
    /// whole frame, to rounding. Applies to the methods with a plan.
    pub region: Option<PixelRegion>,
    /// The device that convolves images. Stars and galaxies are drawn on the processor.
    pub device: Device,
    /// The GPU to use: a part of its name, or its backend. No other GPU is used. None: the
    /// preferred GPU.
    pub gpu_adapter: Option<String>,
    /// The largest number of bytes that a plan keeps on a GPU. None:
    /// `GpuOptions::DEFAULT_MEMORY_BYTES` of conv-core.
    pub gpu_memory: Option<u64>,
}

impl Default for SimulateOptions {
    fn default() -> Self {
        Self {
            method: Method::default(),
            tolerance: PlanOptions::DEFAULT_TOLERANCE,
            tolerance_on: ToleranceOn::default(),
            floor: 0.0,
            anchor: Anchor::default(),
            memory: None,
            oversample: 1,
            scene_pixels: ScenePixels::default(),
            stamp_size: None,
            frame: None,
            region: None,
            device: Device::default(),
            gpu_adapter: None,
            gpu_memory: None,
        }
    }
}

fn above_zero<'de, D: Deserializer<'de>>(from: D) -> Result<usize, D::Error> {
    NonZeroUsize::deserialize(from).map(NonZeroUsize::get)
}

fn above_zero_if_given<'de, D: Deserializer<'de>>(from: D) -> Result<Option<usize>, D::Error> {
    Ok(Option::deserialize(from)?.map(NonZeroUsize::get))
}

impl SimulateOptions {
    /// The largest `oversample`: pixels of the scene along each side of a frame pixel.
    pub const MAX_OVERSAMPLE: usize = 64;

    /// The options of a plan, without the limit of memory that follows from the work. None for
    /// methods without a plan.
    ///
    /// # Errors
    /// [`ErrorKind::Setting`](crate::ErrorKind::Setting) for a tolerance or a floor out of range, also for
    /// methods without a plan.
    pub fn plan_options(&self) -> Result<Option<PlanOptions>, PsfieldError> {
        let options = PlanOptions::new(self.tolerance)?
            .with_floor(self.floor)?
            .with_tolerance_on(self.tolerance_on)
            .with_anchor(self.anchor);
        Ok(match self.method {
            Method::Auto => Some(options.with_paths(Paths::Cheapest)),
            Method::LowRank => Some(options.with_paths(Paths::Transforms)),
            _ => None,
        })
    }
}

/// The meaning of the values of a scene's image. Written as `point` or `integrated`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
#[non_exhaustive]
pub enum ScenePixels {
    /// Each value is light at the centre of its pixel: `image = sum_j f_j h(. - j)`.
    #[default]
    Point,
    /// Each value is light already integrated over the square pixel of the scene. The response of
    /// this pixel is taken out, by a filter that is applied to the PSF within the scene's Nyquist
    /// frequency ([`ScenePixelFilter`](conv_core::ScenePixelFilter)). The image is then that of the
    /// sky, if the sky has no detail beyond this frequency. Finer detail cannot be recovered. Sharp
    /// structures get negative ripples, which the PSF dims. Noise in the scene is amplified before
    /// the PSF: by at most 2.47 at any frequency, and white noise by 1.39 r.m.s.
    Integrated,
}

named!(ScenePixels, "scene pixels", "point or integrated", "point" => Point, "integrated" => Integrated);
through_text!(ScenePixels);

/// The device that convolves images. Written as `auto`, `cpu` or `gpu`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
#[non_exhaustive]
pub enum Device {
    /// A GPU if the plan is predicted to be faster there, else the processor. Never uses an adapter
    /// that runs shaders on the processor.
    #[default]
    Auto,
    /// The processor.
    Cpu,
    /// A GPU. It is an error if no GPU can be used.
    Gpu,
}

named!(Device, "device", "auto, cpu or gpu", "auto" => Auto, "cpu" => Cpu, "gpu" => Gpu);
through_text!(Device);

/// The convolution method. Written as `auto`, `lowrank`, `basis`, `patch=N` or `direct`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
#[non_exhaustive]
pub enum Method {
    /// The fast engine ([`conv_core::Engine`]). Each tile of the image is computed in the cheapest
    /// way: by Fourier transforms, by the direct sum, or by single stamps. A tile without light is
    /// skipped.
    #[default]
    Auto,
    /// The fast engine, with Fourier transforms for all tiles that have light.
    LowRank,
    /// One whole-image convolution per component ([`BasisConvolution`]).
    Basis,
    /// One PSF per patch of this many pixels along each side ([`PatchConvolution`]). This is an
    /// approximation.
    Patch(usize),
    /// The direct sum over pixels and PSF values, in f64 ([`Direct`]).
    Direct,
    /// A method that the caller implements, given to
    /// [`SimulatorBuilder::build_by`](crate::SimulatorBuilder::build_by).
    Own,
}

impl Method {
    /// Returns whether the method makes a plan. Such a method has a tolerance, can stream, and can
    /// run on a GPU.
    pub fn has_plan(self) -> bool {
        matches!(self, Self::Auto | Self::LowRank)
    }

    pub(crate) fn refused(got: impl std::fmt::Display) -> PsfieldError {
        let message =
            format!("the method must be auto, lowrank, basis, patch=N (N at least 1) or direct, got {got}");
        PsfieldError::of_setting("method", message)
    }

    /// The convolution of a method without a plan. None for the methods with a plan, and for
    /// [`Method::Own`], whose convolution the caller gives.
    ///
    /// # Errors
    /// [`ErrorKind::Setting`](crate::ErrorKind::Setting) for a patch size of 0.
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

through_text!(Method => PsfieldError);

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

    #[test]
    fn settings_come_back_from_json() {
        let region = PixelRegion::new(-3, 2, psf_types::FrameShape::new(7, 5).unwrap());
        let options = SimulateOptions {
            method: Method::Patch(64),
            frame: Some(region),
            stamp_size: Some(9),
            ..SimulateOptions::default()
        };
        let text = serde_json::to_string(&options).unwrap();
        assert!(text.contains(r#""frame":[-3,2,7,5]"#), "{text}");
        assert_eq!(serde_json::from_str::<SimulateOptions>(&text).unwrap(), options);
        assert_eq!(
            serde_json::from_str::<SimulateOptions>("{}").unwrap(),
            SimulateOptions::default()
        );
        for text in [
            r#"{"oversample": 0}"#,
            r#"{"stamp_size": 0}"#,
            r#"{"speed": 1}"#,
            r#"{"device": "tpu"}"#,
            r#"{"region": [0, 0, 0, 5]}"#,
        ] {
            assert!(serde_json::from_str::<SimulateOptions>(text).is_err(), "{text}");
        }
    }
}
