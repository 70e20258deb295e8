//! Scenes in colour: the options, the PSFs of the spectra, and further images.

use std::path::{Path, PathBuf};

use clap::builder::{StringValueParser, TypedValueParser};
use conv_core::ConvReal;
use psf_types::FrameShape;
use psfield::colours::{open_bandpass, spectrum_file, spectrum_in};
use psfield::{Dispersion, Psf, SceneLight};

use crate::UsageError;
use crate::context::Context;
use crate::files::{BandpassName, FileUses, Layer, SpectrumName};
use crate::simulate::SimulateArgs;
use crate::simulate::prepared::warn_of_coarse_stamps;
use crate::simulate::scene::{ReadScene, SceneArgs};

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
    #[arg(long, value_name = "FILE[:UNIT]", value_parser = StringValueParser::new().map(BandpassName))]
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
    #[arg(long, value_name = "SPECTRUM", requires = "bandpass", value_parser = StringValueParser::new().map(SpectrumName))]
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

impl SimulateArgs {
    /// The PSF of the scene's light: that of the file or, with a bandpass, those of the spectra.
    pub(super) fn psf_of<T: ConvReal>(
        &self,
        psf: &Psf,
        light: &SceneLight<T>,
        context: &Context,
    ) -> anyhow::Result<Psf> {
        let Some(bandpass) = &self.colour.bandpass else {
            return Ok(psf.clone());
        };
        let dispersion = self.colour.dispersion.as_ref();
        if dispersion.is_some() {
            warn_of_coarse_stamps("--dispersion", psf, context);
        }
        let _spinner = context.spinner("mixing wavelengths");
        let mixed = light.psf_of(psf, &open_bandpass(&bandpass.0)?, dispersion);
        mixed.map_err(|error| self.explained(error))
    }
}

/// Checks that no output replaces a file of a spectrum, also one that the catalogue or the cube names.
pub(super) fn check_spectra(names: &[String], outputs: impl Iterator<Item = PathBuf>) -> anyhow::Result<()> {
    let mut uses = FileUses::default();
    for file in names.iter().filter_map(|name| spectrum_file(name)) {
        uses.read(Path::new(file), "a spectrum of the scene");
    }
    for output in outputs {
        uses.write(&output, "another output").map_err(UsageError)?;
    }
    Ok(())
}

impl SceneArgs {
    /// Reads the further images of a scene. If `by_rows`, opens them, but does not read their pixels.
    pub(super) fn read_layers<T: ConvReal>(
        &self,
        colour: &ColourArgs,
        by_rows: bool,
        read: &mut ReadScene<T>,
    ) -> anyhow::Result<()> {
        for layer in &colour.layer {
            let reader = self.open(&layer.image)?;
            read.add_image(reader, &layer.image, Some(&layer.spectrum), by_rows)?;
        }
        Ok(())
    }

    /// Reads SCENE.fits if it is a cube whose planes have spectra: those that the cards SED1, SED2, ...
    /// name.
    pub(super) fn read_cube<T: ConvReal>(&self, by_rows: bool) -> anyhow::Result<Option<ReadScene<T>>> {
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
        let mut light = SceneLight::new();
        for (number, plane) in (1..).zip(cube.outer_iter()) {
            let keyword = format!("SED{number}");
            let Some(spectrum) = header.text(&keyword) else {
                anyhow::bail!(
                    "{file}: the cube has {count} planes, so it needs the card {keyword} with the name of a spectrum"
                );
            };
            header.remove(&keyword);
            let spectrum = spectrum_in(folder_of(Some(path)), &spectrum);
            light.add_image(Some(&spectrum), plane.to_owned())?;
        }
        let shape = FrameShape::new(nx, ny)?;
        Ok(Some(ReadScene::new(light, shape, header)))
    }
}

/// The folder of a file, which is that of the program for a relative path or none.
pub(super) fn folder_of(file: Option<&Path>) -> &Path {
    file.and_then(Path::parent).unwrap_or(Path::new(""))
}
