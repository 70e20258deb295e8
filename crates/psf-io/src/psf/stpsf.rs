//! STPSF (WebbPSF) gridded PSF libraries.
//!
//! # Layout
//!
//! The first image with pixels is a float cube `[plane, y, x]`, one PSF a plane; an image `[y, x]`
//! is one PSF.
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
//! Stamps are centred at index `(n - 1) / 2`, hold the response of a pixel and sum to about
//! `OVERSAMP^2`. Positions need not form a grid. Where a PSF was made for an even number of
//! detector pixels, its centre lies on a pixel's corner, and the writer has added the half pixel to
//! the position already.
//!
//! A writer that was told two samplings, one for its transforms and one for the stamps, writes both
//! (`OVERSAMP`, `DET_SAMP`): the one with `FOVPIXEL` times itself pixels across the stamp is taken,
//! and if there is none, the file is refused.
//!
//! # The order of the planes
//!
//! WebbPSF up to 1.2.1 stores the planes as its cards say, x being the slower coordinate. Since
//! 2023-12-11 (WebbPSF 1.3, STPSF) the planes are stored sorted by y, then x, while the cards have
//! stayed as they were; a reader that goes by the cards exchanges x and y of the field. photutils
//! up to 3.0 exchanges the coordinates of the cards, which is right for the later files on square
//! grids and wrong for the earlier ones; later photutils goes by the cards, which is right for the
//! earlier files alone. [`PlaneOrder`] decides here.

use std::path::Path;

use psf_types::{Position, named};

use crate::error::{IoError, invalid};
use crate::fits::card::{Card, FromValue};
use crate::fits::hdu::HduChoice;
use crate::fits::image::read_stack;
use crate::fits::structure::FitsStructure;
use crate::psf::gridded::{GriddedPsf, LibraryCards, Planes, cube_shape};

/// The stem of the keywords with positions.
pub(crate) const POSITION: &str = "DET_YX";
const POSITION_EXPECTED: &str =
    "a text \"(y, x)\" with the detector position of a plane in pixels, such as '(0.0, 682.0)'";
const OVERSAMPLING_EXPECTED: &str = "stamp pixels per detector pixel, a whole number above 0";

/// Whether a file is such a library: its cube has positions. (The reader has the errors for all
/// else that must be there.)
pub(crate) fn is_stpsf(structure: &FitsStructure) -> bool {
    structure
        .first_image()
        .is_ok_and(|hdu| hdu.header.iter().any(|card| position_number(card).is_some()))
}

/// Reads a gridded PSF library of STPSF or WebbPSF; see the [layout](self).
///
/// The samples are in the order of the planes. [`GriddedPsf::notes`] says which order of planes was
/// taken and why.
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
/// [`IoError::SeveralHdus`] when more than one image has pixels; [`IoError::Library`] with the card
/// in question where one is missing, malformed or there twice, where the number of planes is not
/// that of the cards, where a plane has no flux, or where [`PlaneOrder::Auto`] cannot tell the
/// order; [`IoError::Data`] for two planes at one position; [`IoError::NonFinitePixels`]; and the
/// errors of any FITS file.
pub fn read_stpsf(path: impl AsRef<Path>, order: PlaneOrder) -> Result<GriddedPsf, IoError> {
    read_stpsf_hdu(path, None, order)
}

