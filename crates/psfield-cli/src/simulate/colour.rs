//! Scenes in colour: the options, and the simulation.

use std::path::Path;

use anyhow::Context as _;
use conv_core::{ConvReal, TileCounts};
use ndarray::{Array2, ArrayViewMut2};
use psf_io::{Card, CardValue, ImageReader};
use psf_types::{FrameShape, Image, NoProgress, Progress};
use psfield::{
    ColourScene, ColourSimulator, Dispersion, PixelPicker, Psf, PsfieldError, Scene, Simulator, SpotCheck,
    open_bandpass, spectrum_file, spectrum_in,
};

use crate::UsageError;
use crate::context::{Context, with_option};
use crate::files::{BandpassName, FileUses, Layer, SpectrumName};
use crate::simulate::SimulateArgs;
use crate::simulate::execute::{FitsRows, MakesImage, StreamsImage};
use crate::simulate::exposure_args::Exposing;
use crate::simulate::prepared::{timed, warn_of_coarse_stamps};
use crate::simulate::report::{Report, Seconds};
use crate::simulate::scene::{LeftOut, ReadScene, SceneArgs, with_nan_as};

/// The bandpass of the image, and the spectra of the light.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Colour (for a PSF that depends on the wavelength)")]
pub(super) struct ColourArgs {
    /// Throughput of the instrument: table of wavelengths and throughputs
    ///
    /// Text or FITS table. The first column is the wavelength, the second the fraction of photons that
    /// is detected. If the file does not state the unit of the wavelengths, give it behind the name:
    /// filter.txt:nm (um, nm, Angstrom, mm or m).
    ///
    /// Each source then has the PSF of its own spectrum: the mean over its detected photons. Fluxes
    /// are those in the bandpass.
    #[arg(long, value_name = "FILE[:UNIT]")]
    pub(super) bandpass: Option<BandpassName>,
    /// Spectrum of SCENE.fits, and of catalogues without a column sed or teff
    ///
    /// blackbody:KELVIN, powerlaw:INDEX (f_lambda proportional to lambda^INDEX), or FILE[:UNIT][:VALUES],
    /// a table of wavelengths and values as for --bandpass. VALUES is flambda (energy per wavelength,
    /// default), fnu (energy per frequency) or photons. Behind any of them, @z=REDSHIFT sets the
    /// redshift: galaxy.txt:nm@z=0.5.
    ///
    /// A catalogue may have a column sed with the name of each source's spectrum, or a column teff with
    /// the temperature of a black body (kelvin).
    #[arg(long, value_name = "SPECTRUM", requires = "bandpass")]
    pub(super) sed: Option<SpectrumName>,
    /// Dispersion of the atmosphere: zenith=DEG,scale=ARCSEC and more
    ///
    /// Light of each wavelength is shifted towards the zenith by its refraction (Filippenko 1982).
    /// zenith: zenith distance (degrees). scale: size of a pixel of the output image (arcsec).
    /// direction: direction of the zenith, degrees from +x towards +y [default: 90].
    /// reference: wavelength without a shift (micrometres) [default: the mean of the bandpass].
    /// pressure (hPa), temperature (Celsius), humidity (0 to 1) [default: those of Filippenko,
    /// 800 hPa, 7 C, 10.7 hPa of water vapour].
    /// The stamps of the PSF should have two or more pixels per pixel of the image.
    #[arg(
        long,
        value_name = "KEY=VALUE,...",
        requires = "bandpass",
        hide_short_help = true,
        verbatim_doc_comment
    )]
    pub(super) dispersion: Option<Dispersion>,
    /// A further image of the scene, with its spectrum (may be repeated)
    ///
    /// It has the pixels of SCENE.fits. The images of all spectra are added up. SCENE.fits may also be a
    /// cube whose header names the spectrum of each plane: SED1, SED2, ...
    #[arg(
        long,
        value_name = "IMAGE.fits:sed=SPECTRUM",
        requires = "bandpass",
        hide_short_help = true
    )]
    pub(super) layer: Vec<Layer>,
}

/// A simulator of several spectra, and the scene of each.
struct InColour<'a, T: ConvReal> {
    simulator: &'a ColourSimulator<T>,
    scenes: &'a [Scene<'static, T>],
    /// The spectra whose images are streamed.
    streamed: Vec<usize>,
}

impl<T: ConvReal> MakesImage<T> for InColour<'_, T> {
    fn of_frame(&self) -> &Simulator<T> {
        &self.simulator.spectra()[0]
    }

    fn simulate_into(
        &self,
        image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, PsfieldError> {
        self.simulator.simulate_into(self.scenes, image, progress)
    }

    fn spot_check(&self, image: &Image<T>, pixels: (usize, u64)) -> Result<SpotCheck, PsfieldError> {
        self.simulator.spot_check(self.scenes, image, pixels, &NoProgress)
    }
}

