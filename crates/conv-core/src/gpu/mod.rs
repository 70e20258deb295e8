//! The fast engine on a GPU: feature `gpu`.
//!
//! [`Plan::use_gpu`](crate::Plan::use_gpu) hands a plan to a [`GpuDevice`]; from then on its executions run there, with the same tiles,
//! modes and treatments as on the processor, in f32.

mod adapter;
mod device;
mod engine;
mod error;
mod options;
mod times;

pub use adapter::{Adapter, AdapterKind, adapters};
pub use device::GpuDevice;
pub(crate) use engine::GpuEngine;
pub use error::GpuError;
pub use options::GpuOptions;
pub use times::GpuTimes;
