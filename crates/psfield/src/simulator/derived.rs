//! Simulators that share tiles with another one: for other regions, or for another PSF.

use std::sync::{Arc, OnceLock};
use std::time::Instant;

use conv_core::ConvReal;
use psf_types::{PixelRegion, Progress};

use super::flux::check_flux;
use super::geometry::Geometry;
use super::{Convolver, REGION, Simulator};
use crate::{Method, Psf, PsfieldError, SimulateOptions};

impl<T: ConvReal> Simulator<T> {
    /// Returns a simulator for another region of the same frame. `region` is in frame pixels
    /// counted from the frame's first pixel. The new simulator uses the tiles that were chosen for
    /// this one and shares its plan for stars, which is much faster than a new plan.
    ///
    /// # Errors
    /// [`ErrorKind::Setting`](crate::ErrorKind::Setting) for a region outside the frame or a method
    /// without a plan, and the errors of [`prepare`](Self::prepare).
    #[inline(never)]
    pub fn for_region(&self, region: PixelRegion, progress: &dyn Progress) -> Result<Self, PsfieldError> {
        let options = SimulateOptions {
            region: Some(region),
            ..self.options.clone()
        };
        let geometry = Geometry::new(self.geometry.shape, &options)?;
        let chosen = self.convolver(progress)?;
        let engine = chosen.engine_for(REGION)?;
        let clock = Instant::now();
        let plan = engine.plan().for_other_region(geometry.fine(region)?, progress)?;
        let convolver = Convolver::of_plan(plan, &options, clock)?;
        Ok(Self {
            shared: Arc::clone(&self.shared),
            options,
            geometry,
            convolver: OnceLock::from(convolver),
        })
    }

    /// Returns a simulator with the same settings for another PSF, such as other coefficients of the
    /// same basis. If the new stamps have the shape and the centre of the old ones, it uses the tiles
    /// that were chosen for this simulator, which is much faster than a new plan. The tolerance holds
    /// in any case.
    ///
    /// # Errors
    /// [`ErrorKind::Setting`](crate::ErrorKind::Setting) for a method of your own, and the errors of
    /// [`SimulatorBuilder::build`](crate::SimulatorBuilder::build) and of [`prepare`](Self::prepare).
    #[inline(never)]
    pub fn for_other_field(&self, psf: Psf, progress: &dyn Progress) -> Result<Self, PsfieldError> {
        if self.options.method == Method::Own {
            return Err(PsfieldError::needs_plan("the PSF can be replaced"));
        }
        let shape = (self.geometry.shape.ny(), self.geometry.shape.nx());
        let other = psf.simulator(shape).options(self.options.clone()).build::<T>()?;
        if self.options.method.has_plan() {
            other.plan_as(self, progress)?;
        }
        Ok(other)
    }

    /// Plans the convolution of images with the tiles of another simulator, if the stamps have the same
    /// shape and centre.
    pub(super) fn plan_as(&self, before: &Self, progress: &dyn Progress) -> Result<(), PsfieldError> {
        let clock = Instant::now();
        let (model, _) = self.image_model()?;
        let (Some(engine), Some(options)) = (&before.convolver(progress)?.engine, self.planned_for(model)?)
        else {
            return Ok(());
        };
        check_flux(self.psf(), model, &options)?;
        let models = std::slice::from_ref(model);
        let plan = engine
            .plan()
            .for_other_fields(models, options.memory_bytes(), progress)?;
        if let Some(plan) = plan {
            let convolver = Convolver::of_plan(plan, &self.options, clock)?;
            self.convolver.get_or_init(|| convolver);
        }
        Ok(())
    }
}
