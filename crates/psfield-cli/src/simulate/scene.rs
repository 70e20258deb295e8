//! The scene of `psfield simulate`: an image, a catalogue, or both.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use conv_core::ConvReal;
use psf_io::{
    Catalog, CatalogOptions, HduChoice, HeaderCards, ImageReader, IoError, SkyCoordinates,
    WorldCoordinatesError,
};
use psf_types::{FrameShape, PixelRegion};
use psfield::{SceneLight, ScenePixels, SimulateOptions, Simulator};

use crate::UsageError;
use crate::catalog_args::CatalogArgs;
use crate::context::{GivenOptions, with_nan_setting, with_option};
use crate::simulate::colour::{ColourArgs, folder_of};
use crate::values::{finite, pair, region};

/// The scene: an image, a catalogue, or both.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct SceneArgs {
    /// FITS image with the flux in each pixel. Without it, give --catalog and --shape
    #[arg(value_name = "SCENE.fits")]
    pub(super) scene: Option<PathBuf>,
    /// Stars and galaxies: CSV, text or FITS table with columns x, y (0-based pixels) and flux
    ///
    /// x and y are in pixels of the output image and count from the first pixel of the scene.
    /// Sources may lie outside the scene. If the columns have other names, give these with
    /// --columns.
    ///
    /// Rows with re and n are galaxies with Sersic profiles. re: half-light radius along the major
    /// axis (pixels of the output image). n: Sersic index, 0.3 to 8. q: axis ratio [default: 1].
    /// angle: degrees from +x towards +y [default: 0]. g1, g2: reduced shear, applied to this
    /// galaxy, which keeps its area [default: 0]. re = 0 is a star.
    ///
    /// With the world coordinates of the scene (or of --wcs), ra and dec (degrees) may replace x
    /// and y, and re_arcsec and pa_deg (position angle, from north towards east) may replace re and
    /// angle. With re_arcsec, the shear is that on the sky. Sources move by pmra, pmdec (mas per
    /// year), parallax (mas) and radial_velocity (km/s) from their epoch to the date of the frame.
    #[arg(long, value_name = "CATALOG", help_heading = SCENE)]
    pub(super) catalog: Option<PathBuf>,
    /// Columns and rows of a scene without an image (pixels) [default: the field of the PSF, if its
    /// file states one]
    ///
    /// A PSFEx model states the positions of its stars (POLZERO, POLSCAL). The default is the frame
    /// that fits them.
    #[arg(
        long,
        value_name = "NX,NY",
        value_parser = pair,
        conflicts_with = "scene",
        allow_hyphen_values = true,
        help_heading = SCENE
    )]
    pub(super) shape: Option<(usize, usize)>,
    /// Scene pixels per pixel of the output image along each axis [default: 1]
    ///
    /// From 1 to 64. For scenes that are images. Stars and galaxies of a catalogue do not depend on
    /// it. The catalogue, --shape and --frame stay in pixels of the output image.
    #[arg(
        long,
        value_name = "S",
        value_parser = clap::value_parser!(u16).range(1..=SimulateOptions::MAX_OVERSAMPLE as i64),
        help_heading = SCENE
    )]
    oversampling: Option<u16>,
    #[arg(
        long,
        value_name = "point|integrated",
        help_heading = SCENE,
        help = scene_pixels_help(),
        long_help = format!(
            "{}\n\npoint: light at the centre of the pixel, such as a single bright pixel for a star.\nintegrated: light that is already integrated over the pixel of the scene, such as the cells of a simulation or a deep image. The response of this pixel is taken out. Detail finer than the pixels cannot be recovered, and noise is amplified by at most 2.47 before the PSF.\nApplies only to a scene that is an image.",
            scene_pixels_help()
        )
    )]
    scene_pixels: Option<ScenePixels>,
    /// Part of the scene to write: first column, first row, columns, rows (pixels)
    ///
    /// X0, Y0 and the catalogue count from the first pixel of the scene. The positions of the PSF
    /// count from the first pixel of this part. All are in pixels of the output image.
    #[arg(
        long,
        value_name = "X0,Y0,NX,NY",
        value_parser = region,
        allow_hyphen_values = true,
        help_heading = SCENE,
        hide_short_help = true
    )]
    pub(super) frame: Option<PixelRegion>,
    /// HDU of the scene (or of --wcs): its number (0: primary), NAME or NAME,VERSION [default: the
    /// primary image, else the only one]
    #[arg(long, value_name = "N|NAME", help_heading = SCENE)]
    pub(super) extension: Option<HduChoice>,
    /// Flux that replaces NaN in pixels of the scene [default: NaN is an error]
    ///
    /// The report states the number of these pixels.
    #[arg(
        long,
        value_name = "FLUX",
        value_parser = finite,
        help_heading = SCENE,
        hide_short_help = true
    )]
    pub(super) nan_as: Option<f64>,
    /// FITS file with the world coordinates of a scene without an image
    ///
    /// The cards of its header are copied to the output image, and the catalogue may give ra and
    /// dec (degrees) in place of x and y.
    #[arg(
        long,
        value_name = "FILE.fits",
        conflicts_with = "scene",
        help_heading = SCENE
    )]
    pub(super) wcs: Option<PathBuf>,
    #[command(flatten)]
    columns: CatalogArgs,
}