impl<T: ConvReal> StreamsImage<T> for InColour<'_, T> {
    fn stream(&self, rows: &mut FitsRows<T>, progress: &dyn Progress) -> Result<TileCounts, PsfieldError> {
        self.simulator.stream(self.scenes, &self.streamed, rows, progress)
    }

    fn picker(&self, pixels: (usize, u64)) -> PixelPicker {
        self.simulator.picker(self.scenes, pixels)
    }

    fn spot_check_stream(
        &self,
        rows: &mut FitsRows<T>,
        picker: PixelPicker,
    ) -> Result<SpotCheck, PsfieldError> {
        let streamed = &self.streamed;
        self.simulator
            .spot_check_stream(self.scenes, streamed, rows, picker, &NoProgress)
    }
}

impl SimulateArgs {
    /// Returns an error message if the options of colours do not fit together with others.
    pub(super) fn misused_colour(&self) -> Option<String> {
        self.colour.bandpass.as_ref()?;
        let lacks = !self.colour.layer.is_empty() && self.scene.scene.is_none();
        lacks.then(|| "--layer needs a first image (SCENE.fits), whose spectrum is --sed".to_owned())
    }

    /// Checks that no output replaces a spectrum, also one that the catalogue or the cube names.
    fn check_spectra(&self, names: &[String]) -> anyhow::Result<()> {
        let mut uses = FileUses::default();
        for file in names.iter().filter_map(|name| spectrum_file(name)) {
            uses.read(Path::new(file), "a spectrum of the scene");
        }
        let outputs = std::iter::once(self.output.to_path_buf()).chain(self.exposure.outputs(&self.output));
        for output in outputs {
            uses.write(&output, "another output").map_err(UsageError)?;
        }
        Ok(())
    }

    /// Simulates a scene in colour.
    pub(super) fn simulate_in_colour<T: ConvReal>(
        &self,
        bandpass: &str,
        psf: &Psf,
        exposing: Option<&Exposing>,
        mut seconds: Seconds,
        context: &Context,
    ) -> anyhow::Result<Report> {
        let spinner = context.spinner("reading");
        let streamed = self.is_streamed::<T>();
        let ((bandpass, (light, mut rows, read)), taken) = timed(|| {
            let bandpass = open_bandpass(bandpass)?;
            Ok((
                bandpass,
                self.scene
                    .read_colours::<T>(&self.colour, streamed, psf.field_shape())?,
            ))
        })?;
        seconds.read += taken;
        drop(spinner);
        self.check_spectra(light.names())?;
        self.note_of_scene(&read, context);

        let shape = (read.shape.ny(), read.shape.nx());
        let dispersion = self.colour.dispersion.as_ref();
        if dispersion.is_some() {
            warn_of_coarse_stamps("--dispersion", psf, context);
        }
        let spinner = context.spinner("mixing wavelengths");
        let made = light.into_simulator(psf, (&bandpass, dispersion), shape, &self.options());
        drop(spinner);
        let (simulator, scenes) = made.map_err(|error| self.explained(error))?;
        let sources = (
            scenes.iter().map(|scene| scene.stars().len()).sum(),
            scenes.iter().map(|scene| scene.galaxies().len()).sum(),
        );
        self.warn_of_empty_catalog(sources, context);
        // Layers are in the order of their spectra.
        rows.sort_by_key(|(spectrum, _)| *spectrum);
        let (streamed, readers): (Vec<usize>, Vec<ImageReader>) = rows.into_iter().unzip();
        let spinner = context.spinner("fitting and planning");
        let made = simulator
            .prepare(&scenes, &streamed, &NoProgress)
            .map_err(|error| self.explained(error))?;
        [seconds.fit, seconds.plan] = [made.fit_seconds, made.plan_seconds];
        drop(spinner);
        let first = &simulator.spectra()[0];
        let any_image = !streamed.is_empty() || scenes.iter().any(|scene| scene.image().is_some());
        if let Some(warning) = first.psf_warning(&scenes[0], any_image)? {
            context.warn(&warning.to_string());
        }
        self.warn_of_placement(&made.placement, context);
        Self::warn_of_scene(|| simulator.warnings(&scenes), &mut seconds, context);
        let in_colour = InColour {
            simulator: &simulator,
            scenes: &scenes,
            streamed,
        };
        let is_streamed = !readers.is_empty();
        let ready = (&in_colour, &made);
        let outcome = if is_streamed {
            self.by_bands(ready, &read, readers, &mut seconds, context)?
        } else {
            self.in_memory(ready, &read, exposing, &mut seconds, context)?
        };
        Ok(Report {
            streamed: is_streamed,
            ..self.report((in_colour.of_frame(), &made), &read, sources, outcome, seconds)
        })
    }
}

