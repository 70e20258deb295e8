//! `psfield bench`.

mod report;
mod settings;

use std::num::{NonZeroU16, NonZeroUsize};
use std::ops::RangeInclusive;
use std::path::PathBuf;

use anyhow::Context as _;
use clap::builder::{OsStringValueParser, TypedValueParser};
use conv_core::ConvReal;
use psf_basis::RankSelection;
use psf_sample::{SamplingMethod, UniformSampling};
use psf_types::{Anchor, FrameShape, Image, Interpolation, PsfModelRecord, PsfSource as _};
use psfield::{Device, FitOptions, Psf};
use psfield_lab::bench::{self, BenchCase, BenchOptions};
use serde::Serialize;

use crate::UsageError;
use crate::bench::report::Report;
use crate::bench::settings::{BenchDeviceArgs, Settings};
use crate::context::{Context, object};
use crate::sample::Preset;
use crate::values::{Precision, number, tolerance};

pub(crate) use crate::bench::settings::JsonTo;

/// Measure run time against error, all methods in one run
///
/// Each method is planned once and then runs in turn with all others (A B C, A B C, ...); plan and run are timed apart. Errors are relative
/// L2 differences from the direct sum in double precision at random pixels, the same for all. The PSF is drawn from a preset on grids of
/// samples and stretched to the frame, so that it varies as much over a frame of any size; in the scene every pixel is lit. The unit of
/// the ratios, `single`, is one convolution with the PSF of the frame's middle by the engine's own tiles (a plan of a constant field with
/// a single mode and no coefficients), the fastest convolution with one PSF that psfield has; it always runs.
#[derive(Debug, clap::Args)]
pub(crate) struct BenchArgs {
    /// Pixels along each side of the frame [default: 512,1024,2048]
    #[arg(long, value_name = "N,...", value_delimiter = ',', conflicts_with = "scene", value_parser = side)]
    sizes: Option<Vec<NonZeroUsize>>,
    /// PSF samples along each side of the field [default: 9,33]
    #[arg(long, value_name = "N,...", value_delimiter = ',', conflicts_with = "psf", value_parser = grid_side)]
    grids: Option<Vec<NonZeroUsize>>,
    /// The methods [default: all]
    #[arg(long, value_name = "METHOD,...", value_delimiter = ',', value_enum)]
    methods: Option<Vec<MethodName>>,
    /// Tolerances of lowrank and auto [default: 1e-1,1e-2,1e-3,1e-4,1e-5,1e-6,0]
    #[arg(
        long,
        value_name = "X,...",
        value_delimiter = ',',
        value_parser = tolerance,
        allow_hyphen_values = true
    )]
    tolerances: Option<Vec<f64>>,
    /// Sides of the patches in pixels [default: 32,64,128,256]
    #[arg(long, value_name = "N,...", value_delimiter = ',', value_parser = side)]
    patches: Option<Vec<NonZeroUsize>>,
    /// Components that basis keeps, at most those of the model [default: 10,30,100]
    #[arg(long, value_name = "K,...", value_delimiter = ',')]
    ranks: Option<Vec<NonZeroUsize>>,
    /// Components of the model, at most those of the samples [default: 100; a model of --psf as it is]
    #[arg(long, value_name = "K")]
    rank: Option<NonZeroUsize>,
    /// The telescope that the PSF is drawn from
    #[arg(long, value_enum, default_value = "survey-2m", conflicts_with = "psf")]
    preset: Preset,
    /// The PSF: a model, or samples to be fitted
    #[arg(long, value_name = "MODEL.fits|SAMPLES.fits")]
    psf: Option<PathBuf>,
    /// Stretch the positions of --psf to the frame
    #[arg(long, requires = "psf")]
    stretch: bool,
    /// The scene: a FITS image [default: noise on a smooth background, every pixel lit]
    #[arg(long, value_name = "SCENE.fits")]
    scene: Option<PathBuf>,
    /// Whose PSF applies: source (each source spreads with its own) or output (each pixel gathers with its own)
    #[arg(long, default_value_t, value_name = "source|output")]
    anchor: Anchor,
    /// Working precision
    #[arg(long, default_value = "f32", value_enum)]
    precision: Precision,
    /// Timed turns of each method; what is done in less than 20 ms runs more than once a turn [default: 3]
    #[arg(long, value_name = "N")]
    repeat: Option<NonZeroU16>,
    /// Random pixels at which errors are measured [default: 400]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=MAX_PIXELS))]
    pixels: Option<u32>,
    /// Chooses the scene and those pixels
    #[arg(long, value_name = "N", default_value_t = BenchOptions::DEFAULT_SEED)]
    seed: u64,
    /// Small lists for what is not given: 256 pixels, 5 x 5 samples, two tolerances, one run
    #[arg(long)]
    quick: bool,
    /// Write all figures as JSON to FILE; without FILE to standard output, in place of the table
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = "-", value_parser = OsStringValueParser::new().map(JsonTo::of_argument))]
    json: Option<JsonTo>,
    /// Draw run time against error, as SVG
    #[arg(long, value_name = "FILE.svg", value_parser = svg_path)]
    plot: Option<PathBuf>,
    /// Replace the files of --json and --plot if they exist
    #[arg(long)]
    overwrite: bool,
    // A group comes last: its heading holds for what follows.
    #[command(flatten)]
    device: BenchDeviceArgs,
}