const SCENE: &str = "Scene";

fn scene_pixels_help() -> String {
    format!(
        "Meaning of the values of the scene's image [default: {}]",
        SimulateOptions::default().scene_pixels
    )
}

/// A scene that has been read.
pub(super) struct ReadScene<T: ConvReal> {
    /// The light.
    pub(super) light: SceneLight<T>,
    /// The images that are read by rows, with the numbers of their layers.
    pub(super) rows: Vec<(usize, ImageReader)>,
    pub(super) files: ReadFiles,
}

/// The properties of a scene's files besides its light.
#[derive(Debug, Clone)]
pub(super) struct ReadFiles {
    /// The shape of the scene, in its own pixels.
    pub(super) shape: FrameShape,
    /// The header of the scene's image or of the file `--wcs`.
    pub(super) header: HeaderCards,
    /// The number of invalid rows that were left out of the catalogue.
    pub(super) invalid_rows: usize,
    /// The number of rows of the catalogue at positions on the sky that the projection does not reach.
    pub(super) rows_off_projection: usize,
    /// A warning that names columns of the catalogue that change a source and were not read.
    pub(super) ignored_warning: Option<String>,
    /// NaN pixels of the images that `--nan-as` has replaced. 0 if the images are read by rows.
    pub(super) nan_pixels: usize,
    /// The numbers of stars and galaxies.
    pub(super) sources: (usize, usize),
}

impl<T: ConvReal> ReadScene<T> {
    pub(super) fn new(light: SceneLight<T>, shape: FrameShape, header: HeaderCards) -> Self {
        let files = ReadFiles {
            shape,
            header,
            invalid_rows: 0,
            rows_off_projection: 0,
            ignored_warning: None,
            nan_pixels: 0,
            sources: (0, 0),
        };
        Self {
            light,
            rows: Vec::new(),
            files,
        }
    }

    /// Adds an image of the scene's light, which may have a spectrum. If `by_rows`, its pixels are read
    /// later.
    pub(super) fn add_image(
        &mut self,
        mut reader: ImageReader,
        path: &Path,
        spectrum: Option<&str>,
        by_rows: bool,
    ) -> anyhow::Result<()> {
        let file = path.display();
        if by_rows {
            let Some(layer) = self.light.add_streamed(spectrum) else {
                let name = spectrum.unwrap_or_default();
                anyhow::bail!(
                    "{file}: another image has the spectrum {name}, too: add them up before they are streamed"
                );
            };
            let (expected, found) = (self.files.shape, reader.shape());
            if expected != found {
                anyhow::bail!("{file}: the image has {found} pixels, but the first image has {expected}");
            }
            self.rows.push((layer, reader));
            return Ok(());
        }
        let pixels = reader.read_rows(0..reader.shape().ny());
        let pixels = pixels.map_err(|error| with_nan_as(error, &reader))?;
        self.files.nan_pixels += reader.nan_pixels();
        let added = self.light.add_image(spectrum, pixels);
        added.with_context(|| file.to_string())
    }
}

