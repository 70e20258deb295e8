//! On the processor or on a GPU: the choice, and who decides it.

mod choice;
mod gpu_seconds;
mod gpus;
mod placement;
#[cfg_attr(not(feature = "gpu"), path = "no_pool.rs")]
mod pool;

pub use choice::{Device, DeviceOptions};
pub use gpu_seconds::GpuSeconds;
pub use gpus::Gpus;
pub use placement::{CpuReason, Placement, PredictedSeconds};
