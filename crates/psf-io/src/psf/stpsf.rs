//! STPSF (WebbPSF) gridded PSF libraries.
//!
//! # Layout
//!
//! The only image with pixels, or else the chosen one, is a float cube `[plane, y, x]` with one PSF
//! per plane. An image `[y, x]` is one PSF.
//!
//! | keyword | meaning |
//! |---|---|
//! | `DET_YX0`, `DET_YX1` ... | for each plane a string `(y, x)`: the position in detector pixels, 0-based |
//! | `OVERSAMP` | stamp pixels per detector pixel, a whole number |
//! | `DET_SAMP` | stamp pixels per detector pixel; if it differs from `OVERSAMP`, `FOVPIXEL` decides (see below) |
//! | `NUM_PSFS` | number of planes, not required |
//! | `FOVPIXEL` | detector pixels across a stamp, not required |
//! | `DETECTOR` | name of the detector, not required |
//! | `VERSION`, `DATE` | version of the software and date of the calculation, from which the order of the planes is found |
//! | `PLANEORD` | `cards` or `sorted`: the order of the planes, written by psfield |
//! | `GRIDLINE` | written by psfield if it interpolated planes between samples. One letter for each distinct coordinate of the planes, in ascending order: samples have this coordinate in x (`x`), in y (`y`) or in both (`b`). Only the planes of samples are read |
//!
//! Stamps are centred at index `(n - 1) / 2`, include the response of a pixel and sum to about
//! `OVERSAMP^2`. Positions need not form a grid. If a PSF was made for an even number of detector
//! pixels, its centre is on the corner of a pixel, half a pixel from the centre of the pixel. STPSF
//! has already added this half pixel to the position in the card.
//!
//! A writer may use one sampling for its Fourier transforms and another for the stamps, and writes
//! both (`OVERSAMP`, `DET_SAMP`). The reader uses the sampling that gives the width of the stamps
//! when multiplied by `FOVPIXEL`. If neither does, the file is refused.
//!
//! # The order of the planes
//!
//! Up to WebbPSF 1.2.1 the planes are in the order of the cards, with x as the slower coordinate.
//! Since 2023-12-11 (WebbPSF 1.3, STPSF) the planes are sorted by y, then x, but the order of the
//! cards is unchanged. A reader that uses the order of the cards then exchanges x and y of the
//! field. photutils up to 3.0 exchanges the coordinates of the cards, which is right for new files
//! on square grids and wrong for old files. Later photutils uses the cards as they are, which is
//! right only for old files. Here [`PlaneOrder`] chooses the order.

use std::path::Path;

use ndarray::Axis;
use psf_types::{Position, named, through_text};
use serde::{Deserialize, Serialize};

use crate::error::{IoError, IoErrorKind, invalid};
use crate::fits::card::{Card, FromValue};
use crate::fits::hdu::HduChoice;
use crate::fits::image::read_stack;
use crate::fits::structure::FitsStructure;
use crate::psf::gridded::{GriddedPsf, LibraryCards, Planes, ascending, cube_shape};

/// The stem of the keywords that hold positions.
pub(crate) const POSITION: &str = "DET_YX";
const POSITION_EXPECTED: &str =
    "a string \"(y, x)\" with the detector position of a plane in pixels, such as '(0.0, 682.0)'";
const OVERSAMPLING_EXPECTED: &str = "stamp pixels per detector pixel, a whole number above 0";

/// Returns whether a file is an STPSF library, that is, whether the header of its first image has a
/// position card. The reader checks everything else.
pub(crate) fn is_stpsf(structure: &FitsStructure) -> bool {
    structure
        .first_image()
        .is_ok_and(|hdu| hdu.header.iter().any(|card| position_number(card).is_some()))
}

/// Reads a gridded PSF library of STPSF or WebbPSF. See the [layout](self).
///
/// The samples are in the order of the planes. [`GriddedPsf::notes`] states which order was used
/// and why.
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
/// - [`IoErrorKind::Setting`] if several images have pixels, or if [`PlaneOrder::Auto`] cannot find
///   the order
/// - [`IoErrorKind::Header`] with the keyword that is missing, malformed or repeated
/// - [`IoErrorKind::Axes`] unless the image has two or three axes
/// - [`IoErrorKind::Data`] if the number of planes differs from the number in the cards, a plane
///   has no flux, or two planes are at one position
/// - the [errors of any FITS file](crate#bad-files)
pub fn read_stpsf(path: impl AsRef<Path>, order: PlaneOrder) -> Result<GriddedPsf, IoError> {
    read_stpsf_hdu(path, None, order, false)
}