/// Adds the option `--nan-as` to an error about a pixel, unless the user has set this option.
pub(super) fn with_nan_as(error: IoError, reader: &ImageReader) -> IoError {
    match reader.nan_as() {
        None => with_nan_setting(error, "nan_as"),
        Some(_) => error,
    }
}

impl SceneArgs {
    /// Returns an error message if the options do not fit together.
    pub(super) fn missing(&self, given: &GivenOptions) -> Option<String> {
        if self.extension.is_some() && self.scene.is_none() && self.wcs.is_none() {
            return Some("--extension needs a scene (SCENE.fits) or --wcs".to_owned());
        }
        if self.nan_as.is_some() && self.scene.is_none() {
            return Some("--nan-as needs a scene that is an image (SCENE.fits)".to_owned());
        }
        if self.scene_pixels.is_some() && self.scene.is_none() {
            return Some("--scene-pixels needs a scene that is an image (SCENE.fits)".to_owned());
        }
        match (&self.scene, &self.catalog, self.shape) {
            (None, None, _) => Some(
                "there is nothing to convolve: give a scene (SCENE.fits), sources (--catalog STARS.csv --shape NX,NY), or both \
                 (SCENE.fits --catalog STARS.csv)"
                    .to_owned(),
            ),
            (Some(_), None, _) => given
                .of_group::<CatalogArgs>()
                .first()
                .map(|option| format!("{option} needs a catalogue (--catalog)")),
            _ => None,
        }
    }

    /// Scene pixels per image pixel along each axis.
    pub(super) fn finer(&self) -> usize {
        let default = SimulateOptions::default().oversample;
        self.oversampling.map_or(default, usize::from)
    }

    /// The meaning of the values of the scene's image.
    pub(super) fn pixels(&self) -> ScenePixels {
        self.scene_pixels
            .unwrap_or(SimulateOptions::default().scene_pixels)
    }

    /// Reads the scene. If `by_rows`, opens the scene's images, but does not read their pixels. `field`
    /// is the field of the PSF: the shape, in image pixels, of a scene without an image and without
    /// `--shape`. `more` chooses further columns of the catalogue.
    pub(super) fn read<T: ConvReal>(
        &self,
        colour: &ColourArgs,
        by_rows: bool,
        field: Option<FrameShape>,
        more: fn(CatalogOptions) -> CatalogOptions,
    ) -> anyhow::Result<ReadScene<T>> {
        let in_colour = colour.bandpass.is_some();
        let cube = if in_colour { self.read_cube(by_rows)? } else { None };
        if in_colour && self.scene.is_some() && cube.is_none() && colour.sed.is_none() {
            const NEEDED: &str = "--bandpass needs the spectrum of SCENE.fits: --sed SPECTRUM (or a cube with cards SED1, SED2, ...)";
            return Err(UsageError(NEEDED.to_owned()).into());
        }
        let default = colour.sed.as_ref().map(|sed| sed.0.as_str());
        let mut read = match cube {
            Some(cube) => cube,
            None => self.read_image(default, by_rows, field)?,
        };
        self.read_layers(colour, by_rows, &mut read)?;
        let catalog = self.read_catalog(&read.files.header, |options| {
            more(options.with_colours(in_colour))
        })?;
        read.files.invalid_rows = catalog.invalid_rows();
        read.files.rows_off_projection = catalog.rows_off_projection();
        read.files.ignored_warning = catalog.ignored_warning();
        read.files.sources = (catalog.stars().len(), catalog.galaxies().len());
        if !in_colour {
            read.light.set_catalog(catalog);
            return Ok(read);
        }
        let folder = folder_of(self.catalog.as_deref());
        let set = read.light.set_catalog_with_spectra(catalog, default, folder);
        let file = || {
            let path = self.catalog.as_ref();
            path.map_or_else(String::new, |path| path.display().to_string())
        };
        set.map_err(|error| anyhow::anyhow!(with_option(&error, error.setting())))
            .with_context(file)?;
        Ok(read)
    }

