//! Scenes in colour: the options, and the simulation.

use std::path::PathBuf;
use std::str::FromStr;

use conv_core::{ConvReal, TileCounts};
use ndarray::ArrayViewMut2;
use psf_io::ImageReader;
use psf_types::{Image, NoProgress, Progress};
use psfield::{
    ColourScene, ColourSimulator, Dispersion, PixelPicker, Psf, PsfieldError, Scene, Simulator, SpotCheck,
    open_bandpass,
};

use crate::context::{Context, with_option};
use crate::simulate::SimulateArgs;
use crate::simulate::execute::{FitsRows, MakesImage, StreamsImage};
use crate::simulate::exposure_args::Exposing;
use crate::simulate::prepared::timed;
use crate::simulate::report::{Report, Seconds};
use crate::simulate::scene::ReadScene;

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
    pub(super) bandpass: Option<String>,
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
    pub(super) sed: Option<String>,
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
    /// It has the pixels of SCENE.fits. The images of all spectra are added up.
    #[arg(
        long,
        value_name = "IMAGE.fits:sed=SPECTRUM",
        requires = "bandpass",
        hide_short_help = true
    )]
    pub(super) layer: Vec<Layer>,
}

/// An image and its spectrum.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Layer {
    pub(super) image: PathBuf,
    pub(super) spectrum: String,
}

impl FromStr for Layer {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once(":sed=") {
            Some((image, spectrum)) if !image.is_empty() && !spectrum.is_empty() => Ok(Self {
                image: image.into(),
                spectrum: spectrum.to_owned(),
            }),
            _ => Err("an image and its spectrum are needed, as in red.fits:sed=blackbody:4000".to_owned()),
        }
    }
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
        let first_image = self.scene.scene.as_ref();
        let message = if !self.colour.layer.is_empty() && first_image.is_none() {
            "--layer needs a first image (SCENE.fits), whose spectrum is --sed"
        } else if first_image.is_some() && self.colour.sed.is_none() {
            "--bandpass needs the spectrum of SCENE.fits: --sed SPECTRUM"
        } else {
            return None;
        };
        Some(message.to_owned())
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
        self.note_of_scene(&read, context);

        let shape = (read.shape.ny(), read.shape.nx());
        let dispersion = self.colour.dispersion.as_ref();
        if dispersion.is_some() && psf.grid().oversampling() < 2.0 {
            context.warn(
                "--dispersion shifts stamps by fractions of a pixel, but these stamps have fewer than two pixels per pixel \
                 of the image: use oversampled stamps",
            );
        }
        let spinner = context.spinner("mixing wavelengths");
        let made = light.into_simulator(psf, (&bandpass, dispersion), shape, &self.options());
        drop(spinner);
        let (simulator, scenes) = made.map_err(|error| self.explained(error))?;
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
        for warning in simulator.warnings(&scenes) {
            context.warn(&with_option(&warning, warning.setting()));
        }
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
        let sources = (
            scenes.iter().map(|scene| scene.stars().len()).sum(),
            scenes.iter().map(|scene| scene.galaxies().len()).sum(),
        );
        Ok(Report {
            streamed: is_streamed,
            ..self.report((in_colour.of_frame(), &made), &read, sources, outcome, seconds)
        })
    }
}

/// The parts of a scene in colour: its light, the images that are read by rows with the numbers of
/// their spectra, and the other data of its files.
pub(super) type ReadColours<T> = (ColourScene<T>, Vec<(usize, ImageReader)>, ReadScene<T>);
