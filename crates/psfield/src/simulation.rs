//! A scene through a PSF.

use std::borrow::Cow;

use conv_core::{ConvReal, ConvolutionMethod, native_grid};
use ndarray::Array2;
use psf_types::{Anchor, Image, NoProgress, Progress, PsfModel, Scene};

use crate::{Method, PsfInput, PsfieldError};

/// Convolves a scene with the right models of a PSF: images with stamps at the frame's pixels, stars with the stamps as they
/// are (an oversampled stamp places a star between pixels better than its own pixels would).
///
/// ```no_run
/// use psfield::psf_types::{Image, Scene};
/// use psfield::{FitOptions, PsfInput, Simulation};
/// let psf = PsfInput::open("samples.fits", FitOptions::default())?;
/// let scene = Scene::from_image(psfield::psf_io::read_image::<f32>("scene.fits")?.into_parts().0);
/// let image = Simulation::new(psf, &scene, None)?.run(&scene, Default::default(), Default::default())?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Simulation {
    model: PsfModel,
    /// For the point sources of a scene that is also an image, where they need another.
    stars: Option<PsfModel>,
}

/// A part of a scene and the model that serves it.
type Part<'a, T> = (&'a PsfModel, Cow<'a, Scene<T>>);

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
        // One model serves both where the stamps have the frame's pixels already.
        let one_serves = stamp_size.is_none() && native_grid(psf.grid())? == psf.grid();
        let simulation = match (scene.image().is_some(), !scene.sources().is_empty()) {
            _ if one_serves => Self::with_model(psf.into_model()?),
            (true, false) => Self::with_model(psf.native(stamp_size)?.into_model()?),
            (true, true) => Self {
                stars: Some(psf.clone().into_model()?),
                ..Self::with_model(psf.native(stamp_size)?.into_model()?)
            },
            (false, _) => Self::with_model(psf.into_model()?),
        };
        let frame = scene.frame().shape();
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

    /// The image of a scene.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`].
    pub fn run<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        method: Method,
        anchor: Anchor,
    ) -> Result<Image<T>, PsfieldError> {
        self.run_with(scene, method.build::<T>(anchor)?.as_ref(), &NoProgress)
    }

    /// The image of a scene by any method, of this project or of the caller's own, telling how far it has come.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`].
    pub fn run_with<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        method: &dyn ConvolutionMethod<T>,
        progress: &dyn Progress,
    ) -> Result<Image<T>, PsfieldError> {
        let mut parts = self.parts(scene)?.into_iter();
        let (model, scene) = parts.next().expect("a scene has a part");
        let mut image = method.convolve_with_progress(model, &scene, progress)?;
        for (model, scene) in parts {
            let sum: Array2<T> = image.into_pixels() + method.convolve(model, &scene)?.pixels();
            image = Image::new(sum)?;
        }
        Ok(image)
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
        let mut sums = vec![0.0; pixels.len()];
        for (model, scene) in self.parts(scene)? {
            let values = conv_core::Direct::new(anchor).at_pixels(model, &scene, pixels)?;
            sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
        }
        Ok(sums)
    }

    /// The scene in parts that one model each serves.
    fn parts<'a, T: ConvReal>(&'a self, scene: &'a Scene<T>) -> Result<Vec<Part<'a, T>>, PsfieldError> {
        Ok(match (&self.stars, scene.image()) {
            (Some(stars), Some(image)) => {
                let sources = scene.sources().to_vec();
                let image = Scene::from_image(image.clone()).with_frame(scene.frame())?;
                let sources = Scene::dark(scene.shape())
                    .with_sources(sources)
                    .with_frame(scene.frame())?;
                vec![(&self.model, Cow::Owned(image)), (stars, Cow::Owned(sources))]
            }
            _ => vec![(&self.model, Cow::Borrowed(scene))],
        })
    }
}