    /// Reads the scene's image, whose light has a spectrum if one is given, or the shape and the header of a
    /// scene without an image.
    fn read_image<T: ConvReal>(
        &self,
        spectrum: Option<&str>,
        by_rows: bool,
        field: Option<FrameShape>,
    ) -> anyhow::Result<ReadScene<T>> {
        let Some(path) = &self.scene else {
            let header = match &self.wcs {
                Some(path) => psf_io::read_cards(path, self.extension.as_ref())?,
                None => HeaderCards::new(),
            };
            return Ok(ReadScene::new(
                SceneLight::new(),
                self.dark_shape::<T>(field)?,
                header,
            ));
        };
        let reader = self.open(path)?;
        let (shape, header) = (reader.shape(), reader.header().clone());
        let mut read = ReadScene::new(SceneLight::new(), shape, header);
        read.add_image(reader, path, spectrum, by_rows)?;
        Ok(read)
    }

    /// Opens the image of the scene for reading by rows.
    pub(super) fn open(&self, path: &Path) -> Result<ImageReader, IoError> {
        Ok(ImageReader::open_hdu(path, self.extension.as_ref())?.with_nan_as(self.nan_as))
    }

    /// The shape of a scene without an image, in its own pixels.
    fn dark_shape<T: ConvReal>(&self, field: Option<FrameShape>) -> anyhow::Result<FrameShape> {
        let field = field.map(|field| (field.nx(), field.ny()));
        let Some((nx, ny)) = self.shape.or(field) else {
            const NEEDED: &str = "a catalogue without an image needs the size of the scene: --shape NX,NY (the PSF file \
                                  does not state a field)";
            return Err(UsageError(NEEDED.to_owned()).into());
        };
        let s = self.finer();
        let pixels = nx.checked_mul(ny).and_then(|n| n.checked_mul(s * s));
        if pixels.is_none_or(|pixels| pixels > Simulator::<T>::MAX_PIXELS) {
            return Err(UsageError(format!("--shape: {nx} x {ny} pixels are too many: a scene without an image may have at most 2^30 = {} pixels (--oversampling multiplies both sides)", Simulator::<T>::MAX_PIXELS)).into());
        }
        Ok(FrameShape::new(nx * s, ny * s)?)
    }

    /// The world coordinates of the pixels in which the positions of the catalogue count.
    pub(super) fn sky(&self, header: &HeaderCards) -> Result<SkyCoordinates, WorldCoordinatesError> {
        // The header of a scene refers to pixels of the scene, but the header of --wcs to pixels of
        // the image.
        match self.scene {
            Some(_) => SkyCoordinates::from_header(&header.binned(self.finer())),
            None => SkyCoordinates::from_header(header),
        }
    }

    /// Reads the catalogue, which may be missing. The positions that it returns are in pixels of the
    /// output image. `more` chooses further columns.
    fn read_catalog(
        &self,
        header: &HeaderCards,
        more: impl Fn(CatalogOptions) -> CatalogOptions,
    ) -> anyhow::Result<Catalog> {
        let Some(path) = &self.catalog else {
            return Ok(Catalog::default());
        };
        let sky = self.sky(header);
        let mut options = more(self.columns.options()?);
        if let Some(unit) = header.pixel_unit().filter(|_| self.scene.is_some()) {
            options = options.with_flux_unit(unit);
        }
        let unusable = match sky {
            Ok(sky) => {
                options = options.with_sky(sky);
                None
            }
            Err(error) => Some(error),
        };
        match (psf_io::read_catalog_with(path, &options), unusable) {
            // An unusable header matters only if the catalogue needs its world coordinates.
            (Err(error), Some(why)) if error.setting() == Some("sky") && !header.is_empty() => {
                let file = self.scene.as_ref().or(self.wcs.as_ref());
                let file = file.map_or_else(String::new, |file| format!("{}: ", file.display()));
                let why = anyhow::anyhow!("{file}{why}");
                // A header may have world coordinates of a kind that is not supported.
                Err(match header.get("CTYPE1") {
                    None => why.context(error),
                    Some(_) => why.context(format!(
                        "{}: the positions on the sky have no pixels",
                        path.display()
                    )),
                })
            }
            (result, _) => Ok(result?),
        }
    }
}
