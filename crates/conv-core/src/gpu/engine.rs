//! Plans on a GPU.

use super::device::GpuDevice;
use super::error::GpuError;
use super::options::GpuOptions;
use super::times::GpuTimes;
use crate::{ConvReal, Plan};

/// What a plan keeps on a GPU.
#[derive(Debug)]
pub(crate) struct GpuEngine {
    device: GpuDevice,
    times: Option<GpuTimes>,
}

impl GpuEngine {
    pub(crate) fn new<T: ConvReal>(
        _plan: &Plan<T>,
        device: &GpuDevice,
        _options: GpuOptions,
    ) -> Result<Self, GpuError> {
        if size_of::<T>() != size_of::<f32>() {
            return Err(GpuError::Precision { precision: T::NAME });
        }
        Ok(Self {
            device: device.clone(),
            times: None,
        })
    }

    pub(crate) fn device(&self) -> &GpuDevice {
        &self.device
    }

    pub(crate) fn times(&self) -> Option<GpuTimes> {
        self.times
    }
}
