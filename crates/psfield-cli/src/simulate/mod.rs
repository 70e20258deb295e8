//! `psfield simulate`.

mod execute;
mod exposure_args;
mod prepared;
mod report;
mod scene;

use std::path::PathBuf;

use conv_core::{ConvReal, PlanSummary};
use psf_io::Card;
use psf_types::Anchor;
use psfield::{JOB_KEYWORD, Method, Preparation, PsfieldError, SimulateOptions, Simulator};
use psfield_lab::{available_memory_bytes, peak_memory_bytes};

use crate::UsageError;
use crate::context::{Context, signature, signature_of, told};
use crate::devices::DeviceArgs;
use crate::psf_args::PsfArgs;
use crate::simulate::exposure_args::ExposureArgs;
use crate::simulate::prepared::timed;
use crate::simulate::report::Seconds;
use crate::simulate::scene::SceneArgs;
use crate::values::{Frame, Precision, bytes, stamp_size, text_of_bytes, tolerance};

pub(crate) use crate::simulate::prepared::Simulators;
pub(crate) use crate::simulate::report::Report;

/// Convolve a scene with a PSF that varies over the field
///
/// The scene is an image (flux in each pixel), a catalogue of stars and galaxies, or both. Field positions of the PSF count from the
/// first pixel of the image that is written.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct SimulateArgs {
    /// The PSF: a model, samples to be fitted, or any PSF file that convert reads
    #[arg(long, value_name = "PSF")]
    psf: PathBuf,
    /// The image to write
    #[arg(short, long, value_name = "IMAGE.fits")]
    output: PathBuf,
    /// Replace outputs that exist
    #[arg(long)]
    overwrite: bool,
    /// Whose PSF applies: source (each source spreads with its own) or output (each pixel gathers with its own, as in the
    /// method's paper)
    #[arg(long, default_value_t, value_name = "source|output")]
    anchor: Anchor,
    #[arg(
        long,
        value_name = "T",
        value_parser = tolerance,
        allow_negative_numbers = true,
        help = format!(
            "The largest relative L2 error that the engine may add to the PSF of any single pixel or star, from 0 to below 1; 0: \
             rounding alone. Of the methods auto and lowrank [default: {:e}]",
            SimulateOptions::default().tolerance
        )
    )]
    tolerance: Option<f64>,
    /// auto (each tile in the cheapest way), lowrank (by transforms alone), basis (a convolution a component; exact), patch=N (one
    /// PSF in N x N pixels; not exact) or direct (the double sum)
    #[arg(long, default_value_t, value_name = "METHOD")]
    method: Method,
    #[arg(
        long,
        value_name = "SIZE",
        value_parser = bytes,
        help = format!(
            "Memory of the plan of auto and lowrank, beside scene and image: bytes, or with K, M or G [default: {}]",
            text_of_bytes(SimulateOptions::default().memory)
        )
    )]
    memory: Option<usize>,
    /// Read the scene and write the image by bands of rows: neither is ever in memory as a whole. The same bytes. Chosen by
    /// itself where they would fill most of the memory
    #[arg(long)]
    stream: bool,
    /// Working precision and that of the result
    #[arg(long, default_value = "f32", value_enum)]
    precision: Precision,
    /// Cut or pad the stamps to N x N pixels of the image, centred at N / 2 (images: before PSFs are scaled to unit flux); stars are cut to
    /// as many about the pixel that each lies on, and the light beyond is lost
    #[arg(long, value_name = "N", value_parser = stamp_size)]
    stamp_size: Option<usize>,
    /// Check N random pixels, half of them where the image is bright, against the direct sum in double precision. A difference
    /// beyond what the method promises is an error, after the image is written
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=MAX_SPOT_CHECK))]
    spot_check: u32,
    /// Chooses the pixels of the spot check, and the detector's noise
    #[arg(long, default_value_t = 0)]
    seed: u64,
    // The groups come last: their headings hold for what follows.
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    exposure: ExposureArgs,
    #[command(flatten)]
    device: DeviceArgs,
    #[command(flatten)]
    fit: PsfArgs,
    /// The job of a batch that this is.
    #[arg(skip)]
    job: Option<JobMark>,
}