/// The methods by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum MethodName {
    /// One PSF for the whole frame: the unit
    Single,
    /// The fast engine by transforms alone, at each of --tolerances
    Lowrank,
    /// The fast engine, each tile in the cheapest way, at each of --tolerances
    Auto,
    /// One PSF a patch, for each of --patches
    Patch,
    /// One whole-image convolution a component, for each of --ranks
    Basis,
    /// The double sum; only where that takes seconds
    Direct,
}

/// Components of a fitted model.
const RANK: usize = 100;
/// More pixels than that are a slip.
const MAX_PIXELS: i64 = 1_000_000;
/// A larger frame is a slip.
const MAX_SIDE: usize = 1 << 15;
/// More samples along a side are a slip.
const MAX_GRID: usize = 256;

impl BenchArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        if let Some(what) = self.device.misused(self.precision == Precision::F32) {
            return Err(UsageError(what.to_owned()).into());
        }
        match self.precision {
            Precision::F32 => self.run_in::<f32>(context),
            Precision::F64 => self.run_in::<f64>(context),
        }
    }

    fn run_in<T: ConvReal>(self, context: &Context) -> anyhow::Result<()> {
        let json = self.json.as_ref().and_then(JsonTo::file);
        for path in json.into_iter().chain(self.plot.as_deref()) {
            psf_io::check_output(path, self.overwrite)?;
        }
        let mut settings = Settings::of(&self);
        let options = BenchOptions {
            anchor: self.anchor,
            repeat: settings.repeat,
            pixels: settings.pixels,
            seed: settings.seed,
            device: self.device.device,
            gpu_adapter: self.device.gpu_adapter.clone(),
            ..BenchOptions::default()
        };
        if options.device == Device::Gpu {
            // Before samples are drawn in vain.
            psfield::open_gpu(options.gpu_adapter.as_deref())?;
        }
        let mut scene = None;
        if let Some(path) = &self.scene {
            settings.sizes = Vec::new();
            let image = psf_io::read_image::<T>(path)?.into_parts().0;
            anyhow::ensure!(
                image.pixels().iter().any(|v| !v.is_zero()),
                "{}: the scene is dark, there is nothing to measure",
                path.display()
            );
            scene = Some(image);
        }
        if self.psf.is_some() {
            settings.grids = Vec::new();
        }
        let mut report = Report {
            version: env!("CARGO_PKG_VERSION"),
            options: self.options::<T>(&settings),
            rows: Vec::new(),
            skipped: Vec::new(),
        };
        for record in self.records(&settings, context)? {
            let record = record?;
            let contenders = settings.contenders(record.basis().rank());
            let mut bench = |scene: Image<T>| -> anyhow::Result<()> {
                let record = if self.psf.is_none() || self.stretch {
                    bench::stretched(&record, scene.shape())?
                } else {
                    record.clone()
                };
                let bar = context.bar("measuring");
                let case = BenchCase::new(record, scene);
                let outcome = bench::run(&case, &contenders, &options, &bar);
                report.add(outcome.with_context(|| self.origin())?);
                Ok(())
            };
            match &scene {
                Some(scene) => bench(scene.clone())?,
                None => {
                    for &size in &settings.sizes {
                        let shape = FrameShape::new(size, size)?;
                        bench(bench::lit_scene(shape, settings.seed)?)?;
                    }
                }
            }
        }
        if let Some(path) = json {
            let text = serde_json::to_string_pretty(&report)?;
            psf_io::write_text(path, &text, self.overwrite)?;
        }
        if let Some(path) = &self.plot {
            let drawn = report::plot(&report.cases())
                .with_context(|| format!("{}: the plot failed", path.display()))?;
            psf_io::write_text(path, drawn.svg(), self.overwrite)?;
        }
        context.report(&report, || report.text())
    }

    /// Where the PSF comes from, for errors.
    fn origin(&self) -> String {
        match &self.psf {
            Some(path) if self.stretch => format!("with the PSF of {}", path.display()),
            Some(path) => format!(
                "with the PSF of {} (--stretch fits its positions to any frame)",
                path.display()
            ),
            None => "with the PSF of the preset".to_owned(),
        }
    }

    /// A model for each grid, or that of the file, made when it is asked for.
    fn records<'a>(
        &'a self,
        settings: &'a Settings,
        context: &'a Context,
    ) -> anyhow::Result<Box<dyn Iterator<Item = anyhow::Result<PsfModelRecord>> + 'a>> {
        if let Some(path) = &self.psf {
            let spinner = context.spinner("fitting the PSF");
            let psf = Psf::open(path)?.with_fit_options(every_component());
            let record = self
                .fitted(&psf.native(None)?)
                .with_context(|| format!("{}: no model could be made", path.display()))?;
            drop(spinner);
            return Ok(Box::new(std::iter::once(Ok(record))));
        }
        let telescope = self.preset.telescope();
        for &grid in &settings.grids {
            psfield::check_stack(grid * grid, telescope.grid())
                .map_err(|e| UsageError(format!("--grids: {e}")))?;
        }
        Ok(Box::new(settings.grids.iter().map(move |&grid| {
            let bar = context.bar("sampling");
            let samples = UniformSampling::new(grid, grid)?
                .sample(&telescope, &bar)?
                .samples;
            drop(bar);
            let _spinner = context.spinner("fitting the PSF");
            let options = FitOptions {
                interpolation: Interpolation::Bilinear,
                ..every_component()
            };
            self.fitted(&Psf::new(samples, options).native(None)?)
        })))
    }

    fn fitted(&self, psf: &Psf) -> anyhow::Result<PsfModelRecord> {
        let of_samples = psf.samples().map(|_| RANK);
        Ok(match self.rank.map(NonZeroUsize::get).or(of_samples) {
            Some(rank) => psf.record()?.truncated(rank)?,
            None => psf.record()?.clone(),
        })
    }

    /// The options in force; those that a file takes the place of are left out.
    fn options<T: ConvReal>(&self, settings: &Settings) -> impl Serialize {
        object! {
            #[serde(flatten)]
            settings: settings.clone(),
            rank: self
                .rank
                .map(NonZeroUsize::get)
                .or_else(|| self.psf.is_none().then_some(RANK)),
            preset: self.psf.is_none().then(|| {
                let value = clap::ValueEnum::to_possible_value(&self.preset);
                value.map_or_else(String::new, |value| value.get_name().to_owned())
            }),
            psf: self.psf.clone(),
            stretch: self.psf.is_none() || self.stretch,
            scene: self.scene.clone(),
            anchor: self.anchor,
            precision: T::NAME,
            device: self.device.device.to_string(),
            gpu_adapter: self.device.gpu_adapter.clone(),
            threads: rayon::current_num_threads(),
        }
    }
}

/// A fit that keeps every component, of which the first are taken.
fn every_component() -> FitOptions {
    FitOptions {
        rank: RankSelection::Full,
        ..FitOptions::default()
    }
}

/// Pixels along a side.
fn side(text: &str) -> Result<NonZeroUsize, String> {
    whole(text, 1..=MAX_SIDE)
}

/// Samples along a side: two ends at least.
fn grid_side(text: &str) -> Result<NonZeroUsize, String> {
    whole(text, 2..=MAX_GRID)
}

fn whole(text: &str, range: RangeInclusive<usize>) -> Result<NonZeroUsize, String> {
    let needed = format!("a whole number from {} to {}", range.start(), range.end());
    number(text.trim(), |n: &NonZeroUsize| range.contains(&n.get()), &needed)
}

fn svg_path(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    let ending = path.extension();
    if ending.is_some_and(|ending| ending.eq_ignore_ascii_case("svg")) {
        return Ok(path);
    }
    Err("the plot is an SVG file: give a name that ends in .svg".to_owned())
}
