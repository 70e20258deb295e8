//! A simulation and its plan.

use std::sync::{Arc, Mutex};

use psfield::conv_core::ConvReal;
use psfield::psf_types::{PixelRegion, Scene};
use psfield::{Gpus, Placement, SceneParts, Simulation, SimulationPlan};
use rayon::ThreadPool;

use crate::error::Failure;
use crate::interruptible::Watch;
use crate::kept_psf::KeptPsf;
use crate::later::turn;
use crate::settings::Settings;

/// A simulation and its plan.
pub(crate) struct Prepared<T: ConvReal> {
    pub(crate) simulation: Arc<Simulation>,
    pub(crate) plan: SimulationPlan<T>,
    pub(crate) placement: Placement,
}

/// What of scenes is simulated.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Part {
    /// Their extended light, on a region of the frame or on all of it.
    Images(Option<PixelRegion>),
    /// Their stars.
    Stars,
}

/// The GPUs that are open, which all plans of a process share.
static GPUS: Mutex<Option<(u32, Gpus)>> = Mutex::new(None);

impl<T: ConvReal> Prepared<T> {
    /// The models and the plan that scenes like this one need; on a thread beside the pool.
    pub(crate) fn new(
        psf: &KeptPsf,
        settings: &Settings,
        part: Part,
        scene: &Scene<T>,
        watch: &Watch,
        pool: &ThreadPool,
    ) -> Result<Self, Failure> {
        let stars = matches!(part, Part::Stars);
        let parts = SceneParts {
            image: !stars,
            sources: stars,
            frame: scene.frame().shape(),
        };
        let options = settings
            .method
            .plan_options(settings.plan)
            .unwrap_or(settings.plan);
        let (simulation, plan) = pool.install(|| -> Result<_, Failure> {
            let resampled = psf.input().needs_resampling(parts, settings.simulation)?;
            let simulation =
                Simulation::for_parts(psf.for_simulation(resampled)?, parts, settings.simulation)?;
            let dark = scene.clone().with_sources(Vec::new());
            let plan = match part {
                Part::Images(Some(region)) => simulation.plan_for_region(&dark, region, options, watch)?,
                Part::Images(None) => simulation.plan_for_images_with_progress(&dark, options, watch)?,
                Part::Stars => simulation.plan(&dark, options)?,
            };
            Ok((simulation, plan))
        })?;
        Self::on_device(Arc::new(simulation), plan, settings, watch, pool)
    }

    /// A plan where it is executed.
    pub(crate) fn on_device(
        simulation: Arc<Simulation>,
        mut plan: SimulationPlan<T>,
        settings: &Settings,
        watch: &Watch,
        pool: &ThreadPool,
    ) -> Result<Self, Failure> {
        let process = std::process::id();
        let mut kept = turn(&GPUS, watch)?;
        if kept.as_ref().is_none_or(|&(of, _)| of != process) {
            // The parent's are not to be closed here.
            std::mem::forget(kept.take());
            *kept = Some((process, Gpus::default()));
        }
        let (_, gpus) = kept.as_mut().expect("just put there");
        let placement =
            pool.install(|| gpus.place(&mut plan, &settings.device, rayon::current_num_threads()))?;
        Ok(Self {
            simulation,
            plan,
            placement,
        })
    }
}
