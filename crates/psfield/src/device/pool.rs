//! Open GPUs.

use conv_core::gpu::{Adapter, AdapterKind, GpuDevice, GpuError, GpuOptions, adapters};
use conv_core::{ConvError, ConvReal, Plan};

use super::{CpuReason, Placement, PredictedSeconds};
use crate::PsfieldError;

#[derive(Debug, Default)]
pub(super) struct Pool {
    /// Looked up once.
    adapters: Option<Vec<Adapter>>,
    /// By the name that was asked for.
    open: Vec<(Option<String>, GpuDevice)>,
}

impl Pool {
    pub(super) fn open(&mut self, adapter: Option<&str>) -> Result<String, PsfieldError> {
        Ok(self.opened(adapter).map_err(of_plan)?.adapter().to_string())
    }

    /// Hands a plan to a GPU, and returns the adapter's name, kind and backend.
    pub(super) fn attach<T: ConvReal>(
        &mut self,
        plan: &mut Plan<T>,
        adapter: Option<&str>,
        memory: Option<u64>,
    ) -> Result<String, PsfieldError> {
        self.handed_over(plan, adapter, memory).map_err(of_plan)
    }

    /// Hands a plan to a GPU if it is predicted to be faster there.
    pub(super) fn attach_if_faster<T: ConvReal>(
        &mut self,
        plan: &mut Plan<T>,
        name: Option<&str>,
        memory: Option<u64>,
        cpu_seconds: f64,
    ) -> Placement {
        let failed = |error: GpuError| match error {
            GpuError::NoAdapter => Placement::cpu(CpuReason::NoGpu),
            error => Placement::cpu(CpuReason::Failed {
                error: error.to_string(),
            }),
        };
        let adapter = match self.candidate(name) {
            Ok(adapter) => adapter,
            Err(error) => return failed(error),
        };
        let gpu_seconds = plan.predicted_gpu_seconds(&adapter);
        match gain(adapter.to_string(), adapter.kind, gpu_seconds, cpu_seconds) {
            Err(reason) => Placement::cpu(reason),
            Ok(predicted) => match self.handed_over(plan, name, memory) {
                Ok(adapter) => Placement::Gpu {
                    adapter,
                    predicted_seconds: Some(predicted),
                },
                Err(error) => failed(error),
            },
        }
    }

    /// The adapter that would be opened. The preferred one need not be opened to be looked at.
    fn candidate(&mut self, name: Option<&str>) -> Result<Adapter, GpuError> {
        if name.is_some() {
            return Ok(self.opened(name)?.adapter().clone());
        }
        let listed = self.adapters.get_or_insert_with(adapters);
        listed.first().cloned().ok_or(GpuError::NoAdapter)
    }

    fn handed_over<T: ConvReal>(
        &mut self,
        plan: &mut Plan<T>,
        name: Option<&str>,
        memory: Option<u64>,
    ) -> Result<String, GpuError> {
        // Before a GPU is opened for nothing.
        if size_of::<T>() != size_of::<f32>() {
            return Err(GpuError::Precision { precision: T::NAME });
        }
        let options = GpuOptions::default();
        let options = memory.map_or(options, |bytes| options.with_memory(bytes));
        let gpu = self.opened(name)?;
        plan.use_gpu(gpu, options)?;
        Ok(gpu.adapter().to_string())
    }

    fn opened(&mut self, name: Option<&str>) -> Result<&GpuDevice, GpuError> {
        let at = self.open.iter().position(|(asked, _)| asked.as_deref() == name);
        let at = if let Some(at) = at {
            at
        } else {
            let gpu = GpuDevice::new(name)?;
            self.open.push((name.map(str::to_owned), gpu));
            self.open.len() - 1
        };
        Ok(&self.open[at].1)
    }
}

fn of_plan(error: GpuError) -> PsfieldError {
    ConvError::Gpu(error).into()
}

/// What a GPU would gain over the processor, or why it would not.
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
