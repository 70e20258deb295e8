//! Bandpasses, spectra, and what a plan in colour sees of them.

use psfield::colours::{open_bandpass, open_spectrum};
use psfield::conv_core::ConvReal;
use psfield::psf_types::ImageView;
use psfield::spectra::{Bandpass, Curve, FluxDensity, Spectrum};
use psfield::{Dispersion, Psf, PsfieldError, SceneLight};
use pyo3::prelude::*;

use crate::catalog::Sources;
use crate::error::Failure;
use crate::settings::parsed;
use crate::simulators::Images;

/// A bandpass or a spectrum: its name, or wavelengths in micrometres and values.
#[derive(FromPyObject)]
pub(crate) enum Curved {
    Name(String),
    Rows((Vec<f64>, Vec<f64>)),
}

impl Curved {
    pub(crate) fn bandpass(self) -> PyResult<Bandpass> {
        Ok(match self {
            Self::Name(name) => open_bandpass(&name).map_err(Failure::from)?,
            Self::Rows(rows) => Bandpass::new(curve(rows)?),
        })
    }

    pub(crate) fn spectrum(self) -> PyResult<Spectrum> {
        Ok(match self {
            Self::Name(name) => open_spectrum(&name).map_err(Failure::from)?,
            Self::Rows(rows) => Spectrum::table(curve(rows)?, FluxDensity::PerWavelength),
        })
    }
}

fn curve((wavelengths_um, values): (Vec<f64>, Vec<f64>)) -> PyResult<Curve> {
    let made = Curve::new(wavelengths_um, values);
    Ok(made.map_err(|error| Failure::from(PsfieldError::from(error)))?)
}

/// A bandpass, a dispersion in the form of the command line, and a spectrum by name.
pub(crate) type ColourArguments = (Curved, Option<String>, Option<String>);

/// The bandpass and the dispersion, which decide the PSF of a spectrum, and the spectrum of light without one
/// of its own.
#[derive(Debug, Clone)]
pub(crate) struct Colour {
    bandpass: Bandpass,
    dispersion: Option<Dispersion>,
    pub(crate) sed: Option<String>,
}

impl Colour {
    pub(crate) fn new((bandpass, dispersion, sed): ColourArguments) -> PyResult<Self> {
        Ok(Self {
            bandpass: bandpass.bandpass()?,
            dispersion: dispersion.as_deref().map(parsed).transpose()?,
            sed,
        })
    }

    /// The PSFs of the spectra of light.
    pub(crate) fn psf_of<T: ConvReal>(&self, psf: &Psf, light: &SceneLight<T>) -> Result<Psf, PsfieldError> {
        light.psf_of(psf, &self.bandpass, self.dispersion.as_ref())
    }
}

/// The light of a scene. In colour, light without a spectrum has that of the plan.
pub(crate) fn light_of_scene<T: ConvReal>(
    colour: Option<&Colour>,
    images: Images<'_, T>,
    sources: &Sources,
) -> Result<SceneLight<T>, Failure> {
    let sed = colour.and_then(|colour| colour.sed.as_deref());
    let mut light = SceneLight::new();
    for (spectrum, image) in images {
        let name = spectrum
            .as_ref()
            .map_or("scene".to_owned(), |name| format!("scene[{name:?}]"));
        ImageView::new(image).map_err(Failure::of(name))?;
        light.add_image(spectrum.as_deref().or(sed), image.to_owned())?;
    }
    if colour.is_some() {
        light.set_catalog_with_spectra(sources.catalog.clone(), sed, &sources.folder)?;
    } else {
        light.set_catalog(sources.catalog.clone());
    }
    light.sort_spectra();
    Ok(light)
}
