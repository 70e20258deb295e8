//! What is asked for.

/// Where plans are to be executed.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Device {
    /// On a GPU where the plan is predicted to be faster there, else on the processor; never by a driver that runs shaders on the
    /// processor.
    Auto {
        /// The only adapter to be considered, by a part of its name or its backend; the preferred one without.
        adapter: Option<String>,
    },
    /// On the processor.
    Cpu,
    /// On a GPU, or not at all.
    Gpu {
        /// The adapter, by a part of its name or its backend; the preferred one without.
        adapter: Option<String>,
    },
}

impl Default for Device {
    fn default() -> Self {
        Self::Auto { adapter: None }
    }
}

/// A device, and what may be used of it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct DeviceOptions {
    device: Device,
    gpu_memory_bytes: Option<u64>,
}

impl DeviceOptions {
    /// For a device.
    pub fn new(device: Device) -> Self {
        Self {
            device,
            gpu_memory_bytes: None,
        }
    }

    /// The same with a limit to what each plan keeps on a GPU, in bytes. What does not fit is made anew by each execution.
    #[must_use]
    pub fn with_gpu_memory(self, bytes: Option<u64>) -> Self {
        Self {
            gpu_memory_bytes: bytes,
            ..self
        }
    }

    /// The device.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Bytes that a plan keeps on a GPU at most; conv-core's default where none are given.
    pub fn gpu_memory_bytes(&self) -> Option<u64> {
        self.gpu_memory_bytes
    }
}
