//! A scene through a PSF.

use conv_core::{
    ConvReal, ConvolutionMethod, Direct, Plan, PlanOptions, RowStream, TileCounts, add_point_sources,
    native_grid,
};
use ndarray::ArrayView2;
use psf_types::{Anchor, FrameShape, Image, NoProgress, Progress, PsfModel, Scene};

use crate::{Method, PsfInput, PsfieldError};

/// Convolves a scene with the right models of a PSF: images with stamps at the frame's pixels, stars with the stamps as they
/// are (an oversampled stamp places a star between pixels better than its own pixels would).
///
/// ```no_run
/// use psfield::conv_core::PlanOptions;
/// use psfield::psf_types::{Image, NoProgress, Scene};
/// use psfield::{FitOptions, PsfInput, Simulation};
/// let psf = PsfInput::open("samples.fits", FitOptions::default())?;
/// let scene = Scene::from_image(psfield::psf_io::read_image::<f32>("scene.fits")?.into_parts().0);
/// let simulation = Simulation::new(psf, &scene, None)?;
/// let image = simulation.run(&scene, Default::default(), PlanOptions::new(1e-3)?)?;
///
/// // Many scenes of one shape: plan once.
/// let plan = simulation.plan(&scene, PlanOptions::new(1e-3)?)?;
/// let (image, tiles) = simulation.run_planned(&plan, &scene, &NoProgress)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Simulation {
    model: PsfModel,
    /// For the point sources of a scene that is also an image, where they need another.
    stars: Option<PsfModel>,
}

/// What of a scene needs a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SceneParts {
    /// There is an image.
    pub image: bool,
    /// There are point sources.
    pub sources: bool,
    /// The frame's shape.
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
    /// The models that scenes of the kind of `scene` need, fitted where `psf` is samples. `stamp_size` cuts or pads the
    /// stamps with which images are convolved; stars are drawn from the stamps as they are.
    ///
    /// # Errors
    /// [`PsfieldError`] when a fit fails, or the frame is larger than the field of the PSF.
    pub fn new<T: ConvReal>(
        psf: PsfInput,
        scene: &Scene<T>,
        stamp_size: Option<usize>,
    ) -> Result<Self, PsfieldError> {
        Self::for_parts(psf, SceneParts::of(scene), stamp_size)
    }

    /// The same for a scene that is not at hand.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn for_parts(
        psf: PsfInput,
        parts: SceneParts,
        stamp_size: Option<usize>,
    ) -> Result<Self, PsfieldError> {
        // One model serves both where the stamps have the frame's pixels already.
        let one_serves = stamp_size.is_none() && native_grid(psf.grid())? == psf.grid();
        let simulation = match (parts.image, parts.sources) {
            _ if one_serves => Self::with_model(psf.into_model()?),
            (true, false) => Self::with_model(psf.native(stamp_size)?.into_model()?),
            (true, true) => Self {
                stars: Some(psf.clone().into_model()?),
                ..Self::with_model(psf.native(stamp_size)?.into_model()?)
            },
            (false, _) => Self::with_model(psf.into_model()?),
        };
        let frame = parts.frame;
        if let Some(field) = simulation.model().field_shape()
            && (frame.nx() > field.nx() || frame.ny() > field.ny())
        {
            return Err(PsfieldError::FrameBeyondField { frame, field });
        }
        Ok(simulation)
    }

    /// A simulation with a model of the caller's, for images and stars alike.
    pub fn with_model(model: PsfModel) -> Self {
        Self { model, stars: None }
    }

    /// The model that convolves images, and draws stars unless their stamps are finer.
    pub fn model(&self) -> &PsfModel {
        &self.model
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
        self.run_with(
            scene,
            method.build::<T>(options)?.as_ref(),
            options.anchor(),
            &NoProgress,
        )
    }

    /// The image of a scene by any method, of this project or of the caller's own, telling how far it has come. `anchor` is that
    /// of the method; it matters here where stars have a model of their own.
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
        let (Some(stars), true) = (&self.stars, scene.image().is_some()) else {
            return Ok(method.convolve_with_progress(&self.model, scene, progress)?);
        };
        let sources = stars_of(scene)?;
        let extended = scene.clone().with_sources(Vec::new());
        let image = method.convolve_with_progress(&self.model, &extended, progress)?;
        let mut pixels = image.into_pixels();
        add_point_sources(stars, &sources, anchor, &mut pixels)?;
        Ok(Image::new(pixels)?)
    }

    /// A plan of the fast engine for the image part of scenes of one shape and frame.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`].
    pub fn plan<T: ConvReal>(&self, scene: &Scene<T>, options: PlanOptions) -> Result<Plan<T>, PsfieldError> {
        Ok(Plan::for_scene(&self.model, scene, options)?)
    }

    /// The image of a scene by a plan of this simulation, and how its tiles were treated.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`].
    pub fn run_planned<T: ConvReal>(
        &self,
        plan: &Plan<T>,
        scene: &Scene<T>,
        progress: &dyn Progress,
    ) -> Result<(Image<T>, TileCounts), PsfieldError> {
        let mut image = plan.dark_image();
        let counts = plan.add_extended_to(scene, &mut image, progress)?;
        add_point_sources(self.star_model(), scene, plan.anchor(), &mut image)?;
        Ok((Image::new(image)?, counts))
    }

    /// The same for a scene whose rows come and go through a stream; `scene` gives the shape, the frame and the point sources.
    ///
    /// # Errors
    /// Those of the stream and of the convolution.
    pub fn stream<T: ConvReal, R: RowStream<T>>(
        &self,
        plan: &Plan<T>,
        scene: &Scene<T>,
        stream: &mut R,
        progress: &dyn Progress,
    ) -> Result<TileCounts, R::Error> {
        plan.stream(scene, self.star_model(), stream, progress)
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
        self.exact_at_rows(scene, scene.pixels().map(|light| (light, 0)), anchor, pixels)
    }

    /// The same where only some rows of the scene's image are at hand, with the number of the first of them: all that reach the
    /// pixels. `scene` gives the shape, the frame and the point sources.
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
        let direct = Direct::new(anchor);
        let dark = Scene::<T>::dark(scene.shape()).with_frame(scene.frame())?;
        let mut sums = direct.at_pixels_of_rows(&self.model, &dark, rows, pixels)?;
        let stars = direct.at_pixels_of_rows(self.star_model(), &stars_of(scene)?, None, pixels)?;
        sums.iter_mut().zip(stars).for_each(|(sum, star)| *sum += star);
        Ok(sums)
    }
}

/// A scene's point sources without its image.
fn stars_of<T: ConvReal>(scene: &Scene<T>) -> Result<Scene<T>, PsfieldError> {
    Ok(Scene::dark(scene.shape())
        .with_sources(scene.sources().to_vec())
        .with_frame(scene.frame())?)
}
