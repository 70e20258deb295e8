//! `psfield devices`, and the options that choose a device.

use std::fmt::Write;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use conv_core::InstructionSet;
use psfield::{Device, SimulateOptions};
use serde::Serialize;

use crate::context::Context;
use crate::values::bytes;
#[cfg(feature = "gpu")]
use crate::values::text_of_bytes;

/// List the devices that can convolve images: GPUs, and software devices that emulate a GPU
///
/// simulate --device gpu takes the first device of the list. --gpu-adapter chooses another, by a
/// part of its name or by its backend (the interface to it, such as vulkan). If there is no device,
/// psfield devices says so and its exit status is 0.
///
/// The environment variable PSFIELD_SIMD (scalar, avx2, avx512 or neon) chooses the vector instructions
/// with which the CPU convolves images and draws stars. The default is the widest that it has.
#[derive(Debug, clap::Args)]
pub(crate) struct DevicesArgs {}

/// The object that `--json` prints.
#[derive(Debug, Serialize)]
struct Report {
    /// The vector instructions of the processor that computations use.
    instruction_set: String,
    /// True if this build supports GPUs.
    gpu_support: bool,
    adapters: Vec<AdapterRow>,
    /// The choice of `--device auto` on this machine.
    auto: &'static str,
}

/// An adapter (a GPU or a software device) and its limits.
#[derive(Debug, Serialize)]
#[cfg_attr(not(feature = "gpu"), allow(dead_code, reason = "unused without gpu"))]
struct AdapterRow {
    name: String,
    kind: String,
    backend: String,
    driver: String,
    /// True if the adapter runs shaders on the CPU.
    software: bool,
    largest_buffer_bytes: u64,
    largest_binding_bytes: u64,
    workgroup_memory_bytes: u32,
    workgroup_threads: u32,
    timestamps: bool,
    /// True if `--device gpu` takes this adapter by default.
    preferred: bool,
}

impl DevicesArgs {
    #[allow(clippy::unused_self, reason = "commands have arguments")]
    pub(crate) fn run(&self, context: &Context) -> anyhow::Result<()> {
        let adapters = adapters();
        let report = Report {
            instruction_set: InstructionSet::used().to_string(),
            gpu_support: cfg!(feature = "gpu"),
            auto: auto(&adapters),
            adapters,
        };
        let processor = || format!("The CPU computes with {}.", report.instruction_set);
        context.report(&report, || format!("{}\n{}", processor(), report.text()))
    }
}

#[cfg(feature = "gpu")]
fn adapters() -> Vec<AdapterRow> {
    use psfield::conv_core::gpu::{AdapterKind, adapters};
    let row = |(place, adapter): (usize, psfield::conv_core::gpu::Adapter)| AdapterRow {
        kind: adapter.kind.to_string(),
        software: adapter.kind == AdapterKind::Software,
        name: adapter.name,
        backend: adapter.backend,
        driver: adapter.driver,
        largest_buffer_bytes: adapter.largest_buffer,
        largest_binding_bytes: adapter.largest_binding,
        workgroup_memory_bytes: adapter.workgroup_memory,
        workgroup_threads: adapter.workgroup_threads,
        timestamps: adapter.timestamps,
        preferred: place == 0,
    };
    adapters().into_iter().enumerate().map(row).collect()
}

#[cfg(not(feature = "gpu"))]
fn adapters() -> Vec<AdapterRow> {
    Vec::new()
}

fn auto(adapters: &[AdapterRow]) -> &'static str {
    match adapters.first() {
        None => "takes the CPU",
        Some(first) if first.software => "takes the CPU, because there are only software devices",
        Some(_) => "takes the first if it is predicted to be faster than the CPU",
    }
}

impl Report {
    fn text(&self) -> String {
        if !self.gpu_support {
            return "This psfield was built without GPU support: everything runs on the CPU. To use GPUs, build with the feature gpu (cargo build \
                    --release -p psfield-cli --features gpu)."
                .to_owned();
        }
        if self.adapters.is_empty() {
            return "No GPU was found through Vulkan, Metal, DirectX 12 or OpenGL: everything runs on the CPU.".to_owned();
        }
        let header = [
            "", "name", "kind", "backend", "driver", "buffer", "binding", "shared", "threads", "clock",
        ];
        let mut table = vec![header.map(str::to_owned)];
        table.extend(self.adapters.iter().map(AdapterRow::cells));
        let widths: [usize; 10] = std::array::from_fn(|column| {
            let widths = table.iter().map(|row| row[column].chars().count());
            widths.max().unwrap_or(0)
        });
        let mut text = String::new();
        for row in &table {
            let cells: Vec<String> = row
                .iter()
                .zip(widths)
                .map(|(cell, width)| format!("{cell:width$}"))
                .collect();
            // Writing to a string does not fail.
            let _ = writeln!(text, "{}", cells.join("  ").trim_end());
        }
        let _ = writeln!(
            text,
            "buffer: largest buffer, binding: largest part of it that a shader can use, shared: memory of a workgroup, threads: most \
             threads of a workgroup, clock: yes if shaders can be timed\n\
             simulate --device gpu takes the first (*), --device auto {}",
            self.auto
        );
        text
    }
}