/// Reads the library in the HDU chosen.
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
    let cards = &LibraryCards::new(hdu);
    let shape = cube_shape(hdu)?;
    let positions = positions(cards, shape.0)?;
    let oversampling = oversampling(cards, shape.2)?;
    let (positions, note) = assign(cards, order, positions)?;
    let detector = cards.text("DETECTOR", "the name of the detector, a text")?;
    let planes = Planes {
        stamps: read_stack(hdu, shape)?,
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
fn positions(cards: &LibraryCards<'_>, planes: usize) -> Result<Vec<Position>, IoError> {
    if let Some(stated) = cards.count("NUM_PSFS", 1, "the number of PSFs, a whole number above 0")?
        && stated != planes
    {
        return Err(cards.plane_count(planes, "NUM_PSFS", &stated.to_string()));
    }
    let mut found = vec![None; planes];
    for card in &cards.hdu.header {
        let Some(number) = position_number(card) else {
            continue;
        };
        let keyword = card.keyword();
        let Some(place) = found.get_mut(number) else {
            return Err(cards.plane_count(planes, "a card", &keyword));
        };
        if place.is_some() {
            let problem = format!("card {keyword} exists more than once: remove the wrong one");
            return Err(cards.refused(&problem));
        }
        let text = card.value().and_then(String::from_value);
        let (y, x) = text
            .and_then(|text| pair(&text))
            .ok_or_else(|| cards.bad(&keyword, POSITION_EXPECTED, card))?;
        *place = Some(Position::new(x, y).map_err(invalid(cards.hdu.path()))?);
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

/// The keyword of this project's own files that names the order.
pub(crate) const PLANE_ORDER: &str = "PLANEORD";
/// The day on which the writer began to sort the planes.
const SORTED_SINCE: &str = "2023-12-11";
/// The first version (major, minor) that does.
const SORTED_FROM: (u32, u32) = (1, 3);

/// Which position belongs to which plane of an [STPSF library](crate::stpsf).
///
/// Written as `auto`, `cards` or `sorted`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum PlaneOrder {
    /// By `PLANEORD` where it is there, else by the writer: by `VERSION`, from 1.3 on sorted,
    /// before as the cards say; for development versions before 1.3 and where there is no version
    /// by `DATE`, from 2023-12-11 on sorted.
    #[default]
    Auto,
    /// Plane `i` lies where `DET_YXi` says.
    Cards,
    /// The planes are sorted by y, then x; the cards only list the positions.
    Sorted,
}

named!(PlaneOrder, "plane order", "auto, cards or sorted", "auto" => Auto, "cards" => Cards, "sorted" => Sorted);

/// The positions of the planes from those of the cards, and a sentence that says how.
fn assign(
    cards: &LibraryCards<'_>,
    order: PlaneOrder,
    positions: Vec<Position>,
) -> Result<(Vec<Position>, String), IoError> {
    let mut sorted = positions.clone();
    sorted.sort_by(|a, b| a.y().total_cmp(&b.y()).then(a.x().total_cmp(&b.x())));
    if sorted == positions {
        let note = "planes: the cards DET_YXn are sorted by y, then x, so that there is one order only";
        return Ok((positions, note.to_owned()));
    }
    let (order, reason) = match order {
        PlaneOrder::Auto => by_writer(cards)?.ok_or_else(|| {
            cards.refused(
                "the order of the planes cannot be told, since neither VERSION nor DATE says which writer made the file: choose with \
                 --psf-order cards or --psf-order sorted",
            )
        })?,
        chosen => (chosen, "as told".to_owned()),
    };
    Ok(match order {
        PlaneOrder::Sorted => (
            sorted,
            format!("planes: taken as sorted by y, then x, not in the order of the cards DET_YXn ({reason})"),
        ),
        _ => (
            positions,
            format!("planes: taken in the order of the cards DET_YXn ({reason})"),
        ),
    })
}

/// The order that the header tells, and from what.
fn by_writer(cards: &LibraryCards<'_>) -> Result<Option<(PlaneOrder, String)>, IoError> {
    const ORDER: &str = "cards or sorted";
    if let Some(text) = cards.text(PLANE_ORDER, ORDER)? {
        let order = text.parse().ok().filter(|&order| order != PlaneOrder::Auto);
        let order = order.ok_or_else(|| cards.bad_value(PLANE_ORDER, ORDER, text.clone()))?;
        return Ok(Some((order, format!("{PLANE_ORDER} says so"))));
    }
    let version = cards.text("VERSION", "the version of the software, a text")?;
    let date = cards.text("DATE", "the date of the calculation, a text")?;
    Ok(of_writer(version.as_deref(), date.as_deref()))
}

fn of_writer(version: Option<&str>, date: Option<&str>) -> Option<(PlaneOrder, String)> {
    let number = version.and_then(release);
    if let (Some(text), Some((number, development))) = (version, number) {
        if number >= SORTED_FROM {
            return Some((PlaneOrder::Sorted, format!("written by version {text}")));
        }
        if !development {
            return Some((PlaneOrder::Cards, format!("written by version {text}")));
        }
    }
    let day = date
        .and_then(|text| text.get(..SORTED_SINCE.len()))
        .filter(|day| is_day(day))?;
    let order = if day < SORTED_SINCE {
        PlaneOrder::Cards
    } else {
        PlaneOrder::Sorted
    };
    Some((order, format!("calculated on {day}")))
}

/// Major and minor number of a version, and whether it is one of development.
fn release(version: &str) -> Option<((u32, u32), bool)> {
    let text = version.trim().trim_start_matches('v');
    let mut parts = text.split(['.', '+', '-']);
    let major = parts.next()?.parse().ok()?;
    let minor = parts.next()?.parse().ok()?;
    let plain = |part: &str| !part.is_empty() && part.bytes().all(|b| b.is_ascii_digit());
    Some(((major, minor), !parts.all(plain)))
}

/// Whether a text looks like 2023-12-11.
fn is_day(text: &str) -> bool {
    text.bytes().enumerate().all(|(i, b)| match i {
        4 | 7 => b == b'-',
        _ => b.is_ascii_digit(),
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

    #[test]
    fn the_version_decides_and_for_development_versions_the_date() {
        let order = |version, date| of_writer(version, date).map(|(order, _)| order);
        let (early, late) = (Some("2023-11-10T01:27:18"), Some("2023-12-11T00:00:00"));
        let (cards, sorted) = (Some(PlaneOrder::Cards), Some(PlaneOrder::Sorted));
        for version in ["1.2.1", "1.2.0", "0.9.2", "v1.1.0"] {
            assert_eq!(order(Some(version), late), cards, "{version}");
        }
        for version in ["1.3.0", "1.4.0", "1.10.0", "2.0.0", "2.1.1.dev3+gabc", "1.3.0rc1"] {
            assert_eq!(order(Some(version), early), sorted, "{version}");
        }
        let development = Some("1.2.2.dev13+g0123456");
        assert_eq!(order(development, early), cards);
        assert_eq!(order(development, late), sorted);
        assert_eq!(order(development, None), None);
        assert_eq!(order(None, early), cards);
        assert_eq!(order(Some("unknown"), late), sorted);
        assert_eq!(order(None, Some("11 Dec 2023")), None);
        assert_eq!(order(None, None), None);
    }

    #[test]
    fn text_forms_round_trip() {
        for text in ["auto", "cards", "sorted"] {
            assert_eq!(text.parse::<PlaneOrder>().unwrap().to_string(), text);
        }
        assert!("x-slow".parse::<PlaneOrder>().is_err());
    }
}
