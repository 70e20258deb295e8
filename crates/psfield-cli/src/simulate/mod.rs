//! `psfield simulate`.

mod colour;
mod execute;
mod exposure_args;
mod prepared;
mod report;
mod scene;
mod series;

use std::path::PathBuf;

use conv_core::{ConvReal, PlanSummary};
use psf_io::Card;
use psf_types::{Anchor, ToleranceOn};
use psfield::image_cards::{JOB_KEYWORD, PSF_FILE_KEYWORD};
use psfield::{ErrorKind, Method, PsfieldError, SimulateOptions, TruthTable};
use psfield_lab::{available_memory_bytes, peak_memory_bytes};

use crate::UsageError;
use crate::context::{Context, GivenOptions, message_of, signature, signature_of, with_option};
use crate::devices::DeviceArgs;
use crate::files::OutputFile;
use crate::psf_args::PsfArgs;
use crate::simulate::colour::{ColourArgs, check_spectra};
use crate::simulate::execute::{Outcome, Ready};
use crate::simulate::exposure_args::{Exposing, ExposureArgs, noise_of};
use crate::simulate::prepared::timed;
use crate::simulate::report::Seconds;
use crate::simulate::scene::{ReadFiles, SceneArgs};
use crate::values::{Floor, Precision, bytes, floor, stamp_size, tolerance};

pub(crate) use crate::simulate::prepared::Simulators;
pub(crate) use crate::simulate::report::{Report, verdict};
pub(crate) use crate::simulate::series::SeriesArgs;

