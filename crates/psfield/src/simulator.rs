//! Makes images of scenes through a PSF.

mod both_precisions;
mod builder;
mod check;
mod colours;
mod derived;
mod flux;
mod geometry;
mod many;
mod mixtures;
mod sources;
mod stamp_sampling;
mod stream;
#[cfg(test)]
mod tests;
mod warnings;

use std::sync::{Arc, OnceLock};
use std::time::Instant;

use conv_core::{
    ConvError, ConvReal, ConvolutionMethod, Engine, Operation, Plan, PlanOptions, PlanSummary, TileCounts,
};
use ndarray::{Array2, ArrayViewMut2};
use psf_types::{DataError, FrameShape, Image, ImageView, NoProgress, PixelRegion, Progress, PsfModel};

use crate::device::{self, CpuReason, GpuSeconds, Placement};
use crate::psf::get_or_make;
use crate::{Device, ErrorKind, Psf, PsfieldError, Scene, ScenePixels, SimulateOptions};

use flux::check_flux;
use geometry::Geometry;
use sources::{Sources, has_sources};

pub use builder::{OwnMethodBuilder, SimulatorBuilder};
pub(crate) use check::spot_check_layers;
pub use colours::ColourSimulator;
pub(crate) use mixtures::{Mixture, Mixtures};
pub use stamp_sampling::SamplingErrors;
pub use warnings::SimulationWarning;

/// The start of the error message for a region with a method that makes no plan
/// ([`PsfieldError::needs_plan`]).
const REGION: &str = "a region of the frame can be computed";

/// Makes images of scenes of one shape through a PSF. Models and plans are made when the first
/// scene needs them, and kept for all later scenes. [`prepare`](Self::prepare) makes them
/// beforehand. Many threads may use one simulator at the same time, each with its own scene. If two
/// threads need a plan before it exists, both make it, and one result is kept.
///
/// The image in a scene is convolved with stamps that are resampled to the scene's pixels. Stars
/// are drawn with the PSF's own stamps, because oversampled stamps place a star between pixels more
/// accurately than resampled ones. The result includes the response of a frame pixel exactly once.
/// If the stamps lack this response, the simulator adds it. If the image's values are integrated
/// over the scene's pixels, the simulator takes the response of these pixels out
/// ([`ScenePixels`]).
///
/// Galaxies are functions on the sky. Each is convolved once with the interpolated stamp of its own
/// position ([`GalaxyPlan`](conv_core::GalaxyPlan)), whatever the scene's pixels are.
///
/// ```
/// use ndarray::{Array2, Array3};
/// use psfield::prelude::*;
/// use psfield::psf_types::{PointSource, Position};
/// let corners = [(0.0, 0.0), (99.0, 0.0), (0.0, 79.0), (99.0, 79.0)];
/// let stamps = Array3::from_shape_fn((4, 15, 15), |(j, y, x)| {
///     let sigma = if j % 2 == 0 { 1.2 } else { 1.5 };
///     (-((y as f64 - 7.0).powi(2) + (x as f64 - 7.0).powi(2)) / (2.0 * sigma * sigma)).exp()
/// });
/// let psf = Psf::from_samples(stamps.view(), &corners)?;
/// let simulator = psf.simulator((80, 100)).tolerance(1e-3).build::<f32>()?;
///
/// // Many scenes: the plan is made once.
/// for flux in [100.0, 200.0] {
///     let star = PointSource::new(Position::new(60.0, 30.0)?, flux)?;
///     let scene = Scene::new(Array2::from_elem((80, 100), 0.01))?.with_stars(vec![star]);
///     let image = simulator.simulate(&scene)?;
///     assert!(image.pixels()[[30, 60]] > 0.05 * flux as f32);
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Simulator<T: ConvReal> {
    shared: Arc<Shared<T>>,
    options: SimulateOptions,
    geometry: Geometry,
    /// Convolves the images of scenes.
    convolver: OnceLock<Convolver<T>>,
}

/// Parts that the simulators of all regions of a frame share.
#[derive(Debug)]
struct Shared<T: ConvReal> {
    psf: Psf,
    /// The method that convolves images without a plan. None for a method with a plan, which an
    /// [`Engine`] executes.
    method: Option<Box<dyn ConvolutionMethod<T>>>,
    /// The model on the scene's pixels, and the seconds that its fit took.
    image_model: OnceLock<(PsfModel, f64)>,
    sources: OnceLock<Sources<T>>,
    /// The errors of stars by the interpolation of the stamps.
    sampling_errors: OnceLock<SamplingErrors>,
}

