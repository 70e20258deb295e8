//! Plain stamps: a cube or a single image, without the table of positions of PSF samples.

use std::path::Path;

use psf_types::{DataError, Position, PsfSamples, SamplePositions, SampleStates, StateKind};

use crate::error::{IoError, IoErrorKind, invalid};
use crate::fits::hdu::{Hdu, HduChoice};
use crate::fits::header_cards::HeaderCards;
use crate::fits::image::read_stack;
use crate::fits::structure::FitsStructure;
use crate::psf::gridded::{LibraryCards, cube_shape};
use crate::psf::samples::{field, stamp_grid};

/// Settings for a [plain cube of stamps](read_stamp_cube) whose file lacks them or states them
/// wrongly. They override the header.
///
/// ```
/// use psf_io::StampCubeOptions;
/// let options = StampCubeOptions::default().with_oversampling(4.0).with_pixel_response_included(false);
/// # let _ = options;
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct StampCubeOptions {
    positions: Option<Vec<Position>>,
    oversampling: Option<f64>,
    centre: Option<(f64, f64)>,
    pixel_response_included: Option<bool>,
    extension: Option<HduChoice>,
}

impl StampCubeOptions {
    /// Sets the positions, one per plane in the order of the planes.
    #[must_use]
    pub fn with_positions(self, positions: Vec<Position>) -> Self {
        Self {
            positions: Some(positions),
            ..self
        }
    }

    /// Sets the oversampling in stamp pixels per frame pixel.
    #[must_use]
    pub fn with_oversampling(self, oversampling: f64) -> Self {
        Self {
            oversampling: Some(oversampling),
            ..self
        }
    }

    /// Chooses the image to read.
    #[must_use]
    pub fn with_extension(self, extension: HduChoice) -> Self {
        Self {
            extension: Some(extension),
            ..self
        }
    }

    /// Sets whether the stamps include the response of a frame pixel.
    #[must_use]
    pub fn with_pixel_response_included(self, pixel_response_included: bool) -> Self {
        Self {
            pixel_response_included: Some(pixel_response_included),
            ..self
        }
    }

    /// Sets the reference point of the stamps, a 0-based index that may be fractional.
    #[must_use]
    pub fn with_centre(self, x: f64, y: f64) -> Self {
        let centre = Some((x, y));
        Self { centre, ..self }
    }
}

/// Reads plain stamps as PSF samples: a cube `[plane, y, x]` or an image `[y, x]`. They are in the
/// chosen image, or in the only image with pixels.
///
/// Keywords of the [`psf-samples` layout](crate::samples) are used if present, otherwise the
/// defaults of that layout. `options` override both. A single stamp needs no position: it is the
/// PSF everywhere, and its sample gets the position (0, 0). So does each plane of a cube over
/// wavelength, as STPSF's `calc_datacube` writes them: the cards `WAVELN00`, `WAVELN01` ... (from 100
/// planes on `WVLN0000` ...) give the wavelength of each plane in metres.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("stamp.fits");
/// use psf_io::{HeaderCards, StampCubeOptions, read_stamp_cube, write_image};
/// use psf_types::Image;
/// let stamp = Image::new(ndarray::Array2::from_elem((5, 5), 0.16_f32))?;
/// write_image(&path, &stamp, &HeaderCards::new(), &[], false)?;
/// let samples = read_stamp_cube(&path, &StampCubeOptions::default().with_oversampling(2.0))?;
/// assert!((samples.flux(0) - 1.0).abs() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// - [`IoErrorKind::Setting`] if several images have pixels and none is chosen, for a choice that
///   is not an image with pixels, or for several planes without positions
/// - [`IoErrorKind::Data`] if there is not one position per plane, two positions are equal, a
///   position is outside the frame of `FIELDNX` by `FIELDNY` pixels, a stamp has no positive flux,
///   a value is not finite, or the oversampling or the centre is out of range
/// - [`IoErrorKind::Axes`] unless the image has two or three axes
/// - the [errors of any FITS file](crate#bad-files)
pub fn read_stamp_cube(path: impl AsRef<Path>, options: &StampCubeOptions) -> Result<PsfSamples, IoError> {
    let path = path.as_ref();
    let structure = FitsStructure::scan(path)?;
    let hdu = structure.stamps(options.extension.as_ref())?;
    let shape = cube_shape(hdu)?;
    let (positions, wavelengths_um) = match &options.positions {
        Some(positions) => {
            let what = "positions, one per plane of the cube";
            DataError::check_count(what, shape.0, positions.len()).map_err(invalid(path))?;
            (positions.clone(), None)
        }
        None if shape.0 == 1 => (vec![Position::of_pixel(0, 0)], None),
        None => {
            let Some(wavelengths_um) = of_planes(hdu, shape.0)? else {
                let problem = format!(
                    "there are {} stamps without positions: give one position per stamp",
                    shape.0
                );
                return Err(hdu.error(IoErrorKind::Setting, problem).with_setting("positions"));
            };
            (vec![Position::of_pixel(0, 0); shape.0], Some(wavelengths_um))
        }
    };
    let states = wavelengths_um.map(|um| SampleStates::new(StateKind::Wavelength, &um));
    let states = states.transpose().map_err(invalid(path))?;
    let positions = SamplePositions::with_states(positions, field(hdu)?, states).map_err(invalid(path))?;
    let mut grid = stamp_grid(hdu, shape.2, shape.1)?;
    if let Some(oversampling) = options.oversampling {
        grid = grid.with_oversampling(oversampling).map_err(invalid(path))?;
    }
    if let Some((x, y)) = options.centre {
        grid = grid.with_centre(x, y).map_err(invalid(path))?;
    }
    if let Some(included) = options.pixel_response_included {
        grid = grid.with_pixel_response_included(included);
    }
    PsfSamples::new(read_stack(hdu, shape)?, positions, grid).map_err(invalid(path))
}

/// The wavelength of each plane in micrometres, if there is a card for the first plane.
fn of_planes(hdu: &Hdu, planes: usize) -> Result<Option<Vec<f64>>, IoError> {
    const EXPECTED: &str = "the wavelength of a plane in metres, a number above 0";
    // STPSF: `label_wavelength` in stpsf/utils.py.
    let keyword = |plane: usize| match planes {
        ..100 => format!("WAVELN{plane:02}"),
        _ => format!("WVLN{plane:04}"),
    };
    let cards = LibraryCards::new(hdu);
    if !cards.has(&keyword(0)) {
        return Ok(None);
    }
    let wavelength_um = |plane| {
        let metres = cards.required_number(&keyword(plane), EXPECTED)?;
        if metres > 0.0 {
            Ok(metres * 1e6)
        } else {
            Err(cards.hdu.wrong_value(&keyword(plane), EXPECTED, metres))
        }
    };
    (0..planes).map(wavelength_um).collect::<Result<_, _>>().map(Some)
}

/// Reads the header cards of the image that [`read_stamp_cube`] reads.
///
/// # Errors
/// [`IoErrorKind::Setting`] if a choice is needed or wrong, and the
/// [errors of any FITS file](crate#bad-files). The pixels are not read.
pub fn read_stamp_header(
    path: impl AsRef<Path>,
    extension: Option<&HduChoice>,
) -> Result<HeaderCards, IoError> {
    let structure = FitsStructure::scan(path.as_ref())?;
    Ok(structure.cards(structure.stamps(extension)?))
}
