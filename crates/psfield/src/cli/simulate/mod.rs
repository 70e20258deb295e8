//! `psfield simulate`.

mod banded;
mod report;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context as _;
use conv_core::{ConvReal, PlanOptions, TileCounts};
use psf_io::{Card, HeaderCards, ImageReader, ImageWriter};
use psf_types::{Anchor, FrameShape, PixelRegion, PointSource, Position, Scene};
use psfield::{
    Method, PixelPicker, PsfInput, PsfieldError, SceneParts, Simulation, SimulationOptions, SimulationPlan,
    SpotCheck, available_memory_bytes, peak_memory_bytes,
};

use super::UsageError;
use super::context::{CHECK_KEYWORDS, Context, check_cards, signature};
use super::fit_args::PsfArgs;
use super::values::{Frame, Pair, Precision, bytes, stamp_size, tolerance};
use banded::FitsRows;
use report::{PlanReport, Report, Seconds, TilesReport};

/// Convolve a scene with a PSF that varies over the field
///
/// The scene is an image (flux in each pixel), a catalogue of point sources, or both. Field positions of the PSF count from the
/// frame's first pixel.
#[derive(Debug, clap::Args)]
pub(crate) struct SimulateArgs {
    /// The scene: a FITS image. Without one: --catalog and --shape
    #[arg(value_name = "SCENE.fits")]
    scene: Option<PathBuf>,
    /// The PSF: a model, samples to be fitted, or any other PSF file (PSFEx, STPSF, STDPSF, ScopeSim, plain stamps)
    #[arg(long, value_name = "PSF")]
    psf: PathBuf,
    /// The image to write
    #[arg(short, long, value_name = "IMAGE.fits")]
    output: PathBuf,
    /// Replace the output if it exists
    #[arg(long)]
    overwrite: bool,
    /// Point sources: CSV or FITS table with columns x, y (0-based pixels of the scene) and flux
    #[arg(long, value_name = "STARS.csv")]
    catalog: Option<PathBuf>,
    /// Columns and rows of a scene without an image
    #[arg(
        long,
        value_name = "NX,NY",
        conflicts_with = "scene",
        allow_hyphen_values = true
    )]
    shape: Option<Pair>,
    /// The part of the scene that the result shows: first column and row, columns and rows
    #[arg(long, value_name = "X0,Y0,NX,NY", allow_hyphen_values = true)]
    frame: Option<Frame>,
    /// Whose PSF applies: source (each source spreads with its own) or output (each pixel gathers with its own, as in the
    /// method's paper)
    #[arg(long, default_value_t, value_name = "source|output")]
    anchor: Anchor,
    /// The largest relative L2 error that the engine may add to the PSF of any single pixel, from 0 to below 1; 0: rounding alone.
    /// Of the methods auto and lowrank [default: 1e-4]
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
    /// The scene is finer than the frame: S x S of its pixels are one of the image. Positions, --shape and --frame are in pixels of
    /// the image all the same, and the response of its pixels is applied once
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u16).range(1..=SimulationOptions::MAX_OVERSAMPLE as i64))]
    oversample: Option<u16>,
    /// Cut or pad the stamps to N x N pixels of the image, centred at N / 2; stars are cut to as many
    #[arg(long, value_name = "N", value_parser = stamp_size)]
    stamp_size: Option<usize>,
    /// Check N random pixels, half of them where the image is bright, against the direct sum in double precision. A difference
    /// beyond what the method promises is an error, after the image is written
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=MAX_SPOT_CHECK))]
    spot_check: u32,
    /// Chooses the pixels of the spot check
    #[arg(long, default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    fit: PsfArgs,
}

/// More pixels than that are a slip.
const MAX_SPOT_CHECK: i64 = 10_000_000;

/// Stamps with fewer pixels a frame pixel than this may be too coarse to be interpolated.
const FINE_ENOUGH: f64 = 2.0;

/// The largest frame that can be asked for, 4 GiB in f32; a larger number is a slip.
const MAX_PIXELS: usize = 1 << 30;

/// Scene and image may fill this part of the free memory; larger ones are streamed.
const IN_MEMORY: f64 = 0.7;

