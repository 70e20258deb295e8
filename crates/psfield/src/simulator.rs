//! Makes images of scenes through a PSF.

mod both_precisions;
mod builder;
mod check;
mod convolver;
mod derived;
mod flux;
mod geometry;
mod gradients;
mod many;
mod part;
mod setup;
mod shooting;
mod source_gradients;
mod sources;
mod stamp_edges;
mod stamp_sampling;
mod stream;
#[cfg(test)]
mod tests;
mod warnings;
mod wings;

use std::sync::{Arc, Mutex, OnceLock};

use conv_core::{ConvError, ConvReal, ConvolutionMethod, Operation, PlanArrays, PlanSummary, TileCounts};
use ndarray::{Array2, ArrayViewMut2, s};
use psf_types::{
    DataError, FrameShape, Image, ImageView, NoProgress, PixelRegion, Progress, PsfModel, SampleStates,
    StateKind,
};

use crate::device::{GpuSeconds, Placement};
use crate::error::{ErrorKind, PsfieldError};
use crate::psf::Psf;
use crate::scene::{Layer, Scene};
use crate::simulate_options::SimulateOptions;

use convolver::OfLayers;
use gradients::PsfDerivative;
use stamp_edges::StampEdge;
use wings::part_of_light;

pub use builder::SimulatorBuilder;
pub use gradients::{Gradients, WantedGradients};
pub(crate) use part::Part;
pub(crate) use setup::Setup;
pub use shooting::{ExposeOptions, ShootBelow};
pub use source_gradients::{GalaxyGradient, SourceGradients};
pub use stamp_sampling::SamplingErrors;
pub use warnings::SimulationWarning;

/// The start of the error message for an adjoint with a method that makes no plan
/// ([`PsfieldError::needs_plan`]).
const ADJOINT: &str = "the adjoint can be computed";

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
/// ([`ScenePixels`](crate::ScenePixels)).
///
/// Galaxies are functions on the sky. Each is convolved once with the interpolated stamp of its own
/// position ([`SourcePlan`](conv_core::SourcePlan)), whatever the scene's pixels are.
///
/// A PSF with several states ([`Psf::states`]), such as those for several spectra, takes scenes with a layer
/// for each state. The images of all layers are convolved together: the engine adds them, weighted for each
/// mode, and transforms the sums. So layers cost no convolutions of their own. The tolerance holds for every
/// position and every layer.
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
    setup: Setup,
    /// Convolve the images of some layers, made when a scene first needs them. The latest few are kept.
    convolvers: Mutex<Vec<OfLayers<T>>>,
    /// Convolves images with the wings of the PSF, if it has any. Made when first needed.
    wings: OnceLock<Option<Box<Self>>>,
    /// Whether this simulator is one of wings.
    of_wings: bool,
    /// For derivatives with respect to the PSF. Made when first needed, and shared by simulators for other
    /// parameters of the PSF.
    psf_derivative: Arc<OnceLock<PsfDerivative<T>>>,
}

/// The PSFs and what the simulators of all regions of a frame share.
#[derive(Debug)]
struct Shared<T: ConvReal> {
    /// The layers of a scene are the states of the first part, then those of the others. Only layers of the
    /// first part may have images.
    parts: Vec<Arc<Part<T>>>,
    /// The PSF of the first part on the pixels of the scenes' images, if it was made in another way.
    images: Option<Psf>,
    /// The method that convolves images without a plan. None for a method with a plan, which an
    /// [`Engine`] executes.
    method: Option<Box<dyn ConvolutionMethod<T>>>,
    /// The models of the first part's states on the scene's pixels, and the seconds that their fit took.
    image_models: OnceLock<(Vec<PsfModel>, f64)>,
    /// The errors of stars by the interpolation of the stamps.
    sampling_errors: OnceLock<SamplingErrors>,
    stamp_edge: OnceLock<StampEdge>,
}

impl<T: ConvReal> Shared<T> {
    /// The part of a layer, and the number of its state.
    fn part_of(&self, layer: usize) -> (&Part<T>, usize) {
        let mut state = layer;
        for part in &self.parts {
            let count = part.layer_count();
            if state < count {
                return (part, state);
            }
            state -= count;
        }
        unreachable!("scenes are checked for their number of layers")
    }

    /// The layers that may have images.
    fn layers_of_images(&self) -> Vec<usize> {
        (0..self.parts[0].layer_count()).collect()
    }
}

/// The model and the plan for scenes of one kind (with or without an image, stars and galaxies),
/// and the time that they took.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Preparation<'a> {
    /// The model for the convolution of images. For scenes without an image, the model for drawing
    /// stars and galaxies. That of the first layer.
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

