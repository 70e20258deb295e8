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
    /// For images, if it is another one.
    native: Option<Psf>,
    /// The PSF on the pixels of the scenes' images.
    on_pixels: OnceLock<Psf>,
    /// The PSF with the response of a pixel.
    with_response: OnceLock<Psf>,
    /// Local bases for stars and galaxies that represent the PSFs of all states.
    sources: OnceLock<Sources<T>>,
}

impl<T: ConvReal> Mixtures<T> {
    /// `native` is the PSF for images if it is not made of `psf`.
    pub(crate) fn new(psf: Psf, native: Option<Psf>) -> Self {
        Self {
            psf,
            native,
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
        let mixed = |psf: &Psf| match mixture {
            Some(mixture) => mixed(psf, &mixture.weights),
            None => Ok(psf.clone()),
        };
        let simulator = mixed(&self.psf)?
            .simulator(shape)
            .options(options.clone())
            .build()?;
        if !options.method.has_plan() {
            return Ok(simulator);
        }
        if let Some(mixture) = mixture.filter(|_| sources) {
            let psf = get_or_make(&self.with_response, || self.psf.with_pixel_response())?;
            let model = mixed(psf)?.model()?.clone();
            let lent = before.and_then(|before| before.shared.sources.get());
            let made = match &mixture.represented {
                Some(represented) => self
                    .local_bases(represented, lent, &simulator)?
                    .for_other_field(&model),
                None => lent.and_then(|lent| lent.for_other_field(&model)),
            };
            if let Some(made) = made {
                simulator.shared.sources.get_or_init(|| made);
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

    /// A plan for stars and galaxies whose local bases represent these mixtures `[mixture, state]`. If
    /// another plan has the same stamps, it lends them.
    fn local_bases(
        &self,
        represented: &Array2<f64>,
        lent: Option<&Sources<T>>,
        simulator: &Simulator<T>,
    ) -> Result<Sources<T>, PsfieldError> {
        let psf = get_or_make(&self.with_response, || self.psf.with_pixel_response())?;
        let psf = mixed(psf, represented)?;
        let models = psf.models()?;
        match lent.and_then(|lent| lent.for_other_layers(models)) {
            Some(made) => Ok(made),
            None => simulator.sources_of_layers(models, 0.0),
        }
    }

    /// The PSF on the pixels of the scenes' images, with all its states.
    pub(crate) fn on_pixels(&self, options: &SimulateOptions) -> Result<&Psf, PsfieldError> {
        get_or_make(&self.on_pixels, || {
            on_scene_pixels(self.native.as_ref().unwrap_or(&self.psf), options)
        })
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
