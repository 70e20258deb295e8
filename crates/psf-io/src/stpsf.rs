//! STPSF (WebbPSF) gridded PSF libraries.
//!
//! # Layout
//!
//! The first image with pixels is a float cube `[plane, y, x]`, one PSF a plane; an image `[y, x]` is one PSF.
//!
//! | keyword | meaning |
//! |---|---|
//! | `DET_YX0`, `DET_YX1` ... | a text `(y, x)` for each plane: the position in detector pixels, 0-based |
//! | `OVERSAMP` | stamp pixels per detector pixel, a whole number |
//! | `DET_SAMP` | the same; where the two differ, `FOVPIXEL` decides (see below) |
//! | `NUM_PSFS` | number of planes, not required |
//! | `FOVPIXEL` | detector pixels across a stamp, not required |
//! | `DETECTOR` | name of the detector, not required |
//! | `VERSION`, `DATE` | version of the software and date of the calculation: they tell the order of the planes |
//! | `PLANEORD` | `cards` or `sorted`, this project's own: the order, said plainly |
//!
//! Stamps are centred at index `(n - 1) / 2`, hold the response of a pixel and sum to about `OVERSAMP^2`. Positions need not form
//! a grid. Where a PSF was made for an even number of detector pixels, its centre lies on a pixel's corner, and the writer has
//! added the half pixel to the position already.
//!
//! A writer that was told two samplings, one for its transforms and one for the stamps, writes both (`OVERSAMP`, `DET_SAMP`): the one
//! with `FOVPIXEL` times itself pixels across the stamp is taken, and if there is none, the file is refused.
//!
//! # The order of the planes
//!
//! WebbPSF up to 1.2.1 stores the planes as its cards say, x being the slower coordinate. Since 2023-12-11 (WebbPSF 1.3, STPSF) the
//! planes are stored sorted by y, then x, while the cards have stayed as they were; a reader that goes by the cards exchanges x and
//! y of the field. photutils up to 3.0 exchanges the coordinates of the cards, which is right for the later files on square grids
//! and wrong for the earlier ones; later photutils goes by the cards, which is right for the earlier files alone. [`PlaneOrder`]
//! decides here.

mod order;

use std::path::Path;

use ndarray::Array3;
use psf_types::Position;

use crate::card::Card;
use crate::error::{invalid, unsuitable};
use crate::gridded_psf::{Planes, cube_shape};
use crate::hdu::Hdu;
use crate::library_cards::LibraryCards;
use crate::pixels::read_pixels;
use crate::structure::FitsStructure;
use crate::{CardValue, GriddedError, GriddedPsf, HduChoice, IoError};

pub(crate) use order::PLANE_ORDER;
pub use order::PlaneOrder;

/// The stem of the keywords with positions.
pub(crate) const POSITION: &str = "DET_YX";
const POSITION_EXPECTED: &str =
    "a text \"(y, x)\" with the detector position of a plane in pixels, such as '(0.0, 682.0)'";
const OVERSAMPLING_EXPECTED: &str = "stamp pixels per detector pixel, a whole number above 0";

/// Whether a file is such a library: its cube has positions. (What else must be there, the reader says best.)
pub(crate) fn is_stpsf(structure: &FitsStructure) -> bool {
    structure
        .first_image()
        .is_ok_and(|hdu| hdu.header.iter().any(|card| position_number(card).is_some()))
}

/// Reads a gridded PSF library of STPSF or WebbPSF; see the [layout](self).
///
/// The samples are in the order of the planes. [`GriddedPsf::notes`] says which order of planes was taken and why.
///
/// ```no_run
/// use psf_io::{PlaneOrder, read_stpsf};
/// let library = read_stpsf("nircam_nrca1_f200w_fovp101_samp4_npsf16.fits", PlaneOrder::Auto)?;
/// println!("{} PSFs of {:?}", library.samples().len(), library.detector());
/// library.notes().iter().for_each(|note| println!("{note}"));
/// # Ok::<(), psf_io::IoError>(())
/// ```
///
/// # Errors
/// [`IoError::SeveralHdus`] when more than one image has pixels; [`IoError::Library`] with the card in question where one is missing, malformed or there twice, where the number of planes is not
/// that of the cards, where a plane has no flux, or where [`PlaneOrder::Auto`] cannot tell the order; [`IoError::Data`] for two planes at
/// one position; [`IoError::NonFinitePixels`]; and the errors of any FITS file.
pub fn read_stpsf(path: impl AsRef<Path>, order: PlaneOrder) -> Result<GriddedPsf, IoError> {
    read_stpsf_hdu(path, None, order)
}