/// More pixels than that are a slip.
const MAX_SPOT_CHECK: i64 = 10_000_000;

/// Scene and image may fill this part of the free memory; larger ones are streamed.
const IN_MEMORY: f64 = 0.7;

impl SimulateArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        let report = self.simulate(&mut Simulators::default(), context)?;
        context.report(&report, || report.text())?;
        report.verdict()
    }

    /// The whole run, with the simulator of an earlier run where it fits.
    ///
    /// A failed spot check is in the report ([`Report::verdict`]): the image is written all the same.
    pub(crate) fn simulate(&self, simulators: &mut Simulators, context: &Context) -> anyhow::Result<Report> {
        if let Some(what) = self.misused() {
            return Err(UsageError(what).into());
        }
        let simulated = match self.precision {
            Precision::F32 => self.simulate_in::<f32>(simulators, context),
            Precision::F64 => self.simulate_in::<f64>(simulators, context),
        };
        simulated.map_err(|error| {
            let of_gpu = error
                .downcast_ref::<PsfieldError>()
                .is_some_and(PsfieldError::is_of_gpu);
            if of_gpu {
                simulators.forget_gpus();
                anyhow::anyhow!("{} (--device cpu does without a GPU)", told(&error))
            } else {
                error
            }
        })
    }

    /// The same as a job of a batch, which its files bear the mark of.
    pub(crate) fn for_job(&self, mark: JobMark, overwrite: bool) -> Self {
        Self {
            job: Some(mark),
            overwrite,
            ..self.clone()
        }
    }

    /// The noise-free image that is written beside the output, if one is.
    pub(crate) fn truth_beside(&self) -> Option<PathBuf> {
        self.exposure.truth(&self.output)
    }

    /// What is wrong with the options given, if anything.
    pub(crate) fn misused(&self) -> Option<String> {
        let planned = self.method.has_plan();
        let first = if self.tolerance.is_some() && !planned {
            Some("--tolerance is of the methods auto and lowrank")
        } else if self.memory.is_some() && !planned {
            Some("--memory is of the methods auto and lowrank")
        } else if self.stream && self.scene.scene.is_none() {
            Some("--stream is of scenes that are images: there is no scene here")
        } else if self.stream && !planned {
            Some("--stream is of the methods auto and lowrank")
        } else if self.stream && self.exposure.detector.is_some() {
            Some("--stream and --detector do not go together: expose the image afterwards (psfield expose)")
        } else {
            self.device.misused(planned, self.precision == Precision::F32)
        };
        self.scene.missing().or(first.map(str::to_owned))
    }

    /// The settings of the simulator.
    pub(super) fn options(&self) -> SimulateOptions {
        let defaults = SimulateOptions::default();
        self.device.applied_to(SimulateOptions {
            method: self.method,
            tolerance: self.tolerance.unwrap_or(defaults.tolerance),
            anchor: self.anchor,
            memory: self.memory.unwrap_or(defaults.memory),
            oversample: self.scene.finer(),
            stamp_size: self.stamp_size,
            frame: self.scene.frame.map(|Frame(frame)| frame),
            ..defaults
        })
    }

    fn simulate_in<T: ConvReal>(
        &self,
        simulators: &mut Simulators,
        context: &Context,
    ) -> anyhow::Result<Report> {
        let inputs = [
            self.scene.scene.as_ref(),
            self.scene.catalog.as_ref(),
            self.scene.wcs.as_ref(),
            Some(&self.psf),
        ];
        let exposing = self
            .exposure
            .exposing(&self.output, self.overwrite, self.seed, &inputs, context)?;
        self.open_gpu(context)?;
        let mut seconds = Seconds::default();
        let psf = self.psf(simulators, &mut seconds, context)?;
        let spinner = context.spinner("reading");
        let ((read, rows), taken) = timed(|| self.scene.read::<T>(self.is_streamed::<T>()))?;
        seconds.read += taken;
        drop(spinner);

        let simulator = self.simulator::<T>(&psf, read.shape, simulators)?;
        let kind = (&read.scene, rows.is_some());
        let made = self.prepare(&simulator, kind, simulators, &mut seconds, context)?;
        for warning in simulator.warnings(&read.scene) {
            context.warn(&warning.to_string());
        }
        let (ready, streamed) = ((&*simulator, &made), rows.is_some());
        let outcome = match rows {
            Some(reader) => self.by_bands(ready, &read, reader, &mut seconds, context)?,
            None => self.in_memory(ready, &read, exposing.as_ref(), &mut seconds, context)?,
        };
        let (options, plan, shape) = (simulator.options(), made.plan.as_ref(), simulator.image_shape());
        Ok(Report {
            output: self.output.clone(),
            method: self.method.to_string(),
            anchor: self.anchor,
            precision: T::NAME,
            tolerance: options.method.has_plan().then_some(options.tolerance),
            rank: made.model.rank(),
            modes: plan.map_or(made.model.stamp_count() as f64, PlanSummary::mean_modes),
            normalise: made.model.normalisation(),
            shape: [shape.nx(), shape.ny()],
            sources: read.scene.stars().len(),
            galaxies: read.scene.galaxies().len(),
            invalid_rows: read.invalid_rows,
            rows_off_projection: read.rows_off_projection,
            streamed,
            plan: plan.cloned(),
            tiles: plan.map(|_| outcome.counts),
            device: made.placement.clone(),
            seconds,
            peak_memory_bytes: peak_memory_bytes(),
            spot_check: outcome.spot_check,
            exposure: outcome.exposure,
        })
    }

    /// An error as bad usage where an option is wrong, else with the file that is to blame.
    fn told_of(&self, error: PsfieldError) -> anyhow::Error {
        match (&error, &self.scene.catalog) {
            // Their texts begin with the name of the option.
            (PsfieldError::FrameOffScene { .. } | PsfieldError::FrameOffAnyScene { .. }, _) => {
                UsageError(format!("--{error}")).into()
            }
            (PsfieldError::FluxBeyondPrecision { .. }, Some(path)) => {
                anyhow::Error::new(error).context(path.display().to_string())
            }
            (
                PsfieldError::UnevenScene { .. } | PsfieldError::Convolution(_) | PsfieldError::NoGpuSupport,
                _,
            ) => error.into(),
            _ => anyhow::Error::new(error).context(format!("with the PSF of {}", self.psf.display())),
        }
    }

    /// Whether the image of the scene is to be streamed.
    fn is_streamed<T: ConvReal>(&self) -> bool {
        let (Some(path), true, None) = (&self.scene.scene, self.method.has_plan(), &self.exposure.detector)
        else {
            return false;
        };
        if self.stream {
            return true;
        }
        // An image that cannot be opened is told of where it is read.
        let (Some(free), Ok(reader)) = (available_memory_bytes(), self.scene.open(path)) else {
            return false;
        };
        let shown = match self.scene.frame {
            Some(Frame(frame)) => frame.shape().pixel_count() * self.scene.finer().pow(2),
            None => reader.shape().pixel_count(),
        };
        let pixels = reader.shape().pixel_count() + shown;
        pixels as f64 * size_of::<T>() as f64 > IN_MEMORY * free as f64
    }
}

/// What made the files of a job.
#[derive(Debug, Clone)]
pub(crate) struct JobMark {
    /// The command line that does the same.
    pub(crate) arguments: Vec<String>,
    /// Tells the options of one job from those of another.
    pub(crate) digest: String,
}

impl SimulateArgs {
    /// What is needed to repeat the result.
    fn cards<T: ConvReal>(
        &self,
        simulator: &Simulator<T>,
        made: &Preparation<'_>,
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
        cards.extend(simulator.cards(made)?);
        Ok(cards)
    }
}
