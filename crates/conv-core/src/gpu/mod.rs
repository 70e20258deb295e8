//! The fast engine on a GPU: feature `gpu`.
//!
//! [`Plan::use_gpu`](crate::Plan::use_gpu) hands a plan to a [`GpuDevice`]; from then on its executions run there, with the same tiles,
//! modes and treatments as on the processor, in f32.

mod adapter;
mod batch_calls;
mod batch_data;
mod buffers;
mod device;
mod engine;
mod error;
mod fft_source;
mod lit_batch;
mod options;
mod panels;
mod passes;
mod pipelines;
mod plane_source;
mod readback;
mod run;
mod shader;
#[doc(hidden)]
pub mod shaders;
mod staging;
mod stopwatch;
mod times;
mod words;
mod work;
mod work_layout;
mod working;

pub use adapter::{Adapter, AdapterKind, adapters};
pub use device::GpuDevice;
pub(crate) use engine::GpuEngine;
pub use error::GpuError;
pub use options::GpuOptions;
pub use times::GpuTimes;
pub use work::GpuWork;
