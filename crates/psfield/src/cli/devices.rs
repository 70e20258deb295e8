//! `psfield devices`.

use std::fmt::Write;

use serde::Serialize;

use super::context::Context;

/// List the GPUs that images can be convolved on
///
/// The first one is that of --device gpu; --gpu-adapter takes another, by a part of its name or its backend. Where there is none, that is said, and
/// the exit status is 0.
#[derive(Debug, clap::Args)]
pub(crate) struct DevicesArgs {}

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct Report {
    /// Whether this build can use GPUs at all.
    gpu_support: bool,
    adapters: Vec<AdapterRow>,
    /// What `--device auto` does here.
    auto: &'static str,
}

/// An adapter and its limits.
#[derive(Debug, Serialize)]
#[cfg_attr(not(feature = "gpu"), allow(dead_code, reason = "there are none without"))]
struct AdapterRow {
    name: String,
    kind: String,
    backend: String,
    driver: String,
    /// Whether shaders run on the processor.
    software: bool,
    largest_buffer_bytes: u64,
    largest_binding_bytes: u64,
    workgroup_memory_bytes: u32,
    workgroup_threads: u32,
    timestamps: bool,
    /// Whether `--device gpu` takes it unless told otherwise.
    preferred: bool,
}

impl DevicesArgs {
    #[allow(clippy::unused_self, reason = "commands have arguments")]
    pub(crate) fn run(&self, context: &Context) -> anyhow::Result<()> {
        let adapters = adapters();
        let report = Report {
            gpu_support: cfg!(feature = "gpu"),
            auto: auto(&adapters),
            adapters,
        };
        context.report(&report, || report.text())
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
        Some(first) if first.software => "takes the CPU: software is no GPU",
        Some(_) => "takes the first where a plan is predicted to be faster there than on the CPU",
    }
}

impl Report {
    fn text(&self) -> String {
        if !self.gpu_support {
            return "This psfield was built without support of GPUs: everything runs on the CPU. Its feature gpu adds them (cargo build --release -p psfield \
                    --features gpu)."
                .to_owned();
        }
        if self.adapters.is_empty() {
            return "There is no GPU that Vulkan, Metal, DirectX 12 or OpenGL could drive here: everything runs on the CPU.".to_owned();
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
            "buffer: the largest; binding: what a shader sees at once; shared: memory of a workgroup, of so many threads; clock: whether kernels can be timed\n\
             --device gpu takes the first (*), --device auto {}",
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

/// Bytes in the largest unit that leaves a whole number of two digits or more.
fn size(bytes: u64) -> String {
    const UNITS: [&str; 5] = ["B", "KiB", "MiB", "GiB", "TiB"];
    let mut unit = 0;
    while unit + 1 < UNITS.len() && bytes >> (10 * (unit + 1)) >= 10 {
        unit += 1;
    }
    format!("{} {}", bytes >> (10 * unit), UNITS[unit])
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
