//! Where the time goes on a GPU.

use conv_core::{ConvReal, Plan};
use serde::Serialize;

/// How long the parts of an execution on a GPU took, in seconds. What the host does overlaps with the rest, so that the sum may be more than the whole.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct GpuSeconds {
    /// Shaders; none where the adapter has no clock that can be read.
    pub kernels: Option<f64>,
    /// Copies to the GPU and from it; none where the adapter has no clock that can be read.
    pub transfers: Option<f64>,
    /// What the processor did meanwhile.
    pub host: f64,
    /// End to end: from the light in the host's memory to the image there.
    pub total: f64,
    /// Bytes copied to the GPU, and from it.
    pub bytes: [u64; 2],
    /// Bytes that the plan has to move where every pixel is lit, over the bus and through the GPU's memory: over the hardware's bandwidths,
    /// the floor under `transfers` and `kernels`.
    pub least_bytes: [u64; 2],
}

impl GpuSeconds {
    /// Those of the last execution of a plan; none where it ran on the processor.
    #[cfg(feature = "gpu")]
    pub fn of_last<T: ConvReal>(plan: &Plan<T>) -> Option<Self> {
        let times = plan.gpu_times()?;
        let work = plan.gpu_work();
        Some(Self {
            kernels: times.kernels.map(|time| time.as_secs_f64()),
            transfers: times.transfers.map(|time| time.as_secs_f64()),
            host: times.host.as_secs_f64(),
            total: times.total.as_secs_f64(),
            bytes: times.bytes.into(),
            least_bytes: [work.bus_bytes, work.memory_bytes],
        })
    }

    /// Those of the last execution of a plan; none where it ran on the processor.
    #[cfg(not(feature = "gpu"))]
    pub fn of_last<T: ConvReal>(_plan: &Plan<T>) -> Option<Self> {
        None
    }
}
