//! Collects and checks the settings of a simulator.

use std::sync::{Arc, Mutex, OnceLock};

use conv_core::{ConvReal, ConvolutionMethod};
use psf_types::{Anchor, PixelRegion, ToleranceOn};

use super::part::Part;
use super::setup::Setup;
use super::{Shared, Simulator};
use crate::error::PsfieldError;
use crate::psf::Psf;
use crate::simulate_options::{Device, Method, ScenePixels, SimulateOptions};

/// Collects the settings of a [`Simulator`]. [`Psf::simulator`] returns this builder. Each setter
/// is named after the field of [`SimulateOptions`] that it sets.
#[derive(Debug, Clone)]
pub struct SimulatorBuilder {
    psf: Psf,
    shape: (usize, usize),
    options: SimulateOptions,
}

impl Psf {
    /// Returns a builder of simulators for scenes of `shape` `(ny, nx)`, in the scenes' own pixels. If the
    /// PSF has several states, the scenes have a layer for each ([`Scene`](crate::Scene)).
    pub fn simulator(&self, shape: (usize, usize)) -> SimulatorBuilder {
        SimulatorBuilder {
            psf: self.clone(),
            shape,
            options: SimulateOptions::default(),
        }
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
    /// - [`Method::Own`], for which [`build_by`](Self::build_by) is needed
    pub fn build<T: ConvReal>(self) -> Result<Simulator<T>, PsfieldError> {
        if self.options.method == Method::Own {
            return Err(Method::refused(Method::Own));
        }
        // Only a PSF that is drawn at its source may have wings.
        let psf = match self.options.anchor {
            Anchor::Output => self.psf.undivided()?,
            _ => self.psf,
        };
        let parts = vec![Arc::new(Part::new(psf))];
        Simulator::of_parts(parts, None, self.shape, self.options)
    }

    /// Returns a simulator that convolves images by a method that the caller implements. The method also
    /// determines the anchor. Stars are drawn one by one in f64.
    ///
    /// # Errors
    /// As for [`build`](Self::build).
    pub fn build_by<T: ConvReal>(
        self,
        method: Box<dyn ConvolutionMethod<T>>,
    ) -> Result<Simulator<T>, PsfieldError> {
        let options = SimulateOptions {
            method: Method::Own,
            anchor: method.anchor(),
            ..self.options
        };
        let setup = Setup::new(&self.psf, self.shape, options)?;
        let parts = vec![Arc::new(Part::new(self.psf))];
        Ok(Simulator::new(setup, parts, None, Some(method)))
    }
}

impl<T: ConvReal> Simulator<T> {
    /// A simulator for the PSFs of these parts, by a method that is not the caller's own. `images` is the PSF
    /// on the pixels of the scenes' images, if it is made in another way.
    pub(crate) fn of_parts(
        parts: Vec<Arc<Part<T>>>,
        images: Option<Psf>,
        shape: (usize, usize),
        options: SimulateOptions,
    ) -> Result<Self, PsfieldError> {
        let method = options.method.without_plan(options.anchor)?;
        let setup = Setup::new(&parts[0].psf, shape, options)?;
        Ok(Self::new(setup, parts, images, method))
    }

    /// A simulator by any method. `method` is None for a method with a plan.
    #[inline(never)]
    pub(super) fn new(
        setup: Setup,
        parts: Vec<Arc<Part<T>>>,
        images: Option<Psf>,
        method: Option<Box<dyn ConvolutionMethod<T>>>,
    ) -> Self {
        Self {
            shared: Arc::new(Shared {
                parts,
                images,
                method,
                image_models: OnceLock::new(),
                sampling_errors: OnceLock::new(),
                stamp_edge: OnceLock::new(),
            }),
            setup,
            convolvers: Mutex::new(Vec::new()),
            wings: OnceLock::new(),
            of_wings: false,
            psf_derivative: Arc::default(),
        }
    }
}
