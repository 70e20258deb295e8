//! Where the fast engine is measured.

use psfield::{Device, DeviceOptions};
use serde::Serialize;

/// Nothing here is chosen by itself: a figure belongs to a device.
#[derive(Debug, Clone, clap::Args, Serialize)]
#[command(next_help_heading = "Device")]
pub(super) struct BenchDeviceArgs {
    /// Where lowrank and auto run, in f32; the other methods run on the CPU
    #[arg(long, default_value = "cpu", value_enum)]
    device: BenchDevice,
    /// The GPU, by a part of its name or its backend (see psfield devices) [default: the first of psfield devices]
    #[arg(long, value_name = "NAME")]
    gpu_adapter: Option<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum BenchDevice {
    Cpu,
    Gpu,
}

impl BenchDeviceArgs {
    pub(super) fn options(&self) -> DeviceOptions {
        DeviceOptions::new(match self.device {
            BenchDevice::Cpu => Device::Cpu,
            BenchDevice::Gpu => Device::Gpu {
                adapter: self.gpu_adapter.clone(),
            },
        })
    }

    /// What is wrong with the options given, if anything. `single`: in f32.
    pub(super) fn misused(&self, single: bool) -> Option<&'static str> {
        match self.device {
            BenchDevice::Cpu if self.gpu_adapter.is_some() => Some("--gpu-adapter is of --device gpu"),
            BenchDevice::Gpu if !single => {
                Some("--device gpu computes in f32, and --precision f64 was asked for")
            }
            _ => None,
        }
    }
}
