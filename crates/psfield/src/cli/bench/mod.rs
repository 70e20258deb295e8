//! `psfield bench`.

mod device_args;
mod json_to;
mod plot;
mod report;
mod settings;

use std::num::{NonZeroU16, NonZeroUsize};
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::builder::{OsStringValueParser, TypedValueParser};
use conv_core::ConvReal;
use psf_basis::RankSelection;

use psf_optics::Telescope;
use psf_sample::{SamplingMethod, UniformSampling};
use psf_types::{Anchor, FrameShape, Interpolation, PsfModelRecord, PsfSource as _, Scene};
use psfield::bench::{self, BenchCase, BenchOptions};
use psfield::{Device, FitOptions, Gpus, PsfInput, fit};
use serde::Serialize;

use super::UsageError;
use super::context::Context;
use super::values::{Precision, tolerance};
use device_args::BenchDeviceArgs;
pub(crate) use json_to::JsonTo;
use report::{Options, Report};
use settings::Settings;

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

impl MethodName {
    const ALL: [Self; 6] = [
        Self::Single,
        Self::Lowrank,
        Self::Auto,
        Self::Patch,
        Self::Basis,
        Self::Direct,
    ];
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Preset {
    /// 2 m off-axis survey telescope
    #[value(name = "survey-2m")]
    Survey2m,
    /// Under-sampled wide-field lens
    WideFieldLens,
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
        let single = matches!(self.precision, Precision::F32);
        if let Some(what) = self.device.misused(single) {
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
            ..BenchOptions::default()
        };
        let (mut gpus, device) = (Gpus::default(), self.device.options());
        if let Device::Gpu { adapter } = device.device() {
            // Before samples are drawn in vain.
            gpus.open(adapter.as_deref())?;
        }
        let scene = self.read_scene::<T>()?;
        if let Some(scene) = &scene {
            settings.sizes = Vec::new();
            anyhow::ensure!(
                scene
                    .pixels()
                    .is_some_and(|pixels| pixels.iter().any(|v| !v.is_zero())),
                "{}: the scene is dark, there is nothing to measure",
                self.scene
                    .iter()
                    .map(|path| path.display())
                    .next()
                    .expect("a scene has its file")
            );
        }
        if self.psf.is_some() {
            settings.grids = Vec::new();
        }
        let mut report = Report {
            version: env!("CARGO_PKG_VERSION"),
            options: self.options::<T>(settings.clone()),
            rows: Vec::new(),
            skipped: Vec::new(),
        };
        for record in self.records(&settings, context)? {
            let record = record?;
            let contenders = settings.contenders(record.basis().rank());
            let mut bench = |scene: Scene<T>| -> anyhow::Result<()> {
                let record = if self.psf.is_none() || self.stretch {
                    bench::stretched(&record, scene.frame().shape())?
                } else {
                    record.clone()
                };
                let bar = context.bar("measuring");
                let case = BenchCase::new(record, scene);
                let outcome = bench::run_on(&case, &contenders, &options, (&mut gpus, &device), &bar);
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
            self.write(path, &text)?;
        }
        if let Some(path) = &self.plot {
            let drawn = plot::plot(&report.cases())
                .with_context(|| format!("{}: the plot failed", path.display()))?;
            self.write(path, drawn.svg())?;
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

    fn read_scene<T: ConvReal>(&self) -> anyhow::Result<Option<Scene<T>>> {
        let Some(path) = &self.scene else {
            return Ok(None);
        };
        let image = psf_io::read_image::<T>(path)?.into_parts().0;
        Ok(Some(Scene::from_image(image)))
    }

    /// A model for each grid, or that of the file, made when it is asked for.
    fn records<'a>(
        &'a self,
        settings: &'a Settings,
        context: &'a Context,
    ) -> anyhow::Result<Box<dyn Iterator<Item = anyhow::Result<PsfModelRecord>> + 'a>> {
        if let Some(path) = &self.psf {
            let spinner = context.spinner("fitting the PSF");
            let record = self.read_psf(path)?;
            drop(spinner);
            return Ok(Box::new(std::iter::once(Ok(record))));
        }
        let telescope = match self.preset {
            Preset::Survey2m => Telescope::survey_2m(),
            Preset::WideFieldLens => Telescope::wide_field_lens(),
        };
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
            self.fitted(PsfInput::Samples(samples, options).native(None)?)
        })))
    }

    fn read_psf(&self, path: &Path) -> anyhow::Result<PsfModelRecord> {
        let psf = PsfInput::open(path, every_component())?;
        self.fitted(psf.native(None)?)
            .with_context(|| format!("{}: no model could be made", path.display()))
    }

    fn fitted(&self, psf: PsfInput) -> anyhow::Result<PsfModelRecord> {
        Ok(match psf {
            PsfInput::Samples(samples, options) => {
                let rank = self.rank.map_or(RANK, NonZeroUsize::get);
                fit(samples, &options)?.record().truncated(rank)?
            }
            PsfInput::Model(record) => match self.rank {
                Some(rank) => record.truncated(rank.get())?,
                None => record,
            },
        })
    }

    fn options<T: ConvReal>(&self, settings: Settings) -> Options {
        Options {
            settings,
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
            device: self.device.clone(),
            threads: rayon::current_num_threads(),
        }
    }

    fn write(&self, path: &Path, content: &str) -> anyhow::Result<()> {
        Ok(psf_io::write_text(path, content, self.overwrite)?)
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

fn whole(text: &str, range: std::ops::RangeInclusive<usize>) -> Result<NonZeroUsize, String> {
    text.trim()
        .parse()
        .ok()
        .filter(|n| range.contains(n))
        .and_then(NonZeroUsize::new)
        .ok_or_else(|| {
            format!(
                "a whole number from {} to {} is needed",
                range.start(),
                range.end()
            )
        })
}

fn svg_path(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    if path
        .extension()
        .is_some_and(|end| end.eq_ignore_ascii_case("svg"))
    {
        Ok(path)
    } else {
        Err("the plot is an SVG file: give a name that ends in .svg".to_owned())
    }
}
