//! Simulators that share tiles with another one: for other regions, or for another PSF.

use std::sync::{Arc, Mutex, OnceLock};
use std::time::Instant;

use conv_core::ConvReal;
use psf_types::{PixelRegion, Progress};

use super::Simulator;
use super::convolver::Convolver;
use super::geometry::Geometry;
use super::part::Part;
use super::setup::{REGION, Setup};
use crate::error::PsfieldError;
use crate::psf::Psf;
use crate::simulate_options::{Method, SimulateOptions};

impl<T: ConvReal> Simulator<T> {
    /// Returns a simulator for another region of the same frame. `region` is in frame pixels
    /// counted from the frame's first pixel. The new simulator uses the tiles that were chosen for
    /// this one and shares its plan for sources, which is much faster than a new plan.
    ///
    /// # Errors
    /// [`ErrorKind::Setting`](crate::ErrorKind::Setting) for a region outside the frame or a method
    /// without a plan, and the errors of [`prepare`](Self::prepare).
    #[inline(never)]
    pub fn for_region(&self, region: PixelRegion, progress: &dyn Progress) -> Result<Self, PsfieldError> {
        let options = SimulateOptions {
            region: Some(region),
            ..self.options().clone()
        };
        let geometry = Geometry::new(self.setup.geometry.shape, &options)?;
        let mut planned = self.kept_convolvers();
        if planned.is_empty() {
            let layers = self.shared.layers_of_images();
            planned.push((layers.clone(), self.convolver(&layers, progress)?));
        }
        let mut convolvers = Vec::with_capacity(planned.len());
        for (layers, whole) in planned {
            let engine = whole.engine_for(REGION)?;
            let clock = Instant::now();
            let plan = engine.plan().for_other_region(geometry.fine(region)?, progress)?;
            let convolver = Convolver::of_plan(plan, &options, clock)?;
            convolvers.push((layers, Arc::new(convolver)));
        }
        let wings = match self.wings()? {
            Some(wings) => Some(Box::new(wings.for_region(region, progress)?)),
            None => None,
        };
        Ok(Self {
            shared: Arc::clone(&self.shared),
            setup: Setup { options, geometry },
            convolvers: Mutex::new(convolvers),
            wings: OnceLock::from(wings),
            of_wings: self.of_wings,
            psf_derivative: Arc::default(),
        })
    }

    /// Returns a simulator with the same settings for another PSF, such as other coefficients of the
    /// same basis. If the new stamps have the shape and the centre of the old ones, it uses the tiles
    /// of the plans that this simulator has made, which is much faster than new plans. The tolerance holds
    /// in any case.
    ///
    /// # Errors
    /// [`ErrorKind::Setting`](crate::ErrorKind::Setting) for a method of your own, and the errors of
    /// [`SimulatorBuilder::build`](crate::SimulatorBuilder::build) and of [`prepare`](Self::prepare).
    #[inline(never)]
    pub fn with_psf(&self, psf: Psf, progress: &dyn Progress) -> Result<Self, PsfieldError> {
        self.with_parts(vec![Arc::new(Part::new(psf))], None, progress)
    }

    /// As [`with_psf`](Self::with_psf), for the PSFs of several parts. `images` is the PSF on the pixels of
    /// the scenes' images, if it is made in another way.
    pub(crate) fn with_parts(
        &self,
        parts: Vec<Arc<Part<T>>>,
        images: Option<Psf>,
        progress: &dyn Progress,
    ) -> Result<Self, PsfieldError> {
        let (options, shape) = (self.options(), self.setup.geometry.shape);
        if options.method == Method::Own {
            return Err(PsfieldError::needs_plan("the PSF can be replaced"));
        }
        let mut other = Self::of_parts(parts, images, (shape.ny(), shape.nx()), options.clone())?;
        let mut convolvers = Vec::new();
        for (layers, before) in self.kept_convolvers() {
            let convolver = other.convolver_on_tiles_of(&before, &layers, progress)?;
            convolvers.extend(convolver.map(|convolver| (layers, Arc::new(convolver))));
        }
        let has_tiles = convolvers.iter().any(|(layers, _)| *layers == [0]);
        if has_tiles && self.shares_derivative_with(&other)? {
            other.psf_derivative = Arc::clone(&self.psf_derivative);
        }
        other.convolvers = Mutex::new(convolvers);
        Ok(other)
    }
}
