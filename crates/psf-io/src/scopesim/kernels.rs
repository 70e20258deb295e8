//! The cubes of PSFs, one a wavelength.

use ndarray::Array3;

use super::ScopesimOptions;
use super::units::arcsec_in_unit;
use crate::error::unsuitable;
use crate::gridded_psf::cube_shape;
use crate::hdu::{Hdu, HduKind};
use crate::library_cards::LibraryCards;
use crate::pixels::read_pixels;
use crate::structure::FitsStructure;
use crate::{GriddedError, IoError};

/// How far the two sides of a PSF pixel may differ, relatively: the rounding of single precision and no more.
const SQUARE: f64 = 1e-6;

/// A cube whose header has been read and whose pixels have not.
#[derive(Debug)]
pub(super) struct Kernels<'a> {
    structure: &'a FitsStructure,
    hdu: &'a Hdu,
    shape: (usize, usize, usize),
    wavelength_um: f64,
    pixel_arcsec: f64,
}

/// The cube of the wavelength asked for, among the images from HDU `first` on.
pub(super) fn choose<'a>(
    structure: &'a FitsStructure,
    first: usize,
    map: usize,
    options: &ScopesimOptions,
) -> Result<Kernels<'a>, IoError> {
    let path = &structure.path;
    let mut cubes = Vec::new();
    for hdu in structure.hdus.iter().skip(first) {
        if hdu.kind == HduKind::Image && hdu.index != map && !hdu.axes.is_empty() {
            cubes.push((wavelength(&LibraryCards::new(path, hdu))?, hdu));
        }
    }
    let chosen = match (options.wavelength_um(), &cubes[..]) {
        (_, []) => return Err(structure.missing(&format!("PSFs: no image from HDU {first} (EDATA) on"))),
        (_, [only]) => only,
        (Some(wanted), several) => several
            .iter()
            .min_by(|(a, _), (b, _)| (a - wanted).abs().total_cmp(&(b - wanted).abs()))
            .expect("there are several"),
        (None, several) => {
            return Err(unsuitable(path)(GriddedError::WavelengthNeeded {
                wavelengths_um: several.iter().map(|(wavelength, _)| *wavelength).collect(),
            }));
        }
    };
    let &(wavelength_um, hdu) = chosen;
    Ok(Kernels {
        structure,
        hdu,
        shape: cube_shape(hdu)?,
        wavelength_um,
        pixel_arcsec: pixel_arcsec(&LibraryCards::new(path, hdu))?,
    })
}

fn wavelength(cards: &LibraryCards<'_>) -> Result<f64, IoError> {
    const EXPECTED: &str = "the wavelength of the PSFs in micrometres, a number above 0";
    const UNIT: &str = "um: wavelengths are in micrometres";
    if let Some(unit) = cards.text("WAVEUNIT", UNIT)?
        && !["um", "micron", "microns", "micrometer", ""].contains(&unit.to_ascii_lowercase().as_str())
    {
        return Err(cards.bad_value("WAVEUNIT", UNIT, unit));
    }
    let wavelength = cards.required_number("WAVE0", EXPECTED)?;
    if wavelength > 0.0 {
        return Ok(wavelength);
    }
    Err(cards.bad_value("WAVE0", EXPECTED, wavelength.to_string()))
}

/// Size of a PSF pixel, which must be square.
fn pixel_arcsec(cards: &LibraryCards<'_>) -> Result<f64, IoError> {
    const EXPECTED: &str = "the size of a PSF pixel, a number other than 0";
    let size = cards.required_number("CDELT1", EXPECTED)?.abs() * arcsec_in_unit(cards, "CUNIT1")?;
    if !(size > 0.0 && size.is_finite()) {
        return Err(cards.bad_value("CDELT1", EXPECTED, size.to_string()));
    }
    if let Some(other) = cards.number("CDELT2", EXPECTED)? {
        let unit = if cards.has("CUNIT2") { "CUNIT2" } else { "CUNIT1" };
        let other_size = other.abs() * arcsec_in_unit(cards, unit)?;
        if (other_size - size).abs() > SQUARE * size {
            return Err(cards.bad_value(
                "CDELT2",
                "as large as CDELT1: pixels of PSFs are square",
                other.to_string(),
            ));
        }
    }
    Ok(size)
}

impl Kernels<'_> {
    /// Layers, rows and columns.
    pub(super) fn shape(&self) -> (usize, usize, usize) {
        self.shape
    }

    pub(super) fn wavelength_um(&self) -> f64 {
        self.wavelength_um
    }

    pub(super) fn pixel_arcsec(&self) -> f64 {
        self.pixel_arcsec
    }

    /// All layers, as the file has them.
    pub(super) fn read(&self) -> Result<Array3<f64>, IoError> {
        let pixels = read_pixels(&self.structure.path, self.hdu)?;
        Ok(Array3::from_shape_vec(self.shape, pixels).expect("as many pixels as the axes say"))
    }
}