/// Convolves the image of a scene.
#[derive(Debug)]
struct Convolver<T: ConvReal> {
    /// None for a method without a plan.
    engine: Option<Engine<T>>,
    placement: Placement,
    seconds: f64,
}

impl<T: ConvReal> Convolver<T> {
    /// Places a plan on a device. The time is counted from `clock` on.
    fn of_plan(plan: Plan<T>, options: &SimulateOptions, clock: Instant) -> Result<Self, PsfieldError> {
        let (engine, placement) = device::place(plan, options)?;
        Ok(Self {
            engine: Some(engine),
            placement,
            seconds: clock.elapsed().as_secs_f64(),
        })
    }

    /// Returns the engine. For a method without a plan, returns an error whose message begins with
    /// `what`.
    fn engine_for(&self, what: &str) -> Result<&Engine<T>, PsfieldError> {
        self.engine.as_ref().ok_or_else(|| PsfieldError::needs_plan(what))
    }
}

/// The model and the plan for scenes of one kind (with or without an image, stars and galaxies),
/// and the time that they took.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Preparation<'a> {
    /// The model for the convolution of images. For scenes without an image, the model for drawing
    /// stars and galaxies.
    pub model: &'a PsfModel,
    /// The plan for the image. None for scenes without an image, and for methods without a plan.
    pub plan: Option<PlanSummary>,
    /// The device that convolves the image.
    pub placement: Placement,
    /// Seconds that the call of [`Simulator::prepare`] spent on fits. 0 if the models existed.
    pub fit_seconds: f64,
    /// Seconds that this call spent on plans. 0 if the plans existed.
    pub plan_seconds: f64,
}

/// The image of a scene, or a part of it, and the column and the row of the scene at which it begins.
type Light<'a, T> = (ImageView<'a, T>, (usize, usize));

impl<T: ConvReal> Simulator<T> {
    /// The largest number of pixels of a scene without an image: 4 GiB in f32. A larger number is
    /// an error, because it is probably a mistake.
    pub const MAX_PIXELS: usize = 1 << 30;

    /// The PSF.
    pub fn psf(&self) -> &Psf {
        &self.shared.psf
    }

    /// The settings.
    pub fn options(&self) -> &SimulateOptions {
        &self.options
    }

    /// Columns and rows of scenes, in their own pixels.
    pub fn scene_shape(&self) -> FrameShape {
        self.geometry.shape
    }

    /// Columns and rows of images.
    pub fn image_shape(&self) -> FrameShape {
        self.geometry.region.shape()
    }

    /// The frame, in frame pixels counted from the scene's first pixel.
    pub fn frame(&self) -> PixelRegion {
        self.geometry.frame
    }

    /// Returns the image of a scene.
    ///
    /// # Errors
    /// The errors of [`simulate_into`](Self::simulate_into).
    pub fn simulate(&self, scene: &Scene<'_, T>) -> Result<Image<T>, PsfieldError> {
        // Check the scene before memory is allocated.
        self.check_sources(scene, false)?;
        let mut image = self.zeros();
        self.simulate_into(scene, image.view_mut(), &NoProgress)?;
        Ok(Image::new(image)?)
    }

    /// Returns an image of zeros, `[y, x]`, for [`simulate_into`](Self::simulate_into). Its memory
    /// pages are already written. Additions to it are therefore faster than to a large array of
    /// zeros from the allocator.
    pub fn zeros(&self) -> Array2<T> {
        let shape = self.image_shape();
        conv_core::zeros((shape.ny(), shape.nx()))
    }

