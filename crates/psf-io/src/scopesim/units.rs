//! Angular units.

use crate::IoError;
use crate::library_cards::LibraryCards;

/// Arcseconds in the unit that a card names; without the card, in a degree.
pub(super) fn arcsec_in_unit(cards: &LibraryCards<'_>, keyword: &str) -> Result<f64, IoError> {
    const EXPECTED: &str = "an angular unit: deg, arcmin, arcsec, mas or rad";
    let Some(text) = cards.text(keyword, EXPECTED)? else {
        return Ok(3600.0);
    };
    match text.to_ascii_lowercase().as_str() {
        "deg" | "degree" | "" => Ok(3600.0),
        "arcmin" => Ok(60.0),
        "arcsec" => Ok(1.0),
        "mas" => Ok(1e-3),
        "rad" => Ok(1_f64.to_degrees() * 3600.0),
        _ => Err(cards.bad_value(keyword, EXPECTED, text)),
    }
}