/// Relative r.m.s. errors of images by transforms: a few 1e-7 and 1e-15, and more where a scene's light varies by decades.
const ROUNDING_F32: f64 = 1e-5;
const ROUNDING_F64: f64 = 1e-10;
/// Single pixels may hold more of a PSF's error than the PSF as a whole.
const PIXELS_OVER_PSF: f64 = 3.0;

/// What becomes of a scene.
struct Outcome {
    image_shape: FrameShape,
    sources: usize,
    seconds: Seconds,
    plan: Option<(conv_core::PlanSummary, TileCounts)>,
    spot_check: Option<SpotCheck>,
    streamed: bool,
}

impl SimulateArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        let missing = match (&self.scene, &self.catalog, self.shape) {
            (None, None, _) => Some(
                "there is nothing to convolve: give a scene (SCENE.fits), point sources (--catalog STARS.csv --shape NX,NY), \
                 or both (SCENE.fits --catalog STARS.csv)",
            ),
            (None, Some(_), None) => {
                Some("a catalogue without a scene needs the frame's size: --shape NX,NY")
            }
            (None, _, _) if self.oversample.is_some() => {
                Some("--oversample is of scenes that are images: there is no image here")
            }
            _ if self.tolerance.is_some() && self.promised()?.is_none() => {
                Some("--tolerance is of the methods auto and lowrank")
            }
            _ if self.memory.is_some() && self.plan_options()?.is_none() => {
                Some("--memory is of the methods auto and lowrank")
            }
            _ if self.stream && self.scene.is_none() => {
                Some("--stream is of scenes that are images: there is no scene here")
            }
            _ if self.stream && self.plan_options()?.is_none() => {
                Some("--stream is of the methods auto and lowrank")
            }
            _ => None,
        };
        if let Some(what) = missing {
            return Err(UsageError(what.to_owned()).into());
        }
        match self.precision {
            Precision::F32 => self.run_in::<f32>(context),
            Precision::F64 => self.run_in::<f64>(context),
        }
    }

    fn run_in<T: ConvReal>(self, context: &Context) -> anyhow::Result<()> {
        psf_io::check_output(&self.output, self.overwrite)?;
        let clock = Instant::now();
        let psf = {
            let _spinner = context.spinner("reading");
            self.fit.open(&self.psf, context)?
        };
        let seconds = Seconds {
            read: clock.elapsed().as_secs_f64(),
            ..Seconds::default()
        };
        let (simulation, outcome) = match self.streamed::<T>()? {
            Some(path) => self.by_bands::<T>(&path, psf, seconds, context)?,
            None => self.in_memory::<T>(psf, seconds, context)?,
        };
        let failed = outcome
            .spot_check
            .as_ref()
            .is_some_and(|check| check.passed == Some(false));
        let model = simulation.model();
        let plan = outcome.plan.as_ref();
        let report = Report {
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
            streamed: outcome.streamed,
            plan: plan.map(|(plan, _)| PlanReport::of(plan)),
            tiles: plan.map(|&(_, counts)| TilesReport::of(counts)),
            plan_text: plan.map(|(plan, _)| plan.to_string()),
            seconds: outcome.seconds,
            peak_memory_bytes: peak_memory_bytes(),
            spot_check: outcome.spot_check,
        };
        context.report(&report, || report.text())?;
        if failed {
            anyhow::bail!(
                "{} was written, but it failed its spot check: it differs from the direct sum by more than the method promises",
                self.output.display()
            );
        }
        Ok(())
    }

    fn in_memory<T: ConvReal>(
        &self,
        psf: PsfInput,
        mut seconds: Seconds,
        context: &Context,
    ) -> anyhow::Result<(Simulation, Outcome)> {
        let spinner = context.spinner("reading");
        let clock = Instant::now();
        let (scene, header) = self.read_scene::<T>()?;
        seconds.read += clock.elapsed().as_secs_f64();
        drop(spinner);
        let simulation = self.simulation(
            psf,
            SceneParts::of(&scene),
            scene.sources(),
            &mut seconds,
            context,
        )?;

        let plan = match self.plan_options()? {
            Some(options) => Some(timed(&mut seconds, context, || simulation.plan(&scene, options))?),
            None => None,
        };
        let bar = context.bar("convolving");
        let clock = Instant::now();
        let (image, plan) = if let Some(plan) = plan {
            let (image, counts) = simulation.run_planned(&plan, &scene, &bar)?;
            (image, plan.summary().map(|summary| (summary, counts)))
        } else {
            let method = self.method.build::<T>(self.options()?)?;
            (
                simulation.run_with(&scene, method.as_ref(), self.anchor, &bar)?,
                None,
            )
        };
        seconds.execute = clock.elapsed().as_secs_f64();
        drop(bar);

        let spot_check = (self.spot_check > 0)
            .then(|| {
                let _spinner = context.spinner("checking");
                SpotCheck::run(&image, self.spot_check as usize, self.seed, |pixels| {
                    simulation.exact_at(&scene, self.anchor, pixels)
                })
            })
            .transpose()?;
        let spot_check = self.judged::<T>(spot_check)?;

        let clock = Instant::now();
        let mut cards = self.cards::<T>(simulation.model())?;
        cards.extend(
            spot_check
                .as_ref()
                .map(check_cards)
                .transpose()?
                .into_iter()
                .flatten(),
        );
        let header = self.carried(&header, &scene);
        psf_io::write_image(&self.output, &image, &header, &cards, self.overwrite)?;
        seconds.write = clock.elapsed().as_secs_f64();
        let outcome = Outcome {
            image_shape: image.shape(),
            sources: scene.sources().len(),
            seconds,
            plan,
            spot_check,
            streamed: false,
        };
        Ok((simulation, outcome))
    }

    fn by_bands<T: ConvReal>(
        &self,
        path: &Path,
        psf: PsfInput,
        mut seconds: Seconds,
        context: &Context,
    ) -> anyhow::Result<(Simulation, Outcome)> {
        let mut reader = ImageReader::open(path)?;
        let scene = self.dressed(Scene::<T>::dark(reader.shape()))?;
        let parts = SceneParts {
            image: true,
            ..SceneParts::of(&scene)
        };
        let simulation = self.simulation(psf, parts, scene.sources(), &mut seconds, context)?;
        let options = self.options()?;
        let options = self.method.plan_options(options).unwrap_or(options);
        let plan = timed(&mut seconds, context, || {
            simulation.plan_for_images(&scene, options)
        })?;
        let shape = self.shown(&scene)?;
        let header = self.carried(reader.header(), &scene);
        let cards = self.cards::<T>(simulation.model())?;
        // None without a check, so that the header is as long as that of an image written as a whole.
        let late = if self.spot_check > 0 {
            CHECK_KEYWORDS.len()
        } else {
            0
        };
        let writer =
            ImageWriter::create_reserving(&self.output, shape, &header, &cards, late, self.overwrite)?;

        let bar = context.bar("convolving");
        let clock = Instant::now();
        let mut rows = FitsRows {
            reader: &mut reader,
            writer,
            picker: PixelPicker::new(shape, self.spot_check as usize, self.seed),
            read_seconds: 0.0,
            write_seconds: 0.0,
        };
        let counts = simulation.stream(&plan, &scene, &mut rows, &bar)?;
        let FitsRows {
            writer,
            picker,
            read_seconds,
            write_seconds,
            ..
        } = rows;
        seconds.execute = clock.elapsed().as_secs_f64() - read_seconds - write_seconds;
        seconds.read += read_seconds;
        drop(bar);

        let spot_check = (self.spot_check > 0)
            .then(|| {
                let _spinner = context.spinner("checking");
                SpotCheck::of_picked(picker, |pixels| {
                    banded::exact_at(&simulation, &mut reader, &scene, self.anchor, pixels)
                })
            })
            .transpose()?;
        let spot_check = self.judged::<T>(spot_check)?;
        let clock = Instant::now();
        let cards: Vec<Card> = spot_check
            .as_ref()
            .map(check_cards)
            .transpose()?
            .into_iter()
            .flatten()
            .collect();
        writer.finish_with(&cards)?;
        seconds.write = write_seconds + clock.elapsed().as_secs_f64();
        let outcome = Outcome {
            image_shape: shape,
            sources: scene.sources().len(),
            seconds,
            plan: plan.summary().map(|summary| (summary, counts)),
            spot_check,
            streamed: true,
        };
        Ok((simulation, outcome))
    }

    /// The scene's file, if its rows are to be streamed.
    fn streamed<T: ConvReal>(&self) -> anyhow::Result<Option<PathBuf>> {
        let (Some(path), Some(_)) = (&self.scene, self.plan_options()?) else {
            return Ok(None);
        };
        if self.stream {
            return Ok(Some(path.clone()));
        }
        let Some(free) = available_memory_bytes() else {
            return Ok(None);
        };
        // What cannot be opened is told of by the reader proper.
        let Ok(reader) = ImageReader::open(path) else {
            return Ok(None);
        };
        let shown = match self.frame {
            Some(Frame(frame)) => frame.shape().pixel_count() * self.finer().pow(2),
            None => reader.shape().pixel_count(),
        };
        let pixels = reader.shape().pixel_count() + shown;
        let too_large = pixels as f64 * size_of::<T>() as f64 > IN_MEMORY * free as f64;
        Ok(too_large.then(|| path.clone()))
    }

    fn simulation(
        &self,
        psf: PsfInput,
        parts: SceneParts,
        sources: &[PointSource],
        seconds: &mut Seconds,
        context: &Context,
    ) -> anyhow::Result<Simulation> {
        let _spinner = context.spinner("fitting the PSF");
        let clock = Instant::now();
        self.warn_of_interpolated_stamps(&psf, parts, sources, context)?;
        let in_psf = || format!("with the PSF of {}", self.psf.display());
        let simulation =
            Simulation::for_parts(psf, parts, self.simulation_options()?).with_context(in_psf)?;
        seconds.fit = clock.elapsed().as_secs_f64();
        Ok(simulation)
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

    /// Pixels of the scene along each side of a frame pixel.
    fn finer(&self) -> usize {
        self.oversample.map_or(1, usize::from)
    }

    fn simulation_options(&self) -> anyhow::Result<SimulationOptions> {
        Ok(SimulationOptions::default()
            .with_stamp_size(self.stamp_size)
            .with_anchor(self.anchor)
            .with_oversample(self.finer())?)
    }

    /// The shape of the image.
    fn shown<T: ConvReal>(&self, scene: &Scene<T>) -> anyhow::Result<FrameShape> {
        let shape = scene.frame().shape();
        Ok(FrameShape::new(
            shape.nx() / self.finer(),
            shape.ny() / self.finer(),
        )?)
    }

    /// The scene's cards as the image carries them.
    fn carried<T: ConvReal>(&self, header: &HeaderCards, scene: &Scene<T>) -> HeaderCards {
        let mut header = header
            .shifted_origin(scene.frame().x0(), scene.frame().y0())
            .binned(self.finer());
        // A scene that is itself a result must not lend its own check to this one.
        for keyword in CHECK_KEYWORDS {
            header.remove(keyword);
        }
        header
    }

    /// The check with a verdict, unless the method promises nothing.
    fn judged<T: ConvReal>(&self, check: Option<SpotCheck>) -> anyhow::Result<Option<SpotCheck>> {
        let rounding = if size_of::<T>() == 4 {
            ROUNDING_F32
        } else {
            ROUNDING_F64
        };
        let limit = match (self.method, self.promised()?) {
            (Method::Patch(_), _) if self.scene.is_some() => None,
            (_, Some(tolerance)) => Some(PIXELS_OVER_PSF * tolerance + rounding),
            (_, None) => Some(rounding),
        };
        Ok(match limit {
            Some(limit) => check.map(|check| check.judged(limit)),
            None => check,
        })
    }

    /// Says where stamps are interpolated between their pixels, which nothing here can check.
    fn warn_of_interpolated_stamps(
        &self,
        psf: &PsfInput,
        parts: SceneParts,
        sources: &[PointSource],
        context: &Context,
    ) -> anyhow::Result<()> {
        if parts.image && !psf.native_is_exact(self.stamp_size)? {
            context.warn(
                "the PSF stamps are not sampled at the centres of the frame's pixels: they are interpolated (cubic spline)",
            );
        }
        let between_pixels =
            |s: &PointSource| s.position().x().fract() != 0.0 || s.position().y().fract() != 0.0;
        if psf.grid().oversampling() < FINE_ENOUGH && sources.iter().any(between_pixels) {
            context.warn(
                "stars lie between pixels, and the PSF stamps are not oversampled: they are interpolated (cubic spline), which is wrong \
                 by percents where the PSF is under-sampled; the spot check does not see that",
            );
        }
        Ok(())
    }

    fn read_scene<T: ConvReal>(&self) -> anyhow::Result<(Scene<T>, HeaderCards)> {
        let (scene, header) = match (&self.scene, self.shape) {
            (Some(path), _) => {
                let (image, header) = psf_io::read_image::<T>(path)?.into_parts();
                (Scene::from_image(image), header)
            }
            (None, Some(Pair(nx, ny))) => {
                if nx.checked_mul(ny).is_none_or(|pixels| pixels > MAX_PIXELS) {
                    return Err(UsageError(format!("--shape: {nx} x {ny} pixels are too many")).into());
                }
                let shape = FrameShape::new(nx, ny).map_err(|e| UsageError(format!("--shape: {e}")))?;
                (Scene::dark(shape), HeaderCards::new())
            }
            (None, None) => unreachable!("checked before"),
        };
        Ok((self.dressed(scene)?, header))
    }

    /// The scene with the catalogue's sources and the frame.
    fn dressed<T: ConvReal>(&self, mut scene: Scene<T>) -> anyhow::Result<Scene<T>> {
        let s = self.finer() as i64;
        // Everything in a scene is in its own pixels.
        let of_scene = |v: f64| v * s as f64 + (s as f64 - 1.0) / 2.0;
        if let Some(path) = &self.catalog {
            let sources = psf_io::read_catalog(path)?.into_iter().map(|source| {
                let (x, y) = (source.position().x(), source.position().y());
                PointSource::new(Position::new(of_scene(x), of_scene(y))?, source.flux())
            });
            scene = scene.with_sources(sources.collect::<Result<_, _>>()?);
        }
        let shape = scene.shape();
        if self.frame.is_none() && [shape.nx(), shape.ny()].iter().any(|n| n % self.finer() != 0) {
            anyhow::bail!(
                "the scene is {shape} pixels, which is no multiple of --oversample {s}: cut it, or choose a part of it with --frame"
            );
        }
        if let Some(Frame(frame)) = self.frame {
            let shape = FrameShape::new(
                frame.shape().nx() * self.finer(),
                frame.shape().ny() * self.finer(),
            )?;
            scene = scene
                .with_frame(PixelRegion::new(frame.x0() * s, frame.y0() * s, shape))
                .map_err(|e| UsageError(format!("--frame: {e}")))?;
        }
        Ok(scene)
    }

    /// What is needed to repeat the result.
    fn cards<T: ConvReal>(&self, model: &psf_types::PsfModel) -> anyhow::Result<Vec<Card>> {
        let mut cards = signature();
        cards.extend([
            Card::new("PSFMETH", self.method.to_string(), "convolution method")?,
            Card::new(
                "PSFANCH",
                self.anchor.to_string(),
                "whose PSF applies: source or output pixel",
            )?,
            Card::new("PSFPREC", T::NAME, "working precision")?,
            Card::new(
                "PSFRANK",
                model.rank(),
                "components of the PSF model (mean not counted)",
            )?,
            Card::new(
                "PSFNORM",
                model.normalisation().to_string(),
                "unit: every PSF has unit flux",
            )?,
        ]);
        if let Some(tolerance) = self.promised()? {
            cards.push(Card::new(
                "PSFTOL",
                tolerance,
                "relative L2 error allowed for any pixel's PSF",
            )?);
        }
        Ok(cards)
    }
}

/// Plans, and takes the time.
fn timed<T: ConvReal>(
    seconds: &mut Seconds,
    context: &Context,
    plan: impl FnOnce() -> Result<SimulationPlan<T>, PsfieldError>,
) -> anyhow::Result<SimulationPlan<T>> {
    let _spinner = context.spinner("planning");
    let clock = Instant::now();
    let plan = plan()?;
    seconds.plan = clock.elapsed().as_secs_f64();
    Ok(plan)
}