    /// Adds the image of a scene to `image`. `image` is `[y, x]` of the frame or, if the simulator
    /// has a region, of this region. Returns counts of the tiles of the scene's image, one for
    /// each way to convolve a tile.
    ///
    /// The image in the scene has the shape of the simulator's scenes. If the simulator has a
    /// region, the scene may instead hold only the image of the part whose light reaches the region
    /// ([`light_region`](Self::light_region)).
    ///
    /// # Errors
    /// [`PsfieldError`] for a wrong shape, light where the PSF is not known, or a flux that `T`
    /// cannot hold, and the errors of [`prepare`](Self::prepare). After [`ErrorKind::Cancelled`],
    /// the image is incomplete.
    #[inline(never)]
    pub fn simulate_into(
        &self,
        scene: &Scene<'_, T>,
        mut image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, PsfieldError> {
        self.check_sources(scene, false)?;
        self.check_image(&image)?;
        let mut counts = TileCounts::default();
        if let Some(of_scene) = scene.image() {
            let convolver = self.convolver(progress)?;
            let (light, _) = self.light(of_scene, progress)?;
            counts = self.convolve_into(convolver, &light, image.view_mut(), progress)?;
        }
        self.draw_sources_into(scene.sources(), self.geometry.region, image, progress)?;
        Ok(counts)
    }

    /// Checks the shape of an array for an image.
    fn check_image(&self, image: &ArrayViewMut2<'_, T>) -> Result<(), PsfieldError> {
        let expected = self.image_shape();
        if image.dim() == (expected.ny(), expected.nx()) {
            return Ok(());
        }
        let got = FrameShape::new(image.ncols(), image.nrows())?;
        Err(ConvError::FrameShape { expected, got }.into())
    }

    /// Computes `A^T g` for an image `g`, where `A` is [`simulate`](Self::simulate) for scenes
    /// without stars and galaxies. For every such scene `f`, `<A f, g> = <f, A^T g>`. Each pixel of
    /// the result is thus the derivative of `<A f, g>` with respect to this pixel of `f`. For a
    /// scene finer than the frame, `A` convolves, samples at the centres of the frame's pixels, and
    /// multiplies by their area in pixels of the scene.
    ///
    /// `image` (`g`) is `[y, x]` of the frame, and the result is `[y, x]` of the scene. If the
    /// simulator has a region, `image` is `[y, x]` of this region, and the result is only the part
    /// of the scene whose light reaches the region ([`light_region`](Self::light_region)).
    ///
    /// # Errors
    /// [`ErrorKind::Convolution`] for an image of another shape, [`ErrorKind::Setting`] for a
    /// method without a plan, and the errors of [`prepare`](Self::prepare).
    #[inline(never)]
    pub fn adjoint(
        &self,
        image: &ImageView<'_, T>,
        progress: &dyn Progress,
    ) -> Result<Image<T>, PsfieldError> {
        let (expected, got) = (self.image_shape(), image.shape());
        if expected != got {
            return Err(ConvError::FrameShape { expected, got }.into());
        }
        let convolver = self.convolver(progress)?;
        let engine = convolver.engine_for("the adjoint can be computed")?;
        let shape = if self.geometry.is_whole() {
            self.geometry.shape
        } else {
            engine.plan().light_region().shape()
        };
        let mut light = conv_core::zeros((shape.ny(), shape.nx()));
        if self.geometry.oversample == 1 {
            engine.execute(Operation::Adjoint, image, light.view_mut(), progress)?;
        } else {
            let fine = self.geometry.spread(image)?;
            engine.execute(Operation::Adjoint, &fine.view(), light.view_mut(), progress)?;
        }
        Ok(Image::new(light)?)
    }

    /// The part of the scene whose light reaches the computed region, in pixels of the scene. For
    /// methods without a plan, it is the whole scene.
    ///
    /// # Errors
    /// The errors of [`prepare`](Self::prepare).
    pub fn light_region(&self, progress: &dyn Progress) -> Result<PixelRegion, PsfieldError> {
        let convolver = self.convolver(progress)?;
        Ok(match &convolver.engine {
            Some(engine) => engine.plan().light_region(),
            None => self.geometry.shape.region(),
        })
    }

    /// The blocks of the plan ([`Plan::blocks`](conv_core::Plan::blocks)): the pixels of each, in
    /// pixels of the scene, and its number of modes.
    ///
    /// # Errors
    /// [`ErrorKind::Setting`] for a method without a plan, and the errors of
    /// [`prepare`](Self::prepare).
    pub fn blocks(&self, progress: &dyn Progress) -> Result<Vec<(PixelRegion, usize)>, PsfieldError> {
        let engine = self.convolver(progress)?.engine_for("blocks are made")?;
        Ok(engine.plan().blocks().collect())
    }

    /// Makes the models and the plans that scenes like `scene` need (with or without an image,
    /// stars and galaxies), unless they exist. If `rows` is true, the image of the scene will be
    /// read row by row ([`stream`](Self::stream)), and `scene` does not hold it.
    ///
    /// # Errors
    /// [`PsfieldError`] if the scene or a flux in it is too large, if a fit or a plan fails, if
    /// `progress` cancels the work, or if [`Device::Gpu`] was chosen and no GPU can be used.
    #[inline(never)]
    pub fn prepare(
        &self,
        scene: &Scene<'_, T>,
        rows: bool,
        progress: &dyn Progress,
    ) -> Result<Preparation<'_>, PsfieldError> {
        self.check_sources(scene, rows)?;
        let with_image = rows || scene.image().is_some();
        let with_sources = !with_image || has_sources(scene);
        // Models and plans that already exist count 0 seconds.
        let new_model = self.shared.image_model.get().is_none();
        let new_convolver = self.convolver.get().is_none();
        let new_sources = self.shared.sources.get().is_none();
        let spent = |new: bool, seconds: f64| if new { seconds } else { 0.0 };
        let (mut fit_seconds, mut plan_seconds) = (0.0, 0.0);
        let mut made = None;
        if with_image {
            let convolver = self.convolver(progress)?;
            let (model, seconds) = self.image_model()?;
            fit_seconds += spent(new_model, seconds);
            plan_seconds += spent(new_convolver, convolver.seconds);
            let plan = convolver.engine.as_ref().map(|engine| engine.plan().summary());
            made = Some((model, plan, convolver.placement.clone()));
        }
        if with_sources {
            let sources = self.sources()?;
            fit_seconds += spent(new_sources, sources.fit_seconds);
            plan_seconds += spent(new_sources, sources.plan_seconds);
            made = made.or_else(|| Some((&sources.model, None, self.placement_of_sources())));
        }
        let (model, plan, placement) = made.expect("an image or sources");
        Ok(Preparation {
            model,
            plan,
            placement,
            fit_seconds,
            plan_seconds,
        })
    }

