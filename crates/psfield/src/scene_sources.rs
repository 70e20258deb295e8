//! Stars and galaxies on a scene, and the light that they make with its image.

use ndarray::{Array2, ArrayView2, ArrayViewMut2, CowArray, Ix2, s};
use psf_io::HeaderCards;
use psf_types::{
    DataError, FrameShape, Image, PixelRegion, PointSource, Position, Real, Scene, SersicProfile,
    SersicSource,
};

use crate::image_cards::JOB_KEYWORD;
use crate::{PsfieldError, SceneLayout, SimulationWarning, SpotCheck};

/// A scene without its image: stars, galaxies and frame, everything in the scene's own pixels.
///
/// A pixel of the image at `i` has its centre at `oversample i + (oversample - 1) / 2` of the scene. Where there are galaxies, dark pixels
/// are put around the scene ([`padding`](Self::padding)), into which those at its edges reach; all positions count from the first of them.
///
/// ```
/// use psfield::psf_types::{FrameShape, Image, PointSource, Position, SersicProfile, SersicSource};
/// use psfield::{SceneLayout, SceneSources};
/// // In pixels of the image.
/// let star = PointSource::new(Position::new(10.0, 12.0)?, 500.0)?;
/// let galaxy = SersicSource::new(Position::new(-3.0, 20.0)?, 900.0, SersicProfile::new(4.0, 1.0, 0.5, 30.0)?)?;
/// let image = Image::<f32>::zeros(FrameShape::new(64, 48)?);
///
/// let layout = SceneLayout::of_image(image.shape(), 1)?.with_reach(9);
/// let sources = SceneSources::<f32>::new(layout, vec![star], vec![galaxy])?;
/// let scene = sources.lit(Some(image))?;
/// assert_eq!((scene.shape().nx(), scene.frame().x0()), (64 + 2 * 9, 9));
/// assert_eq!(scene.sources()[0].position().x(), 19.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct SceneSources<T> {
    scene: Scene<T>,
    galaxies: Vec<SersicSource>,
    padding: usize,
    layout: SceneLayout,
}

/// Galaxies smaller than this are blurred by the pixels on which they are drawn.
pub(crate) const RESOLVED_PX: f64 = 2.0;
/// Stamps with fewer pixels a frame pixel than this may be too coarse to be interpolated.
const FINE_ENOUGH: f64 = 2.0;
/// A star this close to the centre of a pixel is on it.
const ON_PIXEL: f64 = 1e-9;

impl<T: Real> SceneSources<T> {
    /// Places sources on a scene; their positions and sizes are in pixels of the image, 0-based, also off it.
    ///
    /// # Errors
    /// [`PsfieldError::FluxBeyondPrecision`] for a flux that `T` does not hold, [`PsfieldError::FrameOffScene`] and
    /// [`PsfieldError::FrameOffAnyScene`] for a frame that reaches beyond the scene, [`PsfieldError::UnevenScene`] for a scene without a
    /// frame that holds no whole number of pixels of the image, [`PsfieldError::Data`] for positions and shapes that are too large.
    pub fn new(
        layout: SceneLayout,
        stars: Vec<PointSource>,
        galaxies: Vec<SersicSource>,
    ) -> Result<Self, PsfieldError> {
        let mut fluxes = stars
            .iter()
            .map(|s| s.flux())
            .chain(galaxies.iter().map(|g| g.flux()));
        if let Some(flux) = fluxes.find(|&flux| !T::nearest(flux).as_f64().is_finite()) {
            return Err(PsfieldError::FluxBeyondPrecision { flux });
        }
        let shape = layout.shape;
        let padding = if galaxies.is_empty() {
            0
        } else {
            layout.reach.saturating_mul(layout.oversample)
        };
        let stars = stars_in_scene(stars, &layout, padding)?;
        let galaxies = galaxies_in_scene(galaxies, &layout, padding)?;
        let padded = |n: usize| n.saturating_add(padding.saturating_mul(2));
        let padded = FrameShape::new(padded(shape.nx()), padded(shape.ny()))?;
        let frame = layout.frame_in_scene()?;
        // Judged on the scene as it is, before it is padded.
        Scene::<T>::dark(shape)
            .with_frame(frame)
            .map_err(|source| PsfieldError::FrameOffScene { source })?;
        let p = padding as i64;
        let frame = PixelRegion::new(frame.x0() + p, frame.y0() + p, frame.shape());
        Ok(Self {
            scene: Scene::dark(padded).with_frame(frame)?.with_sources(stars),
            galaxies,
            padding,
            layout,
        })
    }

