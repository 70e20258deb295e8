//! A scene through a PSF.

use conv_core::{ConvReal, native_grid};
use ndarray::Array2;
use psf_types::{Anchor, Image, PsfModel, Scene};

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
    /// For the image part of a scene.
    pixels: Option<PsfModel>,
    /// For its point sources, where they need another.
    stars: Option<PsfModel>,
}

impl Simulation {
    /// The models that scenes of the kind of `scene` need, fitted where `psf` is samples. `stamp_size` cuts or pads the
    /// stamps with which images are convolved.
    ///
    /// # Errors
    /// [`PsfieldError`] when a fit fails, or the frame is larger than the field of the PSF.
    pub fn new<T: ConvReal>(
        psf: PsfInput,
        scene: &Scene<T>,
        stamp_size: Option<usize>,
    ) -> Result<Self, PsfieldError> {
        // One model serves both where the stamps have the frame's pixels already.
        let both = native_grid(psf.grid())? == psf.grid();
        let native = psf.clone().native(stamp_size)?;
        let needs_pixels = scene.pixels().is_some();
        let needs_stars = !scene.sources().is_empty() || !needs_pixels;
        let pixels = (needs_pixels || both).then(|| native.into_model()).transpose()?;
        let stars = (needs_stars && !both).then(|| psf.into_model()).transpose()?;
        let simulation = Self { pixels, stars };
        let frame = scene.frame().shape();
        if let Some(field) = simulation.model().field_shape()
            && (frame.nx() > field.nx() || frame.ny() > field.ny())
        {
            return Err(PsfieldError::FrameBeyondField { frame, field });
        }
        Ok(simulation)
    }

    /// The model that convolves images; that of the stars where there is no other.
    pub fn model(&self) -> &PsfModel {
        self.pixels
            .as_ref()
            .or(self.stars.as_ref())
            .expect("one of them is always made")
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
        let method = method.build::<T>(anchor)?;
        let mut parts = self.parts(scene)?.into_iter();
        let (model, scene) = parts.next().expect("a scene has a part");
        let mut image = method.convolve(model, &scene)?;
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
    fn parts<T: ConvReal>(&self, scene: &Scene<T>) -> Result<Vec<(&PsfModel, Scene<T>)>, PsfieldError> {
        Ok(match (&self.stars, scene.image()) {
            (Some(stars), Some(image)) => {
                let sources = scene.sources().to_vec();
                vec![
                    (
                        self.model(),
                        Scene::from_image(image.clone()).with_frame(scene.frame())?,
                    ),
                    (
                        stars,
                        Scene::dark(scene.shape())
                            .with_sources(sources)?
                            .with_frame(scene.frame())?,
                    ),
                ]
            }
            _ => vec![(self.model(), scene.clone())],
        })
    }
}
