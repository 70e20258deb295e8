//! The fast engine on a GPU: feature `gpu`.
//!
//! [`Engine::on_gpu`](crate::Engine::on_gpu) makes an engine that executes a plan on a
//! [`GpuDevice`]. This engine computes in f32. It uses the plan's tiles and modes, as on the
//! processor, but never convolves a tile by the direct sum.

mod adapter;
mod batch_calls;
mod batch_data;
mod buffers;
mod device;
mod engine;
mod fft_source;
mod layout;
mod lit_batch;
mod panels;
mod passes;
mod plane_source;
mod run;
mod shader;
mod stopwatch;
mod work;

pub use crate::error::GpuError;
pub use adapter::{Adapter, AdapterKind, adapters};
pub use device::GpuDevice;
pub(crate) use engine::GpuEngine;
pub use layout::GpuOptions;
#[doc(hidden)]
pub use passes::ShaderTrial;
pub use stopwatch::GpuTimes;
pub use work::GpuWork;
