//! Opens GPUs. All plans of a process share the open GPUs.

use std::sync::{Mutex, MutexGuard, PoisonError};

use conv_core::gpu::{Adapter, AdapterKind, GpuDevice, GpuError, GpuOptions, adapters};
use conv_core::{ConvError, ConvReal, Engine, Plan};

use super::{CpuReason, Placement, PredictedSeconds};
use crate::error::PsfieldError;
use crate::simulate_options::SimulateOptions;

#[derive(Debug)]
struct OpenGpus {
    process: u32,
    /// The adapters, listed once.
    adapters: Option<Vec<Adapter>>,
    /// The open GPUs, each with the name under which the caller asked for it.
    gpus: Vec<(Option<String>, GpuDevice)>,
}

impl OpenGpus {
    const fn none(process: u32) -> Self {
        Self {
            process,
            adapters: None,
            gpus: Vec::new(),
        }
    }
}

/// No process has the number 0, so the first call starts a new list.
static OPEN: Mutex<OpenGpus> = Mutex::new(OpenGpus::none(0));

/// Locks the list of open GPUs. No rayon work may run while the lock is held: rayon could give this
/// thread a task that waits for the same lock.
fn open_gpus() -> MutexGuard<'static, OpenGpus> {
    let mut open = OPEN.lock().unwrap_or_else(PoisonError::into_inner);
    let process = std::process::id();
    if open.process != process {
        // A forked process must not close the GPUs of its parent.
        std::mem::forget(std::mem::replace(&mut *open, OpenGpus::none(process)));
    }
    open
}

/// Opens the GPU that `adapter` names (by a part of the GPU's name, or by its backend). If
/// `adapter` is None, opens the preferred GPU. An open GPU is not opened again. Returns the GPU's
/// name, kind and backend.
///
/// # Errors
/// [`ErrorKind::Gpu`](crate::ErrorKind::Gpu) if there is no such GPU, if its driver refuses, or in
/// a build without the feature `gpu`.
pub fn open_gpu(adapter: Option<&str>) -> Result<String, PsfieldError> {
    let gpu = opened(adapter).map_err(ConvError::Gpu)?;
    Ok(gpu.adapter().to_string())
}

/// Forgets the open GPUs. Call this after an error of a GPU, because the GPU may be lost.
pub fn forget_gpus() {
    *open_gpus() = OpenGpus::none(std::process::id());
}

/// Gives a plan to a GPU.
pub(super) fn place_on_gpu<T: ConvReal>(
    plan: Plan<T>,
    options: &SimulateOptions,
) -> Result<(Engine<T>, Placement), PsfieldError> {
    let (engine, adapter) = handed_over(plan, options).map_err(|(_, error)| ConvError::Gpu(error))?;
    let placement = Placement::Gpu {
        adapter,
        predicted_seconds: None,
    };
    Ok((engine, placement))
}

/// Gives a plan to a GPU if an execution is predicted to be faster there.
pub(super) fn place_where_faster<T: ConvReal>(
    plan: Plan<T>,
    options: &SimulateOptions,
    cpu_seconds: f64,
) -> (Engine<T>, Placement) {
    let on_cpu = |plan, reason| (Engine::new(plan), Placement::cpu(reason));
    let failed = |error: GpuError| match error {
        GpuError::NoAdapter => CpuReason::NoGpu,
        error => CpuReason::Failed {
            error: error.to_string(),
        },
    };
    let adapter = match candidate(options.gpu_adapter.as_deref()) {
        Ok(adapter) => adapter,
        Err(error) => return on_cpu(plan, failed(error)),
    };
    let gpu_seconds = plan.predicted_gpu_seconds(&adapter);
    let predicted = match gain(adapter.to_string(), adapter.kind, gpu_seconds, cpu_seconds) {
        Ok(predicted) => predicted,
        Err(reason) => return on_cpu(plan, reason),
    };
    match handed_over(plan, options) {
        Ok((engine, adapter)) => {
            let placement = Placement::Gpu {
                adapter,
                predicted_seconds: Some(predicted),
            };
            (engine, placement)
        }
        Err((plan, error)) => on_cpu(*plan, failed(error)),
    }
}

/// Returns the adapter to use. An adapter with a given name is opened. The preferred adapter is
/// only listed.
fn candidate(name: Option<&str>) -> Result<Adapter, GpuError> {
    if name.is_some() {
        return Ok(opened(name)?.adapter().clone());
    }
    let mut open = open_gpus();
    let listed = open.adapters.get_or_insert_with(adapters);
    listed.first().cloned().ok_or(GpuError::NoAdapter)
}

/// A plan on a GPU and the GPU's name, or the plan and the error of the GPU.
type HandedOver<T> = Result<(Engine<T>, String), (Box<Plan<T>>, GpuError)>;

fn handed_over<T: ConvReal>(plan: Plan<T>, options: &SimulateOptions) -> HandedOver<T> {
    // Refuse the precision before a GPU is opened.
    if size_of::<T>() != size_of::<f32>() {
        return Err((Box::new(plan), GpuError::Precision { precision: T::NAME }));
    }
    let gpu = match opened(options.gpu_adapter.as_deref()) {
        Ok(gpu) => gpu,
        Err(error) => return Err((Box::new(plan), error)),
    };
    let memory = GpuOptions::default();
    let memory = options
        .gpu_memory
        .map_or(memory, |bytes| memory.with_memory(bytes));
    let engine = Engine::on_gpu(plan, &gpu, memory).map_err(|(plan, error)| (Box::new(plan), error))?;
    Ok((engine, gpu.adapter().to_string()))
}

fn opened(name: Option<&str>) -> Result<GpuDevice, GpuError> {
    let mut open = open_gpus();
    if let Some((_, gpu)) = open.gpus.iter().find(|(asked, _)| asked.as_deref() == name) {
        return Ok(gpu.clone());
    }
    let gpu = GpuDevice::new(name)?;
    open.gpus.push((name.map(str::to_owned), gpu.clone()));
    Ok(gpu)
}

/// The predicted seconds if the GPU is faster than the processor, else the reason against the GPU.
fn gain(
    adapter: String,
    kind: AdapterKind,
    gpu: Option<f64>,
    cpu: f64,
) -> Result<PredictedSeconds, CpuReason> {
    match gpu {
        _ if kind == AdapterKind::Software => Err(CpuReason::Software { adapter }),
        None => Err(CpuReason::Unsuited { adapter }),
        Some(gpu) if gpu < cpu => Ok(PredictedSeconds { gpu, cpu }),
        Some(gpu) => Err(CpuReason::Slower {
            adapter,
            predicted_seconds: PredictedSeconds { gpu, cpu },
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gpu_must_be_one_and_be_faster() {
        let gain = |kind, gpu| gain("it".to_owned(), kind, gpu, 2.0);
        let adapter = "it".to_owned();
        let predicted = |gpu| PredictedSeconds { gpu, cpu: 2.0 };
        for kind in [AdapterKind::Discrete, AdapterKind::Integrated, AdapterKind::Other] {
            assert_eq!(gain(kind, Some(1.9)), Ok(predicted(1.9)));
            for gpu in [2.0, 30.0, f64::NAN] {
                let reason = gain(kind, Some(gpu)).unwrap_err();
                assert!(matches!(reason, CpuReason::Slower { .. }), "{reason}");
            }
            let unsuited = CpuReason::Unsuited {
                adapter: adapter.clone(),
            };
            assert_eq!(gain(kind, None), Err(unsuited));
        }
        let software = CpuReason::Software { adapter };
        assert_eq!(gain(AdapterKind::Software, Some(0.1)), Err(software));
    }
}
