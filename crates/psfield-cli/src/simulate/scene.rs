//! The scene of `psfield simulate`: an image, a catalogue, or both.

use std::path::{Path, PathBuf};

use conv_core::ConvReal;
use psf_io::{
    Catalog, CatalogColumns, CatalogOptions, HduChoice, HeaderCards, ImageReader, IoError, SkyCoordinates,
};
use psf_types::FrameShape;
use psfield::{PsfieldError, Scene, SimulateOptions, Simulator};

use crate::UsageError;
use crate::values::{Frame, Pair, number};

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
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u16).range(1..=SimulateOptions::MAX_OVERSAMPLE as i64))]
    oversample: Option<u16>,
    /// World coordinates of a scene without an image: those of the header of this FITS file. The result gets its cards, and catalogues may
    /// give ra and dec in degrees
    #[arg(long, value_name = "FILE.fits", conflicts_with = "scene")]
    pub(super) wcs: Option<PathBuf>,
    #[command(flatten)]
    columns: CatalogArgs,
}

/// A scene, as far as it is read.
pub(super) struct ReadScene<T: ConvReal> {
    /// Without its image where that comes by rows.
    pub(super) scene: Scene<'static, T>,
    /// The scene's, in its own pixels.
    pub(super) shape: FrameShape,
    /// That of its image, or of --wcs.
    pub(super) header: HeaderCards,
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
        let default = SimulateOptions::default().oversample;
        self.oversample.map_or(default, usize::from)
    }

    /// The scene; its image is not read but opened where it is to come by rows.
    pub(super) fn read<T: ConvReal>(
        &self,
        by_rows: bool,
    ) -> anyhow::Result<(ReadScene<T>, Option<ImageReader>)> {
        let (mut scene, mut rows) = (Scene::dark(), None);
        let (shape, header) = match (&self.scene, &self.wcs) {
            (Some(path), _) if by_rows => {
                let reader = self.open(path)?;
                let of_image = (reader.shape(), reader.header().clone());
                rows = Some(reader);
                of_image
            }
            (Some(path), _) => {
                let read = psf_io::read_image_hdu::<T>(path, self.extension.as_ref())?;
                let (image, header) = read.into_parts();
                let shape = image.shape();
                scene = Scene::from(image);
                (shape, header)
            }
            (None, Some(path)) => {
                let header = psf_io::read_cards(path, self.extension.as_ref())?;
                (self.dark_shape::<T>()?, header)
            }
            (None, None) => (self.dark_shape::<T>()?, HeaderCards::new()),
        };
        let catalog = match &self.catalog {
            Some(path) => self.read_catalog(path, &header)?,
            None => Catalog::default(),
        };
        let (invalid_rows, rows_off_projection) = (catalog.invalid_rows(), catalog.rows_off_projection());
        let (stars, galaxies) = catalog.into_parts();
        let read = ReadScene {
            scene: scene.with_stars(stars).with_galaxies(galaxies),
            shape,
            header,
            invalid_rows,
            rows_off_projection,
        };
        Ok((read, rows))
    }

    /// The image of the scene, row by row.
    pub(super) fn open(&self, path: &Path) -> Result<ImageReader, psf_io::IoError> {
        ImageReader::open_hdu(path, self.extension.as_ref())
    }

    /// The shape of a scene without an image, in its own pixels.
    fn dark_shape<T: ConvReal>(&self) -> anyhow::Result<FrameShape> {
        let Some(Pair(nx, ny)) = self.shape else {
            return Err(UsageError("a scene needs an image or --shape NX,NY".to_owned()).into());
        };
        let s = self.finer();
        let pixels = nx.checked_mul(ny).and_then(|n| n.checked_mul(s * s));
        if pixels.is_none_or(|pixels| pixels > Simulator::<T>::MAX_PIXELS) {
            // Its text begins with the name of the option.
            let error = PsfieldError::SceneTooLarge { nx, ny };
            return Err(UsageError(format!("--{error}")).into());
        }
        Ok(FrameShape::new(nx * s, ny * s)?)
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

/// Columns, origin and magnitudes of a catalogue.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Catalogue")]
struct CatalogArgs {
    /// Columns by what they mean, where they have other names: x, y (or ra, dec), flux (or mag), and for galaxies re, n, q, angle; as in
    /// x=X_IMAGE,y=Y_IMAGE,flux=FLUX_AUTO
    #[arg(long, value_name = "ROLE=COLUMN,...")]
    columns: Option<CatalogColumns>,
    /// Positions count from 1, as those of SExtractor and FITS do
    #[arg(long)]
    one_based: bool,
    /// The magnitude of flux 1, for catalogues with magnitudes
    #[arg(long, value_name = "MAG", allow_negative_numbers = true, value_parser = finite)]
    zero_point: Option<f64>,
    /// Leave out rows that make no source (a position or flux that is missing, a galaxy out of range), and count them
    #[arg(long)]
    skip_invalid: bool,
}

impl CatalogArgs {
    pub(crate) fn options(&self) -> anyhow::Result<CatalogOptions> {
        let mut options = CatalogOptions::new()
            .with_one_based(self.one_based)
            .with_invalid_skipped(self.skip_invalid);
        if let Some(columns) = &self.columns {
            options = options.with_columns(columns.clone());
        }
        if let Some(zero_point) = self.zero_point {
            options = options.with_zero_point(zero_point)?;
        }
        Ok(options)
    }

    /// The first option given.
    pub(crate) fn given(&self) -> Option<&'static str> {
        [
            ("--columns", self.columns.is_some()),
            ("--one-based", self.one_based),
            ("--zero-point", self.zero_point.is_some()),
            ("--skip-invalid", self.skip_invalid),
        ]
        .into_iter()
        .find_map(|(name, given)| given.then_some(name))
    }
}

fn finite(text: &str) -> Result<f64, String> {
    number(text, |value: &f64| value.is_finite(), "a finite number")
}