    /// The scene with its stars, without light in its pixels.
    pub fn scene(&self) -> &Scene<T> {
        &self.scene
    }

    /// The galaxies, in pixels of the scene.
    pub fn galaxies(&self) -> &[SersicSource] {
        &self.galaxies
    }

    /// Dark pixels around the scene on every side; [`scene`](Self::scene) has them.
    pub fn padding(&self) -> usize {
        self.padding
    }

    /// The scene with all its light: that of its image and its galaxies, and the stars. Without an image and without galaxies it has
    /// stars alone.
    ///
    /// # Errors
    /// [`PsfieldError::Data`] for an image of another shape than the layout says, or light beyond the range of `T`.
    pub fn lit(&self, image: Option<Image<T>>) -> Result<Scene<T>, PsfieldError> {
        let image = match image {
            None if self.galaxies.is_empty() => return Ok(self.scene.clone()),
            None => self.with_galaxies(self.dark())?,
            Some(image) => {
                self.check_shape(image.pixels())?;
                if self.galaxies.is_empty() {
                    image
                } else if self.padding == 0 {
                    self.with_galaxies(image.into_pixels())?
                } else {
                    let padded = self.padded(image.pixels());
                    drop(image);
                    self.with_galaxies(padded)?
                }
            }
        };
        Ok(Scene::from_image(image)
            .with_sources(self.scene.sources().to_vec())
            .with_frame(self.scene.frame())?)
    }

