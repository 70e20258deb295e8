//! STDPSF: the standard PSF libraries of J. Anderson (STScI) for HST and JWST.
//!
//! # Layout
//!
//! The first image with pixels is a cube `[plane, y, x]` of `NXPSFS` times `NYPSFS` planes, x fastest, 4 x oversampled (no keyword says so).
//!
//! | keyword | meaning |
//! |---|---|
//! | `NXPSFS`, `NYPSFS` | columns and rows of the grid of PSFs |
//! | `IPSFX01`, `IPSFX02` ... | x of each column in detector pixels, counted from 1 |
//! | `JPSFY01`, `JPSFY02` ... | y of each row |
//! | `IPSFXA5`, `IPSFXB5` ... and `JPSFYA5` ... | the same as texts of several numbers (WFPC2, all of NIRCam's short-wave detectors) |
//!
//! Keywords may be in lower case, as those of real files are in part. Only the first `NXPSFS` and `NYPSFS` positions are read: further ones are filled up with 9999, which is an error among the first.
//! Stamps are centred at index `(n - 1) / 2` and hold the response of a pixel. They are normalised to 1 within a radius that a
//! comment names, so that they do not sum to 16, and are taken as they are.
//!
//! # Detectors
//!
//! Some files hold several detectors side by side, told by the shape of the grid. Positions become those of the one detector:
//!
//! | PSFs | instrument | detectors | offset |
//! |---|---|---|---|
//! | 9 x 10 | ACS/WFC | 1: WFC2 (SCI,1), 2: WFC1 (SCI,2) | 2048 in y on the second |
//! | 7 x 8 | WFC3/UVIS | 1: UVIS2 (SCI,1), 2: UVIS1 (SCI,2) | 2048 in y on the second |
//! | 6 x 6 | WFPC2 | 1: PC, 2: WF2, 3: WF3, 4: WF4, laid out `2 1` over `3 4` | 800 |
//! | 20 x 10 | NIRCam short-wave | 1 to 4: A1 to A4, 5 to 8: B1 to B4, laid out `2 4 7 5` over `1 3 8 6` | 2048 |
//!
//! The numbers are those of photutils' `detector_id`. Any other grid is of one detector.

mod border;
mod layout;
mod lines;

use std::path::Path;

use ndarray::{Array3, Axis};
use psf_types::Position;

use crate::error::{invalid, unsuitable};
use crate::gridded_psf::{Planes, cube_shape};
use crate::library_cards::{LibraryCards, has_card};
use crate::pixels::read_pixels;
use crate::structure::FitsStructure;
use crate::{GriddedError, GriddedPsf, HduChoice, IoError};

use layout::Layout;

/// Stamp pixels per detector pixel.
const OVERSAMPLING: f64 = 4.0;
const COUNT_EXPECTED: &str = "the number of PSFs along an axis of the grid, a whole number above 0";

/// Whether a file is such a library: its cube says how many PSFs lie along an axis. (That both are needed, the reader says
/// best.)
pub(crate) fn is_stdpsf(structure: &FitsStructure) -> bool {
    structure
        .first_image()
        .is_ok_and(|hdu| ["NXPSFS", "NYPSFS"].iter().any(|keyword| has_card(hdu, keyword)))
}

/// Reads an STDPSF library; see the [layout](self). `detector` chooses among several.
///
/// [`GriddedPsf::notes`] names the detector taken and border rows of stamps whose values cannot be those of a PSF; the values
/// stay as they are.
///
/// ```no_run
/// use psf_io::read_stdpsf;
/// let library = read_stdpsf("STDPSF_ACSWFC_F814W.fits", Some(2))?;
/// assert_eq!(library.detector(), Some("WFC1"));
/// assert_eq!(library.samples().grid().oversampling(), 4.0);
/// # Ok::<(), psf_io::IoError>(())
/// ```
///
/// # Errors
/// [`IoError::SeveralHdus`] when more than one image has pixels; [`IoError::Library`] with the card in question where one is missing or malformed, where the number of planes is not that of the
/// grid, where two lines of the grid are equal, where a plane has no flux, or where there are several detectors and none of
/// them is chosen; [`IoError::NonFinitePixels`]; and the errors of any FITS file.
pub fn read_stdpsf(path: impl AsRef<Path>, detector: Option<usize>) -> Result<GriddedPsf, IoError> {
    read_stdpsf_hdu(path, None, detector)
}

/// The same of the HDU chosen.
///
/// # Errors
/// As [`read_stdpsf`]; [`IoError::NoSuchHdu`].
pub fn read_stdpsf_hdu(
    path: impl AsRef<Path>,
    choice: Option<&HduChoice>,
    detector: Option<usize>,
) -> Result<GriddedPsf, IoError> {
    let path = path.as_ref();
    let structure = FitsStructure::scan(path)?;
    let hdu = structure.stamps(choice)?;
    let cards = &LibraryCards::new(path, hdu);
    let (planes, ny, nx) = cube_shape(hdu)?;
    let columns = cards.required_count("NXPSFS", 1, COUNT_EXPECTED)?;
    let rows = cards.required_count("NYPSFS", 1, COUNT_EXPECTED)?;
    // Also bounds what is read of the header below.
    if columns.checked_mul(rows) != Some(planes) {
        return Err(unsuitable(path)(GriddedError::PlaneCount {
            hdu: hdu.index,
            planes,
            what: "NXPSFS times NYPSFS",
            stated: format!("{columns} times {rows}"),
        }));
    }
    let layout = Layout::of_grid(columns, rows);
    let chosen = layout.choose(detector).map_err(unsuitable(path))?;
    let block = layout.block(chosen, columns, rows);
    let x = lines::read(path, hdu.index, cards, "IPSFX", columns, block.columns.clone())?;
    let y = lines::read(path, hdu.index, cards, "JPSFY", rows, block.rows.clone())?;

    let mut positions = Vec::new();
    let mut numbers = Vec::new();
    for (row, y) in block.rows.clone().zip(&y) {
        for (column, x) in block.columns.clone().zip(&x) {
            let position = Position::new(x - 1.0 - block.x0, y - 1.0 - block.y0);
            positions.push(position.map_err(invalid(path))?);
            numbers.push(row * columns + column);
        }
    }
    let cube = Array3::from_shape_vec((planes, ny, nx), read_pixels(path, hdu)?)
        .expect("as many pixels as the axes say");
    let stamps = if numbers.len() == planes {
        cube
    } else {
        cube.select(Axis(0), &numbers)
    };
    let name = layout.name(chosen);
    let mut notes = Vec::new();
    if let Some(name) = &name {
        notes.push(format!(
            "detector: {} ({name}) of {} was taken",
            chosen + 1,
            layout.len()
        ));
    }
    notes.extend(border::defects(&stamps, &numbers));
    let planes = Planes {
        stamps,
        numbers,
        positions,
        oversampling: OVERSAMPLING,
        detector: name.map(str::to_owned),
        notes,
    };
    GriddedPsf::new(path, planes)
}