/// The same of the HDU chosen.
///
/// # Errors
/// As [`read_stpsf`]; [`IoError::NoSuchHdu`].
pub fn read_stpsf_hdu(
    path: impl AsRef<Path>,
    choice: Option<&HduChoice>,
    order: PlaneOrder,
) -> Result<GriddedPsf, IoError> {
    let path = path.as_ref();
    let structure = FitsStructure::scan(path)?;
    let hdu = structure.stamps(choice)?;
    let cards = &LibraryCards::new(path, hdu);
    let shape = cube_shape(hdu)?;
    let positions = positions(path, hdu, cards, shape.0)?;
    let oversampling = oversampling(cards, shape.2)?;
    let (positions, note) = order::assign(path, cards, hdu.index, order, positions)?;
    let detector = cards.text("DETECTOR", "the name of the detector, a text")?;
    let stamps =
        Array3::from_shape_vec(shape, read_pixels(path, hdu)?).expect("as many pixels as the axes say");
    let planes = Planes {
        stamps,
        numbers: (0..shape.0).collect(),
        positions,
        oversampling: oversampling as f64,
        detector,
        notes: vec![note],
    };
    GriddedPsf::new(path, planes)
}

/// The number of a card with a position.
fn position_number(card: &Card) -> Option<usize> {
    let keyword = card.keyword();
    let digits = keyword.strip_prefix(POSITION)?;
    let plain = !digits.is_empty() && digits.bytes().all(|b| b.is_ascii_digit());
    plain.then(|| digits.parse().ok()).flatten()
}

/// The positions that the cards name, in the order of their numbers: one for each plane.
fn positions(
    path: &Path,
    hdu: &Hdu,
    cards: &LibraryCards<'_>,
    planes: usize,
) -> Result<Vec<Position>, IoError> {
    let refused = unsuitable(path);
    let count = |what, stated| GriddedError::PlaneCount {
        hdu: hdu.index,
        planes,
        what,
        stated,
    };
    if let Some(stated) = cards.count("NUM_PSFS", 1, "the number of PSFs, a whole number above 0")?
        && stated != planes
    {
        return Err(refused(count("NUM_PSFS", stated.to_string())));
    }
    let mut found = vec![None; planes];
    for card in &hdu.header {
        let Some(number) = position_number(card) else {
            continue;
        };
        let keyword = card.keyword();
        let Some(place) = found.get_mut(number) else {
            return Err(refused(count("a card", keyword)));
        };
        if place.is_some() {
            return Err(refused(GriddedError::DuplicateCard {
                hdu: hdu.index,
                keyword,
            }));
        }
        let (y, x) = match card.value() {
            Some(CardValue::Text(text)) => pair(&text),
            _ => None,
        }
        .ok_or_else(|| cards.bad(&keyword, POSITION_EXPECTED, card))?;
        *place = Some(Position::new(x, y).map_err(invalid(path))?);
    }
    let position = |(number, position): (usize, Option<Position>)| {
        position.ok_or_else(|| cards.missing(&format!("{POSITION}{number}"), POSITION_EXPECTED))
    };
    found.into_iter().enumerate().map(position).collect()
}

/// Two finite numbers in parentheses.
fn pair(text: &str) -> Option<(f64, f64)> {
    let (first, second) = text
        .trim()
        .strip_prefix('(')?
        .strip_suffix(')')?
        .split_once(',')?;
    let number = |text: &str| text.trim().parse().ok().filter(|v: &f64| v.is_finite());
    Some((number(first)?, number(second)?))
}

/// Stamp pixels per detector pixel of stamps that are `nx` pixels wide.
fn oversampling(cards: &LibraryCards<'_>, nx: usize) -> Result<usize, IoError> {
    let transforms = cards.required_count("OVERSAMP", 1, OVERSAMPLING_EXPECTED)?;
    let stamps = cards
        .count("DET_SAMP", 1, OVERSAMPLING_EXPECTED)?
        .unwrap_or(transforms);
    if stamps == transforms {
        return Ok(stamps);
    }
    let across = cards.count(
        "FOVPIXEL",
        1,
        "detector pixels across a stamp, a whole number above 0",
    )?;
    [stamps, transforms]
        .into_iter()
        .find(|&s| across.and_then(|n| n.checked_mul(s)) == Some(nx))
        .ok_or_else(|| {
            cards.bad_value(
                "DET_SAMP",
                "equal to OVERSAMP, or one of both times FOVPIXEL the width of the stamps",
                stamps.to_string(),
            )
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_are_two_finite_numbers_in_parentheses() {
        assert_eq!(pair("(0.0, 682.0)"), Some((0.0, 682.0)));
        assert_eq!(pair(" (-1,2e3) "), Some((-1.0, 2000.0)));
        for bad in [
            "",
            "1, 2",
            "(1)",
            "(1, 2, 3)",
            "(nan, 1)",
            "(1, inf)",
            "(a, b)",
            "(1, 2",
            "(,)",
        ] {
            assert_eq!(pair(bad), None, "{bad}");
        }
    }
}