impl SceneArgs {
    /// Reads a scene in colour: images and sources, each with its spectrum. If `by_rows`, opens the
    /// images, but does not read their pixels. The scene in the result is dark.
    fn read_colours<T: ConvReal>(
        &self,
        colour: &ColourArgs,
        by_rows: bool,
        field: Option<FrameShape>,
    ) -> anyhow::Result<ReadColours<T>> {
        let mut light = ColourScene::new();
        let cube = self.read_cube::<T>(by_rows)?;
        if self.scene.is_some() && cube.is_none() && colour.sed.is_none() {
            const NEEDED: &str = "--bandpass needs the spectrum of SCENE.fits: --sed SPECTRUM (or a cube with cards SED1, SED2, ...)";
            return Err(UsageError(NEEDED.to_owned()).into());
        }
        let (mut read, first) = match cube {
            Some(SpectralCube { planes, read }) => {
                let folder = folder_of(self.scene.as_deref());
                for (spectrum, plane) in planes {
                    light.add_image(&spectrum_in(folder, &spectrum), plane)?;
                }
                (read, None)
            }
            None => self.without_catalog().read::<T>(by_rows, field)?,
        };
        let mut rows = Vec::new();
        let dark = std::mem::replace(&mut read.scene, Scene::dark());
        if let (Some(image), Some(sed)) = (dark.image(), &colour.sed) {
            light.add_image(sed, image.pixels().to_owned())?;
        }
        if let (Some(reader), Some(sed)) = (first, &colour.sed) {
            rows.push((light.add_spectrum(sed), reader));
        }
        for layer in &colour.layer {
            let mut reader = self.open(&layer.image)?;
            if by_rows {
                let spectrum = light.add_spectrum(&layer.spectrum);
                let (name, file) = (&layer.spectrum, layer.image.display());
                if rows.iter().any(|(known, _)| *known == spectrum) {
                    anyhow::bail!(
                        "{file}: another image has the spectrum {name}, too: add them up before they are streamed"
                    );
                }
                let (expected, found) = (read.shape, reader.shape());
                if expected != found {
                    anyhow::bail!("{file}: the image has {found} pixels, but the first image has {expected}");
                }
                rows.push((spectrum, reader));
                continue;
            }
            let pixels = reader.read_rows(0..reader.shape().ny());
            let pixels = pixels.map_err(|error| with_nan_as(error, &reader))?;
            read.nan_pixels += reader.nan_pixels();
            let added = light.add_image(&layer.spectrum, pixels);
            added.with_context(|| layer.image.display().to_string())?;
        }
        let catalog = self.read_catalog(&read.header, |options| options.with_colours(true))?;
        read.left_out = LeftOut::of(&catalog);
        let added = light.add_catalog(catalog, colour.sed.as_deref(), folder_of(self.catalog.as_deref()));
        let file = || {
            self.catalog
                .as_ref()
                .map_or_else(String::new, |path| path.display().to_string())
        };
        added
            .map_err(|error| anyhow::anyhow!(with_option(&error, error.setting())))
            .with_context(file)?;
        Ok((light, rows, read))
    }

    /// Reads SCENE.fits if it is a cube whose planes have spectra: those that the cards SED1, SED2, ...
    /// name.
    fn read_cube<T: ConvReal>(&self, by_rows: bool) -> anyhow::Result<Option<SpectralCube<T>>> {
        let Some(path) = &self.scene else {
            return Ok(None);
        };
        let mut header = psf_io::read_header_hdu(path, self.extension.as_ref())?;
        if header.get("SED1").is_none() {
            return Ok(None);
        }
        let file = path.display();
        if by_rows {
            anyhow::bail!(
                "{file}: a cube of spectra cannot be streamed: give its planes as images, with --layer"
            );
        }
        if self.nan_as.is_some() {
            anyhow::bail!("{file}: --nan-as cannot be used with a cube of spectra");
        }
        let cube = psf_io::read_cube_hdu::<T>(path, self.extension.as_ref())?;
        let (count, ny, nx) = cube.dim();
        let mut planes = Vec::with_capacity(count);
        for (number, plane) in (1..).zip(cube.outer_iter()) {
            let keyword = format!("SED{number}");
            let Some(CardValue::Text(spectrum)) = header.get(&keyword).and_then(Card::value) else {
                anyhow::bail!(
                    "{file}: the cube has {count} planes, so it needs the card {keyword} with the name of a spectrum"
                );
            };
            header.remove(&keyword);
            planes.push((spectrum, plane.to_owned()));
        }
        let read = ReadScene {
            scene: Scene::dark(),
            shape: FrameShape::new(nx, ny)?,
            header,
            left_out: LeftOut::default(),
            nan_pixels: 0,
        };
        Ok(Some(SpectralCube { planes, read }))
    }
}

/// The folder of a file, which is that of the program for a relative path or none.
fn folder_of(file: Option<&Path>) -> &Path {
    file.and_then(Path::parent).unwrap_or(Path::new(""))
}

/// A cube, each plane with the name of its spectrum.
struct SpectralCube<T: ConvReal> {
    planes: Vec<(String, Array2<T>)>,
    /// The other data of the file.
    read: ReadScene<T>,
}

/// The parts of a scene in colour: its light, the images that are read by rows with the numbers of
/// their spectra, and the other data of its files.
type ReadColours<T> = (ColourScene<T>, Vec<(usize, ImageReader)>, ReadScene<T>);
