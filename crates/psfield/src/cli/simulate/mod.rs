//! `psfield simulate`.

mod banded;
mod cards;
mod exposure_args;
mod in_memory;
mod placing;
mod prepared;
mod report;
mod scene_args;

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Context as _;
use conv_core::{ConvReal, PlanOptions, PlanSummary, TileCounts};
use detector::ExposureReport;
use psf_types::{Anchor, FrameShape, Scene};
use psfield::{
    Gpus, Method, PsfInput, PsfieldError, SceneParts, Simulation, SimulationOptions, SimulationWarning,
    SpotCheck, available_memory_bytes, peak_memory_bytes,
};

use super::UsageError;
use super::context::{Context, told};
use super::device_args::DeviceArgs;
use super::fit_args::PsfArgs;
use super::values::{Frame, Precision, bytes, stamp_size, tolerance};
use exposure_args::ExposureArgs;
use prepared::{Prepared, timed};
use report::{DeviceReport, PlanReport, Seconds, TilesReport};
use scene_args::SceneArgs;

pub(crate) use cards::JobMark;
pub(crate) use prepared::Preparations;
pub(crate) use report::Report;

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
    /// The largest relative L2 error that the engine may add to the PSF of any single pixel or star, from 0 to below 1; 0: rounding
    /// alone. Of the methods auto and lowrank [default: 1e-4]
    #[arg(long, value_name = "T", value_parser = tolerance, allow_negative_numbers = true)]
    tolerance: Option<f64>,
    /// auto (each tile in the cheapest way), lowrank (by transforms alone), basis (a convolution a component; exact), patch=N (one
    /// PSF in N x N pixels; not exact) or direct (the double sum)
    #[arg(long, default_value_t, value_name = "METHOD")]
    method: Method,
    /// Memory of the plan of auto and lowrank, beside scene and image: bytes, or with K, M or G [default: 256M]
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
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

/// What becomes of a scene.
struct Outcome<T: ConvReal> {
    image_shape: FrameShape,
    sources: usize,
    galaxies: usize,
    invalid_rows: usize,
    rows_off_projection: usize,
    seconds: Seconds,
    plan: Option<(PlanSummary, TileCounts)>,
    spot_check: Option<SpotCheck>,
    exposure: Option<ExposureReport>,
    prepared: Arc<Prepared<T>>,
    streamed: bool,
}

