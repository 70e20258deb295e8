//! Chooses whether a plan runs on the processor or on a GPU.

#[cfg(feature = "gpu")]
mod open_gpus;
mod placement;

use conv_core::{ConvReal, Engine, Plan};

use crate::error::PsfieldError;
use crate::simulate_options::{Device, SimulateOptions};

#[cfg(feature = "gpu")]
pub use open_gpus::{forget_gpus, open_gpu};
#[cfg(feature = "gpu")]
use open_gpus::{place_on_gpu, place_where_faster};
pub use placement::{CpuReason, GpuSeconds, Placement, PredictedSeconds};

/// With [`Device::Auto`], a plan stays on the processor if an execution there is predicted to take
/// fewer seconds than this. A search for GPUs would take longer. An open GPU does not change this
/// rule, so the choice of device does not depend on earlier work.
pub const MIN_SECONDS_FOR_GPU: f64 = 0.05;

/// Chooses the device that executes a plan, and gives the plan to this device. The predicted speed
/// of the processor is proportional to the number of threads of rayon's current pool.
pub(crate) fn place<T: ConvReal>(
    plan: Plan<T>,
    options: &SimulateOptions,
) -> Result<(Engine<T>, Placement), PsfieldError> {
    if plan.models().len() > 1 {
        if options.device == Device::Gpu {
            const LAYERS: &str = "images of several layers, such as spectra, are convolved on the CPU: choose the device cpu or auto";
            return Err(PsfieldError::of_setting("device", LAYERS));
        }
        return Ok((Engine::new(plan), Placement::cpu(CpuReason::Spectra)));
    }
    let predicted = || plan.summary().predicted_seconds / rayon::current_num_threads().max(1) as f64;
    let reason = match options.device {
        Device::Gpu => return place_on_gpu(plan, options),
        Device::Cpu => CpuReason::Asked,
        Device::Auto if size_of::<T>() != size_of::<f32>() => CpuReason::Precision { precision: T::NAME },
        Device::Auto => match predicted() {
            cpu_seconds if cpu_seconds < MIN_SECONDS_FOR_GPU => CpuReason::Small { cpu_seconds },
            cpu_seconds => return Ok(place_where_faster(plan, options, cpu_seconds)),
        },
    };
    Ok((Engine::new(plan), Placement::cpu(reason)))
}

/// Fails, because this build has no GPU support.
///
/// # Errors
/// [`ErrorKind::Gpu`](crate::ErrorKind::Gpu).
#[cfg(not(feature = "gpu"))]
pub fn open_gpu(_adapter: Option<&str>) -> Result<String, PsfieldError> {
    Err(no_gpu_support())
}

#[cfg(not(feature = "gpu"))]
fn no_gpu_support() -> PsfieldError {
    const NO_SUPPORT: &str = "this psfield was built without GPU support: build it with its feature gpu (--features gpu, docs/gpu.md shows how)";
    PsfieldError::new(crate::error::ErrorKind::Gpu, NO_SUPPORT)
}

/// Does nothing, because this build has no GPU support.
#[cfg(not(feature = "gpu"))]
pub fn forget_gpus() {}

#[cfg(not(feature = "gpu"))]
fn place_on_gpu<T: ConvReal>(
    _plan: Plan<T>,
    _options: &SimulateOptions,
) -> Result<(Engine<T>, Placement), PsfieldError> {
    Err(no_gpu_support())
}

#[cfg(not(feature = "gpu"))]
fn place_where_faster<T: ConvReal>(
    plan: Plan<T>,
    _options: &SimulateOptions,
    _cpu_seconds: f64,
) -> (Engine<T>, Placement) {
    (Engine::new(plan), Placement::cpu(CpuReason::NotBuilt))
}
