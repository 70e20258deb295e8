//! Convolves the images of a scene's layers: the models, the plan, and the device that executes it.

use std::sync::{Arc, PoisonError};
use std::time::Instant;

use conv_core::{ConvReal, Engine, Plan, PlanOptions};
use psf_types::{PixelRegion, Progress, PsfModel};

use super::Simulator;
use crate::device::{CpuReason, Placement, place};
use crate::error::PsfieldError;
use crate::psf::get_or_make;
use crate::simulate_options::{Device, SimulateOptions};

/// Convolves the images of some layers.
#[derive(Debug)]
pub(super) struct Convolver<T: ConvReal> {
    /// None for a method without a plan.
    pub(super) engine: Option<Engine<T>>,
    pub(super) placement: Placement,
    pub(super) seconds: f64,
}

/// A simulator keeps the plans for this number of sets of layers with an image.
const MOST_KEPT: usize = 4;

/// The numbers of some layers, and the convolver of their images.
pub(super) type OfLayers<T> = (Vec<usize>, Arc<Convolver<T>>);

impl<T: ConvReal> Convolver<T> {
    /// Places a plan on a device. The time is counted from `clock` on.
    pub(super) fn of_plan(
        plan: Plan<T>,
        options: &SimulateOptions,
        clock: Instant,
    ) -> Result<Self, PsfieldError> {
        let (engine, placement) = place(plan, options)?;
        Ok(Self {
            engine: Some(engine),
            placement,
            seconds: clock.elapsed().as_secs_f64(),
        })
    }

    /// Returns the engine. For a method without a plan, returns an error whose message begins with
    /// `what`.
    pub(super) fn engine_for(&self, what: &str) -> Result<&Engine<T>, PsfieldError> {
        self.engine.as_ref().ok_or_else(|| PsfieldError::needs_plan(what))
    }
}

impl<T: ConvReal> Simulator<T> {
    /// The models on the scene's pixels, one for each layer that may have an image, and the seconds that
    /// their fit took.
    pub(super) fn image_models(&self) -> Result<&(Vec<PsfModel>, f64), PsfieldError> {
        get_or_make(&self.shared.image_models, || {
            let clock = Instant::now();
            let on_pixels = match &self.shared.images {
                Some(images) => images.clone(),
                None => self.setup.on_scene_pixels(&self.psf().core()?)?,
            };
            let models = on_pixels.models()?.to_vec();
            Ok((models, clock.elapsed().as_secs_f64()))
        })
    }

    /// The convolvers that exist.
    pub(super) fn kept_convolvers(&self) -> Vec<OfLayers<T>> {
        self.convolvers
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    /// The convolver for the images of some layers, if it exists.
    pub(super) fn kept_convolver(&self, layers: &[usize]) -> Option<Arc<Convolver<T>>> {
        let kept = self.convolvers.lock().unwrap_or_else(PoisonError::into_inner);
        let same = kept.iter().find(|(of, _)| of == layers);
        same.map(|(_, convolver)| Arc::clone(convolver))
    }

    /// Returns the convolver for the images of some layers, one at least. No thread waits for another that
    /// makes it: if two make it, one result is kept.
    #[inline(never)]
    pub(super) fn convolver(
        &self,
        layers: &[usize],
        progress: &dyn Progress,
    ) -> Result<Arc<Convolver<T>>, PsfieldError> {
        if let Some(kept) = self.kept_convolver(layers) {
            return Ok(kept);
        }
        let made = Arc::new(self.new_convolver(layers, progress)?);
        let mut kept = self.convolvers.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, known)) = kept.iter().find(|(of, _)| of == layers) {
            return Ok(Arc::clone(known));
        }
        if kept.len() == MOST_KEPT {
            kept.remove(0);
        }
        kept.push((layers.to_vec(), Arc::clone(&made)));
        Ok(made)
    }

    /// The options of a plan for images with these models.
    fn image_plan_options(&self, models: &[PsfModel]) -> Result<Option<PlanOptions>, PsfieldError> {
        let options = self.setup.plan_options::<T>(self.psf(), models)?;
        Ok(match self.wings()? {
            Some(_) => options.map(PlanOptions::beside_wings),
            None => options,
        })
    }

    fn new_convolver(&self, layers: &[usize], progress: &dyn Progress) -> Result<Convolver<T>, PsfieldError> {
        let (all, _) = self.image_models()?;
        let clock = Instant::now();
        let models: Vec<PsfModel> = layers.iter().map(|&layer| all[layer].clone()).collect();
        let Some(options) = self.image_plan_options(&models)? else {
            return Ok(Convolver {
                engine: None,
                placement: self.placement_of_sources(),
                seconds: clock.elapsed().as_secs_f64(),
            });
        };
        let geometry = &self.setup.geometry;
        let (frame, region) = (geometry.fine(geometry.frame)?, geometry.fine(geometry.region)?);
        let plan = Plan::of_layers(&models, geometry.shape, frame, region, options, progress)?;
        Convolver::of_plan(plan, self.options(), clock)
    }

    /// As [`convolver`](Self::convolver), with the tiles of a convolver for another PSF. None if the stamps
    /// have another shape or centre, or for layers that do not exist.
    pub(super) fn convolver_on_tiles_of(
        &self,
        before: &Convolver<T>,
        layers: &[usize],
        progress: &dyn Progress,
    ) -> Result<Option<Convolver<T>>, PsfieldError> {
        let (all, _) = self.image_models()?;
        let clock = Instant::now();
        let models: Option<Vec<PsfModel>> = layers.iter().map(|&layer| all.get(layer).cloned()).collect();
        let (Some(engine), Some(models)) = (&before.engine, models) else {
            return Ok(None);
        };
        let Some(options) = self.image_plan_options(&models)? else {
            return Ok(None);
        };
        let plan = engine
            .plan()
            .for_other_fields(&models, options.memory_bytes(), progress)?;
        plan.map(|plan| Convolver::of_plan(plan, self.options(), clock))
            .transpose()
    }

    /// The part of the scene whose light reaches the computed region, in pixels of the scene, through the wings
    /// of the PSF if it has any.
    pub(super) fn light_region_of(
        &self,
        layers: &[usize],
        progress: &dyn Progress,
    ) -> Result<PixelRegion, PsfieldError> {
        self.wings()?.unwrap_or(self).core_light_region(layers, progress)
    }

    /// The part of the scene whose light reaches the computed region through the core of the PSF.
    pub(super) fn core_light_region(
        &self,
        layers: &[usize],
        progress: &dyn Progress,
    ) -> Result<PixelRegion, PsfieldError> {
        Ok(match &self.convolver(layers, progress)?.engine {
            Some(engine) => engine.plan().light_region(),
            None => self.setup.geometry.shape.region(),
        })
    }

    pub(super) fn placement_of_sources(&self) -> Placement {
        Placement::cpu(match (self.options().device, &self.shared.method) {
            (Device::Cpu, _) => CpuReason::Asked,
            (_, Some(_)) => CpuReason::Method,
            (_, None) => CpuReason::Stars,
        })
    }
}
