//! `psfield simulate`.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context as _;
use conv_core::ConvReal;
use psf_io::{Card, HeaderCards};
use psf_types::{Anchor, FrameShape, PointSource, Scene};
use psfield::{Method, PsfInput, Simulation, SpotCheck};
use serde::Serialize;

use super::UsageError;
use super::context::{CHECK_KEYWORDS, Context, check_cards, signature};
use super::fit_args::FitArgs;
use super::values::{Frame, Pair, Precision, stamp_size};

/// Convolve a scene with a PSF that varies over the field
///
/// The scene is an image (flux in each pixel), a catalogue of point sources, or both. Field positions of the PSF count from the
/// frame's first pixel.
#[derive(Debug, clap::Args)]
pub(crate) struct SimulateArgs {
    /// The scene: a FITS image. Without one: --catalog and --shape
    #[arg(value_name = "SCENE.fits")]
    scene: Option<PathBuf>,
    /// The PSF: a model, or samples to be fitted
    #[arg(long, value_name = "MODEL.fits|SAMPLES.fits")]
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
    /// auto, basis (a convolution a component; exact), patch=N (one PSF in N x N pixels; not exact) or direct (the double sum)
    #[arg(long, default_value_t, value_name = "METHOD")]
    method: Method,
    /// Working precision and that of the result
    #[arg(long, default_value = "f32", value_enum)]
    precision: Precision,
    /// Cut or pad the stamps that images are convolved with to N x N pixels, centred at N / 2; stars are drawn from the stamps
    /// as they are
    #[arg(long, value_name = "N", value_parser = stamp_size)]
    stamp_size: Option<usize>,
    /// Check N random pixels against the direct sum in double precision
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=MAX_SPOT_CHECK))]
    spot_check: u32,
    /// Chooses the pixels of the spot check
    #[arg(long, default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    fit: FitArgs,
}

/// More pixels than that are a slip.
const MAX_SPOT_CHECK: i64 = 10_000_000;

/// Stamps with fewer pixels a frame pixel than this may be too coarse to be interpolated.
const FINE_ENOUGH: f64 = 2.0;

/// The largest frame that can be asked for, 4 GiB in f32; a larger number is a slip.
const MAX_PIXELS: usize = 1 << 30;

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct Report {
    output: PathBuf,
    method: String,
    anchor: Anchor,
    precision: &'static str,
    /// Components of the model, the mean not counted.
    rank: usize,
    /// Whole-image convolutions of the basis method.
    modes: usize,
    normalise: psf_types::Normalisation,
    shape: [usize; 2],
    sources: usize,
    seconds: Seconds,
    peak_memory_bytes: Option<u64>,
    spot_check: Option<SpotCheck>,
}

/// `plan` is the time that the engine takes to prepare itself; the methods so far prepare nothing.
#[derive(Debug, Default, Serialize)]
struct Seconds {
    read: f64,
    fit: f64,
    plan: f64,
    execute: f64,
    write: f64,
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
            (None, Some(_), Some(_)) if self.stamp_size.is_some() => {
                Some("--stamp-size is of the stamps that images are convolved with: there is no image here")
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
        let mut seconds = Seconds::default();

        let spinner = context.spinner("reading");
        let clock = Instant::now();
        let (scene, header) = self.read_scene::<T>()?;
        let psf = self.fit.open(&self.psf)?;
        seconds.read = clock.elapsed().as_secs_f64();
        drop(spinner);

        let spinner = context.spinner("fitting the PSF");
        let clock = Instant::now();
        self.warn_of_interpolated_stamps(&psf, &scene, context)?;
        let in_psf = || format!("with the PSF of {}", self.psf.display());
        let simulation = Simulation::new(psf, &scene, self.stamp_size).with_context(in_psf)?;
        seconds.fit = clock.elapsed().as_secs_f64();
        drop(spinner);

        let bar = context.bar("convolving");
        let clock = Instant::now();
        let method = self.method.build::<T>(self.anchor)?;
        let image = simulation.run_with(&scene, method.as_ref(), &bar)?;
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

        let clock = Instant::now();
        let model = simulation.model();
        let frame = scene.frame();
        let mut header = header.shifted_origin(frame.x0(), frame.y0());
        // A scene that is itself a result must not lend its own check to this one.
        for keyword in CHECK_KEYWORDS {
            header.remove(keyword);
        }
        let cards = self.cards::<T>(model, spot_check.as_ref())?;
        psf_io::write_image(&self.output, &image, &header, &cards, self.overwrite)?;
        seconds.write = clock.elapsed().as_secs_f64();

        let report = Report {
            output: self.output,
            method: self.method.resolved().to_string(),
            anchor: self.anchor,
            precision: T::NAME,
            rank: model.rank(),
            modes: model.stamp_count(),
            normalise: model.normalisation(),
            shape: [image.shape().nx(), image.shape().ny()],
            sources: scene.sources().len(),
            seconds,
            peak_memory_bytes: peak_memory_bytes(),
            spot_check,
        };
        context.report(&report, || report.text())
    }

