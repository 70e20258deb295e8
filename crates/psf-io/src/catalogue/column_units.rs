//! The units of the columns of a catalogue.

use crate::units::angle_in_deg;

/// The unit of a number of pixels.
pub(crate) const PIXELS: &str = "pix";
/// The unit of angles, and of positions on the sky.
pub(crate) const DEGREES: &str = "deg";
pub(crate) const ARCSECONDS: &str = "arcsec";
pub(crate) const MAS: &str = "mas";
pub(crate) const MAS_PER_YEAR: &str = "mas / yr";
pub(crate) const KILOMETRES_PER_SECOND: &str = "km / s";
/// The unit of epochs: Julian years.
pub(crate) const YEARS: &str = "yr";
pub(crate) const MAGNITUDES: &str = "mag";
pub(crate) const KELVIN: &str = "K";
pub(crate) const PIXELS_PER_SECOND: &str = "pix / s";
/// The unit of numbers such as a Sersic index.
pub(crate) const NONE: &str = "";

/// The factor that converts values of a column to the wanted unit: one of the constants above, or any
/// unit of flux. A column without a unit has the wanted unit. Returns `None` if the units do not fit.
pub(crate) fn factor(unit: &str, wanted: &str) -> Option<f64> {
    let unit = unit.trim();
    let lower = unit.to_ascii_lowercase();
    let one = |fits: bool| fits.then_some(1.0);
    if ["", "-", "--", "1", "none", "unitless", "dimensionless"].contains(&lower.as_str()) {
        return Some(1.0);
    }
    match wanted {
        PIXELS => one(is_pixel(&lower)),
        DEGREES => angle_in_deg(unit),
        ARCSECONDS => angle_in_deg(unit).map(|degrees| degrees * 3600.0),
        MAS => angle_in_deg(unit).map(in_mas),
        MAS_PER_YEAR => {
            let angle = before_ending(
                &lower,
                &["/yr", "/ yr", "/year", "yr-1", "yr^-1", "yr**-1", "year-1"],
            )?;
            angle_in_deg(angle).map(in_mas)
        }
        KILOMETRES_PER_SECOND => match per_second(&lower)? {
            "km" => Some(1.0),
            "m" => Some(1e-3),
            _ => None,
        },
        YEARS => one(["yr", "year", "years", "jyear", "a"].contains(&lower.as_str())),
        MAGNITUDES => one(lower.starts_with("mag") || lower.ends_with("mag") && lower != "mmag"),
        KELVIN => one(["k", "kelvin"].contains(&lower.as_str())),
        PIXELS_PER_SECOND => one(per_second(&lower).is_some_and(is_pixel)),
        NONE => None,
        flux => {
            let ((ours, theirs), (same, other)) = (flux_of(unit), flux_of(flux));
            (theirs == other).then_some(ours / same)
        }
    }
}

/// Returns whether a unit is logarithmic. Such values cannot be added.
pub(crate) fn is_logarithmic(unit: &str) -> bool {
    let unit = unit.trim().to_ascii_lowercase();
    unit.starts_with("mag") || unit.ends_with("mag") || ["dex", "db"].contains(&unit.as_str())
}

fn is_pixel(lower: &str) -> bool {
    ["pix", "pixel", "pixels", "px"].contains(&lower)
}

/// The unit before "per second".
fn per_second(unit: &str) -> Option<&str> {
    before_ending(unit, &["/s", "/ s", "/sec", "s-1", "s^-1", "s**-1", "s**(-1)"])
}

/// The unit before one of some endings.
fn before_ending<'a>(unit: &'a str, endings: &[&str]) -> Option<&'a str> {
    let before = endings.iter().find_map(|ending| unit.strip_suffix(ending))?;
    Some(before.trim_end_matches([' ', '.', '*']))
}

