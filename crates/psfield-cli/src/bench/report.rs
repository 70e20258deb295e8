//! The results of a benchmark as JSON, as text and as a plot.

use std::fmt::Write;

use psfield::device::GpuSeconds;
use psfield_lab::bench::{BenchOutcome, BenchRow};
use psfield_lab::plot::{Axis, Chart, Curve, Figure, Mark, Marker};

/// Returns the rows of each case (a size and a number of samples), with the single PSF first.
fn cases(rows: &[BenchRow]) -> impl Iterator<Item = &[BenchRow]> {
    rows.chunk_by(|_, next| next.method != "single")
}

/// The tables of all cases.
pub(super) fn text(outcome: &BenchOutcome) -> String {
    let mut text = String::new();
    for rows in cases(&outcome.rows) {
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
        let _ = writeln!(text, "\n{}", table(&COLUMNS[..shown], rows));
        for row in rows {
            text.push_str(&least_bytes(row));
        }
        for skipped in outcome
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

/// A column of a table: its name, its width, and the cell of a row.
pub(super) type Column<R> = (&'static str, usize, fn(&R) -> String);

/// The columns. The last four are for the fastest run on a GPU: the seconds of three parts that may
/// overlap, and the seconds of the whole run.
const COLUMNS: [Column<BenchRow>; 14] = [
    ("method", 8, |row| row.method.to_owned()),
    ("setting", 16, |row| or_dash(row.setting.clone())),
    ("plan s", 9, |row| {
        or_dash(row.seconds_plan.map(|s| format!("{s:.4}")))
    }),
    ("min s", 9, |row| format!("{:.4}", row.seconds)),
    ("median s", 9, |row| format!("{:.4}", row.seconds_median)),
    ("ratio", 8, |row| format!("{:.2}", row.ratio_to_single)),
    ("rel. L2", 10, |row| {
        or_dash(row.relative_l2.map(|e| format!("{e:.1e}")))
    }),
    ("modes", 6, |row| or_dash(row.modes.map(|m| format!("{m:.1}")))),
    ("tile", 11, |row| {
        or_dash(row.tile.map(|[x, y]| format!("{x} x {y}")))
    }),
    ("memory", 9, |row| or_dash(row.peak_memory_bytes.map(mebibytes))),
    ("kernel s", 9, |row| on_gpu(row, |times| times.kernels)),
    ("copy s", 9, |row| on_gpu(row, |times| times.transfers)),
    ("host s", 9, |row| on_gpu(row, |times| Some(times.host))),
    ("total s", 9, |row| on_gpu(row, |times| Some(times.total))),
];
/// Number of columns if nothing ran on a GPU.
const ON_CPU: usize = 10;

fn on_gpu(row: &BenchRow, seconds: fn(&GpuSeconds) -> Option<f64>) -> String {
    let seconds = row.gpu_seconds.as_ref().and_then(seconds);
    or_dash(seconds.map(|s| format!("{s:.5}")))
}

/// The lines of a table, below a line with the names of its columns. The first two columns are
/// left-aligned, numbers are right-aligned.
pub(super) fn table<R>(columns: &[Column<R>], rows: &[R]) -> String {
    let line = |cell: &dyn Fn(&Column<R>) -> String| {
        let cells = columns.iter().enumerate().map(|(k, column)| match (k, column.1) {
            (0 | 1, width) => format!("{:width$}", cell(column)),
            (_, width) => format!("{:>width$}", cell(column)),
        });
        cells.collect::<Vec<_>>().join(" ").trim_end().to_owned()
    };
    let names = line(&|(name, ..)| (*name).to_owned());
    let lines = rows.iter().map(|row| line(&|(.., cell)| cell(row)));
    std::iter::once(names).chain(lines).collect::<Vec<_>>().join("\n")
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

/// Draws a chart for each case. The first row of a case is the single PSF.
pub(super) fn plot(rows: &[BenchRow]) -> Figure {
    let charts: Vec<Chart> = cases(rows).map(chart).collect();
    // The title has 80 characters.
    Figure::new(&charts, 660.0)
}

fn chart(rows: &[BenchRow]) -> Chart {
    let of = |name| rows.iter().filter(move |row| row.method == name);
    // A horizontal line across the plot shows the time of a convolution with a single PSF.
    let marks = of(UNIT).map(|row| Mark::Horizontal(row.seconds, UNIT.to_owned()));
    let shown = METHODS
        .iter()
        .filter(|(name, ..)| of(name).any(|row| row.relative_l2.is_some()));
    let curves = shown.map(|&(name, marker, colour)| {
        let points: Vec<(f64, f64, Option<&str>)> = of(name)
            .filter_map(|row| Some((error(row)?, row.seconds, row.setting.as_deref())))
            .collect();
        // If `lowrank` is shown, `auto` has no labels: its points have the same settings and lie
        // nearby.
        let named = name != "auto" || of("lowrank").next().is_none();
        Curve {
            marker: Some(marker),
            colour: Some(colour),
            labels: if named { labels(&points) } else { Vec::new() },
            ..Curve::new(name, points.iter().map(|p| (p.0, p.1)).collect())
        }
    });
    let title = format!("{}\n{}\n{LABELS}", size_of(&rows[0]), settings_of(&rows[0]));
    let x = Axis::logarithmic("measured relative L2 error");
    let y = Axis::logarithmic("run time (s), fastest run");
    Chart::new(&title, x, y, curves.collect()).with_marks(marks.collect())
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
