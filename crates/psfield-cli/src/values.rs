//! Parses and checks the values of options.

use std::str::FromStr;

use psf_types::{FrameShape, PixelRegion};
use psfield::ShootBelow;

/// The largest accepted side of a stamp. A larger number is probably a typing error, and such
/// stamps would fill the memory.
const MAX_STAMP: usize = 8192;

/// Single or double precision. The help of each option says what it applies to: the written values,
/// the computation, or both.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub(crate) enum Precision {
    #[default]
    F32,
    F64,
}

impl From<Precision> for psf_io::Precision {
    fn from(precision: Precision) -> Self {
        match precision {
            Precision::F32 => Self::Single,
            Precision::F64 => Self::Double,
        }
    }
}

/// Parses two sizes or counts `NX,NY`, both above 0.
pub(crate) fn pair(text: &str) -> Result<(usize, usize), String> {
    match numbers::<usize>(text).as_deref() {
        Some(&[nx, ny]) if nx > 0 && ny > 0 => Ok((nx, ny)),
        _ => Err("two whole numbers above 0 are needed, as in 1024,512".to_owned()),
    }
}

/// Parses a region `X0,Y0,NX,NY`: its first column and row, and its size. `NX` and `NY` are above 0.
pub(crate) fn region(text: &str) -> Result<PixelRegion, String> {
    match numbers::<i64>(text).as_deref() {
        Some(&[x0, y0, nx, ny]) if nx > 0 && ny > 0 => {
            let shape = FrameShape::new(nx as usize, ny as usize).map_err(|e| e.to_string())?;
            Ok(PixelRegion::new(x0, y0, shape))
        }
        _ => Err("four whole numbers are needed, the last two above 0, as in 64,64,1024,1024".to_owned()),
    }
}

/// Parses numbers with commas between them. `None` if one of them cannot be parsed.
pub(crate) fn numbers<T: FromStr>(text: &str) -> Option<Vec<T>> {
    text.split(',').map(|n| n.trim().parse().ok()).collect()
}

/// Parses a number that satisfies `good`. The error says what is `needed`.
pub(crate) fn number<T: FromStr>(
    text: &str,
    good: impl FnOnce(&T) -> bool,
    needed: &str,
) -> Result<T, String> {
    let number = text.parse().ok().filter(good);
    number.ok_or_else(|| format!("{needed} is needed"))
}

/// Parses the number of stamp pixels along each axis.
pub(crate) fn stamp_size(text: &str) -> Result<usize, String> {
    let needed = format!("a whole number from 1 to {MAX_STAMP}");
    number(text, |size| (1..=MAX_STAMP).contains(size), &needed)
}

/// Parses a finite number above 0.
pub(crate) fn above_zero(text: &str) -> Result<f64, String> {
    number(
        text,
        |&value: &f64| value.is_finite() && value > 0.0,
        "a number above 0",
    )
}

/// Parses a finite number, 0 or above.
pub(crate) fn at_least_zero(text: &str) -> Result<f64, String> {
    number(
        text,
        |&value: &f64| value.is_finite() && value >= 0.0,
        "a number, 0 or above,",
    )
}

/// Parses a number from 0 to below 1.
pub(crate) fn tolerance(text: &str) -> Result<f64, String> {
    number(
        text,
        |value| (0.0..1.0).contains(value),
        "a number from 0 to below 1",
    )
}

/// The floor of sources.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Floor {
    /// A tenth of the detector's noise.
    Auto,
    /// Flux per pixel.
    At(f64),
}

/// Parses a floor: a number of at least 0, or `auto`.
pub(crate) fn floor(text: &str) -> Result<Floor, String> {
    auto_or_number(text, Floor::Auto, Floor::At)
}

/// Parses the number of photons below which sources are drawn photon by photon, or `auto`.
pub(crate) fn shoot_below(text: &str) -> Result<ShootBelow, String> {
    auto_or_number(text, ShootBelow::Auto, ShootBelow::Photons)
}

fn auto_or_number<V>(text: &str, auto: V, of_number: impl Fn(f64) -> V) -> Result<V, String> {
    if text == "auto" {
        return Ok(auto);
    }
    let is_valid = |value: &f64| *value >= 0.0 && value.is_finite();
    number(text, is_valid, "auto or a number of at least 0").map(of_number)
}

/// Parses a number of bytes: a whole number, optionally followed by K, M or G (powers of 1024).
pub(crate) fn bytes(text: &str) -> Result<usize, String> {
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let shift = match text[digits.len()..].to_ascii_uppercase().as_str() {
        "" | "B" => Some(0),
        "K" | "KB" | "KIB" => Some(10),
        "M" | "MB" | "MIB" => Some(20),
        "G" | "GB" | "GIB" => Some(30),
        _ => None,
    };
    let number: Option<usize> = digits.trim().parse().ok();
    number
        .zip(shift)
        .and_then(|(n, shift)| n.checked_mul(1 << shift))
        .ok_or_else(|| "a whole number of bytes is needed, perhaps with K, M or G, as in 256M".to_owned())
}

/// Formats a number of bytes as [`bytes`] reads it, in the largest unit that gives a whole number.
pub(crate) fn text_of_bytes(bytes: usize) -> String {
    let units = [("G", 30), ("M", 20), ("K", 10)];
    let whole = units
        .iter()
        .find(|(_, shift)| bytes > 0 && bytes.is_multiple_of(1 << shift));
    whole.map_or_else(
        || bytes.to_string(),
        |(unit, shift)| format!("{}{unit}", bytes >> shift),
    )
}

/// The text of an error about the value of an option, without Rust's own words and ranges.
pub(crate) fn plain_text(error: &clap::Error) -> String {
    let text = psfield::error::in_plain_words(&error.to_string());
    text.replace(" is not in ", " is not within ")
        .replace("..=", " to ")
}

/// Parses a finite number.
pub(crate) fn finite(text: &str) -> Result<f64, String> {
    number(text, |value: &f64| value.is_finite(), "a finite number")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_have_units() {
        for (text, size) in [
            ("0", 0),
            ("17", 17),
            ("3K", 3072),
            ("256M", 256 << 20),
            ("2GiB", 2 << 30),
            ("1kb", 1024),
        ] {
            assert_eq!(bytes(text), Ok(size));
            assert_eq!(bytes(&text_of_bytes(size)), Ok(size));
        }
        assert_eq!(text_of_bytes(256 << 20), "256M");
        for text in [
            "",
            "M",
            "-1",
            "1.5G",
            "1T",
            "99999999999999999999",
            "99999999999G",
        ] {
            assert!(bytes(text).is_err(), "{text}");
        }
    }
}
