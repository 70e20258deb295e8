//! Who opens GPUs and hands plans to them.

use conv_core::{ConvReal, Plan};

use super::pool::Pool;
use super::{CpuReason, Device, DeviceOptions, Placement};
use crate::{PsfieldError, SimulationPlan};

/// The GPUs that were opened so far. Opening one takes a fraction of a second: plans share what is open.
///
/// ```
/// use psfield::{Device, DeviceOptions, Gpus};
/// # use std::sync::Arc;
/// # use ndarray::Array3;
/// # use psfield::conv_core::{Plan, PlanOptions};
/// # use psfield::psf_types::{
/// #     Image, Position, PsfSamples, SamplePositions, Scene, StampGrid
/// # };
/// # let stamp = Array3::from_elem((1, 3, 3), 1.0 / 9.0);
/// # let at = SamplePositions::new(vec![Position::of_pixel(8, 8)], None)?;
/// # let samples = PsfSamples::new(stamp, at, StampGrid::new(3, 3)?)?;
/// # let model = psfield::fit(samples, &Default::default())?.into_model()?;
/// # let scene = Scene::from_image(Image::new(ndarray::Array2::from_elem((16, 16), 1.0f32))?);
/// let mut plan = Plan::for_scene(&model, &scene, PlanOptions::new(1e-3)?)?;
/// let mut gpus = Gpus::default();
/// let placement = gpus.place_plan(&mut plan, &DeviceOptions::new(Device::default()), 8)?;
/// println!("{placement}"); // on the CPU: predicted 2.1e-5 s, less than it takes to open a GPU
/// assert_eq!(placement.adapter(), None);
/// let image = plan.execute(&scene)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Default)]
pub struct Gpus {
    pool: Pool,
}

impl Gpus {
    /// Work predicted to take less on the processor is not worth a look at what GPUs there are, which takes longer. What others were
    /// opened before has no part in it, so that the same plan is executed in the same place whatever ran before it.
    pub const WORTH_A_LOOK_SECONDS: f64 = 0.05;

    /// Opens the GPU that answers to a name (a part of its name or its backend), or the preferred one, unless it is open; returns its name, kind and
    /// backend.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`] with what the GPU's driver says, where there is none, or none of that name;
    /// [`PsfieldError::NoGpuSupport`] in a build without the feature `gpu`.
    pub fn open(&mut self, adapter: Option<&str>) -> Result<String, PsfieldError> {
        self.pool.open(adapter)
    }

    /// Decides where a plan that is on no GPU yet is executed, and hands it over. `threads` is the number of threads that would share the work on the processor.
    ///
    /// # Errors
    /// Where a GPU was asked for ([`Device::Gpu`]): as [`open`](Self::open), for plans in f64, and for plans beyond the GPU's limits. With the other
    /// devices what goes wrong is in the [`Placement`].
    pub fn place_plan<T: ConvReal>(
        &mut self,
        plan: &mut Plan<T>,
        options: &DeviceOptions,
        threads: usize,
    ) -> Result<Placement, PsfieldError> {
        let memory = options.gpu_memory_bytes();
        match options.device() {
            Device::Cpu => Ok(Placement::cpu(CpuReason::Asked)),
            Device::Gpu { adapter } => {
                let adapter = self.pool.attach(plan, adapter.as_deref(), memory)?;
                Ok(Placement::Gpu {
                    adapter,
                    predicted_seconds: None,
                })
            }
            Device::Auto { adapter } => {
                let cpu = plan.summary().predicted_seconds / threads.max(1) as f64;
                Ok(if size_of::<T>() != size_of::<f32>() {
                    Placement::cpu(CpuReason::Precision { precision: T::NAME })
                } else if cpu < Self::WORTH_A_LOOK_SECONDS {
                    Placement::cpu(CpuReason::Small { cpu_seconds: cpu })
                } else {
                    self.pool.attach_if_faster(plan, adapter.as_deref(), memory, cpu)
                })
            }
        }
    }

    /// The same for the plan of a simulation. Stars are drawn on the processor in any case.
    ///
    /// # Errors
    /// As [`place_plan`](Self::place_plan).
    pub fn place<T: ConvReal>(
        &mut self,
        plan: &mut SimulationPlan<T>,
        options: &DeviceOptions,
        threads: usize,
    ) -> Result<Placement, PsfieldError> {
        match (plan.engine_mut(), options.device()) {
            (Some(engine), _) => self.place_plan(engine, options, threads),
            (None, Device::Cpu) => Ok(Placement::cpu(CpuReason::Asked)),
            (None, _) => Ok(Placement::cpu(CpuReason::Stars)),
        }
    }
}