/// Convolve a scene with a PSF that varies over the field
///
/// The scene is an image (flux in each pixel), a catalogue of stars and galaxies, or both.
/// Positions in the PSF file count from the first pixel of the image that is written.
///
/// An example with the catalogue of a source extractor:
///
/// psfield simulate --catalog cat.fits --columns x=X_IMAGE,y=Y_IMAGE,mag=MAG_AUTO --one-based
/// --zero-point 25 --shape 2048,2048 --psf model.fits -o image.fits
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct SimulateArgs {
    /// PSF: a model, samples (which are fitted), or any PSF file that convert reads
    #[arg(long, value_name = "PSF")]
    psf: PathBuf,
    /// Image to write
    #[arg(short, long, value_name = "IMAGE.fits")]
    pub(crate) output: OutputFile,
    /// Replace outputs that exist
    #[arg(long)]
    overwrite: bool,
    /// Also write a FITS table of the catalogue's sources as they are in the image
    ///
    /// Its columns: row (of the catalogue, from 0), x, y (0-based pixels of the image), ra, dec (at the date of
    /// the image, if it has world coordinates), flux, in_frame, and with --detector saturated_pixels: the size of
    /// the saturated area at the source.
    #[arg(long, value_name = "TABLE.fits")]
    truth_table: Option<OutputFile>,
    // The heading of a group also applies to the options after it, unless they name their own.
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    colour: ColourArgs,
    /// Largest relative L2 error that the convolution adds to the PSF of any pixel or star [default:
    /// {tolerance}]
    ///
    /// At least 0 and below 1. With 0, only rounding limits the accuracy. Applies only to the methods
    /// auto and lowrank.
    #[arg(long, value_name = "T", value_parser = tolerance, help_heading = ACCURACY)]
    tolerance: Option<f64>,
    #[arg(
        long,
        value_name = "l2|aperture",
        help_heading = ACCURACY,
        help = tolerance_on_help(),
        long_help = format!(
            "{}\n\nl2: the relative L2 error of the PSF.\naperture: also the error of the flux in every circle about the source, relative to the total flux of the PSF. Choose it for aperture photometry of PSFs with faint wide wings.\nApplies only to the methods auto and lowrank.",
            tolerance_on_help()
        )
    )]
    tolerance_on: Option<ToleranceOn>,
    /// Drop the light of stars and galaxies below E, in flux per pixel, or auto [default: {floor}]
    ///
    /// Each star and galaxy is drawn as far as its light exceeds E, and at least to the radius of 90 % of its
    /// light. Faint sources are then drawn on few pixels. The report says how much light is dropped in any
    /// pixel at most, so does the header, and --spot-check allows it. auto: a tenth of the noise of a dark
    /// pixel, which needs --detector. With 0, nothing is dropped. The scene's image does not depend on E.
    /// Applies only to the methods auto and lowrank.
    #[arg(long, value_name = "E|auto", value_parser = floor, help_heading = ACCURACY)]
    floor: Option<Floor>,
    /// Check N random pixels against the direct sum in double precision (0: no check)
    ///
    /// Half of them are bright pixels. The pixels around up to 96 random sources are compared, too. If
    /// a source, a pixel or the r.m.s. difference is beyond what --tolerance allows, the image is still
    /// written, but the command fails (docs/accuracy.md gives the limits). For basis and direct, the
    /// limits allow only rounding. For patch, there is no limit if the scene has an image.
    #[arg(
        long,
        value_name = "N",
        default_value_t = 0,
        value_parser = clap::value_parser!(u32).range(..=MAX_SPOT_CHECK),
        help_heading = ACCURACY
    )]
    spot_check: u32,
    /// Seed for the pixels of the spot check and for the detector's noise
    #[arg(long, default_value_t = 0, help_heading = ACCURACY)]
    seed: u64,
    /// Method of the convolution
    ///
    /// auto: the cheapest computation for each tile of the image, within --tolerance.
    /// lowrank: Fourier transforms for all tiles of the image, within --tolerance.
    /// basis: one convolution of the image per component, exact.
    /// patch=N: one PSF for each N x N pixels, approximate.
    /// direct: sum over all pixels, exact and very slow.
    #[arg(
        long,
        default_value_t,
        value_name = "METHOD",
        help_heading = ACCURACY,
        hide_short_help = true,
        verbatim_doc_comment
    )]
    method: Method,
    /// Position at which the PSF is evaluated: source or output
    ///
    /// source: the light of each source is spread by the PSF at the source.
    /// output: each pixel gathers light by the PSF at that pixel, as in the method's paper.
    #[arg(
        long,
        default_value_t,
        value_name = "source|output",
        help_heading = ACCURACY,
        hide_short_help = true,
        verbatim_doc_comment
    )]
    anchor: Anchor,
    /// Precision of the computation and of the image
    #[arg(
        long,
        default_value_t,
        value_enum,
        help_heading = ACCURACY,
        hide_short_help = true
    )]
    precision: Precision,
    /// Cut or pad the PSF stamps to N x N output pixels [default: the stamp's own size]
    ///
    /// The PSF is centred at pixel N / 2 (0-based, rounded down). For images, stamps are cut or
    /// padded, then scaled to unit flux (not with --normalise keep). For stars, stamps are cut
    /// around the star's pixel. For galaxies, they are cut around the centre of the PSF. Cut stamps
    /// of stars and galaxies are not scaled again, so that light outside these N x N pixels is
    /// lost.
    #[arg(
        long,
        value_name = "N",
        value_parser = stamp_size,
        help_heading = ACCURACY,
        hide_short_help = true
    )]
    stamp_size: Option<usize>,
    /// Upper limit of the memory for the plan, the prepared PSF data (bytes, or with K, M or G) [default:
    /// {memory}, and more for large frames and stamps]
    ///
    /// The default has room for two images of the frame and for the stamps of the PSF model, so it is the
    /// same on every machine. Each execution makes again the parts of a plan that exceed the limit, which
    /// is slow. The memory of scene and image comes in addition, and so does that of galaxies, which grows
    /// with the number of components and with the sizes of the galaxies. Applies only to the methods auto
    /// and lowrank.
    #[arg(long, value_name = "SIZE", value_parser = bytes, help_heading = MEMORY, hide_short_help = true)]
    memory: Option<usize>,
    /// Read the scene and write the image in bands of rows
    ///
    /// psfield then never holds the whole scene or image in memory. The result does not change.
    /// Applies only to a scene that is an image, to the methods auto and lowrank, and without
    /// --detector. In such a run psfield does this also without --stream if scene and image would
    /// fill more than 70 % of the free memory.
    #[arg(long, help_heading = MEMORY, hide_short_help = true)]
    stream: bool,
    #[command(flatten)]
    exposure: ExposureArgs,
    #[command(flatten)]
    device: DeviceArgs,
    #[command(flatten)]
    fit: PsfArgs,
    /// The mark of the batch job, if this run is a job of a batch.
    #[arg(skip)]
    job: Option<JobMark>,
    /// Further header cards.
    #[arg(skip)]
    cards: Vec<Card>,
}

const ACCURACY: &str = "Accuracy and method";
const MEMORY: &str = "Memory";

