//! What is to be convolved.

use std::path::{Path, PathBuf};

use conv_core::ConvReal;
use ndarray::{Array2, ArrayViewMut2, s};
use psf_io::{Catalog, HduChoice, HeaderCards, ImageReader, IoError, SkyCoordinates};
use psf_types::{FrameShape, Image, PixelRegion, PointSource, Position, Scene, SersicProfile, SersicSource};
use psfield::SimulationOptions;

use super::super::UsageError;
use super::super::catalog_args::CatalogArgs;
use super::super::context::Context;
use super::super::values::{Frame, Pair};

/// The scene: an image, a catalogue, or both.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct SceneArgs {
    /// The scene: a FITS image, flux in each pixel. Without one: --catalog and --shape
    #[arg(value_name = "SCENE.fits")]
    pub(super) scene: Option<PathBuf>,
    /// Which image of the file of the scene (or of --wcs): a number counted from 0 (the primary HDU), or NAME or NAME,VERSION
    #[arg(long, value_name = "N|NAME")]
    pub(super) extension: Option<HduChoice>,
    /// Stars and galaxies: a CSV, text or FITS table with the columns x, y (pixels of the image, 0-based; also off it) and flux; with re, n,
    /// q and angle: galaxies with Sersic profiles. See --columns
    #[arg(long, value_name = "CATALOG")]
    pub(super) catalog: Option<PathBuf>,
    /// Columns and rows of a scene without an image
    #[arg(
        long,
        value_name = "NX,NY",
        conflicts_with = "scene",
        allow_hyphen_values = true
    )]
    pub(super) shape: Option<Pair>,
    /// The part of the scene that the result shows: first column and row, columns and rows
    #[arg(long, value_name = "X0,Y0,NX,NY", allow_hyphen_values = true)]
    pub(super) frame: Option<Frame>,
    /// The scene is finer than the image: S x S of its pixels are one of the image. The catalogue, --shape and --frame are in pixels of
    /// the image all the same, and the response of its pixels is applied once
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u16).range(1..=SimulationOptions::MAX_OVERSAMPLE as i64))]
    oversample: Option<u16>,
    /// World coordinates of a scene without an image: those of the header of this FITS file. The result gets its cards, and catalogues may
    /// give ra and dec in degrees
    #[arg(long, value_name = "FILE.fits", conflicts_with = "scene")]
    pub(super) wcs: Option<PathBuf>,
    #[command(flatten)]
    columns: CatalogArgs,
}

/// The largest frame that can be asked for, 4 GiB in f32; a larger number is a slip.
const MAX_PIXELS: usize = 1 << 30;

/// A scene without its image, everything in its own pixels.
pub(super) struct Sources<T> {
    pub(super) scene: Scene<T>,
    pub(super) galaxies: Vec<SersicSource>,
    /// Rows of the catalogue that make no source.
    pub(super) invalid_rows: usize,
    /// Rows of the catalogue that lie on a part of the sky that the projection does not show.
    pub(super) rows_off_projection: usize,
    /// Dark pixels put around the scene, into which galaxies at its edges reach; `scene` has them.
    pub(super) padding: usize,
}

impl SceneArgs {
    /// What is wrong with the options given, if anything.
    pub(super) fn missing(&self) -> Option<String> {
        if self.extension.is_some() && self.scene.is_none() && self.wcs.is_none() {
            return Some("--extension is of the file of the scene or of --wcs: there is none".to_owned());
        }
        match (&self.scene, &self.catalog, self.shape) {
            (None, None, _) => Some(
                "there is nothing to convolve: give a scene (SCENE.fits), sources (--catalog STARS.csv --shape NX,NY), or both \
                 (SCENE.fits --catalog STARS.csv)"
                    .to_owned(),
            ),
            (None, Some(_), None) => {
                Some("a catalogue without a scene needs the frame's size: --shape NX,NY".to_owned())
            }
            (Some(_), None, _) => self
                .columns
                .given()
                .map(|option| format!("{option} is of a catalogue: there is none here (--catalog)")),
            _ => None,
        }
    }

    /// Pixels of the scene along each side of a pixel of the image.
    pub(super) fn finer(&self) -> usize {
        self.oversample.map_or(1, usize::from)
    }