/// Reads the library in the chosen HDU. Without a choice it is the only image with pixels. If
/// `skip_invalid` is true, planes without positive flux are left out ([`GriddedPsf::left_out`]) and
/// not an error. [`GriddedPsf::notes`] names them.
///
/// # Errors
/// The errors of [`read_stpsf`], and [`IoErrorKind::Setting`] for a choice that is not an image
/// with pixels.
pub fn read_stpsf_hdu(
    path: impl AsRef<Path>,
    choice: Option<&HduChoice>,
    order: PlaneOrder,
    skip_invalid: bool,
) -> Result<GriddedPsf, IoError> {
    let path = path.as_ref();
    let structure = FitsStructure::scan(path)?;
    let hdu = structure.stamps(choice)?;
    let cards = &LibraryCards::new(hdu);
    let shape = cube_shape(hdu)?;
    let positions = positions(cards, shape.0)?;
    let oversampling = oversampling(cards, shape.2)?;
    let (positions, note) = assign(cards, order, positions)?;
    let detector = cards.text("DETECTOR", "the name of the detector, a string")?;
    let (mut stamps, mut positions, mut notes) = (read_stack(hdu, shape)?, positions, vec![note]);
    let numbers = sample_planes(cards, &positions)?;
    if numbers.len() < shape.0 {
        notes.push(format!(
            "planes: only {} of {} are read: psfield interpolated the others from these when it wrote the file",
            numbers.len(),
            shape.0
        ));
        stamps = stamps.select(Axis(0), &numbers);
        positions = numbers.iter().map(|&plane| positions[plane]).collect();
    }
    let planes = Planes {
        stamps,
        numbers,
        positions,
        oversampling: oversampling as f64,
        detector,
        notes,
    };
    GriddedPsf::new(path, planes, skip_invalid)
}

/// The keyword in psfield's own files that states which planes are samples.
pub(crate) const GRID_LINES: &str = "GRIDLINE";

/// Returns the planes that are samples. psfield may have interpolated further planes between them.
fn sample_planes(cards: &LibraryCards<'_>, positions: &[Position]) -> Result<Vec<usize>, IoError> {
    const EXPECTED: &str = "a letter x, y or b for each coordinate of the planes";
    let Some(axes) = cards.text(GRID_LINES, EXPECTED)? else {
        return Ok((0..positions.len()).collect());
    };
    let lines = ascending(positions.iter().map(|p| p.x()));
    let on = |axis: u8, value: f64| {
        let letter = axes.as_bytes().get(lines.partition_point(|&line| line < value));
        letter.is_some_and(|&letter| letter == axis || letter == b'b')
    };
    let is_sample = |&plane: &usize| on(b'x', positions[plane].x()) && on(b'y', positions[plane].y());
    let planes: Vec<usize> = (0..positions.len()).filter(is_sample).collect();
    if axes.len() != lines.len() || planes.is_empty() {
        return Err(cards.hdu.wrong_value(GRID_LINES, EXPECTED, axes));
    }
    Ok(planes)
}

/// The plane number in the keyword of a position card.
fn position_number(card: &Card) -> Option<usize> {
    let keyword = card.keyword();
    let digits = keyword.strip_prefix(POSITION)?;
    let plain = !digits.is_empty() && digits.bytes().all(|b| b.is_ascii_digit());
    plain.then(|| digits.parse().ok()).flatten()
}

/// The positions in the cards, ordered by plane number: one per plane.
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
            return Err(cards.plane_count(planes, "the header", &format!("a position {keyword}")));
        };
        if place.is_some() {
            const TWICE: &str = "the card exists more than once: remove the wrong one";
            return Err(cards.hdu.header_error(&keyword, TWICE));
        }
        let text = card.value().and_then(String::from_value);
        let (y, x) = text
            .and_then(|text| pair(&text))
            .ok_or_else(|| cards.hdu.wrong_value(&keyword, POSITION_EXPECTED, card.shown()))?;
        *place = Some(Position::new(x, y).map_err(invalid(cards.hdu.path()))?);
    }
    let position = |(number, position): (usize, Option<Position>)| {
        position.ok_or_else(|| {
            cards
                .hdu
                .missing_keyword(&format!("{POSITION}{number}"), POSITION_EXPECTED)
        })
    };
    found.into_iter().enumerate().map(position).collect()
}

/// Parses two finite numbers in parentheses.
fn pair(text: &str) -> Option<(f64, f64)> {
    let (first, second) = text
        .trim()
        .strip_prefix('(')?
        .strip_suffix(')')?
        .split_once(',')?;
    let number = |text: &str| text.trim().parse().ok().filter(|v: &f64| v.is_finite());
    Some((number(first)?, number(second)?))
}

/// Stamp pixels per detector pixel for stamps that are `nx` pixels wide.
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
            cards.hdu.wrong_value(
                "DET_SAMP",
                "equal to OVERSAMP (if they differ, one of them times FOVPIXEL must be the width of the stamps)",
                stamps,
            )
        })
}