/// `--floor auto` is this part of the noise of a dark pixel.
const FLOOR_OF_NOISE: f64 = 0.1;

fn tolerance_on_help() -> String {
    format!(
        "Errors of the PSF that --tolerance bounds [default: {}]",
        SimulateOptions::default().tolerance_on
    )
}

/// The largest number of pixels of a spot check. A larger number is a typing error.
const MAX_SPOT_CHECK: i64 = 100_000;

/// If scene and image together need more than this fraction of the free memory, they are streamed.
const IN_MEMORY: f64 = 0.7;

impl SimulateArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        if let Some(what) = self.misused(&context.given) {
            return Err(UsageError(what).into());
        }
        let report = self.simulate(&mut Simulators::default(), context)?;
        context.report(&report, || report.text())?;
        report.verdict()
    }

    /// Runs the simulation. Uses a kept simulator of an earlier run if one suits this run.
    ///
    /// The image is written even if its spot check fails. [`Report::verdict`] returns this failure.
    pub(crate) fn simulate(&self, simulators: &mut Simulators, context: &Context) -> anyhow::Result<Report> {
        let with_floor = self.with_floor(None)?;
        let simulated = match self.precision {
            Precision::F32 => with_floor.simulate_in::<f32>(simulators, context),
            Precision::F64 => with_floor.simulate_in::<f64>(simulators, context),
        };
        simulated.map_err(|error| {
            let kind = error.downcast_ref().map(PsfieldError::kind);
            if kind == Some(ErrorKind::Gpu) {
                simulators.forget_gpus();
                anyhow::anyhow!("{} (--device cpu needs no GPU)", message_of(&error))
            } else {
                error
            }
        })
    }

    /// Returns these options for a job of a batch. The headers of the job's files will hold `mark`.
    pub(crate) fn for_job(&self, mark: JobMark, overwrite: bool) -> Self {
        Self {
            job: Some(mark),
            overwrite,
            ..self.clone()
        }
    }

    /// The default name of the noise-free image. `None` if a name is given or no such image is
    /// written.
    pub(crate) fn default_truth(&self) -> Option<PathBuf> {
        self.exposure.default_truth(&self.output)
    }

    /// Returns an error message if options do not fit together.
    pub(crate) fn misused(&self, given: &GivenOptions) -> Option<String> {
        let planned = self.method.has_plan();
        let first = if self.tolerance.is_some() && !planned {
            Some("--tolerance applies only to the methods auto and lowrank")
        } else if self.tolerance_on.is_some() && !planned {
            Some("--tolerance-on applies only to the methods auto and lowrank")
        } else if self.floor.is_some() && !planned {
            Some("--floor applies only to the methods auto and lowrank")
        } else if self.floor == Some(Floor::Auto) && self.exposure.detector.is_none() {
            Some("--floor auto is a tenth of the detector's noise: give --detector, or a number")
        } else if self.memory.is_some() && !planned {
            Some("--memory applies only to the methods auto and lowrank")
        } else if self.stream && self.scene.scene.is_none() {
            Some("--stream needs a scene that is an image (SCENE.fits)")
        } else if self.stream && !planned {
            Some("--stream applies only to the methods auto and lowrank")
        } else if self.stream && self.exposure.detector.is_some() {
            Some("--stream cannot be used with --detector: expose the image afterwards (psfield expose)")
        } else if self.truth_table.is_some() && self.scene.catalog.is_none() {
            Some("--truth-table needs a catalogue (--catalog)")
        } else {
            self.device.misused(planned, self.precision == Precision::F32)
        };
        let only_layers = !self.colour.layer.is_empty() && self.scene.scene.is_none();
        let first = first
            .or(only_layers.then_some("--layer needs a first image (SCENE.fits), whose spectrum is --sed"));
        self.scene.missing(given).or(first.map(str::to_owned))
    }

    /// These options with a number as floor. `exposure_s` is the exposure time of a series.
    pub(super) fn with_floor(&self, exposure_s: Option<f64>) -> anyhow::Result<Self> {
        let floor = match (self.floor, &self.exposure.detector) {
            (Some(Floor::Auto), Some(path)) => {
                let noise = noise_of(path, exposure_s)?;
                anyhow::ensure!(
                    noise > 0.0,
                    "{}: --floor auto needs a detector with noise: give the floor as a number",
                    path.display()
                );
                Some(Floor::At(FLOOR_OF_NOISE * noise))
            }
            (floor, _) => floor,
        };
        Ok(Self {
            floor,
            ..self.clone()
        })
    }

    /// The settings of the simulator.
    pub(super) fn options(&self) -> SimulateOptions {
        let defaults = SimulateOptions::default();
        self.device.applied_to(SimulateOptions {
            method: self.method,
            tolerance: self.tolerance.unwrap_or(defaults.tolerance),
            tolerance_on: self.tolerance_on.unwrap_or(defaults.tolerance_on),
            floor: match self.floor {
                Some(Floor::At(floor)) => floor,
                _ => defaults.floor,
            },
            anchor: self.anchor,
            memory: self.memory,
            oversample: self.scene.finer(),
            scene_pixels: self.scene.pixels(),
            stamp_size: self.stamp_size,
            frame: self.scene.frame,
            ..defaults
        })
    }

    fn simulate_in<T: ConvReal>(
        &self,
        simulators: &mut Simulators,
        context: &Context,
    ) -> anyhow::Result<Report> {
        let exposing = self
            .exposure
            .exposing(&self.output, self.overwrite, self.seed, context)?;
        self.open_gpu(context)?;
        let mut seconds = Seconds::default();
        let psf = self.psf(simulators, &mut seconds, context)?;
        let spinner = context.spinner("reading");
        let by_rows = self.is_streamed::<T>();
        let (mut read, taken) = timed(|| {
            self.scene
                .read::<T>(&self.colour, by_rows, psf.field_shape(), |options| options)
        })?;
        seconds.read += taken;
        drop(spinner);
        let outputs = std::iter::once(self.output.to_path_buf()).chain(self.exposure.outputs(&self.output));
        check_spectra(read.light.spectra(), outputs)?;
        self.note_of_scene(&read.files, context);
        self.warn_of_empty_catalog(read.files.sources, context);

        let simulator = self.simulator::<T>(&psf, &read, simulators, context)?;
        let sources = self.truth_table.as_ref().map(|_| {
            let sky = self.scene.sky(&read.files.header).ok();
            TruthTable::new(read.light.catalog(), simulator.shown_region(), sky.as_ref())
        });
        let readers = std::mem::take(&mut read.rows);
        let light = read.light.into_scene()?;
        let scene = &light;
        let made = self.prepare(&simulator, scene, simulators, &mut seconds, context)?;
        let noise = exposing.as_ref().and_then(Exposing::noise);
        Self::warn_of_scene(|| simulator.warnings(scene, noise), &mut seconds, context);
        let (simulator, streamed) = (&*simulator, !readers.is_empty());
        let ready = Ready {
            simulator,
            scene,
            made,
            sources,
        };
        let outcome = if streamed {
            self.by_bands(&ready, &read.files, readers, &mut seconds, context)?
        } else {
            self.in_memory(&ready, &read.files, exposing.as_ref(), &mut seconds, context)?
        };
        Ok(Report {
            streamed,
            ..self.report(&ready, &read.files, outcome, seconds)
        })
    }

    /// Warns if there is a catalogue without sources. `sources` are the numbers of stars and galaxies.
    fn warn_of_empty_catalog(&self, sources: (usize, usize), context: &Context) {
        if let (Some(path), (0, 0)) = (&self.scene.catalog, sources) {
            context.warn(&format!("{}: the catalogue has no sources", path.display()));
        }
    }

    /// Notes the size of a frame that the user did not give, and warns of columns of the catalogue that
    /// change a source but are not read.
    fn note_of_scene(&self, read: &ReadFiles, context: &Context) {
        if let (Some(path), Some(warning)) = (&self.scene.catalog, &read.ignored_warning) {
            context.warn(&format!("{}: {warning}", path.display()));
        }
        if self.scene.scene.is_none() && self.scene.shape.is_none() {
            let (s, shape) = (self.scene.finer(), read.shape);
            let (nx, ny) = (shape.nx() / s, shape.ny() / s);
            context.note(&format!(
                "the frame has {nx} x {ny} pixels, the field of the PSF (option --shape)"
            ));
        }
    }

    /// The report of an image that was not streamed.
    fn report<T: ConvReal>(
        &self,
        Ready { simulator, made, .. }: &Ready<'_, '_, T>,
        read: &ReadFiles,
        outcome: Outcome,
        seconds: Seconds,
    ) -> Report {
        let (options, plan, shape) = (simulator.options(), made.plan.as_ref(), simulator.image_shape());
        Report {
            output: self.output.to_path_buf(),
            method: self.method.to_string(),
            anchor: self.anchor,
            precision: T::NAME,
            tolerance: options.method.has_plan().then_some(options.tolerance),
            tolerance_on: options.method.has_plan().then_some(options.tolerance_on),
            floor: options.method.has_plan().then_some(options.floor),
            scene_pixels: self
                .scene
                .scene
                .as_ref()
                .map(|_| options.scene_pixels.to_string()),
            rank: made.model.rank(),
            modes: plan.map_or(made.model.stamp_count() as f64, PlanSummary::mean_modes),
            normalise: made.model.normalisation(),
            shape: [shape.nx(), shape.ny()],
            sources: read.sources.0,
            galaxies: read.sources.1,
            invalid_rows: read.invalid_rows,
            rows_off_projection: read.rows_off_projection,
            nan_pixels: outcome.nan_pixels,
            streamed: false,
            plan: plan.cloned(),
            tiles: plan.map(|_| outcome.counts),
            device: made.placement.clone(),
            seconds,
            peak_memory_bytes: peak_memory_bytes(),
            dropped: outcome.dropped,
            shot: outcome.shot,
            spot_check: outcome.spot_check,
            exposure: outcome.exposure,
        }
    }

    /// Turns an error about the value of `--frame` into a usage error. Adds the name of the
    /// catalogue or of the PSF file to errors about these files.
    fn explained(&self, error: PsfieldError) -> anyhow::Error {
        match (error.kind(), error.setting(), &self.scene.catalog) {
            (ErrorKind::Setting, Some("frame"), _) => UsageError(with_option(&error, error.setting())).into(),
            (ErrorKind::Data, Some("frame"), _) => error.into(),
            (_, Some("precision"), Some(path)) => {
                anyhow::Error::new(error).context(path.display().to_string())
            }
            (ErrorKind::Setting | ErrorKind::Convolution | ErrorKind::Cancelled | ErrorKind::Gpu, ..) => {
                error.into()
            }
            _ => anyhow::Error::new(error).context(format!("with the PSF of {}", self.psf.display())),
        }
    }

    /// Returns whether the image of the scene is streamed.
    fn is_streamed<T: ConvReal>(&self) -> bool {
        let (Some(path), true, None) = (&self.scene.scene, self.method.has_plan(), &self.exposure.detector)
        else {
            return false;
        };
        if self.stream {
            return true;
        }
        // An error on opening the image is reported later, when the image is read.
        let (Some(free), Ok(reader)) = (available_memory_bytes(), self.scene.open(path)) else {
            return false;
        };
        let shown = match self.scene.frame {
            Some(frame) => frame.shape().pixel_count() * self.scene.finer().pow(2),
            None => reader.shape().pixel_count(),
        };
        let images = 1 + self.colour.layer.len();
        let pixels = images * reader.shape().pixel_count() + shown;
        pixels as f64 * size_of::<T>() as f64 > IN_MEMORY * free as f64
    }
}

/// The mark that a batch job leaves in the headers of its files.
#[derive(Debug, Clone)]
pub(crate) struct JobMark {
    /// The equivalent command line.
    pub(crate) arguments: Vec<String>,
    /// Digest of the options. Jobs with other options have another digest.
    pub(crate) digest: String,
}

impl SimulateArgs {
    /// Header cards with all that is needed to repeat the result.
    fn cards<T: ConvReal>(
        &self,
        Ready { simulator, made, .. }: &Ready<'_, '_, T>,
    ) -> anyhow::Result<Vec<Card>> {
        let mut cards = match &self.job {
            Some(mark) => {
                let mut cards = signature_of(&mark.arguments);
                let digest = mark.digest.as_str();
                cards.push(Card::new(
                    JOB_KEYWORD,
                    digest,
                    "digest of the options of the job",
                )?);
                cards
            }
            None => signature(),
        };
        let psf = self.psf.file_name().unwrap_or_default().to_string_lossy();
        cards.push(Card::new(PSF_FILE_KEYWORD, psf.as_ref(), "file of the PSF")?);
        cards.extend(simulator.cards(made)?);
        cards.extend(self.cards.iter().cloned());
        Ok(cards)
    }
}