/// Degrees in milliarcseconds. The factor of `mas` is exactly 1.
fn in_mas(degrees: f64) -> f64 {
    let mas = degrees * 3.6e6;
    if (mas - 1.0).abs() < 1e-12 { 1.0 } else { mas }
}

/// A unit of flux, in a pixel or in all, as a multiple of another one: 1 mJy is 1e-3 Jy.
fn flux_of(unit: &str) -> (f64, String) {
    /// The flux density of magnitude 22.5 in the AB system, which is one nanomaggy (Oke and Gunn 1983).
    const NANOMAGGY_JY: f64 = 3.631e-6;
    let unit = unit.trim();
    // In upper case, too: `ELECTRONS/S`.
    let lower = unit.to_ascii_lowercase();
    let (unit, rate) = match per_second(&lower) {
        Some(before) => (&unit[..before.len()], "/s"),
        None => (unit, ""),
    };
    let unit = unit.strip_suffix("/pix").unwrap_or(unit);
    let of = |factor: f64, base: &str| (factor, format!("{base}{rate}"));
    let prefix = unit.strip_suffix("Jy").and_then(|prefix| match prefix {
        "" => Some(1.0),
        "k" => Some(1e3),
        "M" => Some(1e6),
        "m" => Some(1e-3),
        "u" | "\u{b5}" | "\u{3bc}" => Some(1e-6),
        "n" => Some(1e-9),
        _ => None,
    });
    if let Some(factor) = prefix {
        return of(factor, "Jy");
    }
    match unit.to_ascii_lowercase().as_str() {
        "nmgy" | "nanomaggy" | "nanomaggies" => of(NANOMAGGY_JY, "Jy"),
        "electron" | "electrons" | "e-" | "e" => of(1.0, "electron"),
        "photon" | "photons" | "ph" => of(1.0, "photon"),
        // SExtractor calls the units of any image counts.
        "count" | "counts" | "ct" | "cts" | "adu" | "dn" => of(1.0, "count"),
        other => of(1.0, other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_converted_or_refused() {
        for (unit, wanted, expected) in [
            ("", PIXELS, Some(1.0)),
            ("pixel", PIXELS, Some(1.0)),
            ("arcsec", PIXELS, None),
            ("rad", DEGREES, Some(180.0 / std::f64::consts::PI)),
            ("arcmin", DEGREES, Some(1.0 / 60.0)),
            ("hourangle", DEGREES, Some(15.0)),
            ("m", DEGREES, None),
            ("mag(AB)", MAGNITUDES, Some(1.0)),
            ("ABmag", MAGNITUDES, Some(1.0)),
            ("mmag", MAGNITUDES, None),
            ("Jy", MAGNITUDES, None),
            ("K", KELVIN, Some(1.0)),
            ("pixel s-1", PIXELS_PER_SECOND, Some(1.0)),
            ("arcsec/s", PIXELS_PER_SECOND, None),
            ("%", NONE, None),
            ("mJy", "Jy", Some(1e-3)),
            ("Jy", "uJy", Some(1e6)),
            ("nmgy", "Jy", Some(3.631e-6)),
            ("e-", "electron", Some(1.0)),
            ("electron / s", "e-/s", Some(1.0)),
            ("electron / s", "electron", None),
            ("count", "adu", Some(1.0)),
            ("electron / s", "ELECTRONS/S", Some(1.0)),
            ("COUNTS/S", "DN/S", Some(1.0)),
            ("mJy", "Jy/pix", Some(1e-3)),
            ("Jy/s/s/s", "Jy/s", None),
            ("erg", "ERG", Some(1.0)),
        ] {
            let found = factor(unit, wanted);
            let same = match (found, expected) {
                (Some(found), Some(expected)) => (found / expected - 1.0).abs() < 1e-15,
                (found, expected) => found == expected,
            };
            assert!(same, "{unit:?} as {wanted:?}: {found:?}");
        }
        assert!(is_logarithmic("mag") && is_logarithmic("ABmag") && !is_logarithmic("nanomaggy"));
    }
}
