//! `psfield bench --real`.

use anyhow::Context as _;
use psfield::Psf;
use psfield_lab::bench::{self, REAL_TOLERANCE, RealCase, RealGroup, RealPsf, RealRow};

use crate::UsageError;
use crate::bench::report::{line, mebibytes, or_dash};
use crate::bench::settings::Settings;
use crate::bench::{BenchArgs, JsonTo};
use crate::context::{Context, object, without_option};

impl BenchArgs {
    pub(super) fn run_real(&self, groups: &[RealGroup], context: &Context) -> anyhow::Result<()> {
        let settings = Settings::of(self);
        let options = self.bench_options(&settings);
        let cases: Vec<RealCase> = groups
            .iter()
            .flat_map(|group| group.cases(&settings.sizes, self.quick))
            .collect();
        let colours_alone = cases.iter().all(|case| case.psf == RealPsf::Spectra);
        let of_spectra = match &self.psf {
            Some(path) if colours_alone => Some(bench::of_black_bodies(&Psf::open(path)?.native(None)?)?),
            Some(_) => {
                return Err(UsageError("--psf: among --real, only for --real=colours alone".into()).into());
            }
            None => None,
        };
        let needs_grid = cases.iter().any(|case| case.psf != RealPsf::Spectra);
        let grid = needs_grid.then(|| self.records(&settings, context)?.next().context("one grid")?);
        let grid = grid.transpose()?;
        let bar = context.bar("measuring");
        let rows = bench::run_real_cases(&cases, (grid.as_ref(), of_spectra), &options, &bar)
            .map_err(without_option)?;
        drop(bar);
        let threads = rayon::current_num_threads();
        let report = object! {
            version: env!("CARGO_PKG_VERSION"),
            options: object! {
                groups: groups.to_vec(),
                sizes: settings.sizes.clone(),
                grid: settings.grids[0],
                rank: grid.as_ref().map(|grid| grid.basis().rank()),
                tolerance: REAL_TOLERANCE,
                tolerance_on: settings.tolerance_on,
                repeat: settings.repeat,
                pixels: settings.pixels,
                seed: settings.seed,
                threads: threads,
            },
            rows: rows.clone(),
        };
        if let Some(path) = self.json.as_ref().and_then(JsonTo::file) {
            psf_io::write_text(path, &serde_json::to_string_pretty(&report)?, self.overwrite)?;
        }
        let samples = grid.map_or_else(String::new, |_| {
            format!(", {} PSF samples", settings.grids[0].pow(2))
        });
        let title = format!(
            "auto, f32, tolerance {REAL_TOLERANCE:e} on {}{samples}, threads: {threads}\n",
            settings.tolerance_on
        );
        context.report(&report, || title + &table(&rows))
    }
}

/// The names of the columns. `single s`: seconds of one convolution with one PSF. `ratio`: `min s`
/// of several spectra, divided by that of one spectrum.
const COLUMNS: [&str; 13] = [
    "group", "PSF", "frame", "amount", "model s", "plan s", "first s", "min s", "median s", "single s",
    "ratio", "rel. L2", "memory",
];
const WIDTHS: [usize; 13] = [8, 15, 11, 15, 9, 9, 9, 9, 9, 9, 6, 8, 9];

fn table(rows: &[RealRow]) -> String {
    let seconds = |s: f64| format!("{s:.4}");
    let lines = rows.iter().map(|row| {
        let cells = [
            row.group.to_string(),
            row.psf.clone(),
            format!("{} x {}", row.size[0], row.size[1]),
            format!("{} {}", row.amount, row.unit),
            seconds(row.seconds_model),
            seconds(row.seconds_plan),
            seconds(row.seconds_first),
            seconds(row.seconds),
            seconds(row.seconds_median),
            or_dash(row.seconds_single.map(seconds)),
            or_dash(
                row.seconds_simpler
                    .map(|simpler| format!("{:.2}", row.seconds / simpler)),
            ),
            or_dash(row.relative_l2.map(|e| format!("{e:.1e}"))),
            or_dash(row.peak_memory_bytes.map(mebibytes)),
        ];
        line(&cells, &WIDTHS)
    });
    let header = std::iter::once(line(&COLUMNS, &WIDTHS));
    header.chain(lines).collect::<Vec<_>>().join("\n")
}
