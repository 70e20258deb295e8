//! `psfield bench --model`.

use anyhow::Context as _;
use psf_sample::{Refinement, UniformSampling, hold_out};
use psf_types::{PsfSource as _, SamplePositions};
use psfield_lab::bench::{ModelRow, ModelSampling, measure_model};
use psfield_lab::plot::{Axis, Curve, Curves, Figure, Marker, PlotError, curve_panels};

use crate::bench::report::line;
use crate::bench::{BenchArgs, JsonTo};
use crate::context::{Context, object};

/// The number of PSFs that are not samples.
const HELD_OUT: usize = 300;
/// The number of positions along each side that held-out PSFs keep away from.
const APART: usize = 37;

/// The ways of sampling that are measured.
fn samplings(quick: bool) -> Vec<ModelSampling> {
    let (kriging, mesh, grids): (&[f64], &[f64], &[usize]) = if quick {
        (&[1e-2], &[1e-1], &[5, 9])
    } else {
        (
            &[3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4],
            &[1e-1, 3e-2, 1e-2, 3e-3],
            &[5, 7, 9, 13, 21, 33],
        )
    };
    let refined = |refinement, thresholds: &[f64]| -> Vec<ModelSampling> {
        thresholds
            .iter()
            .map(|&t| ModelSampling::Refined(refinement, t))
            .collect()
    };
    let mut all = refined(Refinement::Kriging, kriging);
    all.extend(refined(Refinement::Mesh, mesh));
    all.extend(grids.iter().map(|&side| ModelSampling::Grid(side)));
    all
}

impl BenchArgs {
    pub(super) fn run_model(&self, context: &Context) -> anyhow::Result<()> {
        let telescope = self.preset.telescope();
        // No PSF that is held out is close to these positions, which are not those of the samples.
        let apart = UniformSampling::new(APART, APART)?.positions(telescope.field())?;
        let apart = SamplePositions::new(apart, Some(telescope.field()))?;
        let bar = context.bar("holding out");
        let held_out = hold_out(&telescope, &apart, (HELD_OUT, self.seed), &bar)?;
        drop(bar);
        let mut rows = Vec::new();
        for sampling in samplings(self.quick) {
            let bar = context.bar("sampling");
            rows.extend(measure_model(&telescope, sampling, &held_out, &bar)?);
        }
        let preset = clap::ValueEnum::to_possible_value(&self.preset);
        let report = object! {
            version: env!("CARGO_PKG_VERSION"),
            options: object! {
                preset: preset.map_or_else(String::new, |value| value.get_name().to_owned()),
                held_out: HELD_OUT,
                seed: self.seed,
                threads: rayon::current_num_threads(),
            },
            rows: rows.clone(),
        };
        if let Some(path) = self.json.as_ref().and_then(JsonTo::file) {
            psf_io::write_text(path, &serde_json::to_string_pretty(&report)?, self.overwrite)?;
        }
        if let Some(path) = &self.plot {
            let drawn = plot(&rows).with_context(|| format!("{}: the plot failed", path.display()))?;
            psf_io::write_text(path, drawn.svg(), self.overwrite)?;
        }
        context.report(&report, || table(&rows))
    }
}

const COLUMNS: [&str; 9] = [
    "sampling", "setting", "draws", "samples", "sample s", "fit s", "median", "99 %", "largest",
];
const WIDTHS: [usize; 9] = [9, 8, 7, 8, 9, 8, 9, 9, 9];

fn table(rows: &[ModelRow]) -> String {
    let error = |e: f64| format!("{e:.1e}");
    let lines = rows.iter().map(|row| {
        let cells = [
            row.sampling.clone(),
            row.setting.to_string(),
            row.draws.to_string(),
            row.samples.to_string(),
            format!("{:.2}", row.seconds_sample),
            format!("{:.2}", row.seconds_fit),
            error(row.median_error),
            error(row.error_99),
            error(row.max_error),
        ];
        format!("{} {}", line(&cells, &WIDTHS), row.interpolation)
    });
    let header = std::iter::once(line(&COLUMNS, &WIDTHS));
    header.chain(lines).collect::<Vec<_>>().join("\n")
}

/// A curve in the plot: the name of a sampling, its marker and its colour.
const CURVES: [(&str, Marker, usize); 3] = [
    ("kriging", Marker::Circle, 0),
    ("mesh", Marker::Triangle, 1),
    ("grid", Marker::Square, 2),
];

/// Errors against PSFs drawn, and against seconds.
fn plot(rows: &[ModelRow]) -> Result<Figure, PlotError> {
    let panel = |name: &str, x: &dyn Fn(&ModelRow) -> f64| {
        let curves = CURVES.iter().map(|&(sampling, marker, colour)| {
            let of_sampling = rows.iter().filter(|row| row.sampling == sampling);
            Curve {
                marker: Some(marker),
                colour: Some(colour),
                ..Curve::new(sampling, of_sampling.map(|row| (x(row), row.error_99)).collect())
            }
        });
        Curves {
            x: Axis::logarithmic(name),
            y: Axis::logarithmic("error of the PSF (relative L2), 99 %"),
            curves: curves.collect(),
            marks: Vec::new(),
        }
    };
    let seconds = |row: &ModelRow| row.seconds_sample + row.seconds_fit;
    curve_panels(&[
        (
            "by PSFs drawn".to_owned(),
            panel("PSFs drawn", &|row| row.draws as f64),
        ),
        (
            "by run time".to_owned(),
            panel("seconds (sampling and fit)", &seconds),
        ),
    ])
}
