//! Draws the stars and galaxies of scenes.

use std::time::Instant;

use conv_core::{ConvReal, GalaxyPlan, PlanOptions, StarPainter, StarPlan};
use ndarray::ArrayViewMut2;
use psf_types::{LightProfile, PixelRegion, Progress, PsfModel, SersicSource};
use sersic::SersicLight;

use super::Simulator;
use super::flux::check_flux;
use crate::psf::get_or_make;
use crate::scene::SceneSources;
use crate::{PsfieldError, Scene};

/// Draws stars and galaxies.
#[derive(Debug)]
pub(super) struct Sources<T: ConvReal> {
    pub(super) model: PsfModel,
    /// If None, stars are drawn one by one from all components, in f64.
    pub(super) stars: Option<StarPlan<T>>,
    pub(super) galaxies: GalaxyPlan<T>,
    pub(super) fit_seconds: f64,
    pub(super) plan_seconds: f64,
}

impl<T: ConvReal> Sources<T> {
    /// Draws sources through another model with the local bases of this one. None if the model has other
    /// stamps.
    pub(super) fn for_other_field(&self, model: &PsfModel) -> Option<Self> {
        self.planned_as(
            model,
            |plan| plan.for_other_field(model),
            |plan| plan.for_other_field(model),
        )
    }

    /// Draws sources through the first of some other models, with local bases that represent the PSFs of
    /// all. None if they have other stamps.
    pub(super) fn for_other_layers(
        &self,
        simulator: &Simulator<T>,
        models: &[PsfModel],
    ) -> Result<Option<Self>, PsfieldError> {
        simulator.check_fluxes(models)?;
        Ok(self.planned_as(
            &models[0],
            |plan| plan.for_other_layers(models),
            |plan| plan.for_other_layers(models),
        ))
    }

    fn planned_as(
        &self,
        model: &PsfModel,
        stars: impl FnOnce(&StarPlan<T>) -> Option<StarPlan<T>>,
        galaxies: impl FnOnce(&GalaxyPlan<T>) -> Option<GalaxyPlan<T>>,
    ) -> Option<Self> {
        let stars = match &self.stars {
            Some(plan) => Some(stars(plan)?),
            None => None,
        };
        Some(Self {
            model: model.clone(),
            stars,
            galaxies: galaxies(&self.galaxies)?,
            fit_seconds: 0.0,
            plan_seconds: 0.0,
        })
    }
}

impl<T: ConvReal> Simulator<T> {
    pub(super) fn sources(&self) -> Result<&Sources<T>, PsfieldError> {
        get_or_make(&self.shared.sources, || {
            let clock = Instant::now();
            let psf = self.psf().with_pixel_response()?;
            let models = std::slice::from_ref(psf.model()?);
            self.sources_of_layers(models, clock.elapsed().as_secs_f64())
        })
    }

    /// Draws sources through the first of these models. The local bases represent the PSFs of all.
    pub(super) fn sources_of_layers(
        &self,
        models: &[PsfModel],
        fit_seconds: f64,
    ) -> Result<Sources<T>, PsfieldError> {
        let clock = Instant::now();
        let size = self.options.stamp_size;
        let planned = self.planned_for(&models[0])?;
        self.check_fluxes(models)?;
        let stars = planned
            .map(|options| StarPlan::of_layers(models, options, size))
            .transpose()?;
        let exact = PlanOptions::new(TOLERANCE_WITHOUT_PLAN)?.with_anchor(self.options.anchor);
        let galaxies = GalaxyPlan::of_layers(models, planned.unwrap_or(exact), size)?;
        Ok(Sources {
            model: models[0].clone(),
            stars,
            galaxies,
            fit_seconds,
            plan_seconds: clock.elapsed().as_secs_f64(),
        })
    }

    /// The error of PSFs whose flux is too small for the tolerance of apertures.
    fn check_fluxes(&self, models: &[PsfModel]) -> Result<(), PsfieldError> {
        let planned = self.planned_for(&models[0])?;
        let check = |options| {
            models
                .iter()
                .try_for_each(|model| check_flux(self.psf(), model, options))
        };
        planned.as_ref().map_or(Ok(()), check)
    }

    /// Adds stars and galaxies to `image`, which holds the pixels of a region of the frame.
    #[inline(never)]
    pub(super) fn draw_sources_into(
        &self,
        (stars, galaxies): SceneSources<'_>,
        region: PixelRegion,
        mut image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<(), PsfieldError> {
        if stars.is_empty() && galaxies.is_empty() {
            return Ok(());
        }
        let (sources, frame) = (self.sources()?, self.geometry.frame);
        if !galaxies.is_empty() {
            let image = image.view_mut();
            sources
                .galaxies
                .draw_into(galaxies, &light_of, frame, region, image, progress)?;
        }
        match &sources.stars {
            Some(plan) => plan.draw_into(stars, frame, region, image, progress)?,
            None => self
                .painter(&sources.model)?
                .draw_into(stars, region, image, progress)?,
        }
        Ok(())
    }

    pub(super) fn painter<'a>(&self, model: &'a PsfModel) -> Result<StarPainter<'a>, PsfieldError> {
        let (frame, anchor) = (self.geometry.frame, self.options.anchor);
        Ok(StarPainter::new(model, frame, anchor, self.options.stamp_size)?)
    }
}

/// The tolerance for galaxies with a method that has no tolerance.
const TOLERANCE_WITHOUT_PLAN: f64 = 1e-7;

pub(super) fn has_sources<T: ConvReal>(scene: &Scene<'_, T>) -> bool {
    !scene.stars().is_empty() || !scene.galaxies().is_empty()
}

/// The light of a galaxy.
pub(super) fn light_of(galaxy: &SersicSource) -> Box<dyn LightProfile + Send + Sync> {
    Box::new(SersicLight::new(galaxy))
}
