//! Light before the PSF.

use std::borrow::Cow;
use std::fmt;

use conv_core::Light;
use ndarray::Array2;
use psf_types::{DataError, Image, ImageView, PointSource, Position, Real, SersicSource};

/// The light before the PSF: an image `[y, x]` in flux per pixel, stars, galaxies, sources with profiles of
/// the caller's own, or any combination of these.
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
/// assert_eq!(owned.stars().count(), stars_alone.stars().count());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Layers
/// A PSF may have several states ([`Psf::states`](crate::Psf::states)), such as those for several
/// spectra. Then the scene has a [`Layer`] of light for each state, in their order, and all layers are
/// added up in one image. The scenes above have one layer. [`of_layers`](Self::of_layers) joins the
/// layers of several scenes:
///
/// ```
/// # use ndarray::Array2;
/// # use psfield::Scene;
/// let (red, blue) = (Array2::<f32>::ones((48, 64)), Array2::<f32>::zeros((48, 64)));
/// let scene = Scene::of_layers([Scene::new(red)?, Scene::new(blue)?]);
/// assert_eq!(scene.layers().len(), 2);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Scene<'a, T = f64> {
    /// One at least.
    layers: Vec<Layer<'a, T>>,
}

/// The light of a [`Scene`] that sees one state of the PSF.
#[derive(Debug, Clone)]
pub struct Layer<'a, T = f64> {
    pixels: Pixels<'a, T>,
    stars: Cow<'a, [PointSource]>,
    galaxies: Cow<'a, [SersicSource]>,
    profiles: Cow<'a, [ProfileSource]>,
}

/// A source with a profile of the caller's own: any light on the sky that is a
/// [`LightProfile`](psf_types::LightProfile).
#[derive(Clone)]
pub struct ProfileSource {
    /// Position and flux.
    pub point: PointSource,
    /// The light, for a flux of 1.
    pub light: Light,
}

impl fmt::Debug for ProfileSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let point = &self.point;
        f.debug_struct("ProfileSource")
            .field("point", point)
            .finish_non_exhaustive()
    }
}

