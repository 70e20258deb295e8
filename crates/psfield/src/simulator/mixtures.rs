//! Simulators for mixtures of the states of one PSF, such as its PSFs at several times.

use std::sync::OnceLock;

use conv_core::ConvReal;
use ndarray::Array2;
use psf_types::Progress;

use super::sources::Sources;
use super::{Simulator, on_scene_pixels};
use crate::psf::get_or_make;
use crate::{Psf, PsfieldError, SimulateOptions};

/// A PSF, and the parts that simulators of mixtures of its states share: stamps, and local bases for
/// stars and galaxies that represent the PSFs of all states.
#[derive(Debug)]
pub(crate) struct Mixtures<T: ConvReal> {
    psf: Psf,
    /// The PSF on the pixels of the scenes' images.
    on_pixels: OnceLock<Psf>,
    /// The PSF with the response of a pixel, and the plan for stars and galaxies.
    sources: OnceLock<(Psf, Sources<T>)>,
}

impl<T: ConvReal> Mixtures<T> {
    pub(crate) fn new(psf: Psf) -> Self {
        Self {
            psf,
            on_pixels: OnceLock::new(),
            sources: OnceLock::new(),
        }
    }

    /// Makes the simulator of the mixture with these weights `[1, state]`. None: the PSF has no states.
    /// `light` says whether the scenes have an image, and whether they have stars or galaxies. A
    /// simulator of another mixture lends its tiles.
    pub(crate) fn simulator(
        &self,
        weights: Option<&Array2<f64>>,
        (shape, options): ((usize, usize), &SimulateOptions),
        (image, sources): (bool, bool),
        before: Option<&Simulator<T>>,
        progress: &dyn Progress,
    ) -> Result<Simulator<T>, PsfieldError> {
        let planned = options.method.has_plan();
        let Some(weights) = weights.filter(|_| planned) else {
            let psf = match weights {
                Some(weights) => self.psf.mixed(weights.view(), None)?,
                None => self.psf.clone(),
            };
            return match before.filter(|_| planned && image) {
                Some(before) => before.for_other_field(psf, progress),
                None => psf.simulator(shape).options(options.clone()).build(),
            };
        };
        let mixed = |psf: &Psf| {
            // The mixture shares the stamps of these models.
            psf.models()?;
            psf.mixed(weights.view(), None)
        };
        let simulator = mixed(&self.psf)?
            .simulator(shape)
            .options(options.clone())
            .build()?;
        if sources {
            let (psf, plan) = self.sources(&simulator)?;
            if let Some(plan) = plan.for_other_field(mixed(psf)?.model()?) {
                simulator.shared.sources.get_or_init(|| plan);
            }
        }
        if image {
            let model = mixed(self.on_pixels(&simulator.options)?)?.model()?.clone();
            simulator.shared.image_model.get_or_init(|| (model, 0.0));
            if let Some(before) = before {
                simulator.plan_as(before, progress)?;
            }
        }
        Ok(simulator)
    }

    /// The PSF on the pixels of the scenes' images, with all its states.
    pub(crate) fn on_pixels(&self, options: &SimulateOptions) -> Result<&Psf, PsfieldError> {
        get_or_make(&self.on_pixels, || on_scene_pixels(&self.psf, options))
    }

    /// Gives each simulator, one for each state of the PSF, the plan for stars and galaxies that all
    /// share, unless it has one.
    pub(super) fn lend_sources(&self, simulators: &[Simulator<T>]) -> Result<(), PsfieldError> {
        if simulators
            .iter()
            .all(|simulator| simulator.shared.sources.get().is_some())
        {
            return Ok(());
        }
        let (psf, plan) = self.sources(&simulators[0])?;
        for (simulator, model) in simulators.iter().zip(psf.models()?) {
            if let Some(plan) = plan.for_other_field(model) {
                simulator.shared.sources.get_or_init(|| plan);
            }
        }
        Ok(())
    }

    /// The plan for stars and galaxies.
    fn sources(&self, simulator: &Simulator<T>) -> Result<&(Psf, Sources<T>), PsfieldError> {
        get_or_make(&self.sources, || {
            let psf = self.psf.with_pixel_response()?;
            let sources = simulator.sources_of_layers(psf.models()?, 0.0)?;
            Ok((psf, sources))
        })
    }
}