    /// The whole scene in memory, and the header of its image. Light from as far as `reach` pixels of the image beyond the scene comes
    /// in.
    pub(super) fn read<T: ConvReal>(
        &self,
        reach: usize,
    ) -> anyhow::Result<(Scene<T>, Sources<T>, HeaderCards)> {
        let (image, header) = match &self.scene {
            Some(path) => {
                let read = psf_io::read_image_hdu::<T>(path, self.extension.as_ref())?;
                let (image, header) = read.into_parts();
                (Some(image), header)
            }
            None => match &self.wcs {
                Some(path) => (None, psf_io::read_cards(path, self.extension.as_ref())?),
                None => (None, HeaderCards::new()),
            },
        };
        let shape = match &image {
            Some(image) => image.shape(),
            None => self.dark_shape()?,
        };
        let sources = self.sources(shape, &header, reach)?;
        let image = match image {
            None if sources.galaxies.is_empty() => None,
            None => Some(Image::zeros(shape)),
            image => image,
        };
        let Some(image) = image else {
            return Ok((sources.scene.clone(), sources, header));
        };
        let mut light = image.into_pixels();
        if sources.padding > 0 {
            let (p, shape) = (sources.padding, sources.scene.shape());
            let mut padded = Array2::zeros((shape.ny(), shape.nx()));
            let (ny, nx) = light.dim();
            padded.slice_mut(s![p..p + ny, p..p + nx]).assign(&light);
            light = padded;
        }
        sources.add_galaxies(light.view_mut(), 0);
        let scene = Scene::from_image(Image::new(light)?)
            .with_sources(sources.scene.sources().to_vec())
            .with_frame(sources.scene.frame())?;
        Ok((scene, sources, header))
    }

    /// The image of the scene, row by row.
    pub(super) fn open(&self, path: &Path) -> Result<ImageReader, psf_io::IoError> {
        ImageReader::open_hdu(path, self.extension.as_ref())
    }

    fn dark_shape(&self) -> anyhow::Result<FrameShape> {
        let Some(Pair(nx, ny)) = self.shape else {
            return Err(UsageError("a scene needs an image or --shape NX,NY".to_owned()).into());
        };
        let s = self.finer();
        let pixels = nx.checked_mul(ny).and_then(|n| n.checked_mul(s * s));
        if pixels.is_none_or(|pixels| pixels > MAX_PIXELS) {
            return Err(UsageError(format!("--shape: {nx} x {ny} pixels are too many")).into());
        }
        Ok(FrameShape::new(nx * s, ny * s).map_err(|e| UsageError(format!("--shape: {e}")))?)
    }

    /// The catalogue's sources on a scene of a shape and header, seen through the frame.
    pub(super) fn sources<T: ConvReal>(
        &self,
        shape: FrameShape,
        header: &HeaderCards,
        reach: usize,
    ) -> anyhow::Result<Sources<T>> {
        let catalog = match &self.catalog {
            Some(path) => self.read_catalog(path, header)?,
            None => Catalog::default(),
        };
        let (invalid_rows, rows_off_projection) = (catalog.invalid_rows(), catalog.rows_off_projection());
        let s = self.finer();
        let padding = if catalog.galaxies().is_empty() {
            0
        } else {
            reach * s
        };
        let (stars, galaxies) = self.in_scene_pixels::<T>(catalog, padding as f64)?;
        let padded = FrameShape::new(shape.nx() + 2 * padding, shape.ny() + 2 * padding)?;
        let seen = |frame: PixelRegion| {
            // Judged on the scene as it is, before it is padded.
            Scene::<T>::dark(shape)
                .with_frame(frame)
                .map_err(|e| UsageError(format!("--frame: {e}")))?;
            let p = padding as i64;
            let frame = PixelRegion::new(frame.x0() + p, frame.y0() + p, frame.shape());
            Ok::<_, anyhow::Error>(Scene::dark(padded).with_frame(frame)?)
        };
        let mut scene = seen(shape.region())?;
        match self.frame {
            Some(Frame(frame)) => {
                scene = seen(finer_frame(frame, s)?)?;
            }
            None if !(shape.nx().is_multiple_of(s) && shape.ny().is_multiple_of(s)) => anyhow::bail!(
                "the scene is {shape} pixels, which is no multiple of --oversample {s}: cut it, or choose a part of it with --frame"
            ),
            None => {}
        }
        Ok(Sources {
            scene: scene.with_sources(stars),
            padding,
            galaxies,
            invalid_rows,
            rows_off_projection,
        })
    }