    /// The light of an image and the galaxies, in the shape of [`scene`](Self::scene): a copy where there are galaxies, else the image
    /// itself. Pixels are not checked for NaN and infinity.
    ///
    /// # Errors
    /// [`PsfieldError::Data`] for an image of another shape than the layout says.
    pub fn light_of<'a>(&self, image: ArrayView2<'a, T>) -> Result<CowArray<'a, T, Ix2>, PsfieldError> {
        self.check_shape(image)?;
        if self.galaxies.is_empty() {
            return Ok(image.into());
        }
        let mut light = self.padded(image);
        self.add_galaxies(light.view_mut(), 0);
        Ok(light.into())
    }

    /// Adds the galaxies' light to rows of the (padded) scene, the first of which is row `first_row`.
    pub fn add_galaxies(&self, rows: ArrayViewMut2<'_, T>, first_row: usize) {
        sersic::add_galaxies(rows, (0, first_row as i64), &self.galaxies);
    }

    /// The cards of the scene as its image carries them: world coordinates of its pixels, without what was noted of the scene's own making.
    ///
    /// `header` is that of the scene's image and counts its pixels; for a scene without one it counts those of the image.
    pub fn carried_header(&self, header: &HeaderCards) -> HeaderCards {
        let (frame, padding) = (self.scene.frame(), self.padding as i64);
        let (x0, y0, finer) = (frame.x0() - padding, frame.y0() - padding, self.layout.oversample);
        let mut header = if self.layout.of_image {
            header.shifted_origin(x0, y0).binned(finer)
        } else {
            header.shifted_origin(x0 / finer as i64, y0 / finer as i64)
        };
        // A scene that is itself a result must not lend its own check and job to this one.
        for keyword in SpotCheck::KEYWORDS.into_iter().chain([JOB_KEYWORD]) {
            header.remove(keyword);
        }
        header
    }

    /// How many galaxies are blurred by the scene's own pixels: those with a half-light radius below 2 of them.
    pub fn small_galaxies(&self) -> usize {
        let small = |galaxy: &&SersicSource| galaxy.profile().half_light_radius_px() < RESOLVED_PX;
        self.galaxies.iter().filter(small).count()
    }

    /// Whether some star is off the centres of the image's pixels.
    pub fn has_stars_between_pixels(&self) -> bool {
        let s = self.layout.oversample as f64;
        let of_image = |v: f64| (v - (s - 1.0) / 2.0) / s;
        let off = |v: f64| (of_image(v) - of_image(v).round()).abs() > ON_PIXEL;
        let between_pixels = |s: &PointSource| off(s.position().x()) || off(s.position().y());
        self.scene.sources().iter().any(between_pixels)
    }

    /// What a user should know of these sources, which nothing checks: `psf_oversampling` are the pixels of the PSF's stamps along each
    /// side of a pixel of the image, as they were given ([`PsfInput::grid`](crate::PsfInput::grid)).
    pub fn warnings(&self, psf_oversampling: f64) -> Vec<SimulationWarning> {
        let mut warnings = Vec::new();
        if psf_oversampling < FINE_ENOUGH && self.has_stars_between_pixels() {
            warnings.push(SimulationWarning::StarsBetweenPixels);
        }
        let count = self.small_galaxies();
        if count > 0 {
            warnings.push(SimulationWarning::SmallGalaxies { count });
        }
        warnings
    }

    fn dark(&self) -> Array2<T> {
        let shape = self.scene.shape();
        Array2::zeros((shape.ny(), shape.nx()))
    }

    fn padded(&self, image: ArrayView2<'_, T>) -> Array2<T> {
        let (p, (ny, nx)) = (self.padding, image.dim());
        let mut padded = self.dark();
        padded.slice_mut(s![p..p + ny, p..p + nx]).assign(&image);
        padded
    }

    fn with_galaxies(&self, mut light: Array2<T>) -> Result<Image<T>, DataError> {
        self.add_galaxies(light.view_mut(), 0);
        Image::new(light)
    }

    fn check_shape(&self, image: ArrayView2<'_, T>) -> Result<(), DataError> {
        let (expected, got) = ((self.layout.shape.ny(), self.layout.shape.nx()), image.dim());
        if expected == got {
            Ok(())
        } else {
            Err(DataError::ImageShape { expected, got })
        }
    }
}

/// A position in pixels of the padded scene.
fn in_scene(position: Position, layout: &SceneLayout, padding: usize) -> Result<Position, DataError> {
    let s = layout.oversample as f64;
    let of_scene = |v: f64| v * s + (s - 1.0) / 2.0 + padding as f64;
    Position::new(of_scene(position.x()), of_scene(position.y()))
}

fn stars_in_scene(
    stars: Vec<PointSource>,
    layout: &SceneLayout,
    padding: usize,
) -> Result<Vec<PointSource>, DataError> {
    stars
        .into_iter()
        .map(|star| PointSource::new(in_scene(star.position(), layout, padding)?, star.flux()))
        .collect()
}

fn galaxies_in_scene(
    galaxies: Vec<SersicSource>,
    layout: &SceneLayout,
    padding: usize,
) -> Result<Vec<SersicSource>, DataError> {
    galaxies
        .into_iter()
        .map(|galaxy| {
            let of = galaxy.profile();
            let radius = of.half_light_radius_px() * layout.oversample as f64;
            let profile = SersicProfile::new(radius, of.index(), of.axis_ratio(), of.angle_deg())?;
            SersicSource::new(
                in_scene(galaxy.position(), layout, padding)?,
                galaxy.flux(),
                profile,
            )
        })
        .collect()
}

#[cfg(test)]
mod tests;
