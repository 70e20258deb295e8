//! A scene through a PSF.

use conv_core::{
    ConvError, ConvReal, ConvolutionMethod, Direct, Plan, PlanOptions, RowStream, StarPainter, StarPlan,
    TileCounts, native_grid,
};
use ndarray::{Array2, ArrayView2, ArrayViewMut2};
use psf_types::{Anchor, FrameShape, Image, ImageView, NoProgress, Progress, PsfModel, Scene};

use crate::finer_scene::{FinerRows, FinerScene, spread};
use crate::{Method, PsfInput, PsfieldError, SimulationOptions, SimulationPlan};

/// Convolves a scene with the right models of a PSF: images with stamps at the scene's pixels, stars with the stamps as they
/// are (an oversampled stamp places a star between pixels better than its own pixels would).
///
/// The response of a frame pixel is applied once: stamps that lack it get it here.
///
/// ```no_run
/// use psfield::conv_core::PlanOptions;
/// use psfield::psf_types::{Image, NoProgress, Scene};
/// use psfield::{FitOptions, PsfInput, Simulation};
/// let psf = PsfInput::open("samples.fits", FitOptions::default())?;
/// let scene = Scene::from_image(psfield::psf_io::read_image::<f32>("scene.fits")?.into_parts().0);
/// let simulation = Simulation::new(psf, &scene, Default::default())?;
/// let image = simulation.run(&scene, Default::default(), PlanOptions::new(1e-3)?)?;
///
/// // Many scenes of one shape: plan once.
/// let plan = simulation.plan(&scene, PlanOptions::new(1e-3)?)?;
/// let (image, tiles) = simulation.run_planned(&plan, &scene, &NoProgress)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Simulation {
    /// For images, at the scene's pixels; for stars too, unless they have one.
    model: PsfModel,
    stars: Option<PsfModel>,
    options: SimulationOptions,
}

/// What of a scene needs a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SceneParts {
    /// There is an image.
    pub image: bool,
    /// There are point sources.
    pub sources: bool,
    /// The frame's shape, in pixels of the scene.
    pub frame: FrameShape,
}

impl SceneParts {
    /// Those of a scene.
    pub fn of<T: ConvReal>(scene: &Scene<T>) -> Self {
        Self {
            image: scene.image().is_some(),
            sources: !scene.sources().is_empty(),
            frame: scene.frame().shape(),
        }
    }
}

impl Simulation {
    /// The models that scenes of the kind of `scene` need, fitted where `psf` is samples.
    ///
    /// # Errors
    /// [`PsfieldError`] when a fit fails, or the frame is larger than the field of the PSF.
    pub fn new<T: ConvReal>(
        psf: PsfInput,
        scene: &Scene<T>,
        options: SimulationOptions,
    ) -> Result<Self, PsfieldError> {
        Self::for_parts(psf, SceneParts::of(scene), options)
    }

