//! Simulators for mixtures of the states of one PSF, such as its PSFs at several times.

use std::sync::OnceLock;

use conv_core::ConvReal;
use ndarray::Array2;
use psf_types::{Progress, StateKind};

use super::sources::Sources;
use super::{Simulator, on_scene_pixels};
use crate::psf::get_or_make;
use crate::{Psf, PsfieldError, SimulateOptions};

/// A mixture of the states of a PSF.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Mixture {
    /// `[1, state]`.
    pub(crate) weights: Array2<f64>,
    /// The mixtures `[mixture, state]` that new local bases represent. None: the local bases of another
    /// simulator represent this mixture.
    pub(crate) represented: Option<Array2<f64>>,
}

/// A PSF, and the parts that simulators of mixtures of its states share.
#[derive(Debug)]
pub(crate) struct Mixtures<T: ConvReal> {
    psf: Psf,
    /// The PSF on the pixels of the scenes' images.
    on_pixels: OnceLock<Psf>,
    /// The PSF with the response of a pixel.
    with_response: OnceLock<Psf>,
    /// Local bases for stars and galaxies that represent the PSFs of all states.
    sources: OnceLock<Sources<T>>,
}

impl<T: ConvReal> Mixtures<T> {
    pub(crate) fn new(psf: Psf) -> Self {
        Self {
            psf,
            on_pixels: OnceLock::new(),
            with_response: OnceLock::new(),
            sources: OnceLock::new(),
        }
    }

    /// Makes the simulator of a mixture. None: the PSF has no states. `light` says whether the scenes
    /// have an image, and whether they have stars or galaxies. A simulator of another mixture lends its
    /// tiles and its local bases.
    pub(crate) fn simulator(
        &self,
        mixture: Option<&Mixture>,
        (shape, options): ((usize, usize), &SimulateOptions),
        (image, sources): (bool, bool),
        before: Option<&Simulator<T>>,
        progress: &dyn Progress,
    ) -> Result<Simulator<T>, PsfieldError> {
        let planned = options.method.has_plan();
        let Some(Mixture { weights, represented }) = mixture.filter(|_| planned) else {
            let psf = match mixture {
                Some(Mixture { weights, .. }) => self.psf.mixed(weights.view(), None)?,
                None => self.psf.clone(),
            };
            return match before.filter(|_| planned && image) {
                Some(before) => before.for_other_field(psf, progress),
                None => psf.simulator(shape).options(options.clone()).build(),
            };
        };
        let simulator = mixed(&self.psf, weights)?
            .simulator(shape)
            .options(options.clone())
            .build()?;
        if sources {
            let psf = get_or_make(&self.with_response, || self.psf.with_pixel_response())?;
            let model = mixed(psf, weights)?.model()?.clone();
            let lent = before.and_then(|before| before.shared.sources.get());
            let made = if let Some(represented) = represented {
                let psf = mixed(psf, represented)?;
                let models = psf.models()?;
                let made = match lent.and_then(|lent| lent.for_other_layers(models)) {
                    Some(made) => made,
                    None => simulator.sources_of_layers(models, 0.0)?,
                };
                made.for_other_field(&model)
            } else {
                lent.and_then(|lent| lent.for_other_field(&model))
            };
            if let Some(made) = made {
                simulator.shared.sources.get_or_init(|| made);
            }
        }
        if image {
            let model = mixed(self.on_pixels(&simulator.options)?, weights)?;
            let model = model.model()?.clone();
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
        let psf = get_or_make(&self.with_response, || self.psf.with_pixel_response())?;
        let models = psf.models()?;
        let plan = get_or_make(&self.sources, || simulators[0].sources_of_layers(models, 0.0))?;
        for (simulator, model) in simulators.iter().zip(models) {
            if let Some(plan) = plan.for_other_field(model) {
                simulator.shared.sources.get_or_init(|| plan);
            }
        }
        Ok(())
    }
}

/// Mixtures `[mixture, state]` of a PSF's states. They share the stamps of its models.
fn mixed(psf: &Psf, weights: &Array2<f64>) -> Result<Psf, PsfieldError> {
    psf.models()?;
    let numbers: Vec<f64> = (0..weights.nrows()).map(|mixture| mixture as f64).collect();
    let labels = (weights.nrows() > 1).then_some((StateKind::Frame, &numbers[..]));
    psf.mixed(weights.view(), labels)
}