impl AdapterRow {
    fn cells(&self) -> [String; 10] {
        [
            if self.preferred { "*" } else { "" }.to_owned(),
            self.name.clone(),
            self.kind.clone(),
            self.backend.clone(),
            self.driver.clone(),
            size(self.largest_buffer_bytes),
            size(self.largest_binding_bytes),
            size(u64::from(self.workgroup_memory_bytes)),
            self.workgroup_threads.to_string(),
            if self.timestamps { "yes" } else { "no" }.to_owned(),
        ]
    }
}

/// Formats bytes, rounded down, in the largest unit that leaves at least two digits.
fn size(bytes: u64) -> String {
    const UNITS: [&str; 5] = ["B", "KiB", "MiB", "GiB", "TiB"];
    let mut unit = 0;
    while unit + 1 < UNITS.len() && bytes >> (10 * (unit + 1)) >= 10 {
        unit += 1;
    }
    format!("{} {}", bytes >> (10 * unit), UNITS[unit])
}

/// The device on which images are convolved.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Device")]
pub(crate) struct DeviceArgs {
    /// Device that convolves images
    ///
    /// auto: a GPU if it is predicted to be faster, else the CPU. gpu: the first device that
    /// psfield devices lists, which may be a software device. If there is no device, gpu is an
    /// error.
    ///
    /// Only --method auto and lowrank use a GPU. A GPU computes only in f32, and its results differ
    /// from those of the CPU by rounding. With --precision f64, --device auto uses the CPU. The CPU
    /// always draws the stars.
    #[arg(long, default_value_t, value_parser = device_parser(["auto", "cpu", "gpu"]))]
    device: Device,
    /// GPU to use: a part of its name, or its backend [default: the first that psfield devices
    /// lists]
    #[arg(long, value_name = "NAME", hide_short_help = true)]
    gpu_adapter: Option<String>,
    #[arg(long, value_name = "SIZE", value_parser = bytes, help = gpu_memory_help(), hide_short_help = true)]
    gpu_memory: Option<usize>,
}

pub(crate) fn device_parser<const N: usize>(
    names: [&'static str; N],
) -> impl TypedValueParser<Value = Device> {
    PossibleValuesParser::new(names).try_map(|name| name.parse::<Device>())
}

const GPU_MEMORY: &str = "Upper limit of the GPU memory for prepared PSF data (bytes, or with K, M or G)";

#[cfg(feature = "gpu")]
fn gpu_memory_help() -> String {
    let default = psfield::conv_core::gpu::GpuOptions::DEFAULT_MEMORY_BYTES as usize;
    format!("{GPU_MEMORY} [default: {}]", text_of_bytes(default))
}

#[cfg(not(feature = "gpu"))]
fn gpu_memory_help() -> &'static str {
    GPU_MEMORY
}

impl DeviceArgs {
    /// Returns `options` with this device.
    pub(crate) fn applied_to(&self, options: SimulateOptions) -> SimulateOptions {
        SimulateOptions {
            device: self.device,
            gpu_adapter: self.gpu_adapter.clone(),
            gpu_memory: self.gpu_memory.map(|bytes| bytes as u64),
            ..options
        }
    }

    /// Returns an error message if options do not fit together. `planned`: the method has a plan
    /// that a GPU can execute. `single`: the precision is f32.
    pub(crate) fn misused(&self, planned: bool, single: bool) -> Option<&'static str> {
        Some(match self.device {
            Device::Cpu if self.gpu_adapter.is_some() => "--gpu-adapter cannot be used with --device cpu",
            Device::Cpu if self.gpu_memory.is_some() => "--gpu-memory cannot be used with --device cpu",
            Device::Gpu if !planned => "--device gpu applies only to the methods auto and lowrank",
            Device::Gpu if !single => "--device gpu computes in f32: leave --precision f64 out",
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_have_units() {
        for (bytes, text) in [
            (0, "0 B"),
            (48 << 10, "48 KiB"),
            (128 << 20, "128 MiB"),
            (2 << 30, "2048 MiB"),
            (u64::MAX, "16777215 TiB"),
        ] {
            assert_eq!(size(bytes), text);
        }
    }

    #[test]
    fn auto_takes_no_software() {
        let row = |software| AdapterRow {
            name: "it".into(),
            kind: "kind".into(),
            backend: "vulkan".into(),
            driver: "driver".into(),
            software,
            largest_buffer_bytes: 1 << 30,
            largest_binding_bytes: 128 << 20,
            workgroup_memory_bytes: 32 << 10,
            workgroup_threads: 256,
            timestamps: true,
            preferred: true,
        };
        assert!(auto(&[]).starts_with("takes the CPU"));
        assert!(auto(&[row(true)]).starts_with("takes the CPU"));
        assert!(auto(&[row(false), row(true)]).starts_with("takes the first"));
        let report = Report {
            instruction_set: InstructionSet::used().to_string(),
            gpu_support: true,
            auto: auto(&[row(false)]),
            adapters: vec![row(false)],
        };
        let text = report.text();
        assert!(
            text.contains("\n*  it    kind  vulkan   driver  1024 MiB  128 MiB  32 KiB  256"),
            "{text}"
        );
    }
}
