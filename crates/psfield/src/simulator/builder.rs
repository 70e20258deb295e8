//! Collects and checks the settings of a simulator.

use std::sync::{Arc, OnceLock};

use conv_core::{ConvReal, ConvolutionMethod, InstructionSet};
use psf_types::{Anchor, FrameShape, PixelRegion, ToleranceOn};

use super::geometry::Geometry;
use super::{REGION, Shared, Simulator};
use crate::{Device, Method, Psf, PsfieldError, ScenePixels, SimulateOptions, check_frame_on_field};

/// Frame pixels by which padded stamps may extend beyond the reach of the PSF ([`Psf::reach`]).
const STAMP_MARGIN: usize = 8;

/// Collects the settings of a [`Simulator`]. [`Psf::simulator`] returns this builder. Each setter
/// is named after the field of [`SimulateOptions`] that it sets.
#[derive(Debug, Clone)]
pub struct SimulatorBuilder {
    psf: Psf,
    shape: (usize, usize),
    options: SimulateOptions,
}

impl Psf {
    /// Returns a builder of simulators for scenes of `shape` `(ny, nx)`, in the scenes' own pixels.
    pub fn simulator(&self, shape: (usize, usize)) -> SimulatorBuilder {
        SimulatorBuilder {
            psf: self.clone(),
            shape,
            options: SimulateOptions::default(),
        }
    }

    /// Returns a builder of simulators that convolve images by a method that the caller implements.
    /// The method also determines the anchor. Stars are drawn one by one in f64.
    pub fn simulator_by<T: ConvReal>(
        &self,
        method: Box<dyn ConvolutionMethod<T>>,
        shape: (usize, usize),
    ) -> OwnMethodBuilder<T> {
        let options = SimulateOptions {
            method: Method::Own,
            anchor: method.anchor(),
            ..SimulateOptions::default()
        };
        let builder = self.simulator(shape).options(options);
        OwnMethodBuilder { builder, method }
    }
}

/// Collects the settings of a [`Simulator`] with a method that the caller implements.
/// [`Psf::simulator_by`] returns this builder.
#[derive(Debug)]
pub struct OwnMethodBuilder<T> {
    builder: SimulatorBuilder,
    method: Box<dyn ConvolutionMethod<T>>,
}

impl<T: ConvReal> OwnMethodBuilder<T> {
    /// Sets how many pixels of the scene lie along each side of a frame pixel.
    #[must_use]
    pub fn oversample(mut self, oversample: usize) -> Self {
        self.builder.options.oversample = oversample;
        self
    }

    /// Sets the meaning of the values of the scene's image.
    #[must_use]
    pub fn scene_pixels(mut self, scene_pixels: ScenePixels) -> Self {
        self.builder.options.scene_pixels = scene_pixels;
        self
    }

    /// Sets the part of the scene that the image shows, in frame pixels counted from the scene's
    /// first pixel.
    #[must_use]
    pub fn frame(mut self, frame: PixelRegion) -> Self {
        self.builder.options.frame = Some(frame);
        self
    }

    /// Cuts or pads stamps to `size` frame pixels along each side.
    #[must_use]
    pub fn stamp_size(mut self, size: usize) -> Self {
        self.builder.options.stamp_size = Some(size);
        self
    }

    /// Checks the settings and returns the simulator. Plans are made when the first scene needs
    /// them.
    ///
    /// # Errors
    /// The errors of [`SimulatorBuilder::build`].
    pub fn build(self) -> Result<Simulator<T>, PsfieldError> {
        self.builder.build_by(Some(self.method))
    }
}

impl SimulatorBuilder {
    /// Replaces all settings.
    #[must_use]
    pub fn options(self, options: SimulateOptions) -> Self {
        Self { options, ..self }
    }

    /// Sets the largest relative L2 error that a plan may add to the PSF of any pixel, star or galaxy.
    #[must_use]
    pub fn tolerance(mut self, tolerance: f64) -> Self {
        self.options.tolerance = tolerance;
        self
    }