impl<T: ConvReal> Simulator<T> {
    /// The largest number of pixels of a scene without an image: 4 GiB in f32. A larger number is
    /// an error, because it is probably a mistake.
    pub const MAX_PIXELS: usize = 1 << 30;

    /// The PSF.
    pub fn psf(&self) -> &Psf {
        &self.shared.parts[0].psf
    }

    /// The settings.
    pub fn options(&self) -> &SimulateOptions {
        &self.setup.options
    }

    /// Columns and rows of scenes, in their own pixels.
    pub fn scene_shape(&self) -> FrameShape {
        self.setup.geometry.shape
    }

    /// Columns and rows of images.
    pub fn image_shape(&self) -> FrameShape {
        self.setup.geometry.region.shape()
    }

    /// The frame, in frame pixels counted from the scene's first pixel.
    pub fn frame(&self) -> PixelRegion {
        self.setup.geometry.frame
    }

    /// The part of the scene that images show, in frame pixels counted from the scene's first pixel: the frame, or the
    /// region of it.
    pub fn shown_region(&self) -> PixelRegion {
        let frame = self.frame();
        self.setup.geometry.region.shifted(frame.x0(), frame.y0())
    }

    /// The number of layers that scenes have: one for each state of the PSF, or 1. An exposure with trails has
    /// further layers.
    pub fn layer_count(&self) -> usize {
        self.shared.parts.iter().map(|part| part.layer_count()).sum()
    }

