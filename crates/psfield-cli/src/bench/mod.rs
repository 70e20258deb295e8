//! `psfield bench`.

mod model;
mod real;
mod report;
mod settings;

use std::ffi::OsString;
use std::num::{NonZeroU16, NonZeroUsize};
use std::ops::RangeInclusive;
use std::path::PathBuf;

use anyhow::Context as _;
use clap::builder::{OsStringValueParser, TypedValueParser};
use conv_core::ConvReal;
use psf_basis::RankSelection;
use psf_sample::{SamplingMethod, UniformSampling};
use psf_types::{Anchor, FrameShape, Image, Interpolation, PsfModelRecord, PsfSource as _, ToleranceOn};
use psfield::{Device, FitOptions, Psf};
use psfield_lab::bench::{self, BenchCase, BenchOptions, BenchOutcome, RealGroup};
use psfield_lab::plot::Figure;
use serde::Serialize;

use crate::UsageError;
use crate::bench::settings::Settings;
use crate::context::{Context, object, without_option};
use crate::devices::device_parser;
use crate::files::{JsonTo, OutputFile};
use crate::sample::Preset;
use crate::values::{Precision, number, tolerance};

/// Measure run time and error of all convolution methods in one run
///
/// Each method is planned once and then runs in turn with all others (A B C, A B C, ...). Planning
/// and running are timed separately. Errors are relative L2 differences from the direct sum in
/// double precision, at the same random pixels for all methods.
///
/// By default, the PSF of a preset telescope is sampled at grids of positions (--grids). The field
/// of the telescope is stretched to the frame, so that the PSF varies by the same amount over a
/// frame of any size. In the default scene every pixel has light.
///
/// All run times are also given as ratios to the run time of `single`, which always runs. `single`
/// convolves the scene with one PSF: the PSF at the middle of the frame. It is the fastest
/// convolution with one PSF in psfield.
///
/// --model measures the whole PSF model instead: PSFs drawn and seconds against the error of PSFs
/// that are not samples.
///
/// --real measures real work instead: how time and memory grow with pixels, light, stars, galaxies,
/// frames and spectra, for PSFs of several kinds.
#[derive(Debug, clap::Args)]
#[allow(clippy::struct_excessive_bools, reason = "each is an option")]
pub(crate) struct BenchArgs {
    /// Measure how time and memory grow with real work, in groups [default: all groups]
    ///
    /// pixels: frames of --sizes through five PSFs, every pixel lit.
    /// light: 0 to 100 % of the pixels lit, chosen at random.
    /// stars: 10^3 to 10^7 stars.
    /// galaxies: 10^3 to 10^5 galaxies.
    /// floor: 10^4 stars and as many galaxies of fluxes from 1 to 10^6, for floors from 0 to 10.
    /// wings: frames with every pixel lit, through PSFs with wings of 0 to 4 stamps of 1023 x 1023 pixels.
    /// starphotons, galaxyphotons: 10^5 stars or galaxies of 3 to 1000 photons each, simulated and
    /// exposed with --shoot-below auto. The column ratio is the run time divided by the better of
    /// shooting all and none.
    /// frames: 1000 frames of 256 x 256 pixels with one plan.
    /// fields: 100 frames of 256 x 256 pixels, each with its own PSF field: plan and image.
    /// colours: frames of --sizes with the light of five black bodies, each with its own image,
    /// every pixel lit. The column ratio is the run time divided by that of one of the spectra. If this
    /// is the only group, --psf may name a PSF with wavelengths.
    /// series: 100 exposures of 2048 x 2048 pixels, every pixel lit. The PSF changes with time, and the
    /// telescope drifts: plans and images. The column ratio is the run time divided by that of a series
    /// through the first PSF, without drift.
    /// starseries: such a series of 2000 stars.
    ///
    /// The method is auto with tolerance 1e-3, in f32. No frame is larger than the largest of
    /// --sizes. A case whose first run takes more than 10 s runs once. All groups together take
    /// about fifteen minutes and 2 GiB of memory on two cores.
    #[arg(
        long,
        value_name = "GROUP,...",
        num_args = 0..=1,
        require_equals = true,
        value_delimiter = ',',
        default_missing_value = "pixels,light,stars,galaxies,floor,wings,starphotons,galaxyphotons,frames,fields,colours,series,starseries",
        conflicts_with_all = [
            "grids", "scene", "stretch", "preset", "rank", "methods", "tolerances", "patches", "ranks", "anchor",
            "precision", "plot", "device", "gpu_adapter"
        ],
        verbatim_doc_comment
    )]
    real: Option<Vec<RealGroup>>,
    /// Measure PSFs drawn and seconds against the error of the whole model (samples, basis, interpolation)
    ///
    /// The telescope of --preset is sampled where kriging expects the largest error, on a mesh, and on
    /// grids. Each model is fitted with the default options. Errors are those of 300 PSFs at random
    /// positions (--seed). Takes about five minutes on two cores.
    #[arg(
        long,
        conflicts_with_all = [
            "real", "sizes", "grids", "psf", "scene", "stretch", "rank", "methods", "tolerances", "tolerance_on",
            "patches", "ranks", "anchor", "precision", "repeat", "pixels", "device", "gpu_adapter"
        ]
    )]
    model: bool,
    /// Sides of the square frames (pixels) [default: 512,1024,2048; with --real: 1024,4096,9216]
    #[arg(long, value_name = "N,...", value_delimiter = ',', conflicts_with = "scene", value_parser = side, help_heading = CASES)]
    sizes: Option<Vec<NonZeroUsize>>,
    /// Numbers of PSF samples along each side of the field [default: 9,33]
    #[arg(long, value_name = "N,...", value_delimiter = ',', conflicts_with = "psf", value_parser = grid_side, help_heading = CASES)]
    grids: Option<Vec<NonZeroUsize>>,
    /// PSF: a model, or samples (which are fitted) [default: sampled from --preset]
    #[arg(long, value_name = "MODEL.fits|SAMPLES.fits", help_heading = CASES)]
    psf: Option<PathBuf>,
    /// Scene: a FITS image [default: noise on a smooth background]
    #[arg(long, value_name = "SCENE.fits", help_heading = CASES)]
    scene: Option<PathBuf>,
    /// Stretch the positions of the samples of --psf to the frame
    #[arg(long, requires = "psf", help_heading = CASES, hide_short_help = true)]
    stretch: bool,
    /// Telescope whose PSF is sampled
    #[arg(
        long,
        value_enum,
        default_value = "survey-2m",
        conflicts_with = "psf",
        help_heading = CASES,
        hide_short_help = true
    )]
    preset: Preset,
    /// Number of components of the PSF model (fewer if the samples give fewer) [default: 100]
    ///
    /// Default for --psf with a model: all its components.
    #[arg(long, value_name = "K", help_heading = CASES, hide_short_help = true)]
    rank: Option<NonZeroUsize>,
    /// Methods to measure [default: all]
    #[arg(long, value_name = "METHOD,...", value_delimiter = ',', value_enum, help_heading = METHODS)]
    methods: Option<Vec<MethodName>>,
    /// Tolerances of lowrank and auto [default: 1e-1,1e-2,1e-3,1e-4,1e-5,1e-6,0]
    #[arg(
        long,
        value_name = "X,...",
        value_delimiter = ',',
        value_parser = tolerance,
        allow_hyphen_values = true,
        help_heading = METHODS
    )]
    tolerances: Option<Vec<f64>>,
    /// Errors of the PSF that --tolerances bound: l2, or aperture (as for simulate)
    /// [default: aperture; with --real: l2]
    #[arg(long, value_name = "l2|aperture", help_heading = METHODS, hide_short_help = true)]
    tolerance_on: Option<ToleranceOn>,
    /// Sides of the patches (pixels) [default: 32,64,128,256]
    #[arg(
        long,
        value_name = "N,...",
        value_delimiter = ',',
        value_parser = side,
        help_heading = METHODS,
        hide_short_help = true
    )]
    patches: Option<Vec<NonZeroUsize>>,
    /// Numbers of components that basis keeps (fewer if the model has fewer) [default: 10,30,100]
    #[arg(long, value_name = "K,...", value_delimiter = ',', help_heading = METHODS, hide_short_help = true)]
    ranks: Option<Vec<NonZeroUsize>>,
    /// Position at which the PSF is evaluated: source or output
    ///
    /// source: the light of each source is spread by the PSF at the source.
    /// output: each pixel gathers light by the PSF at that pixel.
    #[arg(
        long,
        default_value_t,
        value_name = "source|output",
        help_heading = METHODS,
        hide_short_help = true,
        verbatim_doc_comment
    )]
    anchor: Anchor,
    /// Precision of the computation
    #[arg(long, default_value_t, value_enum, help_heading = METHODS, hide_short_help = true)]
    precision: Precision,
    /// Number of timed turns of each method [default: 3]
    ///
    /// In each turn, a method runs as often as fits into 20 ms, at least once and at most 20 times.
    #[arg(long, value_name = "N", help_heading = MEASUREMENT, hide_short_help = true)]
    repeat: Option<NonZeroU16>,
    /// Number of random pixels at which errors are measured [default: 400]
    #[arg(
        long,
        value_name = "N",
        value_parser = clap::value_parser!(u32).range(1..=MAX_PIXELS),
        help_heading = MEASUREMENT,
        hide_short_help = true
    )]
    pixels: Option<u32>,
    /// Seed for the scene and for the random pixels
    #[arg(
        long,
        value_name = "N",
        default_value_t = BenchOptions::DEFAULT_SEED,
        help_heading = MEASUREMENT,
        hide_short_help = true
    )]
    seed: u64,
    /// Use smaller defaults: --sizes 256, --grids 5, --patches 64, --ranks 10, --tolerances
    /// 1e-2,1e-4, --repeat 1, --pixels 100. With --real or --model: a small version of every case
    #[arg(long, help_heading = MEASUREMENT)]
    quick: bool,
    /// Write all numbers as JSON to FILE. Without FILE: print them instead of the table
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = "-", value_parser = OsStringValueParser::new().map(JsonTo::of_argument))]
    json: Option<JsonTo>,
    /// Plot run time against error (SVG). With --model: PSFs drawn and seconds against error
    #[arg(long, value_name = "FILE.svg", value_parser = OsStringValueParser::new().try_map(svg_path))]
    plot: Option<OutputFile>,
    /// Replace the files of --json and --plot if they exist
    #[arg(long)]
    overwrite: bool,
    /// Device of lowrank and auto (gpu computes in f32; the other methods run on the CPU)
    // It is never chosen automatically, because times are compared on a known device.
    #[arg(long, default_value = "cpu", value_parser = device_parser(["cpu", "gpu"]), help_heading = DEVICE)]
    device: Device,
    /// GPU to use: a part of its name, or its backend [default: the first that psfield devices
    /// lists]
    #[arg(long, value_name = "NAME", help_heading = DEVICE, hide_short_help = true)]
    gpu_adapter: Option<String>,
}