    /// Returns whether [`prepare`](Self::prepare) has nothing left to make for scenes like `scene`.
    pub fn is_prepared(&self, scene: &Scene<'_, T>, rows: bool) -> bool {
        let with_image = rows || scene.image().is_some();
        (!with_image || self.convolver.get().is_some())
            && (with_image && !has_sources(scene) || self.shared.sources.get().is_some())
    }

    /// Times of the last convolution on a GPU, in seconds. None if the processor convolves images,
    /// or before the first convolution.
    pub fn gpu_seconds(&self) -> Option<GpuSeconds> {
        let convolver = self.convolver.get()?;
        convolver.engine.as_ref().and_then(GpuSeconds::of_last)
    }

    fn placement_of_sources(&self) -> Placement {
        Placement::cpu(match (self.options.device, &self.shared.method) {
            (Device::Cpu, _) => CpuReason::Asked,
            (_, Some(_)) => CpuReason::Method,
            (_, None) => CpuReason::Stars,
        })
    }

    fn check_sources(&self, scene: &Scene<'_, T>, rows: bool) -> Result<(), PsfieldError> {
        let stars = scene.stars().iter().map(|star| star.flux());
        let mut fluxes = stars.chain(scene.galaxies().iter().map(|galaxy| galaxy.flux()));
        if let Some(flux) = fluxes.find(|&flux| !T::nearest(flux).as_f64().is_finite()) {
            let message = format!("a flux of {flux:e} is beyond single precision (3.4e38): choose f64");
            return Err(PsfieldError::new(ErrorKind::Data, message).with_setting("precision"));
        }
        let (shape, s) = (self.geometry.shape, self.geometry.oversample);
        if !rows && scene.image().is_none() && shape.pixel_count() > Self::MAX_PIXELS {
            let (nx, ny) = (shape.nx() / s, shape.ny() / s);
            let message = format!(
                "a scene of {nx} x {ny} frame pixels without an image is too large: choose at most 2^30 = {} scene pixels",
                Self::MAX_PIXELS
            );
            return Err(PsfieldError::new(ErrorKind::TooLarge, message).with_setting("shape"));
        }
        Ok(())
    }

    /// The options of the plans. None for methods without a plan.
    fn planned(&self) -> Result<Option<PlanOptions>, PsfieldError> {
        let options = self.options.plan_options()?;
        Ok(options.filter(|_| self.shared.method.is_none()))
    }

