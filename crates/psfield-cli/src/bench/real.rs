//! `psfield bench --real`.

use anyhow::Context as _;
use psfield::Psf;
use psfield_lab::bench::{self, REAL_TOLERANCE, RealCase, RealGroup, RealPsf, RealRow};

use crate::UsageError;
use crate::bench::BenchArgs;
use crate::bench::report::{Column, mebibytes, or_dash, table};
use crate::bench::settings::Settings;
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
        let samples = grid.map_or_else(String::new, |_| {
            format!(", {} PSF samples", settings.grids[0].pow(2))
        });
        let title = format!(
            "auto, f32, tolerance {REAL_TOLERANCE:e} on {}{samples}, threads: {threads}\n",
            settings.tolerance_on
        );
        self.publish(&report, None, || title + &table(&COLUMNS, &rows), context)
    }
}

/// The columns. `single s`: seconds of one convolution with one PSF. `ratio`: `min s`, divided by that of
/// simpler work, or of the better of two ways to do the same.
const COLUMNS: [Column<RealRow>; 13] = [
    ("group", 8, |row| row.group.to_string()),
    ("PSF", 15, |row| row.psf.clone()),
    ("frame", 11, |row| format!("{} x {}", row.size[0], row.size[1])),
    ("amount", 15, |row| format!("{} {}", row.amount, row.unit)),
    ("model s", 9, |row| seconds(row.seconds_model)),
    ("plan s", 9, |row| seconds(row.seconds_plan)),
    ("first s", 9, |row| seconds(row.seconds_first)),
    ("min s", 9, |row| seconds(row.seconds)),
    ("median s", 9, |row| seconds(row.seconds_median)),
    ("single s", 9, |row| or_dash(row.seconds_single.map(seconds))),
    ("ratio", 6, |row| {
        let others = row.seconds_simpler.into_iter().chain(row.seconds_photons);
        let ratio = others.reduce(f64::min).map(|least| row.seconds / least);
        or_dash(ratio.map(|ratio| format!("{ratio:.2}")))
    }),
    ("rel. L2", 8, |row| {
        or_dash(row.relative_l2.map(|e| format!("{e:.1e}")))
    }),
    ("memory", 9, |row| or_dash(row.peak_memory_bytes.map(mebibytes))),
];

fn seconds(seconds: f64) -> String {
    format!("{seconds:.4}")
}
