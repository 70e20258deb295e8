//! What is to be convolved.

use std::path::{Path, PathBuf};

use conv_core::ConvReal;
use psf_io::{Catalog, HduChoice, HeaderCards, ImageReader, IoError, SkyCoordinates};
use psf_types::Scene;
use psfield::{PsfieldError, SceneLayout, SceneSources, SimulationOptions};

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

/// The sources of a scene, and what of the catalogue makes none.
pub(super) struct Sources<T> {
    pub(super) placed: SceneSources<T>,
    /// Rows of the catalogue that make no source.
    pub(super) invalid_rows: usize,
    /// Rows of the catalogue that lie on a part of the sky that the projection does not show.
    pub(super) rows_off_projection: usize,
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
        let layout = match &image {
            Some(image) => SceneLayout::of_image(image.shape(), self.finer())?,
            None => self.dark_layout()?,
        };
        let sources = self.sources(layout, &header, reach)?;
        let scene = sources.placed.lit(image)?;
        Ok((scene, sources, header))
    }

    /// The image of the scene, row by row.
    pub(super) fn open(&self, path: &Path) -> Result<ImageReader, psf_io::IoError> {
        ImageReader::open_hdu(path, self.extension.as_ref())
    }

    fn dark_layout(&self) -> anyhow::Result<SceneLayout> {
        let Some(Pair(nx, ny)) = self.shape else {
            return Err(UsageError("a scene needs an image or --shape NX,NY".to_owned()).into());
        };
        SceneLayout::of_frame(nx, ny, self.finer()).map_err(|e| self.told_of(e))
    }

    /// The catalogue's sources on a scene with a header, seen through the frame.
    pub(super) fn sources<T: ConvReal>(
        &self,
        layout: SceneLayout,
        header: &HeaderCards,
        reach: usize,
    ) -> anyhow::Result<Sources<T>> {
        let catalog = match &self.catalog {
            Some(path) => self.read_catalog(path, header)?,
            None => Catalog::default(),
        };
        let (invalid_rows, rows_off_projection) = (catalog.invalid_rows(), catalog.rows_off_projection());
        let layout = layout
            .with_frame(self.frame.map(|Frame(frame)| frame))
            .with_reach(reach);
        let (stars, galaxies) = catalog.into_parts();
        Ok(Sources {
            placed: SceneSources::new(layout, stars, galaxies).map_err(|e| self.told_of(e))?,
            invalid_rows,
            rows_off_projection,
        })
    }

    /// The same error as bad usage where an option is wrong, and with the file that holds what is wrong with the catalogue.
    fn told_of(&self, error: PsfieldError) -> anyhow::Error {
        match (&error, &self.catalog) {
            // Their texts begin with the name of the option.
            (
                PsfieldError::SceneTooLarge { .. }
                | PsfieldError::FrameOffScene { .. }
                | PsfieldError::FrameOffAnyScene { .. },
                _,
            ) => UsageError(format!("--{error}")).into(),
            (PsfieldError::FluxBeyondPrecision { .. }, Some(path)) => {
                let file = path.display().to_string();
                anyhow::Error::new(error).context(file)
            }
            _ => error.into(),
        }
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
}

impl<T: ConvReal> Sources<T> {
    /// Says what nothing here can check; `psf_oversampling` as in [`SceneSources::warnings`].
    pub(super) fn warn(&self, psf_oversampling: f64, context: &Context) {
        for warning in self.placed.warnings(psf_oversampling) {
            context.warn(&warning.to_string());
        }
    }
}