    /// The catalogue, in pixels of the image.
    fn read_catalog(&self, path: &Path, header: &HeaderCards) -> anyhow::Result<Catalog> {
        // A scene's header counts its own pixels, that of --wcs the image's.
        let sky = match self.scene {
            Some(_) => SkyCoordinates::from_header(&header.binned(self.finer())),
            None => SkyCoordinates::from_header(header),
        };
        let mut options = self.columns.options()?;
        let unusable = match sky {
            Ok(sky) => {
                options = options.with_sky(sky);
                None
            }
            Err(error) => Some(error),
        };
        match (psf_io::read_catalog_with(path, &options), unusable) {
            // Only now does it matter.
            (Err(error @ IoError::NoWorldCoordinates { .. }), Some(why)) if !header.is_empty() => {
                let file = self.scene.as_ref().or(self.wcs.as_ref());
                let file = file.map_or_else(String::new, |file| format!("{}: ", file.display()));
                Err(anyhow::anyhow!("{file}{why}").context(error))
            }
            (result, _) => Ok(result?),
        }
    }

    /// Everything in a scene is in its own pixels.
    fn in_scene_pixels<T: ConvReal>(
        &self,
        catalog: Catalog,
        padding: f64,
    ) -> anyhow::Result<(Vec<PointSource>, Vec<SersicSource>)> {
        let (stars, galaxies) = catalog.into_parts();
        let fluxes = stars
            .iter()
            .map(|s| s.flux())
            .chain(galaxies.iter().map(|g| g.flux()));
        if let Some(flux) = fluxes
            .into_iter()
            .find(|&flux| !T::nearest(flux).as_f64().is_finite())
        {
            anyhow::bail!(
                "{}: a flux of {flux:e} is beyond single precision: choose --precision f64",
                self.catalog.as_deref().unwrap_or(Path::new("")).display()
            );
        }
        let s = self.finer() as f64;
        let place = |p: Position| {
            let of_scene = |v: f64| v * s + (s - 1.0) / 2.0 + padding;
            Position::new(of_scene(p.x()), of_scene(p.y()))
        };
        let stars = stars
            .into_iter()
            .map(|star| PointSource::new(place(star.position())?, star.flux()))
            .collect::<Result<_, _>>()?;
        let galaxies = galaxies
            .into_iter()
            .map(|galaxy| {
                let of = galaxy.profile();
                let radius = of.half_light_radius_px() * s;
                let profile = SersicProfile::new(radius, of.index(), of.axis_ratio(), of.angle_deg())?;
                SersicSource::new(place(galaxy.position())?, galaxy.flux(), profile)
            })
            .collect::<Result<_, _>>()?;
        Ok((stars, galaxies))
    }
}

/// Galaxies smaller than this are blurred by the pixels on which they are drawn.
const RESOLVED_PX: f64 = 2.0;

impl<T: ConvReal> Sources<T> {
    /// Says where galaxies are blurred by the scene's own pixels, which nothing here can check.
    pub(super) fn warn_of_small_galaxies(&self, context: &Context) {
        let small = |galaxy: &&SersicSource| galaxy.profile().half_light_radius_px() < RESOLVED_PX;
        let count = self.galaxies.iter().filter(small).count();
        if count > 0 {
            context.warn(&format!(
                "{count} galaxies have a half-light radius below {RESOLVED_PX} pixels of the scene, whose own size then blurs them (by \
                 percents): --oversample S draws them on finer pixels"
            ));
        }
    }

    /// Adds the galaxies' light to rows of the padded scene, the first of which is row `first_row`.
    pub(super) fn add_galaxies(&self, rows: ArrayViewMut2<'_, T>, first_row: usize) {
        sersic::add_galaxies(rows, (0, first_row as i64), &self.galaxies);
    }
}

/// A frame in pixels of a finer scene.
fn finer_frame(frame: PixelRegion, finer: usize) -> anyhow::Result<PixelRegion> {
    let place = |v: i64| v.checked_mul(finer as i64);
    let length = |n: usize| n.checked_mul(finer);
    let (nx, ny) = (frame.shape().nx(), frame.shape().ny());
    match (place(frame.x0()), place(frame.y0()), length(nx), length(ny)) {
        (Some(x0), Some(y0), Some(nx), Some(ny)) => Ok(PixelRegion::new(x0, y0, FrameShape::new(nx, ny)?)),
        _ => Err(UsageError(format!(
            "--frame: {nx} x {ny} pixels at ({}, {}) lie off any scene",
            frame.x0(),
            frame.y0()
        ))
        .into()),
    }
}