    /// The same for a scene that is not at hand.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn for_parts(
        psf: PsfInput,
        parts: SceneParts,
        options: SimulationOptions,
    ) -> Result<Self, PsfieldError> {
        let (finer, size) = (options.oversample(), options.stamp_size());
        let frame = FrameShape::new(parts.frame.nx().div_ceil(finer), parts.frame.ny().div_ceil(finer))?;
        // One model serves both where the stamps have the frame's pixels already.
        let as_it_is = size.is_none() && finer == 1 && native_grid(psf.grid())? == psf.grid();
        let of_image = |psf: PsfInput| match finer {
            1 => psf.native(size),
            _ => psf.for_finer_scene(finer, size, options.anchor()),
        };
        let of_stars = |psf: PsfInput| psf.with_pixel_response()?.into_model();
        let (model, stars) = match (parts.image, parts.sources) {
            _ if as_it_is && psf.grid().pixel_response_included() => (psf.into_model()?, None),
            (true, false) => (of_image(psf)?.into_model()?, None),
            (true, true) => (of_image(psf.clone())?.into_model()?, Some(of_stars(psf)?)),
            (false, _) => (of_stars(psf)?, None),
        };
        let scale = if parts.image { finer } else { 1 };
        let field = model
            .field_shape()
            .map(|field| (field.nx() / scale, field.ny() / scale));
        if let Some((nx, ny)) = field
            && (frame.nx() > nx || frame.ny() > ny)
        {
            return Err(PsfieldError::FrameBeyondField {
                frame,
                field: FrameShape::new(nx, ny)?,
            });
        }
        Ok(Self {
            model,
            stars,
            options,
        })
    }

    /// A simulation with a model of the caller's, for images and stars alike.
    pub fn with_model(model: PsfModel) -> Self {
        Self {
            model,
            stars: None,
            options: SimulationOptions::default(),
        }
    }

    /// The model that convolves images, and draws stars unless their stamps are finer.
    pub fn model(&self) -> &PsfModel {
        &self.model
    }

    /// What it was made for.
    pub fn options(&self) -> SimulationOptions {
        self.options
    }

    fn star_model(&self) -> &PsfModel {
        self.stars.as_ref().unwrap_or(&self.model)
    }

    /// The image of a scene.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`].
    pub fn run<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        method: Method,
        options: PlanOptions,
    ) -> Result<Image<T>, PsfieldError> {
        match method.plan_options(options) {
            Some(options) => {
                let plan = self.plan(scene, options)?;
                Ok(self.run_planned(&plan, scene, &NoProgress)?.0)
            }
            None => self.run_with(
                scene,
                method.build::<T>(options)?.as_ref(),
                options.anchor(),
                &NoProgress,
            ),
        }
    }

    /// The image of a scene by any method, of this project or of the caller's own, telling how far it has come; stars are drawn one
    /// by one in double precision. `anchor` is that of the method.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`].
    pub fn run_with<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        method: &dyn ConvolutionMethod<T>,
        anchor: Anchor,
        progress: &dyn Progress,
    ) -> Result<Image<T>, PsfieldError> {
        let finer = FinerScene::new(self.options.oversample(), scene)?;
        let mut pixels = if scene.image().is_some() {
            let extended = scene.clone().with_sources(Vec::new());
            let image = method.convolve_with_progress(&self.model, &extended, progress)?;
            finer.sampled(image.into_pixels())
        } else {
            let frame = finer.stars().frame().shape();
            Array2::zeros((frame.ny(), frame.nx()))
        };
        let (stars, whole) = (finer.stars(), finer.stars().frame().shape().region());
        self.painter(stars, anchor)?
            .add_to_region(stars.sources(), whole, pixels.view_mut(), progress)?;
        Ok(Image::new(pixels)?)
    }

    /// A plan of the fast engine for scenes of one shape and frame.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`].
    pub fn plan<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        options: PlanOptions,
    ) -> Result<SimulationPlan<T>, PsfieldError> {
        let engine = match scene.image() {
            Some(_) => Some(Plan::for_scene(&self.model, scene, options)?),
            None => None,
        };
        self.planned(engine, options)
    }

    /// The same for scenes that are images and not at hand; `scene` gives their shape and frame.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`].
    pub fn plan_for_images<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        options: PlanOptions,
    ) -> Result<SimulationPlan<T>, PsfieldError> {
        self.planned(Some(Plan::for_scene(&self.model, scene, options)?), options)
    }

    fn planned<T: ConvReal>(
        &self,
        engine: Option<Plan<T>>,
        options: PlanOptions,
    ) -> Result<SimulationPlan<T>, PsfieldError> {
        let size = self.options.stamp_size();
        let stars = StarPlan::new(self.star_model(), options, size)?;
        Ok(SimulationPlan::new(engine, stars))
    }

    /// The image of a scene by a plan of this simulation, and how its tiles were treated.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`].
    pub fn run_planned<T: ConvReal>(
        &self,
        plan: &SimulationPlan<T>,
        scene: &Scene<T>,
        progress: &dyn Progress,
    ) -> Result<(Image<T>, TileCounts), PsfieldError> {
        let mut image = match plan.engine() {
            Some(engine) if self.options.oversample() == 1 => engine.dark_image(),
            _ => {
                let finer = FinerScene::new(self.options.oversample(), scene)?;
                let frame = finer.stars().frame().shape();
                Array2::zeros((frame.ny(), frame.nx()))
            }
        };
        let light = scene.image().map(Image::view);
        let counts = self.add_planned_to(plan, scene, light.as_ref(), image.view_mut(), progress)?;
        Ok((Image::new(image)?, counts))
    }

    /// Adds the image of a scene to one that belongs to somebody else, from light that does. `scene` gives the shape, the frame and the point
    /// sources; its image is not looked at. `light` is `[y, x]` of the scene, or of its part that reaches the frame
    /// ([`Plan::light_region`]); `image` is `[y, x]` of the frame, in its own pixels.
    ///
    /// Nothing is copied where the pixels of each row are neighbours in memory and the scene is not finer than the frame.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`]: shapes that do not fit, light where there is no PSF, and [`ConvError::Cancelled`],
    /// after which the image is left half done. [`PsfieldError::PlanForStars`] for light where the plan is for stars alone.
    pub fn add_planned_to<T: ConvReal>(
        &self,
        plan: &SimulationPlan<T>,
        scene: &Scene<T>,
        light: Option<&ImageView<'_, T>>,
        mut image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, PsfieldError> {
        let finer = FinerScene::new(self.options.oversample(), scene)?;
        if let Some(engine) = plan.engine() {
            engine.check_scene(scene)?;
        }
        let frame = finer.stars().frame().shape();
        if image.dim() != (frame.ny(), frame.nx()) {
            let got = FrameShape::new(image.ncols(), image.nrows())?;
            return Err(ConvError::FrameShape { expected: frame, got }.into());
        }
        let counts = match (light, plan.engine()) {
            (None, _) => TileCounts::default(),
            (Some(_), None) => return Err(PsfieldError::PlanForStars),
            (Some(light), Some(engine)) if self.options.oversample() == 1 => {
                engine.add_light_to(light, image.view_mut(), progress)?
            }
            (Some(light), Some(engine)) => {
                let mut fine = engine.dark_image();
                let counts = engine.add_light_to(light, fine.view_mut(), progress)?;
                finer.add_sampled(&fine, image.view_mut());
                counts
            }
        };
        plan.stars()
            .add_to_region(finer.stars(), frame.region(), image, progress)?;
        Ok(counts)
    }

    /// The transpose of [`Self::add_planned_to`] without stars: what each pixel of the scene gives to the scalar product of its image with `image`,
    /// `[y, x]` of the frame in its own pixels. `<A f, g> = <f, A^T g>` for every scene `f` without point sources; of a finer scene, `A`
    /// convolves and then samples at the centres of the frame's pixels, times their area in pixels of the scene.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`] for an image of another shape; [`PsfieldError::PlanForStars`] where the plan is for stars alone.
    pub fn adjoint_planned<T: ConvReal>(
        &self,
        plan: &SimulationPlan<T>,
        image: &ImageView<'_, T>,
        progress: &dyn Progress,
    ) -> Result<Image<T>, PsfieldError> {
        let engine = plan.engine().ok_or(PsfieldError::PlanForStars)?;
        match self.options.oversample() {
            1 => Ok(engine.adjoint_with_progress(image, progress)?),
            finer => {
                let fine = spread(finer, image)?;
                Ok(engine.adjoint_with_progress(&fine.view(), progress)?)
            }
        }
    }

    /// Adds the same transpose to a plane that belongs to somebody else, `[y, x]` of the scene or of its part that reaches the frame
    /// ([`Plan::light_region`]).
    ///
    /// # Errors
    /// As [`Self::adjoint_planned`]; where it was cancelled, the plane is left half done.
    pub fn add_adjoint_planned_to<T: ConvReal>(
        &self,
        plan: &SimulationPlan<T>,
        image: &ImageView<'_, T>,
        light: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, PsfieldError> {
        let engine = plan.engine().ok_or(PsfieldError::PlanForStars)?;
        match self.options.oversample() {
            1 => Ok(engine.add_adjoint_to(image, light, progress)?),
            finer => {
                let fine = spread(finer, image)?;
                Ok(engine.add_adjoint_to(&fine.view(), light, progress)?)
            }
        }
    }

    /// The same for a scene whose rows come and go through a stream; `scene` gives the shape, the frame and the point sources.
    ///
    /// # Errors
    /// Those of the stream and of the convolution.
    pub fn stream<T: ConvReal, R: RowStream<T>>(
        &self,
        plan: &SimulationPlan<T>,
        scene: &Scene<T>,
        stream: &mut R,
        progress: &dyn Progress,
    ) -> Result<TileCounts, R::Error>
    where
        R::Error: From<PsfieldError>,
    {
        let finer = FinerScene::new(self.options.oversample(), scene)?;
        let engine = plan.engine().ok_or(PsfieldError::NothingToStream)?;
        let dark = scene.clone().with_sources(Vec::new());
        let mut rows = FinerRows::new(stream, &finer, plan.stars());
        engine.stream(&dark, None, &mut rows, progress)
    }

    /// Single pixels `(column, row)` of the image by the direct sum in double precision.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`].
    pub fn exact_at<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        anchor: Anchor,
        pixels: &[(usize, usize)],
    ) -> Result<Vec<f64>, PsfieldError> {
        let part = scene.pixels().map(|light| (light, (0, 0)));
        self.exact_sums(scene, part, (anchor, pixels), &NoProgress)
    }

    /// The same from light that belongs to somebody else: all of the scene's, or a part of it that reaches the pixels, with the column and the row
    /// of the scene that it begins at. `scene` gives the shape, the frame and the point sources. One step a pixel.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`].
    pub fn exact_at_part<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        part: Option<(&ImageView<'_, T>, (usize, usize))>,
        anchor: Anchor,
        pixels: &[(usize, usize)],
        progress: &dyn Progress,
    ) -> Result<Vec<f64>, PsfieldError> {
        let light = part.map(|(light, first)| (light.pixels(), first));
        self.exact_sums(scene, light, (anchor, pixels), progress)
    }

    /// The same where only some rows of the scene's image are at hand, with the number of the first of them: all that reach the
    /// pixels ([`Self::rows_reaching`]). `scene` gives the shape, the frame and the point sources.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`].
    pub fn exact_at_rows<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        rows: Option<(ArrayView2<'_, T>, usize)>,
        anchor: Anchor,
        pixels: &[(usize, usize)],
    ) -> Result<Vec<f64>, PsfieldError> {
        let part = rows.map(|(light, first_row)| (light, (0, first_row)));
        self.exact_sums(scene, part, (anchor, pixels), &NoProgress)
    }

    /// The values of single pixels from a part of the light and the column and row that it begins at.
    fn exact_sums<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        part: Option<(ArrayView2<'_, T>, (usize, usize))>,
        (anchor, pixels): (Anchor, &[(usize, usize)]),
        progress: &dyn Progress,
    ) -> Result<Vec<f64>, PsfieldError> {
        let finer = FinerScene::new(self.options.oversample(), scene)?;
        let dark = Scene::<T>::dark(scene.shape()).with_frame(scene.frame())?;
        let of_scene: Vec<(usize, usize)> = pixels.iter().map(|&pixel| finer.sampled_pixel(pixel)).collect();
        let mut sums = if part.is_some() {
            Direct::new(anchor).at_pixels_of_part(&self.model, &dark, part, &of_scene, progress)?
        } else {
            vec![0.0; pixels.len()]
        };
        let stars = self
            .painter(finer.stars(), anchor)?
            .at_pixels(finer.stars().sources(), pixels)?;
        for (sum, star) in sums.iter_mut().zip(stars) {
            *sum = *sum * finer.pixel_area() + star;
        }
        Ok(sums)
    }

    /// The rows of a scene that reach some rows of the image.
    pub fn rows_reaching<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        rows: std::ops::RangeInclusive<usize>,
    ) -> std::ops::Range<usize> {
        let reach = self.model.grid().ny();
        let of_scene = |row: usize| scene.frame().y0() as usize + row * self.options.oversample();
        let last = of_scene(rows.end() + 1) + reach;
        of_scene(*rows.start()).saturating_sub(reach)..last.min(scene.shape().ny())
    }

    fn painter<'a, T: ConvReal>(
        &'a self,
        stars: &Scene<T>,
        anchor: Anchor,
    ) -> Result<StarPainter<'a>, PsfieldError> {
        let size = self.options.stamp_size();
        Ok(StarPainter::new(self.star_model(), stars.frame(), anchor, size)?)
    }
}