/// The image of a layer.
#[derive(Debug, Clone)]
enum Pixels<'a, T> {
    None,
    InMemory(ImageView<'a, T>),
    /// Its rows are read from a stream.
    Streamed,
}

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
        Self::with(Pixels::None)
    }

    /// A scene whose image is read row by row ([`Simulator::stream`](crate::Simulator::stream)).
    pub fn streamed() -> Self {
        Self::with(Pixels::Streamed)
    }

    fn with(pixels: Pixels<'a, T>) -> Self {
        let layer = Layer {
            pixels,
            stars: Cow::Borrowed(&[]),
            galaxies: Cow::Borrowed(&[]),
            profiles: Cow::Borrowed(&[]),
        };
        Self { layers: vec![layer] }
    }

    /// A scene with the layers of these scenes, in their order.
    ///
    /// # Panics
    /// When there are no scenes.
    pub fn of_layers(scenes: impl IntoIterator<Item = Self>) -> Self {
        let layers: Vec<_> = scenes.into_iter().flat_map(|scene| scene.layers).collect();
        assert!(!layers.is_empty(), "at least one scene");
        Self { layers }
    }

    /// Replaces the stars of the last layer.
    #[must_use]
    pub fn with_stars(mut self, stars: impl Into<Cow<'a, [PointSource]>>) -> Self {
        self.last().stars = stars.into();
        self
    }

    /// Replaces the galaxies of the last layer.
    #[must_use]
    pub fn with_galaxies(mut self, galaxies: impl Into<Cow<'a, [SersicSource]>>) -> Self {
        self.last().galaxies = galaxies.into();
        self
    }

    /// Replaces the sources with profiles of the caller's own in the last layer.
    #[must_use]
    pub fn with_profiles(mut self, profiles: impl Into<Cow<'a, [ProfileSource]>>) -> Self {
        self.last().profiles = profiles.into();
        self
    }

    /// Divides the scene in two, layer by layer: the images and the sources that `is_faint` refuses, and the
    /// sources that it accepts. It takes a source and whether it is a star.
    pub(crate) fn split(&self, is_faint: impl Fn(&PointSource, bool) -> bool) -> (Self, Self) {
        let of_layer = |layer: &Layer<'a, T>| {
            let (faint_stars, stars) = layer.stars.iter().partition(|star| is_faint(star, true));
            let (faint_galaxies, galaxies) = layer.galaxies.iter().partition(|galaxy| {
                let point = PointSource::new(galaxy.position(), galaxy.flux());
                point.is_ok_and(|point| is_faint(&point, false))
            });
            let (faint_profiles, profiles): (Vec<_>, Vec<_>) = layer
                .profiles
                .iter()
                .cloned()
                .partition(|source| is_faint(&source.point, false));
            let part = |pixels, stars: Vec<_>, galaxies: Vec<_>, profiles: Vec<_>| Layer {
                pixels,
                stars: stars.into(),
                galaxies: galaxies.into(),
                profiles: profiles.into(),
            };
            (
                part(layer.pixels.clone(), stars, galaxies, profiles),
                part(Pixels::None, faint_stars, faint_galaxies, faint_profiles),
            )
        };
        let (bright, faint) = self.layers.iter().map(of_layer).unzip();
        (Self { layers: bright }, Self { layers: faint })
    }

    fn last(&mut self) -> &mut Layer<'a, T> {
        self.layers.last_mut().expect("a scene has a layer")
    }

    /// The layers, one at least.
    pub fn layers(&self) -> &[Layer<'a, T>] {
        &self.layers
    }

    /// The stars of all layers.
    pub fn stars(&self) -> impl Iterator<Item = &PointSource> {
        self.layers.iter().flat_map(Layer::stars)
    }

    /// The galaxies of all layers.
    pub fn galaxies(&self) -> impl Iterator<Item = &SersicSource> {
        self.layers.iter().flat_map(Layer::galaxies)
    }

    /// The sources with profiles of the caller's own, of all layers.
    pub fn profiles(&self) -> impl Iterator<Item = &ProfileSource> {
        self.layers.iter().flat_map(Layer::profiles)
    }

    /// The positions and fluxes of all sources.
    pub(crate) fn points(&self) -> impl Iterator<Item = (Position, f64)> {
        let stars = self.stars().map(|star| (star.position(), star.flux()));
        let galaxies = self.galaxies().map(|galaxy| (galaxy.position(), galaxy.flux()));
        let profiles = self.profiles().map(|source| &source.point);
        let profiles = profiles.map(|point| (point.position(), point.flux()));
        stars.chain(galaxies).chain(profiles)
    }

    /// Returns whether a layer has an image, in memory or streamed.
    pub fn has_image(&self) -> bool {
        self.layers.iter().any(Layer::has_image)
    }

    /// Returns whether a layer has stars, galaxies or other sources.
    pub(crate) fn has_sources(&self) -> bool {
        self.layers.iter().any(Layer::has_sources)
    }

    /// The numbers of the layers that have an image.
    pub(crate) fn layers_with_image(&self) -> Vec<usize> {
        let numbers = 0..self.layers.len();
        numbers.filter(|&layer| self.layers[layer].has_image()).collect()
    }
}

impl<'a, T: Real> Layer<'a, T> {
    /// The image, if there is one in memory.
    pub fn image(&self) -> Option<&ImageView<'a, T>> {
        match &self.pixels {
            Pixels::InMemory(image) => Some(image),
            Pixels::None | Pixels::Streamed => None,
        }
    }

    /// Returns whether the layer has an image that is read row by row.
    pub fn is_streamed(&self) -> bool {
        matches!(self.pixels, Pixels::Streamed)
    }

    /// Returns whether the layer has an image, in memory or streamed.
    pub fn has_image(&self) -> bool {
        !matches!(self.pixels, Pixels::None)
    }

    /// The stars.
    pub fn stars(&self) -> &[PointSource] {
        &self.stars
    }

    /// The galaxies.
    pub fn galaxies(&self) -> &[SersicSource] {
        &self.galaxies
    }

    /// The sources with profiles of the caller's own.
    pub fn profiles(&self) -> &[ProfileSource] {
        &self.profiles
    }

    pub(crate) fn has_sources(&self) -> bool {
        !(self.stars.is_empty() && self.galaxies.is_empty() && self.profiles.is_empty())
    }
}

impl<'a, T: Real> From<ImageView<'a, T>> for Scene<'a, T> {
    fn from(image: ImageView<'a, T>) -> Self {
        Self::with(Pixels::InMemory(image))
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
