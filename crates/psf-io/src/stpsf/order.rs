//! Which position belongs to which plane.

use std::path::Path;
use std::str::FromStr;

use psf_types::{DataError, Position};

use crate::error::unsuitable;
use crate::library_cards::LibraryCards;
use crate::{GriddedError, IoError};

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
    /// By `PLANEORD` where it is there, else by the writer: by `VERSION`, from 1.3 on sorted, before as the cards say; for
    /// development versions before 1.3 and where there is no version by `DATE`, from 2023-12-11 on sorted.
    #[default]
    Auto,
    /// Plane `i` lies where `DET_YXi` says.
    Cards,
    /// The planes are sorted by y, then x; the cards only list the positions.
    Sorted,
}

impl std::fmt::Display for PlaneOrder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Auto => "auto",
            Self::Cards => "cards",
            Self::Sorted => "sorted",
        })
    }
}

impl FromStr for PlaneOrder {
    type Err = DataError;
    fn from_str(text: &str) -> Result<Self, DataError> {
        match text {
            "auto" => Ok(Self::Auto),
            "cards" => Ok(Self::Cards),
            "sorted" => Ok(Self::Sorted),
            _ => Err(DataError::Setting {
                name: "plane order",
                allowed: "auto, cards or sorted",
                got: text.to_owned(),
            }),
        }
    }
}

/// The positions of the planes from those of the cards, and a sentence that says how.
pub(crate) fn assign(
    path: &Path,
    cards: &LibraryCards<'_>,
    hdu: usize,
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
        PlaneOrder::Auto => {
            by_writer(cards)?.ok_or_else(|| unsuitable(path)(GriddedError::UnknownOrder { hdu }))?
        }
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
