//! A scene through a PSF.

mod exact;
mod plans;
mod run;

use conv_core::{ConvReal, ConvolutionMethod, PlanOptions, StarPainter, native_grid};
use ndarray::Array2;
use psf_types::{Anchor, FrameShape, Image, NoProgress, Progress, PsfModel, Scene};

use crate::finer_scene::FinerScene;
use crate::{Method, PsfInput, PsfieldError, SimulationOptions};

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

    fn painter<'a, T: ConvReal>(
        &'a self,
        stars: &Scene<T>,
        anchor: Anchor,
    ) -> Result<StarPainter<'a>, PsfieldError> {
        let size = self.options.stamp_size();
        Ok(StarPainter::new(self.star_model(), stars.frame(), anchor, size)?)
    }
}