    /// Says where stamps are interpolated between their pixels, which nothing here can check.
    fn warn_of_interpolated_stamps<T: ConvReal>(
        &self,
        psf: &PsfInput,
        scene: &Scene<T>,
        context: &Context,
    ) -> anyhow::Result<()> {
        if scene.image().is_some() && !psf.native_is_exact(self.stamp_size)? {
            context.warn(
                "the PSF stamps are not sampled at the centres of the frame's pixels: they are interpolated (cubic spline)",
            );
        }
        let between_pixels =
            |s: &PointSource| s.position().x().fract() != 0.0 || s.position().y().fract() != 0.0;
        if psf.grid().oversampling() < FINE_ENOUGH && scene.sources().iter().any(between_pixels) {
            context.warn(
                "stars lie between pixels, and the PSF stamps are not oversampled: they are interpolated (cubic spline), which is wrong \
                 by percents where the PSF is under-sampled; the spot check does not see that",
            );
        }
        Ok(())
    }

    fn read_scene<T: ConvReal>(&self) -> anyhow::Result<(Scene<T>, HeaderCards)> {
        let (mut scene, header) = match (&self.scene, self.shape) {
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
        if let Some(path) = &self.catalog {
            let sources = psf_io::read_catalog(path)?;
            scene = scene.with_sources(sources);
        }
        if let Some(Frame(frame)) = self.frame {
            scene = scene
                .with_frame(frame)
                .map_err(|e| UsageError(format!("--frame: {e}")))?;
        }
        Ok((scene, header))
    }

    /// What is needed to repeat and to judge the result.
    fn cards<T: ConvReal>(
        &self,
        model: &psf_types::PsfModel,
        spot_check: Option<&SpotCheck>,
    ) -> anyhow::Result<Vec<Card>> {
        let mut cards = signature();
        cards.extend([
            Card::new(
                "PSFMETH",
                self.method.resolved().to_string(),
                "convolution method",
            )?,
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
        if let Some(check) = spot_check {
            cards.extend(check_cards(check)?);
        }
        Ok(cards)
    }
}

impl Report {
    fn text(&self) -> String {
        let [nx, ny] = self.shape;
        let s = &self.seconds;
        let check = self.spot_check.as_ref().map_or_else(String::new, |check| {
            let over_peak = check
                .max_over_peak
                .map_or_else(String::new, |m| format!(" ({m:.1e} of the peak)"));
            format!(
                "against the direct sum at {} pixels: largest difference {:.2e}{over_peak}, r.m.s. {:.2e}\n",
                check.pixels, check.max_abs, check.rms,
            )
        });
        format!(
            "{}: {nx} x {ny} pixels, {} components, method {}, {}-anchored, {}\n\
             seconds: read {:.3}, fit {:.3}, convolve {:.3}, write {:.3}\n{check}",
            self.output.display(),
            self.rank,
            self.method,
            self.anchor,
            self.precision,
            s.read,
            s.fit,
            s.execute,
            s.write,
        )
    }
}

/// The most memory this process has held, where the system tells (Linux).
fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes * 1024)
}
