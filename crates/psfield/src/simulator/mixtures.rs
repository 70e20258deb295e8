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
#[derive(Debug)]
pub(crate) struct Mixture {
    /// `[1, state]`. None: the PSF has no states.
    pub(crate) weights: Option<Array2<f64>>,
    /// The PSF of the mixture for images, if it is made in another way.
    pub(crate) native: Option<Psf>,
    /// New local bases represent these mixtures `[mixture, state]`. None: the local bases of the
    /// simulator before are used again.
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
    /// The plan for stars and galaxies with the PSFs of all states.
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

    /// Makes the simulator of a mixture. `light` says whether the scenes have an image, and whether they
    /// have stars or galaxies. A simulator of another mixture lends its tiles, and its local bases unless
    /// the mixture needs new ones.
    pub(crate) fn simulator(
        &self,
        mixture: &Mixture,
        (shape, options): ((usize, usize), &SimulateOptions),
        (image, sources): (bool, bool),
        before: Option<&Simulator<T>>,
        progress: &dyn Progress,
    ) -> Result<Simulator<T>, PsfieldError> {
        let of_mixture = |psf: &Psf| match &mixture.weights {
            Some(weights) => mixed(psf, weights),
            None => Ok(psf.clone()),
        };
        let psf = match &mixture.native {
            // Images need no other stamps.
            Some(native) if !sources => native.clone(),
            _ => of_mixture(&self.psf)?,
        };
        let simulator = psf.simulator(shape).options(options.clone()).build()?;
        if !options.method.has_plan() {
            return Ok(simulator);
        }
        if sources && mixture.weights.is_some() {
            let model = of_mixture(self.with_response()?)?.model()?.clone();
            let made = match &mixture.represented {
                Some(represented) => self
                    .local_bases(represented, &simulator)?
                    .and_then(|plan| plan.for_other_field(&model)),
                None => before
                    .and_then(|before| before.shared.sources.get())
                    .and_then(|lent| lent.for_other_field(&model)),
            };
            if let Some(made) = made {
                simulator.shared.sources.get_or_init(|| made);
            }
        }
        if image {
            let on_pixels = match &mixture.native {
                Some(native) => on_scene_pixels(native, &simulator.options)?,
                None => of_mixture(self.on_pixels(&simulator.options)?)?,
            };
            let model = on_pixels.model()?.clone();
            simulator.shared.image_model.get_or_init(|| (model, 0.0));
            if let Some(before) = before {
                simulator.plan_as(before, progress)?;
            }
        }
        Ok(simulator)
    }

    /// A plan for stars and galaxies whose local bases represent these mixtures `[mixture, state]`.
    fn local_bases(
        &self,
        represented: &Array2<f64>,
        simulator: &Simulator<T>,
    ) -> Result<Option<Sources<T>>, PsfieldError> {
        let psf = mixed(self.with_response()?, represented)?;
        self.sources(simulator)?
            .for_other_layers(simulator, psf.models()?)
    }

    /// The plan for stars and galaxies with the PSFs of all states.
    fn sources(&self, simulator: &Simulator<T>) -> Result<&Sources<T>, PsfieldError> {
        let models = self.with_response()?.models()?;
        get_or_make(&self.sources, || simulator.sources_of_layers(models, 0.0))
    }

    fn with_response(&self) -> Result<&Psf, PsfieldError> {
        get_or_make(&self.with_response, || self.psf.with_pixel_response())
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
        let plan = self.sources(&simulators[0])?;
        let models = self.with_response()?.models()?;
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