/// The keyword in psfield's own files that states the order of the planes.
pub(crate) const PLANE_ORDER: &str = "PLANEORD";
/// The date since which WebbPSF, later STPSF, has sorted the planes.
const SORTED_SINCE_DATE: &str = "2023-12-11";
/// The first version (major, minor) that sorts the planes.
const SORTED_SINCE_VERSION: (u32, u32) = (1, 3);

/// The rule that assigns the positions of an [STPSF library](crate::stpsf) to its planes.
///
/// Text form: `auto`, `cards` or `sorted`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
#[non_exhaustive]
pub enum PlaneOrder {
    /// Uses `PLANEORD` if present, else `VERSION`: sorted from 1.3 on, and in the order of the
    /// cards before. Without a version, or for development versions before 1.3, it uses `DATE`:
    /// sorted from 2023-12-11 on.
    #[default]
    Auto,
    /// Plane `i` is at the position in `DET_YXi`.
    Cards,
    /// The planes are sorted by y, then x. The cards give the positions, but their numbers do not
    /// say which plane a position belongs to.
    Sorted,
}

named!(PlaneOrder, "plane order", "auto, cards or sorted", "auto" => Auto, "cards" => Cards, "sorted" => Sorted);
through_text!(PlaneOrder);

/// The positions of the planes, and a note that states the order used.
fn assign(
    cards: &LibraryCards<'_>,
    order: PlaneOrder,
    positions: Vec<Position>,
) -> Result<(Vec<Position>, String), IoError> {
    let mut sorted = positions.clone();
    sorted.sort_by(|a, b| a.y().total_cmp(&b.y()).then(a.x().total_cmp(&b.x())));
    if sorted == positions {
        let note = "planes: the cards DET_YXn are sorted by y, then x, so only one order is possible";
        return Ok((positions, note.to_owned()));
    }
    let (order, reason) = match order {
        PlaneOrder::Auto => by_writer(cards)?.ok_or_else(|| {
            const UNKNOWN: &str = "the order of the planes is unknown, since neither VERSION nor DATE shows which writer \
                                   made the file: choose cards or sorted";
            cards
                .hdu
                .error(IoErrorKind::Setting, UNKNOWN)
                .with_setting("plane_order")
        })?,
        chosen => (chosen, "as requested".to_owned()),
    };
    Ok(match order {
        PlaneOrder::Sorted => (
            sorted,
            format!("planes: sorted by y, then x, not in the order of the cards DET_YXn ({reason})"),
        ),
        _ => (
            positions,
            format!("planes: in the order of the cards DET_YXn ({reason})"),
        ),
    })
}

/// The order of the planes according to the header, and the reason for it.
fn by_writer(cards: &LibraryCards<'_>) -> Result<Option<(PlaneOrder, String)>, IoError> {
    const ORDER: &str = "cards or sorted";
    if let Some(text) = cards.text(PLANE_ORDER, ORDER)? {
        let order = text.parse().ok().filter(|&order| order != PlaneOrder::Auto);
        let order = order.ok_or_else(|| cards.hdu.wrong_value(PLANE_ORDER, ORDER, text.clone()))?;
        return Ok(Some((order, format!("{PLANE_ORDER} says so"))));
    }
    let version = cards.text("VERSION", "the version of the software, a string")?;
    let date = cards.text("DATE", "the date of the calculation, a string")?;
    Ok(of_writer(version.as_deref(), date.as_deref()))
}

fn of_writer(version: Option<&str>, date: Option<&str>) -> Option<(PlaneOrder, String)> {
    let number = version.and_then(release);
    if let (Some(text), Some((number, development))) = (version, number) {
        if number >= SORTED_SINCE_VERSION {
            return Some((PlaneOrder::Sorted, format!("the card VERSION is {text}")));
        }
        if !development {
            return Some((PlaneOrder::Cards, format!("the card VERSION is {text}")));
        }
    }
    let day = date
        .and_then(|text| text.get(..SORTED_SINCE_DATE.len()))
        .filter(|day| is_day(day))?;
    let order = if day < SORTED_SINCE_DATE {
        PlaneOrder::Cards
    } else {
        PlaneOrder::Sorted
    };
    Some((order, format!("calculated on {day}")))
}

/// The major and minor number of a version, and whether it is a development version.
fn release(version: &str) -> Option<((u32, u32), bool)> {
    let text = version.trim().trim_start_matches('v');
    let mut parts = text.split(['.', '+', '-']);
    let major = parts.next()?.parse().ok()?;
    let minor = parts.next()?.parse().ok()?;
    let plain = |part: &str| !part.is_empty() && part.bytes().all(|b| b.is_ascii_digit());
    Some(((major, minor), !parts.all(plain)))
}

/// Returns whether a text has the form of 2023-12-11.
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
