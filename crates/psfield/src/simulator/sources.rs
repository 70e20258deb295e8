//! Draws the stars, galaxies and other sources of scenes.

use std::sync::Arc;
use std::time::Instant;

use conv_core::{ConvError, ConvReal, DroppedLight, ExtendedSources, Light, SourcePlan};
use ndarray::ArrayViewMut2;
use psf_types::{PixelRegion, PointSource, Progress, SersicSource};
use sersic::SersicLight;

use super::Simulator;
use super::setup::Setup;
use crate::error::PsfieldError;
use crate::psf::Psf;
use crate::scene::{Layer, Scene};

/// The plans for the sources of all layers of a [`Part`](super::Part). The layers share their local bases.
#[derive(Debug)]
pub(super) struct PartSources<T: ConvReal> {
    pub(super) of_layers: Vec<SourcePlan<T>>,
    pub(super) fit_seconds: f64,
    pub(super) plan_seconds: f64,
}

impl<T: ConvReal> PartSources<T> {
    /// Plans the drawing with the PSFs of all states.
    pub(super) fn new(psf: &Psf, setup: &Setup) -> Result<Self, PsfieldError> {
        let clock = Instant::now();
        let psf = psf.with_pixel_response()?;
        let models = psf.models()?;
        let fit_seconds = clock.elapsed().as_secs_f64();
        let clock = Instant::now();
        let size = setup.stamp_size(&psf);
        let first = match setup.plan_options::<T>(&psf, models)? {
            Some(options) => SourcePlan::of_layers(models, options, size)?,
            None => SourcePlan::exact(models, setup.options.anchor, size)?,
        };
        let others = models[1..].iter().map(|model| first.for_other_field(model));
        let others: Option<Vec<_>> = others.collect();
        let mut of_layers = vec![first];
        of_layers.extend(others.expect("the states of a PSF share their stamps"));
        Ok(Self {
            of_layers,
            fit_seconds,
            plan_seconds: clock.elapsed().as_secs_f64(),
        })
    }

    /// Draws sources with the PSFs of another PSF, one for each of its states, with the local bases of this
    /// one. None if it has other stamps.
    pub(super) fn for_other_field(&self, psf: &Psf) -> Result<Option<Self>, PsfieldError> {
        let psf = psf.with_pixel_response()?;
        let each = psf.models()?.iter();
        let made = each.map(|model| self.of_layers[0].for_other_field(model));
        Ok(made.collect::<Option<_>>().map(Self::at_once))
    }

    /// Draws sources with local bases that represent the PSFs of all states of another PSF. None if it has
    /// other stamps.
    pub(super) fn representing(&self, psf: &Psf, setup: &Setup) -> Result<Option<Self>, PsfieldError> {
        let psf = psf.with_pixel_response()?;
        let models = psf.models()?;
        // Only their check of the flux counts.
        setup.plan_options::<T>(&psf, models)?;
        let made = self.of_layers[0].for_other_layers(models);
        Ok(made.map(|made| Self::at_once(vec![made])))
    }

    fn at_once(of_layers: Vec<SourcePlan<T>>) -> Self {
        Self {
            of_layers,
            fit_seconds: 0.0,
            plan_seconds: 0.0,
        }
    }
}

/// Gives the extended sources of a layer to `work`: galaxies, then sources with profiles of the caller's own.
pub(super) fn with_extended<T: ConvReal, R>(
    layer: &Layer<'_, T>,
    work: impl FnOnce(ExtendedSources<'_>) -> Result<R, ConvError>,
) -> Result<R, PsfieldError> {
    let (galaxies, profiles) = (layer.galaxies(), layer.profiles());
    let point = |galaxy: &SersicSource| PointSource::new(galaxy.position(), galaxy.flux());
    let mut points: Vec<PointSource> = galaxies.iter().map(point).collect::<Result<_, _>>()?;
    points.extend(profiles.iter().map(|source| source.point));
    let light = |index: usize| -> Light {
        match galaxies.get(index) {
            Some(galaxy) => Arc::new(SersicLight::new(galaxy)),
            None => Arc::clone(&profiles[index - galaxies.len()].light),
        }
    };
    Ok(work(ExtendedSources {
        points: &points,
        light: &light,
    })?)
}

impl<T: ConvReal> Simulator<T> {
    /// Adds the sources of all layers, without their wings, to `image`, which holds the pixels of a region of the frame.
    #[inline(never)]
    pub(super) fn draw_sources_into(
        &self,
        scene: &Scene<'_, T>,
        region: PixelRegion,
        mut image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<(), PsfieldError> {
        let frame = self.frame();
        let drawn = scene.layers().iter().enumerate();
        for (number, layer) in drawn.filter(|(_, layer)| layer.has_sources()) {
            let plan = self.sources(number)?;
            if !(layer.galaxies().is_empty() && layer.profiles().is_empty()) {
                let into = image.view_mut();
                let draw = |sources: ExtendedSources<'_>| {
                    plan.draw_extended_into(sources, frame, region, into, progress)
                };
                with_extended(layer, draw)?;
            }
            plan.draw_stars_into(layer.stars(), frame, region, image.view_mut(), progress)?;
        }
        Ok(())
    }

    /// Adds the wings of the sources of all layers to `image`, which holds the pixels of the simulator's region.
    pub(super) fn draw_wings_into(
        &self,
        scene: &Scene<'_, T>,
        mut image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<(), PsfieldError> {
        let (frame, region) = (self.frame(), self.setup.geometry.region);
        let drawn = scene.layers().iter().enumerate();
        for (number, layer) in drawn.filter(|(_, layer)| layer.has_sources()) {
            let (plan, into) = (self.sources(number)?, image.view_mut());
            with_extended(layer, |extended| {
                plan.draw_wings_into((layer.stars(), extended), frame, region, into, progress)
            })?;
        }
        Ok(())
    }

    /// Returns upper limits of the light that is dropped in the image of a scene because it is below the floor
    /// ([`SimulateOptions::floor`](crate::SimulateOptions::floor)). None without a floor, and without sources.
    ///
    /// # Errors
    /// The errors of [`prepare`](Self::prepare).
    pub fn dropped_light(&self, scene: &Scene<'_, T>) -> Result<Option<DroppedLight>, PsfieldError> {
        self.check_scene(scene)?;
        let options = self.options();
        if options.floor == 0.0 || !options.method.has_plan() || !scene.has_sources() {
            return Ok(None);
        }
        let (frame, region) = (self.frame(), self.setup.geometry.region);
        let mut dropped = DroppedLight::new(region);
        let layers = scene.layers().iter().enumerate();
        for (number, layer) in layers.filter(|(_, layer)| layer.has_sources()) {
            let plan = self.sources(number)?;
            with_extended(layer, |extended| {
                plan.add_dropped_light((layer.stars(), extended), frame, region, &mut dropped)
            })?;
        }
        Ok(Some(dropped))
    }

    /// The plan for the sources of a layer.
    pub(super) fn sources(&self, layer: usize) -> Result<&SourcePlan<T>, PsfieldError> {
        let (part, state) = self.shared.part_of(layer);
        Ok(&part.sources(&self.setup)?.of_layers[state])
    }
}
