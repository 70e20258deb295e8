//! The choice of a device.

use psfield::{Device, DeviceOptions};

use super::values::bytes;

/// Where images are convolved.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Device")]
pub(crate) struct DeviceArgs {
    /// Where auto and lowrank convolve images in f32: auto (on a GPU where that is predicted to be faster), cpu, or gpu (there or not at all).
    /// Results differ by the rounding of f32. Stars are drawn on the CPU
    #[arg(long, default_value = "auto", value_enum)]
    device: DeviceName,
    /// The GPU, by a part of its name or its backend (see psfield devices) [default: the first of psfield devices]
    #[arg(long, value_name = "NAME")]
    gpu_adapter: Option<String>,
    /// Memory of the plan on the GPU: bytes, or with K, M or G [default: 2G]
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    gpu_memory: Option<usize>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum DeviceName {
    Auto,
    Cpu,
    Gpu,
}

impl DeviceArgs {
    pub(crate) fn options(&self) -> DeviceOptions {
        let adapter = self.gpu_adapter.clone();
        let device = match self.device {
            DeviceName::Auto => Device::Auto { adapter },
            DeviceName::Cpu => Device::Cpu,
            DeviceName::Gpu => Device::Gpu { adapter },
        };
        DeviceOptions::new(device).with_gpu_memory(self.gpu_memory.map(|bytes| bytes as u64))
    }

    /// Whether it must be a GPU.
    pub(crate) fn is_gpu(&self) -> bool {
        self.device == DeviceName::Gpu
    }

    /// What is wrong with the options given, if anything. `planned`: the method has a plan that a GPU can execute; `single`: in f32.
    pub(crate) fn misused(&self, planned: bool, single: bool) -> Option<&'static str> {
        let is_cpu = self.device == DeviceName::Cpu;
        let what = [
            (
                is_cpu && self.gpu_adapter.is_some(),
                "--gpu-adapter and --device cpu exclude each other",
            ),
            (
                is_cpu && self.gpu_memory.is_some(),
                "--gpu-memory and --device cpu exclude each other",
            ),
            (
                self.is_gpu() && !planned,
                "--device gpu is of the methods auto and lowrank",
            ),
            (
                self.is_gpu() && !single,
                "--device gpu computes in f32, and --precision f64 was asked for",
            ),
        ];
        what.into_iter().find_map(|(wrong, what)| wrong.then_some(what))
    }
}