impl SimulateArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        let report = self.simulate(&mut Preparations::default(), context)?;
        context.report(&report, || report.text())?;
        report.verdict()
    }

    /// The whole run, with what earlier runs prepared where it fits.
    ///
    /// A failed spot check is in the report ([`Report::verdict`]): the image is written all the same.
    pub(crate) fn simulate(
        &self,
        preparations: &mut Preparations,
        context: &Context,
    ) -> anyhow::Result<Report> {
        if let Some(what) = self.misused()? {
            return Err(UsageError(what).into());
        }
        let simulated = match self.precision {
            Precision::F32 => self.simulate_in::<f32>(preparations, context),
            Precision::F64 => self.simulate_in::<f64>(preparations, context),
        };
        simulated.map_err(|error| {
            let of_gpu = error
                .downcast_ref::<PsfieldError>()
                .is_some_and(PsfieldError::is_of_gpu);
            if of_gpu {
                preparations.forget_gpus();
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
    pub(crate) fn misused(&self) -> anyhow::Result<Option<String>> {
        let planned = self.plan_options()?.is_some();
        let what = [
            (
                self.tolerance.is_some() && !planned,
                "--tolerance is of the methods auto and lowrank",
            ),
            (
                self.memory.is_some() && !planned,
                "--memory is of the methods auto and lowrank",
            ),
            (
                self.stream && self.scene.scene.is_none(),
                "--stream is of scenes that are images: there is no scene here",
            ),
            (
                self.stream && !planned,
                "--stream is of the methods auto and lowrank",
            ),
            (
                self.stream && self.exposure.detector.is_some(),
                "--stream and --detector do not go together: expose the image afterwards (psfield expose)",
            ),
        ];
        let single = matches!(self.precision, Precision::F32);
        let first = what
            .into_iter()
            .find_map(|(wrong, what)| wrong.then_some(what))
            .or_else(|| self.device.misused(planned, single));
        Ok(self.scene.missing().or(first.map(str::to_owned)))
    }

    fn simulate_in<T: ConvReal>(
        &self,
        preparations: &mut Preparations,
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
        self.open_gpu(preparations.gpus(), context)?;
        let outcome = match self.streamed::<T>()? {
            Some(path) => self.by_bands::<T>(&path, preparations, context)?,
            None => self.in_memory::<T>(exposing.as_ref(), preparations, context)?,
        };
        let model = outcome.prepared.simulation.model();
        let plan = outcome.plan.as_ref();
        Ok(Report {
            output: self.output.clone(),
            method: self.method.to_string(),
            anchor: self.anchor,
            precision: T::NAME,
            tolerance: self.promised()?,
            rank: model.rank(),
            modes: plan.map_or(model.stamp_count() as f64, |(plan, _)| plan.mean_modes()),
            normalise: model.normalisation(),
            shape: [outcome.image_shape.nx(), outcome.image_shape.ny()],
            sources: outcome.sources,
            galaxies: outcome.galaxies,
            invalid_rows: outcome.invalid_rows,
            rows_off_projection: outcome.rows_off_projection,
            streamed: outcome.streamed,
            plan: plan.map(|(plan, _)| PlanReport::of(plan)),
            tiles: plan.map(|&(_, counts)| TilesReport::of(counts)),
            plan_text: plan.map(|(plan, _)| plan.to_string()),
            device: DeviceReport::of(&outcome.prepared.placement),
            seconds: outcome.seconds,
            peak_memory_bytes: peak_memory_bytes(),
            spot_check: outcome.spot_check,
            exposure: outcome.exposure,
        })
    }

    /// Models and plan for a scene.
    fn prepared<T: ConvReal>(
        &self,
        parts: SceneParts,
        scene: &Scene<T>,
        preparations: &mut Preparations,
        seconds: &mut Seconds,
        context: &Context,
    ) -> anyhow::Result<Arc<Prepared<T>>> {
        let options = self.simulation_options()?;
        // All that a preparation depends on.
        let key = format!(
            "{:?}",
            (
                (&self.psf, &self.fit, parts, scene.shape(), scene.frame()),
                (options, self.method, self.plan_options()?, T::NAME),
                self.device.options(),
            )
        );
        let psf = self.psf(preparations, seconds, context)?;
        preparations.forget_single_psf();
        let own = || Arc::try_unwrap(psf).unwrap_or_else(|kept| (*kept).clone());
        let (prepared, new) =
            preparations.get(&key, |gpus| self.prepare(parts, scene, own(), gpus, context))?;
        if new {
            [seconds.fit, seconds.plan] = prepared.seconds;
        }
        self.warn_of_placement(&prepared.placement, context);
        Ok(prepared)
    }

    /// The PSF of the file, kept or read.
    fn psf(
        &self,
        preparations: &mut Preparations,
        seconds: &mut Seconds,
        context: &Context,
    ) -> anyhow::Result<Arc<PsfInput>> {
        let key = format!("{:?}", (&self.psf, &self.fit));
        preparations.psf(&key, || {
            let _spinner = context.spinner("reading the PSF");
            let (psf, read) = timed(|| self.fit.open(&self.psf, context))?;
            seconds.read += read;
            Ok(psf)
        })
    }

    fn prepare<T: ConvReal>(
        &self,
        parts: SceneParts,
        scene: &Scene<T>,
        psf: PsfInput,
        gpus: &mut Gpus,
        context: &Context,
    ) -> anyhow::Result<Prepared<T>> {
        let options = self.simulation_options()?;
        let oversampling = psf.grid().oversampling();
        if let Some(warning) = SimulationWarning::of_psf(&psf, parts, options)? {
            context.warn(&warning.to_string());
        }
        let spinner = context.spinner("fitting the PSF");
        let (simulation, fit) = timed(|| {
            Simulation::for_parts(psf, parts, options)
                .with_context(|| format!("with the PSF of {}", self.psf.display()))
        })?;
        drop(spinner);
        let _spinner = context.spinner("planning");
        let ((plan, placement), planning) = timed(|| {
            let Some(options) = self.plan_options()? else {
                return Ok((None, self.unplanned()));
            };
            let mut plan = if parts.image {
                simulation.plan_for_images(scene, options)
            } else {
                simulation.plan(scene, options)
            }?;
            let placement = gpus.place(&mut plan, &self.device.options(), rayon::current_num_threads())?;
            Ok((Some(plan), placement))
        })?;
        Ok(Prepared {
            simulation,
            plan,
            placement,
            oversampling,
            seconds: [fit, planning],
        })
    }

    /// The scene's file, if its rows are to be streamed.
    fn streamed<T: ConvReal>(&self) -> anyhow::Result<Option<PathBuf>> {
        let (Some(path), Some(_), None) = (&self.scene.scene, self.plan_options()?, &self.exposure.detector)
        else {
            return Ok(None);
        };
        if self.stream {
            return Ok(Some(path.clone()));
        }
        let Some(free) = available_memory_bytes() else {
            return Ok(None);
        };
        // What cannot be opened is told of by the reader proper.
        let Ok(reader) = self.scene.open(path) else {
            return Ok(None);
        };
        let shown = match self.scene.frame {
            Some(Frame(frame)) => frame.shape().pixel_count() * self.scene.finer().pow(2),
            None => reader.shape().pixel_count(),
        };
        let pixels = reader.shape().pixel_count() + shown;
        let too_large = pixels as f64 * size_of::<T>() as f64 > IN_MEMORY * free as f64;
        Ok(too_large.then(|| path.clone()))
    }

    /// The options of the engine, whatever the method.
    fn options(&self) -> anyhow::Result<PlanOptions> {
        let tolerance = self.tolerance.unwrap_or(PlanOptions::DEFAULT_TOLERANCE);
        let memory = self.memory.unwrap_or(PlanOptions::DEFAULT_MEMORY_BYTES);
        Ok(PlanOptions::new(tolerance)?
            .with_anchor(self.anchor)
            .with_memory(memory))
    }

    /// The options of the plan, for methods that have one.
    fn plan_options(&self) -> anyhow::Result<Option<PlanOptions>> {
        Ok(self.method.plan_options(self.options()?))
    }

    /// The tolerance, of methods that have one.
    fn promised(&self) -> anyhow::Result<Option<f64>> {
        Ok(self.plan_options()?.map(|options| options.tolerance()))
    }

    fn simulation_options(&self) -> anyhow::Result<SimulationOptions> {
        Ok(SimulationOptions::default()
            .with_stamp_size(self.stamp_size)
            .with_anchor(self.anchor)
            .with_oversample(self.scene.finer())?)
    }

    /// The shape of the image.
    fn shown<T: ConvReal>(&self, scene: &Scene<T>) -> anyhow::Result<FrameShape> {
        let (shape, s) = (scene.frame().shape(), self.scene.finer());
        Ok(FrameShape::new(shape.nx() / s, shape.ny() / s)?)
    }

    /// The check with a verdict, unless the method promises nothing.
    fn judged<T: ConvReal>(&self, check: Option<SpotCheck>) -> anyhow::Result<Option<SpotCheck>> {
        let limit = SpotCheck::limit_of::<T>(self.method, self.options()?, self.scene.scene.is_some());
        Ok(match limit {
            Some(limit) => check.map(|check| check.judged(limit)),
            None => check,
        })
    }
}
