//! The results of a benchmark as JSON, as text and as a plot.

use std::fmt::Write;

use psfield_lab::bench::{BenchOutcome, BenchRow, Skipped};
use psfield_lab::plot::{Axis, Curve, Curves, Figure, Mark, Marker, PlotError, curve_panels};
use serde::Serialize;

/// The object that `--json` writes.
#[derive(Debug, Serialize)]
pub(super) struct Report<O> {
    pub(super) version: &'static str,
    pub(super) options: O,
    pub(super) rows: Vec<BenchRow>,
    pub(super) skipped: Vec<Skipped>,
}

impl<O> Report<O> {
    pub(super) fn add(&mut self, outcome: BenchOutcome) {
        self.rows.extend(outcome.rows);
        self.skipped.extend(outcome.skipped);
    }

    /// Returns the rows of each case (a size and a number of samples), with the single PSF first.
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
            let _ = write!(text, "{}, {}", size_of(&rows[0]), settings_of(&rows[0]));
            if let Some(gpu) = gpu {
                let _ = write!(text, ", lowrank and auto on {gpu}");
            }
            let shown = if gpu.is_some() { COLUMNS.len() } else { ON_CPU };
            let _ = writeln!(text, "\n{}", line(&COLUMNS[..shown], &WIDTHS));
            for row in rows {
                let _ = writeln!(text, "{}", line(&cells(row)[..shown], &WIDTHS));
            }
            for row in rows {
                text.push_str(&least_bytes(row));
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

/// The frame size and the number of PSF samples of a case.
pub(super) fn size_of(row: &BenchRow) -> String {
    format!(
        "{} x {} pixels, {} PSF samples",
        row.size[0], row.size[1], row.samples
    )
}

/// The settings of a case.
fn settings_of(row: &BenchRow) -> String {
    let threads = if row.threads == 1 { "thread" } else { "threads" };
    format!(
        "{}, each {} pixel uses its own PSF, {} {threads}",
        row.precision, row.anchor, row.threads
    )
}

pub(super) fn or_dash(text: Option<String>) -> String {
    text.unwrap_or_else(|| "-".to_owned())
}

pub(super) fn mebibytes(bytes: u64) -> String {
    format!("{:.0} MiB", bytes as f64 / f64::from(1 << 20))
}

/// Returns a line with two lower bounds for this run, which hold for every GPU: the bytes moved over
/// the bus, and the bytes moved through the GPU's memory. Returns an empty string if the run was on
/// the CPU.
fn least_bytes(row: &BenchRow) -> String {
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

/// The names of the columns. The last four are for the fastest run on a GPU: the seconds of three
/// parts that may overlap, and the seconds of the whole run.
const COLUMNS: [&str; 14] = [
    "method", "setting", "plan s", "min s", "median s", "ratio", "rel. L2", "modes", "tile", "memory",
    "kernel s", "copy s", "host s", "total s",
];
const WIDTHS: [usize; 14] = [8, 16, 9, 9, 9, 8, 10, 6, 11, 9, 9, 9, 9, 9];
/// Number of columns if nothing ran on a GPU.
const ON_CPU: usize = 10;

fn cells(row: &BenchRow) -> [String; 14] {
    let times = row.gpu_seconds.as_ref();
    let on_gpu = |seconds: Option<f64>| or_dash(seconds.map(|s| format!("{s:.5}")));
    [
        row.method.to_owned(),
        or_dash(row.setting.clone()),
        or_dash(row.seconds_plan.map(|s| format!("{s:.4}"))),
        format!("{:.4}", row.seconds),
        format!("{:.4}", row.seconds_median),
        format!("{:.2}", row.ratio_to_single),
        or_dash(row.relative_l2.map(|e| format!("{e:.1e}"))),
        or_dash(row.modes.map(|m| format!("{m:.1}"))),
        or_dash(row.tile.map(|[x, y]| format!("{x} x {y}"))),
        or_dash(row.peak_memory_bytes.map(mebibytes)),
        on_gpu(times.and_then(|t| t.kernels)),
        on_gpu(times.and_then(|t| t.transfers)),
        on_gpu(times.map(|t| t.host)),
        on_gpu(times.map(|t| t.total)),
    ]
}

/// A line of a table. The first two columns are left-aligned, numbers are right-aligned.
pub(super) fn line(cells: &[impl AsRef<str>], widths: &[usize]) -> String {
    let cells = cells
        .iter()
        .map(AsRef::as_ref)
        .zip(widths.iter().copied())
        .enumerate();
    let padded = cells.map(|(k, (cell, width))| match k {
        0 | 1 => format!("{cell:width$}"),
        _ => format!("{cell:>width$}"),
    });
    padded.collect::<Vec<_>>().join(" ")
}

/// Smaller errors, including 0, are drawn at this value.
const LEAST_ERROR: f64 = 1e-17;

/// The methods in the order of the legend, each with its marker and the index of its colour.
const METHODS: [(&str, Marker, usize); 6] = [
    (UNIT, Marker::Cross, 3),
    ("lowrank", Marker::Circle, 0),
    ("auto", Marker::Triangle, 5),
    ("patch", Marker::Square, 2),
    ("basis", Marker::Diamond, 1),
    ("direct", Marker::Cross, 4),
];
/// The method whose time is the unit of the ratios.
const UNIT: &str = "single";

/// The meaning of the labels next to points.
const LABELS: &str = "numbers: tolerance (lowrank, auto), patch side in pixels (patch), rank (basis)";

/// Draws a panel for each case. The first row of a case is the single PSF.
pub(super) fn plot(cases: &[&[BenchRow]]) -> Result<Figure, PlotError> {
    let panels: Vec<(String, Curves)> = cases
        .iter()
        .map(|rows| {
            let title = format!("{}\n{}\n{LABELS}", size_of(&rows[0]), settings_of(&rows[0]));
            (title, curves(rows))
        })
        .collect();
    curve_panels(&panels)
}

fn curves(rows: &[BenchRow]) -> Curves {
    let of = |name| rows.iter().filter(move |row| row.method == name);
    // A horizontal line across the plot shows the time of a convolution with a single PSF.
    let marks = of(UNIT)
        .map(|row| Mark::Horizontal(row.seconds, UNIT.to_owned()))
        .collect();
    let curves = METHODS
        .iter()
        .filter(|(name, ..)| of(name).any(|row| row.relative_l2.is_some()))
        .map(|&(name, marker, colour)| {
            let points: Vec<(f64, f64, Option<&str>)> = of(name)
                .filter_map(|row| Some((error(row)?, row.seconds, row.setting.as_deref())))
                .collect();
            // If `lowrank` is shown, `auto` has no labels: its points have the same settings and
            // lie nearby.
            let named = name != "auto" || of("lowrank").next().is_none();
            Curve {
                marker: Some(marker),
                colour: Some(colour),
                labels: if named { labels(&points) } else { Vec::new() },
                ..Curve::new(name, points.iter().map(|p| (p.0, p.1)).collect())
            }
        })
        .collect();
    Curves {
        x: Axis::logarithmic("measured relative L2 error"),
        y: Axis::logarithmic("run time (s), fastest run"),
        curves,
        marks,
    }
}

/// Labels with the values of the settings. Points that lie close together share a label.
fn labels(points: &[(f64, f64, Option<&str>)]) -> Vec<((f64, f64), String)> {
    points
        .chunk_by(|a, b| close(a.0, b.0) && close(a.1, b.1))
        .map(|same| {
            let values = same.iter().filter_map(|p| p.2?.rsplit('=').next());
            ((same[0].0, same[0].1), values.collect::<Vec<_>>().join(", "))
        })
        .collect()
}

/// Returns whether two values lie so close on a logarithmic axis that their labels would overlap.
fn close(a: f64, b: f64) -> bool {
    (a / b).ln().abs() < 0.3
}

/// The error at which a row is drawn, if it has an error.
fn error(row: &BenchRow) -> Option<f64> {
    row.relative_l2.map(|e| e.max(LEAST_ERROR))
}
