//! Plans of a simulation.

#[cfg(doc)]
use conv_core::ConvError;
use conv_core::{ConvReal, Plan, PlanOptions, StarPlan};
use psf_types::{NoProgress, PixelRegion, Progress, Scene};

use super::Simulation;
use crate::finer_scene::FinerScene;
use crate::{PsfieldError, SimulationPlan};

impl Simulation {
    /// A plan of the fast engine for scenes of one shape and frame.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`].
    pub fn plan<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        options: PlanOptions,
    ) -> Result<SimulationPlan<T>, PsfieldError> {
        let engine = match scene.image() {
            Some(_) => Some(Plan::for_scene(&self.model, scene, options)?),
            None => None,
        };
        self.planned(engine, options)
    }

    /// The same for scenes that are images and not at hand; `scene` gives their shape and frame.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`].
    pub fn plan_for_images<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        options: PlanOptions,
    ) -> Result<SimulationPlan<T>, PsfieldError> {
        self.plan_for_images_with_progress(scene, options, &NoProgress)
    }

    /// The same until it is no longer wanted: `progress` is asked whether to go on, and not told how far it has come.
    ///
    /// # Errors
    /// As [`Self::plan_for_images`], and [`ConvError::Cancelled`].
    pub fn plan_for_images_with_progress<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        options: PlanOptions,
        progress: &dyn Progress,
    ) -> Result<SimulationPlan<T>, PsfieldError> {
        let engine = self.engine(scene, scene.frame().shape().region(), options, progress)?;
        self.planned(Some(engine), options)
    }

    /// A plan for a region of the frame, in the frame's own pixels, so that a frame can be made in pieces, on many machines: put together they are
    /// the image that the plan of the whole frame makes but for rounding ([`Plan::for_region`]). `scene` gives the shape and the frame of the whole.
    ///
    /// Executions give images of the region, and need no light but that of [`SimulationPlan::light_region`]. `progress` is asked whether to go
    /// on, and not told how far it has come.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`], with [`ConvError::RegionOutsideFrame`] or [`ConvError::Cancelled`] among what there may be.
    pub fn plan_for_region<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        region: PixelRegion,
        options: PlanOptions,
        progress: &dyn Progress,
    ) -> Result<SimulationPlan<T>, PsfieldError> {
        let finer = FinerScene::new(self.options.oversample(), scene)?;
        let engine = self.engine(scene, finer.of_scene(region)?, options, progress)?;
        Ok(self.planned(Some(engine), options)?.of_region(region))
    }

    /// A plan for another region of the same frame, with the tiles that were chosen for `plan` and the stars' plan that it has: much sooner made
    /// than one that has to choose. `scene` gives the shape and the frame of the whole.
    ///
    /// # Errors
    /// As [`Self::plan_for_region`]; [`PsfieldError::PlanForStars`] where `plan` is for stars alone.
    pub fn plan_for_other_region<T: ConvReal>(
        &self,
        plan: &SimulationPlan<T>,
        scene: &Scene<T>,
        region: PixelRegion,
        progress: &dyn Progress,
    ) -> Result<SimulationPlan<T>, PsfieldError> {
        let engine = plan.engine().ok_or(PsfieldError::PlanForStars)?;
        engine.check_scene(scene)?;
        let finer = FinerScene::new(self.options.oversample(), scene)?;
        let other = engine.for_other_region(finer.of_scene(region)?, progress)?;
        Ok(plan.with_engine(other).of_region(region))
    }

    /// The engine for a region, in pixels of the scene counted from the frame's first.
    fn engine<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        region: PixelRegion,
        options: PlanOptions,
        progress: &dyn Progress,
    ) -> Result<Plan<T>, PsfieldError> {
        let (model, shape, frame) = (&self.model, scene.shape(), scene.frame());
        Ok(Plan::for_region_with_progress(
            model, shape, frame, region, options, progress,
        )?)
    }

    fn planned<T: ConvReal>(
        &self,
        engine: Option<Plan<T>>,
        options: PlanOptions,
    ) -> Result<SimulationPlan<T>, PsfieldError> {
        let size = self.options.stamp_size();
        let stars = StarPlan::new(self.star_model(), options, size)?;
        Ok(SimulationPlan::new(engine, stars))
    }
}