    /// Returns the image of a scene.
    ///
    /// # Errors
    /// The errors of [`simulate_into`](Self::simulate_into).
    pub fn simulate(&self, scene: &Scene<'_, T>) -> Result<Image<T>, PsfieldError> {
        // Check the scene before memory is allocated.
        self.check_scene(scene)?;
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
    /// Images in the scene have the shape of the simulator's scenes. If the simulator has a
    /// region, they may instead be only the part whose light reaches the region
    /// ([`light_region`](Self::light_region)).
    ///
    /// # Errors
    /// [`PsfieldError`] for a wrong shape or number of layers, light where the PSF is not known, or a flux
    /// that `T` cannot hold, and the errors of [`prepare`](Self::prepare). [`ErrorKind::Data`] for a scene
    /// whose image is read row by row. After [`ErrorKind::Cancelled`], the image is incomplete.
    #[inline(never)]
    pub fn simulate_into(
        &self,
        scene: &Scene<'_, T>,
        mut image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, PsfieldError> {
        self.check_scene(scene)?;
        self.check_image(image.dim())?;
        let mut counts = TileCounts::default();
        let of_wings = self.light_of_wings(scene, progress)?;
        if scene.has_image() {
            counts = self.convolve_into(scene, image.view_mut(), progress)?;
        }
        self.draw_sources_into(scene, self.setup.geometry.region, image.view_mut(), progress)?;
        if let Some(of_wings) = of_wings {
            image += &of_wings;
        }
        Ok(counts)
    }

    /// Checks the shape of an array for an image.
    fn check_image(&self, (ny, nx): (usize, usize)) -> Result<(), PsfieldError> {
        let expected = self.image_shape();
        if (ny, nx) == (expected.ny(), expected.nx()) {
            return Ok(());
        }
        let got = FrameShape::new(nx, ny)?;
        Err(ConvError::FrameShape { expected, got }.into())
    }

    /// Computes `A^T g` for an image `g`, where `A` is [`simulate`](Self::simulate) for scenes
    /// without stars and galaxies. For every such scene `f`, `<A f, g> = <f, A^T g>`. Each pixel of
    /// the result is thus the derivative of `<A f, g>` with respect to this pixel of `f`. For a
    /// scene finer than the frame, `A` convolves, samples at the centres of the frame's pixels, and
    /// multiplies by their area in pixels of the scene.
    ///
    /// `image` (`g`) is `[y, x]` of the frame, and the result is `[y, x]` of the scene, one array for each
    /// layer. If the simulator has a region, `image` is `[y, x]` of this region, and the result is only the
    /// part of the scene whose light reaches the region ([`light_region`](Self::light_region)).
    ///
    /// # Errors
    /// [`ErrorKind::Convolution`] for an image of another shape, [`ErrorKind::Setting`] for a
    /// method without a plan, and the errors of [`prepare`](Self::prepare).
    #[inline(never)]
    pub fn adjoint(
        &self,
        image: &ImageView<'_, T>,
        progress: &dyn Progress,
    ) -> Result<Vec<Image<T>>, PsfieldError> {
        self.check_image(image.pixels().dim())?;
        let (layers, geometry) = (self.shared.layers_of_images(), &self.setup.geometry);
        let convolver = self.convolver(&layers, progress)?;
        let engine = convolver.engine_for(ADJOINT)?;
        let wings = self.wings()?;
        let of_wings = wings.map(|wings| wings.adjoint(image, progress)).transpose()?;
        let shape = if geometry.is_whole() {
            geometry.shape
        } else {
            engine.plan().light_region().shape()
        };
        let zeros = |_: &usize| conv_core::zeros((shape.ny(), shape.nx()));
        let mut light: Vec<Array2<T>> = layers.iter().map(zeros).collect();
        let into = light.iter_mut().map(|light| light.view_mut()).collect();
        let spread = (geometry.oversample > 1)
            .then(|| geometry.spread(image))
            .transpose()?;
        let fine = spread.as_ref().map_or_else(|| image.view(), Image::view);
        engine.execute(Operation::Adjoint, &[fine], into, progress)?;
        let mut sums: Vec<Array2<T>> = match of_wings {
            Some(of_wings) => of_wings.into_iter().map(Image::into_pixels).collect(),
            None => return light.into_iter().map(|light| Ok(Image::new(light)?)).collect(),
        };
        // The light that reaches the region through the wings comes from a larger part of the scene.
        let (inner, outer) = (
            engine.plan().light_region(),
            self.light_region_of(&layers, progress)?,
        );
        let first = if geometry.is_whole() {
            (0, 0)
        } else {
            (inner.x0() - outer.x0(), inner.y0() - outer.y0())
        };
        for (sum, light) in sums.iter_mut().zip(&light) {
            let ((x, y), (ny, nx)) = ((first.0 as usize, first.1 as usize), light.dim());
            let mut part = sum.slice_mut(s![y..y + ny, x..x + nx]);
            part += light;
        }
        sums.into_iter().map(|sum| Ok(Image::new(sum)?)).collect()
    }

    /// The shape of the adjoint of an image.
    fn adjoint_shape(&self, progress: &dyn Progress) -> Result<FrameShape, PsfieldError> {
        if self.setup.geometry.is_whole() {
            return Ok(self.setup.geometry.shape);
        }
        let light = self.light_region_of(&self.shared.layers_of_images(), progress)?;
        Ok(light.shape())
    }

    /// The part of the scene whose light reaches the computed region, in pixels of the scene. For
    /// methods without a plan, it is the whole scene.
    ///
    /// # Errors
    /// The errors of [`prepare`](Self::prepare).
    pub fn light_region(&self, progress: &dyn Progress) -> Result<PixelRegion, PsfieldError> {
        self.light_region_of(&self.shared.layers_of_images(), progress)
    }

    /// The blocks of the plan ([`Plan::blocks`](conv_core::Plan::blocks)): the pixels of each, in
    /// pixels of the scene, and its number of modes.
    ///
    /// # Errors
    /// [`ErrorKind::Setting`] for a method without a plan, and the errors of
    /// [`prepare`](Self::prepare).
    pub fn blocks(&self, progress: &dyn Progress) -> Result<Vec<(PixelRegion, usize)>, PsfieldError> {
        let convolver = self.convolver(&self.shared.layers_of_images(), progress)?;
        Ok(convolver.engine_for("blocks are made")?.plan().blocks().collect())
    }

    /// Returns the plan for images as plain arrays, with which other software can execute it. The image of
    /// the arrays is the fine image, which the frame [samples](Self::sampled_pixels).
    ///
    /// # Errors
    /// [`ErrorKind::Setting`] for a method without a plan. [`ErrorKind::Data`] for a PSF with several states
    /// or with wings, which need the native engine. [`ErrorKind::Field`] if a pixel has no PSF, even if no
    /// light needs it. The errors of [`prepare`](Self::prepare).
    pub fn plan_arrays(&self, progress: &dyn Progress) -> Result<PlanArrays<T>, PsfieldError> {
        let needs_engine = |what| {
            let message = format!("{what} needs the native engine: use simulate and adjoint");
            Err(PsfieldError::new(ErrorKind::Data, message))
        };
        if self.layer_count() > 1 {
            return needs_engine("a PSF with several states");
        }
        if self.has_wings()? {
            return needs_engine("a PSF with wings");
        }
        let convolver = self.convolver(&self.shared.layers_of_images(), progress)?;
        let engine = convolver.engine_for("arrays of plans are made")?;
        Ok(engine.plan().arrays()?)
    }

    /// The pixels at which the frame samples a fine image, which has the scene's pixels: the index of the
    /// first and the step, along either axis. The frame's image holds their values times `step^2`.
    pub fn sampled_pixels(&self) -> (usize, usize) {
        (self.setup.geometry.offset(), self.setup.geometry.oversample)
    }

    /// Makes the models and the plans that scenes like `scene` need (with or without images,
    /// stars and galaxies), unless they exist.
    ///
    /// # Errors
    /// [`PsfieldError`] if the scene or a flux in it is too large, if a fit or a plan fails, if
    /// `progress` cancels the work, or if [`Device::Gpu`](crate::Device::Gpu) was chosen and no GPU can be
    /// used.
    #[inline(never)]
    pub fn prepare(
        &self,
        scene: &Scene<'_, T>,
        progress: &dyn Progress,
    ) -> Result<Preparation<'_>, PsfieldError> {
        self.check_scene(scene)?;
        let layers = scene.layers_with_image();
        // Models and plans that already exist count 0 seconds.
        let spent = |new: bool, seconds: f64| if new { seconds } else { 0.0 };
        let (mut fit_seconds, mut plan_seconds) = (0.0, 0.0);
        let mut made = None;
        if !layers.is_empty() {
            let new_model = self.shared.image_models.get().is_none();
            let new_convolver = self.kept_convolver(&layers).is_none();
            let convolver = self.convolver(&layers, progress)?;
            if let Some(wings) = self.wings()? {
                let new = wings.kept_convolver(&layers).is_none();
                plan_seconds += spent(new, wings.convolver(&layers, progress)?.seconds);
            }
            let (models, seconds) = self.image_models()?;
            fit_seconds += spent(new_model, *seconds);
            plan_seconds += spent(new_convolver, convolver.seconds);
            let plan = convolver.engine.as_ref().map(|engine| engine.plan().summary());
            made = Some((&models[layers[0]], plan, convolver.placement.clone()));
        }
        for (part, layer) in self.parts_to_draw(scene) {
            let new = !part.has_sources();
            let sources = part.sources(&self.setup)?;
            fit_seconds += spent(new, sources.fit_seconds);
            plan_seconds += spent(new, sources.plan_seconds);
            let model = self.sources(layer)?.model();
            made = made.or_else(|| Some((model, None, self.placement_of_sources())));
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
    pub fn is_prepared(&self, scene: &Scene<'_, T>) -> bool {
        let layers = scene.layers_with_image();
        let drawn = self.parts_to_draw(scene);
        (layers.is_empty() || self.kept_convolver(&layers).is_some())
            && drawn.iter().all(|(part, _)| part.has_sources())
    }

    /// The parts that draw the stars and galaxies of a scene, each with the number of its first layer. The
    /// first part for a scene without any light.
    fn parts_to_draw(&self, scene: &Scene<'_, T>) -> Vec<(&Part<T>, usize)> {
        let mut first = 0;
        let mut drawn = Vec::new();
        for part in &self.shared.parts {
            let layers = scene.layers().iter().skip(first).take(part.layer_count());
            if layers.clone().any(Layer::has_sources) {
                drawn.push((&**part, first));
            }
            first += part.layer_count();
        }
        if drawn.is_empty() && !scene.has_image() {
            drawn.push((&*self.shared.parts[0], 0));
        }
        drawn
    }

    /// Times of the last convolution on a GPU, in seconds, by the newest plan. None if the processor convolves
    /// images, or before the first convolution.
    pub fn gpu_seconds(&self) -> Option<GpuSeconds> {
        let kept = self.kept_convolvers();
        let mut engines = kept
            .iter()
            .rev()
            .filter_map(|(_, convolver)| convolver.engine.as_ref());
        engines.find_map(GpuSeconds::of_last)
    }

    /// Checks the number of layers, the fluxes, and the size of a scene.
    fn check_scene(&self, scene: &Scene<'_, T>) -> Result<(), PsfieldError> {
        let (expected, got) = (self.layer_count(), scene.layers().len());
        if expected != got {
            let kind = self.psf().states().map(SampleStates::kind);
            if got == 1 && kind.is_some_and(|kind| kind != StateKind::Spectrum) {
                return Err(self.psf().several_states());
            }
            let message = format!(
                "the PSF has {expected} states, but the scene has {got} layers: give one layer for each state"
            );
            return Err(PsfieldError::new(ErrorKind::Data, message));
        }
        let mut fluxes = scene.points().map(|(_, flux)| flux);
        if let Some(flux) = fluxes.find(|&flux| !T::nearest(flux).as_f64().is_finite()) {
            let message = format!("a flux of {flux:e} is beyond single precision (3.4e38): choose f64");
            return Err(PsfieldError::new(ErrorKind::Data, message).with_setting("precision"));
        }
        let (shape, s) = (self.setup.geometry.shape, self.setup.geometry.oversample);
        if !scene.has_image() && shape.pixel_count() > Self::MAX_PIXELS {
            let (nx, ny) = (shape.nx() / s, shape.ny() / s);
            let message = format!(
                "a scene of {nx} x {ny} frame pixels without an image is too large: choose at most 2^30 = {} scene pixels",
                Self::MAX_PIXELS
            );
            return Err(PsfieldError::new(ErrorKind::TooLarge, message).with_setting("shape"));
        }
        let with_image = scene.layers_with_image();
        if with_image.last() >= Some(&self.shared.parts[0].layer_count()) {
            const TRAILS: &str = "a layer of moving sources has no image";
            return Err(PsfieldError::new(ErrorKind::Data, TRAILS));
        }
        Ok(())
    }

    /// The images of the layers that have one, for a convolver: the whole scene, or only the part whose light
    /// reaches the region. Their shape tells which.
    fn lights<'a>(
        &self,
        scene: &'a Scene<'_, T>,
        progress: &dyn Progress,
    ) -> Result<Vec<ImageView<'a, T>>, PsfieldError> {
        let with_image = scene.layers().iter().filter(|layer| layer.has_image());
        let light = with_image.map(|layer| match layer.image() {
            Some(image) => Ok(self.light(image, scene, progress)?.0),
            None => Err(PsfieldError::new(
                ErrorKind::Data,
                "the image of this scene is read row by row: use stream",
            )),
        });
        light.collect()
    }

    /// The image of a layer, or a part of it, and the column and the row of the scene at which it begins.
    fn light<'a>(
        &self,
        image: &'a ImageView<'_, T>,
        scene: &Scene<'_, T>,
        progress: &dyn Progress,
    ) -> Result<(ImageView<'a, T>, (usize, usize)), PsfieldError> {
        let (whole, mut first) = (self.setup.geometry.shape, (0, 0));
        if image.shape() != whole {
            let part = self.light_region_of(&scene.layers_with_image(), progress)?;
            if image.shape() != part.shape() {
                let (expected, got) = ((whole.ny(), whole.nx()), image.pixels().dim());
                return Err(DataError::ImageShape { expected, got }.into());
            }
            first = (part.x0() as usize, part.y0() as usize);
        }
        Ok((image.view(), first))
    }

