//! The figures as JSON and as text.

use std::fmt::Write;
use std::path::PathBuf;

use psf_types::Anchor;
use psfield::bench::{BenchOutcome, BenchRow, Skipped};
use serde::Serialize;

use super::device_args::BenchDeviceArgs;
use super::settings::Settings;

/// What `--json` writes.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    pub(super) version: &'static str,
    pub(super) options: Options,
    pub(super) rows: Vec<BenchRow>,
    pub(super) skipped: Vec<Skipped>,
}

/// The options in force; those that a file takes the place of are left out.
#[derive(Debug, Serialize)]
pub(super) struct Options {
    #[serde(flatten)]
    pub(super) settings: Settings,
    pub(super) rank: Option<usize>,
    pub(super) preset: Option<String>,
    pub(super) psf: Option<PathBuf>,
    pub(super) stretch: bool,
    pub(super) scene: Option<PathBuf>,
    pub(super) anchor: Anchor,
    pub(super) precision: &'static str,
    #[serde(flatten)]
    pub(super) device: BenchDeviceArgs,
    pub(super) threads: usize,
}

impl Report {
    pub(super) fn add(&mut self, outcome: BenchOutcome) {
        self.rows.extend(outcome.rows);
        self.skipped.extend(outcome.skipped);
    }

    /// The rows of each size and number of samples, the single PSF first.
    pub(super) fn cases(&self) -> Vec<&[BenchRow]> {
        self.rows.chunk_by(|_, next| next.method != "single").collect()
    }

    pub(super) fn text(&self) -> String {
        let mut text = String::new();
        for rows in self.cases() {
            if !text.is_empty() {
                text.push('\n');
            }
            let gpu = rows.iter().find_map(|row| row.gpu.as_deref());
            // Writing to a string does not fail.
            let _ = writeln!(text, "{}", heading(&rows[0], gpu));
            let _ = write!(
                text,
                "{:8} {:16} {:>9} {:>9} {:>9} {:>8} {:>10} {:>6} {:>11} {:>9}",
                "method",
                "setting",
                "plan s",
                "min s",
                "median s",
                "ratio",
                "rel. L2",
                "modes",
                "tile",
                "memory"
            );
            if gpu.is_some() {
                let _ = write!(
                    text,
                    " {:>9} {:>9} {:>9} {:>9}",
                    "kernel s", "copy s", "host s", "total s"
                );
            }
            text.push('\n');
            for row in rows {
                let _ = write!(text, "{}", line(row));
                if gpu.is_some() {
                    text.push_str(&parts(row));
                }
                text.push('\n');
            }
            for row in rows {
                text.push_str(&floor(row));
            }
            for skipped in self
                .skipped
                .iter()
                .filter(|s| s.size == rows[0].size && s.samples == rows[0].samples)
            {
                let setting = skipped.setting.as_deref().unwrap_or("-");
                let _ = writeln!(
                    text,
                    "{:8} {setting:16} skipped: {}",
                    skipped.method, skipped.reason
                );
            }
        }
        text
    }
}

/// What the rows of a case share.
fn heading(row: &BenchRow, gpu: Option<&str>) -> String {
    let shared = format!("{}, {}", size_of(row), settings_of(row));
    match gpu {
        Some(gpu) => format!("{shared}; lowrank and auto on {gpu}"),
        None => shared,
    }
}

/// How large a case is.
pub(super) fn size_of(row: &BenchRow) -> String {
    format!(
        "{} x {} pixels, {} PSF samples",
        row.size[0], row.size[1], row.samples
    )
}

/// How a case was run.
pub(super) fn settings_of(row: &BenchRow) -> String {
    let threads = if row.threads == 1 { "thread" } else { "threads" };
    format!(
        "{}, {}-anchored, {} {threads}",
        row.precision, row.anchor, row.threads
    )
}

fn or_dash(text: Option<String>) -> String {
    text.unwrap_or_else(|| "-".to_owned())
}

/// Where the time of the fastest run went on the GPU.
fn parts(row: &BenchRow) -> String {
    let times = row.gpu_seconds.as_ref();
    let cell = |seconds: Option<f64>| or_dash(seconds.map(|s| format!("{s:.5}")));
    format!(
        " {:>9} {:>9} {:>9} {:>9}",
        cell(times.and_then(|t| t.kernels)),
        cell(times.and_then(|t| t.transfers)),
        cell(times.map(|t| t.host)),
        cell(times.map(|t| t.total)),
    )
}

/// What has to be moved whatever the hardware, where a GPU did the work.
fn floor(row: &BenchRow) -> String {
    let Some([bus, memory]) = row.gpu_seconds.as_ref().map(|times| times.least_bytes) else {
        return String::new();
    };
    let gigabytes = |bytes: u64| bytes as f64 / 1e9;
    format!(
        "{:8} {:16} moves at least {:.4} GB over the bus and {:.4} GB through the GPU's memory\n",
        row.method,
        or_dash(row.setting.clone()),
        gigabytes(bus),
        gigabytes(memory)
    )
}

fn line(row: &BenchRow) -> String {
    format!(
        "{:8} {:16} {:>9} {:>9.4} {:>9.4} {:>8.2} {:>10} {:>6} {:>11} {:>9}",
        row.method,
        row.setting.as_deref().unwrap_or("-"),
        or_dash(row.seconds_plan.map(|s| format!("{s:.4}"))),
        row.seconds,
        row.seconds_median,
        row.ratio_to_single,
        or_dash(row.relative_l2.map(|e| format!("{e:.1e}"))),
        or_dash(row.modes.map(|m| format!("{m:.1}"))),
        or_dash(row.tile.map(|[x, y]| format!("{x} x {y}"))),
        or_dash(
            row.peak_memory_bytes
                .map(|b| format!("{:.0} MiB", b as f64 / f64::from(1 << 20)))
        ),
    )
}
