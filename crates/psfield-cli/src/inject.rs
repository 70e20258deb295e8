//! `psfield inject`.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context as _;
use psf_io::{CatalogOptions, SkyCoordinates};
use psf_types::NoProgress;
use psfield::inject::{InjectOptions, InjectedLight, RealFrame};
use psfield::{FitOptions, Psf, SimulateOptions};
use serde::Serialize;

use crate::UsageError;
use crate::catalog_args::CatalogArgs;
use crate::context::{Context, with_option};
use crate::files::{FileUses, OutputFile};
use crate::json_lines::LineWriter;
use crate::psf_args::PsfArgs;
use crate::sample::warn_of;
use crate::star_args::{MaskArgs, StarArgs};
use crate::values::tolerance;

/// Inject stars and galaxies into a real frame
///
/// The sources of a catalogue get the PSF of the frame, found from its stars (or that of --psf). The photon noise of
/// their light alone is added: the frame has its own noise already. All pixels without injected light, all header
/// cards, the storage type and other extensions stay as they are. A line of HISTORY is added, checksums are
/// renewed, and an image that is compressed in tiles becomes an uncompressed one.
///
/// Fluxes are in the unit of the frame, and positive. With --runs, the frame is written several times, each with another noise:
/// {seed} in the names of the files is replaced by the seed.
#[derive(Debug, clap::Args)]
pub(crate) struct InjectArgs {
    /// Frame: FITS image
    #[arg(value_name = "FRAME.fits")]
    image: PathBuf,
    /// Stars and galaxies, as for psfield simulate. With --runs, {seed} in the name is replaced by the seed
    #[arg(long, value_name = "CATALOG")]
    catalog: PathBuf,
    /// Frame with the injected sources
    #[arg(short, long, value_name = "IMAGE.fits")]
    output: OutputFile,
    /// Replace outputs that exist
    #[arg(long)]
    overwrite: bool,
    /// PSF: a model, samples (which are fitted), or any PSF file that convert reads [default: that of the
    /// frame's stars]
    #[arg(long, value_name = "PSF")]
    psf: Option<PathBuf>,
    /// Seed of the photon noise
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Number of injections, with the seeds from --seed on
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    runs: u32,
    /// Also write a FITS table of the injected sources as they are in the frame
    ///
    /// Its columns are those of psfield simulate --truth-table. saturated_pixels needs a saturation level.
    #[arg(long, value_name = "TABLE.fits")]
    truth_table: Option<OutputFile>,
    /// Largest relative L2 error of the PSF of any source [default: {tolerance}]
    #[arg(long, value_name = "T", value_parser = tolerance)]
    tolerance: Option<f64>,
    #[command(flatten)]
    columns: CatalogArgs,
    #[command(flatten)]
    stars: StarArgs,
    #[command(flatten)]
    mask: MaskArgs,
    #[command(flatten)]
    fit: PsfArgs,
}

/// The place of the seed in the names of files.
const SEED: &str = "{seed}";

/// The line of a run.
#[derive(Debug, Serialize)]
struct RunReport {
    output: PathBuf,
    sources: usize,
    in_frame: usize,
    invalid_rows: usize,
    #[serde(flatten)]
    injected: psfield::inject::InjectReport,
    seconds: f64,
}