    /// Convolves the images of a scene's layers with the core of the PSF and adds the result to `image`.
    fn convolve_into(
        &self,
        scene: &Scene<'_, T>,
        image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, PsfieldError> {
        let layers = scene.layers_with_image();
        let lights = self.lights(scene, progress)?;
        let are_whole = lights.iter().all(|light| light.shape() == self.scene_shape());
        if are_whole || self.wings()?.is_none() {
            return self.convolve_lights_into((&layers, &lights), image, progress);
        }
        let given = self.light_region_of(&layers, progress)?;
        let needed = self.core_light_region(&layers, progress)?;
        let first = (given.x0(), given.y0());
        let parts = lights.iter().map(|light| part_of_light(light, first, needed));
        let parts: Vec<ImageView<'_, T>> = parts.collect::<Result<_, _>>()?;
        self.convolve_lights_into((&layers, &parts), image, progress)
    }

    /// Convolves the images of some layers with the core of the PSF and adds the result to `image`.
    pub(super) fn convolve_lights_into(
        &self,
        (layers, lights): (&[usize], &[ImageView<'_, T>]),
        mut image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, PsfieldError> {
        let convolver = self.convolver(layers, progress)?;
        let geometry = &self.setup.geometry;
        let Some(engine) = &convolver.engine else {
            let (method, frame) = (&self.shared.method, geometry.fine(geometry.frame)?);
            let method = method.as_ref().expect("a simulator without a plan has a method");
            for (&layer, light) in layers.iter().zip(lights) {
                let model = &self.image_models()?.0[layer];
                let fine = method.convolve(model, light, frame, progress)?;
                geometry.add_sampled(fine.pixels(), image.view_mut());
            }
            return Ok(TileCounts::default());
        };
        let execute = |image| engine.execute(Operation::Convolve, lights, vec![image], progress);
        if geometry.oversample == 1 {
            return Ok(execute(image)?);
        }
        let mut fine = engine.plan().zeros();
        let counts = execute(fine.view_mut())?;
        geometry.add_sampled(fine.view(), image);
        Ok(counts)
    }
}