    /// Chooses the errors that the tolerance bounds.
    #[must_use]
    pub fn tolerance_on(mut self, tolerance_on: ToleranceOn) -> Self {
        self.options.tolerance_on = tolerance_on;
        self
    }

    /// Chooses whether the PSF is evaluated at the position of the source or of the output pixel.
    #[must_use]
    pub fn anchor(mut self, anchor: Anchor) -> Self {
        self.options.anchor = anchor;
        self
    }

    /// Sets the convolution method.
    #[must_use]
    pub fn method(mut self, method: Method) -> Self {
        self.options.method = method;
        self
    }

    /// Sets how many pixels of the scene's image lie along each side of a frame pixel.
    #[must_use]
    pub fn oversample(mut self, oversample: usize) -> Self {
        self.options.oversample = oversample;
        self
    }

    /// Sets the meaning of the values of the scene's image.
    #[must_use]
    pub fn scene_pixels(mut self, scene_pixels: ScenePixels) -> Self {
        self.options.scene_pixels = scene_pixels;
        self
    }

    /// Sets the part of the scene that the image shows, in frame pixels counted from the scene's
    /// first pixel.
    #[must_use]
    pub fn frame(mut self, frame: PixelRegion) -> Self {
        self.options.frame = Some(frame);
        self
    }

    /// Sets the device that convolves images.
    #[must_use]
    pub fn device(mut self, device: Device) -> Self {
        self.options.device = device;
        self
    }

    /// Checks the settings and returns the simulator. Plans are made when the first scene needs
    /// them.
    ///
    /// # Errors
    /// [`PsfieldError`] for settings that cannot be used:
    ///
    /// - a tolerance, an oversampling, a patch size or a stamp size out of range
    /// - a scene that is not a whole number of frame pixels wide and high, if no frame is given
    /// - a frame that reaches beyond the scene or is larger than the field of the PSF
    /// - a region that reaches beyond the frame
    /// - a region or a GPU for a method without a plan
    /// - [`Method::Own`], for which [`Psf::simulator_by`] is needed
    pub fn build<T: ConvReal>(self) -> Result<Simulator<T>, PsfieldError> {
        if self.options.method == Method::Own {
            return Err(Method::refused(Method::Own));
        }
        let method = self.options.method.without_plan(self.options.anchor)?;
        self.build_by(method)
    }

    #[inline(never)]
    pub(super) fn build_by<T: ConvReal>(
        self,
        method: Option<Box<dyn ConvolutionMethod<T>>>,
    ) -> Result<Simulator<T>, PsfieldError> {
        let Self {
            psf,
            shape,
            mut options,
        } = self;
        options.plan_options()?;
        InstructionSet::asked()?;
        let geometry = Geometry::new(FrameShape::new(shape.1, shape.0)?, &options)?;
        if method.is_some() && !geometry.is_whole() {
            return Err(PsfieldError::needs_plan(REGION));
        }
        if method.is_some() && options.device == Device::Gpu {
            const ON_GPU: &str =
                "only the methods auto and lowrank run on a GPU: choose one of them, or the device cpu";
            return Err(PsfieldError::of_setting("device", ON_GPU));
        }
        if options.stamp_size == Some(0) {
            const NO_STAMP: &str = "the stamp size must be at least 1 pixel";
            return Err(PsfieldError::of_setting("stamp_size", NO_STAMP));
        }
        // Farther out, padded stamps hold only zeros, which would cost time and change nothing.
        let widest = 2 * (psf.reach(None) + STAMP_MARGIN);
        options.stamp_size = options.stamp_size.map(|size| size.min(widest));
        let frame = geometry.frame.shape();
        check_frame_on_field(frame, psf.positions().field())?;
        Ok(Simulator {
            shared: Arc::new(Shared {
                psf,
                method,
                image_model: OnceLock::new(),
                sources: OnceLock::new(),
                sampling_errors: OnceLock::new(),
            }),
            options,
            geometry,
            convolver: OnceLock::new(),
        })
    }
}