impl InjectArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        self.check()?;
        let frame = RealFrame::open(&self.image, self.stars.extension.clone())?;
        // Without a gain, all other work is useless.
        frame
            .gain(self.stars.gain)
            .map_err(|error| UsageError(with_option(&error, error.setting())))?;
        let psf = self.psf(context)?;
        let mut lines = (self.runs > 1)
            .then(|| LineWriter::new(None, context))
            .transpose()?;
        let mut light: Option<Light> = None;
        for seed in self.seeds() {
            let clock = Instant::now();
            let catalog = named(&self.catalog, seed);
            let light = match &mut light {
                Some(light) if light.catalog == catalog => light,
                other => other.insert(self.light(&frame, &psf, catalog, context)?),
            };
            let options = InjectOptions {
                gain: self.stars.gain,
                saturation: self.stars.saturation,
                seed,
                truth_table: self.truth_table.as_ref().map(|path| named(path, seed)),
                overwrite: self.overwrite,
            };
            let output = named(&self.output, seed);
            let report = RunReport {
                injected: frame.inject(&light.injected, &output, &options)?,
                output,
                sources: light.injected.table().count(),
                in_frame: light.injected.table().count_in_frame(),
                invalid_rows: light.invalid_rows,
                seconds: clock.elapsed().as_secs_f64(),
            };
            match &mut lines {
                Some(lines) => lines.write(&report, false)?,
                None => context.report(&report, || text(&report))?,
            }
        }
        Ok(())
    }

    fn seeds(&self) -> impl Iterator<Item = u64> {
        let first = self.seed;
        (0..u64::from(self.runs)).map(move |run| first.wrapping_add(run))
    }

    /// Checks the files of all runs: no output may be an input or another output, or exist unless --overwrite is given.
    fn check(&self) -> anyhow::Result<()> {
        let outputs = [Some(&self.output), self.truth_table.as_ref()]
            .into_iter()
            .flatten();
        let outputs: Vec<&OutputFile> = outputs.collect();
        if let Some(file) = outputs
            .iter()
            .find(|file| self.runs > 1 && !file.to_string_lossy().contains(SEED))
        {
            let what = format!(
                "{}: --runs writes several files of this name: put {SEED} into it",
                file.display()
            );
            return Err(UsageError(what).into());
        }
        let mut uses = FileUses::default();
        uses.read(&self.image, "the frame");
        for seed in self.seeds() {
            uses.read(&named(&self.catalog, seed), "a catalogue");
        }
        for seed in self.seeds() {
            for output in outputs.iter().map(|output| named(output, seed)) {
                uses.write(&output, "another output").map_err(UsageError)?;
                psf_io::check_output(&output, self.overwrite)?;
            }
        }
        Ok(())
    }

    /// The PSF: that of a file, or of the frame's stars.
    fn psf(&self, context: &Context) -> anyhow::Result<Psf> {
        if let Some(path) = &self.psf {
            return self.fit.open(path, context);
        }
        let spinner = context.spinner("finding stars");
        let (pixels, _, sampling) = self.stars.open(&self.image, &self.mask)?;
        let found = sampling.run_masked(pixels);
        let found = found.with_context(|| format!("in {}", self.image.display()))?;
        drop(spinner);
        warn_of(&found, context);
        let options = self.fit.fit.choices().or(FitOptions::default());
        Ok(Psf::new(found.samples, options))
    }

    /// The light of the catalogue.
    fn light(&self, frame: &RealFrame, psf: &Psf, path: PathBuf, context: &Context) -> anyhow::Result<Light> {
        let sky = SkyCoordinates::from_header(frame.header());
        let mut options: CatalogOptions = self.columns.options()?;
        if let Ok(sky) = &sky {
            options = options.with_sky(sky.clone());
        }
        if let Some(unit) = frame.header().pixel_unit() {
            options = options.with_flux_unit(unit);
        }
        let catalog = psf_io::read_catalog_with(&path, &options).map_err(|error| match &sky {
            // An unusable header matters only if the catalogue needs its world coordinates.
            Err(why) if error.setting() == Some("sky") && frame.header().get("CTYPE1").is_some() => {
                anyhow::anyhow!("{}: {why}", self.image.display()).context(error)
            }
            _ => error.into(),
        })?;
        if let Some(warning) = catalog.ignored_warning() {
            context.warn(&format!("{}: {warning}", path.display()));
        }
        if catalog.rows().is_empty() {
            context.warn(&format!("{}: the catalogue has no sources", path.display()));
        }
        let settings = SimulateOptions {
            tolerance: self.tolerance.unwrap_or(SimulateOptions::default().tolerance),
            ..SimulateOptions::default()
        };
        let spinner = context.spinner("drawing");
        let injected = frame.light_of(psf, &catalog, settings, &NoProgress);
        let injected = injected.with_context(|| path.display().to_string())?;
        drop(spinner);
        for warning in injected.warnings() {
            context.warn(&with_option(warning, warning.setting()));
        }
        Ok(Light {
            invalid_rows: catalog.invalid_rows(),
            injected,
            catalog: path,
        })
    }
}

/// The light of a catalogue's sources.
struct Light {
    catalog: PathBuf,
    injected: InjectedLight,
    invalid_rows: usize,
}

/// The name of a file in the run of a seed.
fn named(path: &Path, seed: u64) -> PathBuf {
    path.to_string_lossy().replace(SEED, &seed.to_string()).into()
}

fn text(report: &RunReport) -> String {
    let injected = &report.injected;
    let saturation = match injected.saturation {
        Some(level) => format!("{} saturated at {level}", injected.saturated_pixels),
        None => "saturation unknown (--saturation)".to_owned(),
    };
    format!(
        "{}: {} sources, {} of them on the frame, {:.6e} electrons (gain {}), seed {}\n\
         pixels: {} with injected light, {saturation}\n\
         seconds: {:.3}",
        report.output.display(),
        report.sources,
        report.in_frame,
        injected.electrons,
        injected.gain,
        injected.seed,
        injected.pixels,
        report.seconds
    )
}
