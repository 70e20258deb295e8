//! Light before the PSF.

use std::borrow::Cow;

use ndarray::Array2;
use psf_types::{DataError, Image, ImageView, PointSource, Real, SersicSource};

/// The light before the PSF: an image `[y, x]` in flux per pixel, stars, galaxies, or any
/// combination of these.
///
/// Positions and sizes of stars and galaxies are in pixels of the frame, even if the image is finer
/// than the frame ([`oversample`](crate::SimulateOptions::oversample)). Positions count from the
/// first pixel of the scene, 0-based, and an integer is the centre of a pixel. They may lie outside
/// the scene.
///
/// The image is owned or borrowed. A borrowed image is not copied if the pixels of each row are
/// neighbours in memory.
///
/// ```
/// use ndarray::Array2;
/// use psfield::Scene;
/// use psfield::psf_types::{ImageView, PointSource, Position};
/// let star = PointSource::new(Position::new(10.25, 12.0)?, 500.0)?;
/// let owned = Scene::new(Array2::<f32>::zeros((48, 64)))?.with_stars(vec![star]);
///
/// let pixels = Array2::<f32>::ones((48, 64));
/// let borrowed = Scene::from(ImageView::new(pixels.view())?);
/// let stars_alone = Scene::<f32>::dark().with_stars(vec![star]);
/// assert_eq!(owned.stars(), stars_alone.stars());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Scene<'a, T = f64> {
    image: Option<ImageView<'a, T>>,
    stars: Cow<'a, [PointSource]>,
    galaxies: Cow<'a, [SersicSource]>,
}

/// Stars and galaxies.
pub(crate) type SceneSources<'a> = (&'a [PointSource], &'a [SersicSource]);

impl<'a, T: Real> Scene<'a, T> {
    /// A scene with only an image.
    ///
    /// # Errors
    /// [`DataError`] for an image without pixels, or with a pixel that is not finite.
    pub fn new(image: Array2<T>) -> Result<Self, DataError> {
        Ok(Image::new(image)?.into())
    }

    /// A scene without an image, for stars and galaxies.
    pub fn dark() -> Self {
        Self {
            image: None,
            stars: Cow::Borrowed(&[]),
            galaxies: Cow::Borrowed(&[]),
        }
    }

    /// Replaces the stars.
    #[must_use]
    pub fn with_stars(self, stars: impl Into<Cow<'a, [PointSource]>>) -> Self {
        Self {
            stars: stars.into(),
            ..self
        }
    }

    /// Replaces the galaxies.
    #[must_use]
    pub fn with_galaxies(self, galaxies: impl Into<Cow<'a, [SersicSource]>>) -> Self {
        Self {
            galaxies: galaxies.into(),
            ..self
        }
    }

    /// The image, if there is one.
    pub fn image(&self) -> Option<&ImageView<'a, T>> {
        self.image.as_ref()
    }

    /// The stars.
    pub fn stars(&self) -> &[PointSource] {
        &self.stars
    }

    /// The galaxies.
    pub fn galaxies(&self) -> &[SersicSource] {
        &self.galaxies
    }

    /// The stars and the galaxies.
    pub(crate) fn sources(&self) -> SceneSources<'_> {
        (&self.stars, &self.galaxies)
    }
}

impl<'a, T: Real> From<ImageView<'a, T>> for Scene<'a, T> {
    fn from(image: ImageView<'a, T>) -> Self {
        Self {
            image: Some(image),
            ..Self::dark()
        }
    }
}

impl<'a, T: Real> From<&'a Image<T>> for Scene<'a, T> {
    fn from(image: &'a Image<T>) -> Self {
        image.view().into()
    }
}

impl<T: Real> From<Image<T>> for Scene<'_, T> {
    fn from(image: Image<T>) -> Self {
        ImageView::from(image).into()
    }
}