    /// The options of a model's plans, with the limit of memory for this model.
    fn planned_for(&self, model: &PsfModel) -> Result<Option<PlanOptions>, PsfieldError> {
        let frame = self.geometry.fine(self.geometry.frame)?.shape();
        let memory = || PlanOptions::memory_for::<T>(frame, model);
        let bytes = self.options.memory.unwrap_or_else(memory);
        Ok(self.planned()?.map(|options| options.with_memory(bytes)))
    }

    /// The model on the scene's pixels, and the seconds that its fit took.
    fn image_model(&self) -> Result<(&PsfModel, f64), PsfieldError> {
        let (psf, options) = (self.psf(), &self.options);
        let (model, seconds) = get_or_make(&self.shared.image_model, || {
            let clock = Instant::now();
            let model = on_scene_pixels(psf, options)?.model()?.clone();
            Ok::<_, PsfieldError>((model, clock.elapsed().as_secs_f64()))
        })?;
        Ok((model, *seconds))
    }

    /// Returns the convolver for the images of scenes.
    #[inline(never)]
    fn convolver(&self, progress: &dyn Progress) -> Result<&Convolver<T>, PsfieldError> {
        get_or_make(&self.convolver, || {
            let (model, _) = self.image_model()?;
            let clock = Instant::now();
            let Some(options) = self.planned_for(model)? else {
                return Ok(Convolver {
                    engine: None,
                    placement: self.placement_of_sources(),
                    seconds: clock.elapsed().as_secs_f64(),
                });
            };
            check_flux(self.psf(), model, &options)?;
            let (shape, frame) = (self.geometry.shape, self.geometry.fine(self.geometry.frame)?);
            let region = self.geometry.fine(self.geometry.region)?;
            let plan = Plan::for_region(model, shape, frame, region, options, progress)?;
            Convolver::of_plan(plan, &self.options, clock)
        })
    }

    /// Returns the image of a scene for the convolver. It is the whole scene, or only the part whose
    /// light reaches the region. Its shape tells which.
    fn light<'a>(
        &self,
        image: &'a ImageView<'_, T>,
        progress: &dyn Progress,
    ) -> Result<Light<'a, T>, PsfieldError> {
        let (whole, mut first) = (self.geometry.shape, (0, 0));
        if image.shape() != whole {
            let part = self.light_region(progress)?;
            if image.shape() != part.shape() {
                let (expected, got) = ((whole.ny(), whole.nx()), image.pixels().dim());
                return Err(DataError::ImageShape { expected, got }.into());
            }
            first = (part.x0() as usize, part.y0() as usize);
        }
        Ok((image.view(), first))
    }

    /// Convolves the image of a scene and adds the result to `image`.
    fn convolve_into(
        &self,
        convolver: &Convolver<T>,
        light: &ImageView<'_, T>,
        image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, PsfieldError> {
        let Some(engine) = &convolver.engine else {
            let method = self
                .shared
                .method
                .as_ref()
                .expect("a simulator without a plan has a method");
            let frame = self.geometry.fine(self.geometry.frame)?;
            let fine = method.convolve(self.image_model()?.0, light, frame, progress)?;
            self.geometry.add_sampled(fine.pixels(), image);
            return Ok(TileCounts::default());
        };
        self.add_executed(engine, image, |image| {
            engine.execute(Operation::Convolve, light, image, progress)
        })
    }

    /// Adds the result of an execution of a plan to `image`. The result of a finer scene is sampled.
    fn add_executed(
        &self,
        engine: &Engine<T>,
        image: ArrayViewMut2<'_, T>,
        execute: impl FnOnce(ArrayViewMut2<'_, T>) -> Result<TileCounts, ConvError>,
    ) -> Result<TileCounts, PsfieldError> {
        if self.geometry.oversample == 1 {
            return Ok(execute(image)?);
        }
        let shape = engine.plan().region().shape();
        let mut fine = conv_core::zeros((shape.ny(), shape.nx()));
        let counts = execute(fine.view_mut())?;
        self.geometry.add_sampled(fine.view(), image);
        Ok(counts)
    }
}

/// The PSF on the pixels of a scene's image, for its convolution.
fn on_scene_pixels(psf: &Psf, options: &SimulateOptions) -> Result<Psf, PsfieldError> {
    let psf = match options.oversample {
        1 => psf.native(options.stamp_size)?,
        finer => psf.for_finer_scene(finer, options.stamp_size, options.anchor)?,
    };
    match options.scene_pixels {
        ScenePixels::Point => Ok(psf),
        ScenePixels::Integrated => psf.without_scene_pixel(),
    }
}
