//! `psfield bench --model`.

use psf_sample::{Refinement, UniformSampling, hold_out};
use psf_types::{PsfSource as _, SamplePositions};
use psfield_lab::bench::{ModelRow, ModelSampling, measure_model};
use psfield_lab::plot::{Axis, Chart, Curve, Figure, Marker};

use crate::bench::BenchArgs;
use crate::bench::report::{Column, table};
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
        let report = object! {
            version: env!("CARGO_PKG_VERSION"),
            options: object! {
                preset: self.preset_name(),
                held_out: HELD_OUT,
                seed: self.seed,
                threads: rayon::current_num_threads(),
            },
            rows: rows.clone(),
        };
        self.publish(&report, Some(&|| plot(&rows)), || table(&COLUMNS, &rows), context)
    }
}

/// The columns. The last one has the interpolation.
const COLUMNS: [Column<ModelRow>; 10] = [
    ("sampling", 9, |row| row.sampling.clone()),
    ("setting", 8, |row| row.setting.to_string()),
    ("draws", 7, |row| row.draws.to_string()),
    ("samples", 8, |row| row.samples.to_string()),
    ("sample s", 9, |row| format!("{:.2}", row.seconds_sample)),
    ("fit s", 8, |row| format!("{:.2}", row.seconds_fit)),
    ("median", 9, |row| format!("{:.1e}", row.median_error)),
    ("99 %", 9, |row| format!("{:.1e}", row.error_99)),
    ("largest", 9, |row| format!("{:.1e}", row.max_error)),
    ("", 0, |row| row.interpolation.clone()),
];

/// A curve in the plot: the name of a sampling, its marker and its colour.
const CURVES: [(&str, Marker, usize); 3] = [
    ("kriging", Marker::Circle, 0),
    ("mesh", Marker::Triangle, 1),
    ("grid", Marker::Square, 2),
];

/// Errors against PSFs drawn, and against seconds.
fn plot(rows: &[ModelRow]) -> Figure {
    let chart = |title, name, x: fn(&ModelRow) -> f64| {
        let curves = CURVES.iter().map(|&(sampling, marker, colour)| {
            let of_sampling = rows.iter().filter(|row| row.sampling == sampling);
            Curve {
                marker: Some(marker),
                colour: Some(colour),
                ..Curve::new(sampling, of_sampling.map(|row| (x(row), row.error_99)).collect())
            }
        });
        let y = Axis::logarithmic("error of the PSF (relative L2), 99 %");
        Chart::new(title, Axis::logarithmic(name), y, curves.collect())
    };
    let charts = [
        chart("by PSFs drawn", "PSFs drawn", |row| row.draws as f64),
        chart("by run time", "seconds (sampling and fit)", |row| {
            row.seconds_sample + row.seconds_fit
        }),
    ];
    Figure::new(&charts, 550.0)
}
