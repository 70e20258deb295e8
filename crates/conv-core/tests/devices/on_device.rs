//! The device that a plan runs on.

use conv_core::{Engine, Plan};

/// The processor, or a GPU.
#[derive(Clone)]
pub(crate) struct OnDevice {
    #[cfg(feature = "gpu")]
    gpu: Option<conv_core::gpu::GpuDevice>,
}

impl OnDevice {
    pub(crate) fn processor() -> Self {
        Self {
            #[cfg(feature = "gpu")]
            gpu: None,
        }
    }

    /// The GPU, or the reason why there is none.
    #[cfg(feature = "gpu")]
    pub(crate) fn gpu() -> Result<Self, String> {
        let gpu = conv_core::gpu::GpuDevice::new(None).map_err(|error| error.to_string())?;
        eprintln!("tests on the GPU run on {}", gpu.adapter());
        Ok(Self { gpu: Some(gpu) })
    }

    #[cfg(not(feature = "gpu"))]
    pub(crate) fn gpu() -> Result<Self, String> {
        Err("conv-core was built without its feature `gpu`".to_owned())
    }

    /// An engine that executes a plan on this device.
    #[cfg(feature = "gpu")]
    pub(crate) fn with(&self, plan: Plan<f32>) -> Engine<f32> {
        match &self.gpu {
            Some(gpu) => Engine::on_gpu(plan, gpu, conv_core::gpu::GpuOptions::default())
                .map_err(|(_, error)| error)
                .unwrap(),
            None => Engine::new(plan),
        }
    }

    #[cfg(not(feature = "gpu"))]
    #[allow(clippy::unused_self, reason = "there is only one device")]
    pub(crate) fn with(&self, plan: Plan<f32>) -> Engine<f32> {
        Engine::new(plan)
    }

    #[cfg(feature = "gpu")]
    pub(crate) fn handle(&self) -> &conv_core::gpu::GpuDevice {
        self.gpu.as_ref().expect("only called by tests on the GPU")
    }
}