const CASES: &str = "Frames and PSFs";
const METHODS: &str = "Methods";
const MEASUREMENT: &str = "Measurement";
const DEVICE: &str = "Device";

/// The methods by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum MethodName {
    /// One PSF for the whole frame, the unit of the ratios
    Single,
    /// Fourier transforms for all tiles of the frame, at each of --tolerances
    Lowrank,
    /// The cheapest computation for each tile of the frame, at each of --tolerances
    Auto,
    /// One PSF per patch, for each of --patches
    Patch,
    /// One convolution of the whole image per component, for each of --ranks
    Basis,
    /// The exact sum over all pixels, skipped where it would take more than a few seconds
    Direct,
}

/// Default number of components of a fitted model.
const RANK: usize = 100;
/// The largest number of pixels at which errors are measured. A larger number is a typing error.
const MAX_PIXELS: i64 = 1_000_000;
/// The largest side of a frame. A larger number is a typing error.
const MAX_SIDE: usize = 1 << 15;
/// The largest number of samples along a side. A larger number is a typing error.
const MAX_GRID: usize = 256;

impl BenchArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        if self.device == Device::Cpu && self.gpu_adapter.is_some() {
            return Err(UsageError("--gpu-adapter applies only to --device gpu".to_owned()).into());
        }
        if self.device == Device::Gpu && self.precision == Precision::F64 {
            let text = "--device gpu computes in f32: leave --precision f64 out";
            return Err(UsageError(text.to_owned()).into());
        }
        if self.model {
            return self.run_model(context);
        }
        if let Some(groups) = &self.real {
            return self.run_real(groups, context);
        }
        match self.precision {
            Precision::F32 => self.run_in::<f32>(context),
            Precision::F64 => self.run_in::<f64>(context),
        }
    }

    fn run_in<T: ConvReal>(self, context: &Context) -> anyhow::Result<()> {
        let mut settings = Settings::of(&self);
        let options = self.bench_options(&settings);
        if options.device == Device::Gpu {
            // A missing GPU is reported before samples are drawn.
            psfield::device::open_gpu(options.gpu_adapter.as_deref())?;
        }
        let mut scene = None;
        if let Some(path) = &self.scene {
            settings.sizes = Vec::new();
            let image = psf_io::read_image::<T>(path)?.into_parts().0;
            anyhow::ensure!(
                image.pixels().iter().any(|v| !v.is_zero()),
                "{}: the scene has no light, so there is nothing to measure",
                path.display()
            );
            scene = Some(image);
        }
        if self.psf.is_some() {
            settings.grids = Vec::new();
        }
        let mut outcome = BenchOutcome::default();
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
                let of_case = bench::run(&case, &contenders, &options, &bar);
                let of_case = of_case.map_err(without_option).with_context(|| self.origin())?;
                outcome.rows.extend(of_case.rows);
                outcome.skipped.extend(of_case.skipped);
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
        let report = object! {
            version: env!("CARGO_PKG_VERSION"),
            options: self.options::<T>(&settings),
            #[serde(flatten)]
            outcome: &outcome,
        };
        let plot = || report::plot(&outcome.rows);
        self.publish(&report, Some(&plot), || report::text(&outcome), context)
    }

    /// Writes the files of `--json` and `--plot`, and prints the report. The numbers are written first, so
    /// that an error in drawing loses no measurement. `plot` is None if there is nothing to plot.
    fn publish(
        &self,
        report: &impl Serialize,
        plot: Option<&dyn Fn() -> Figure>,
        text: impl FnOnce() -> String,
        context: &Context,
    ) -> anyhow::Result<()> {
        if let Some(path) = self.json.as_ref().and_then(JsonTo::file) {
            psf_io::write_text(path, &serde_json::to_string_pretty(report)?, self.overwrite)?;
        }
        if let (Some(path), Some(plot)) = (&self.plot, plot) {
            psf_io::write_text(path, &plot().svg(), self.overwrite)?;
        }
        context.report(report, text)
    }

    /// The name of the preset telescope.
    fn preset_name(&self) -> String {
        let value = clap::ValueEnum::to_possible_value(&self.preset);
        value.map_or_else(String::new, |value| value.get_name().to_owned())
    }

    fn bench_options(&self, settings: &Settings) -> BenchOptions {
        BenchOptions {
            anchor: self.anchor,
            tolerance_on: settings.tolerance_on,
            repeat: settings.repeat,
            pixels: settings.pixels,
            seed: settings.seed,
            device: self.device,
            gpu_adapter: self.gpu_adapter.clone(),
            ..BenchOptions::default()
        }
    }

    /// Returns the origin of the PSF, for error messages.
    fn origin(&self) -> String {
        match &self.psf {
            Some(path) if self.stretch => format!("with the PSF of {}", path.display()),
            Some(path) => format!(
                "with the PSF of {} (--stretch adapts its field to any frame)",
                path.display()
            ),
            None => "with the PSF of the preset".to_owned(),
        }
    }

    /// Returns a model for each grid, or the model of the file. The iterator makes the model of a
    /// grid when it reaches the grid.
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
            psfield::stack_size::check_stack(grid * grid, telescope.grid())
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

    /// Returns the options in force, without the options that a file replaces.
    fn options<T: ConvReal>(&self, settings: &Settings) -> impl Serialize {
        object! {
            #[serde(flatten)]
            settings: settings.clone(),
            rank: self
                .rank
                .map(NonZeroUsize::get)
                .or_else(|| self.psf.is_none().then_some(RANK)),
            preset: self.psf.is_none().then(|| self.preset_name()),
            psf: self.psf.clone(),
            stretch: self.psf.is_none() || self.stretch,
            scene: self.scene.clone(),
            anchor: self.anchor,
            precision: T::NAME,
            device: self.device.to_string(),
            gpu_adapter: self.gpu_adapter.clone(),
            threads: rayon::current_num_threads(),
        }
    }
}

/// A fit that keeps every component, so that models can be truncated later.
fn every_component() -> FitOptions {
    FitOptions {
        rank: RankSelection::Full,
        ..FitOptions::default()
    }
}

/// Parses a number of pixels along a side.
fn side(text: &str) -> Result<NonZeroUsize, String> {
    whole(text, 1..=MAX_SIDE)
}

/// Parses a number of samples along a side, at least 2.
fn grid_side(text: &str) -> Result<NonZeroUsize, String> {
    whole(text, 2..=MAX_GRID)
}

fn whole(text: &str, range: RangeInclusive<usize>) -> Result<NonZeroUsize, String> {
    let needed = format!("a whole number from {} to {}", range.start(), range.end());
    number(text.trim(), |n: &NonZeroUsize| range.contains(&n.get()), &needed)
}

fn svg_path(text: OsString) -> Result<OutputFile, String> {
    let path = OutputFile::from(text);
    let ending = path.extension();
    if ending.is_some_and(|ending| ending.eq_ignore_ascii_case("svg")) {
        return Ok(path);
    }
    Err("the plot is an SVG file: give a name that ends in .svg".to_owned())
}
