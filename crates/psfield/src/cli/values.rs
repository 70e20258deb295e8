//! Values of options that need more than a number.

use std::str::FromStr;

use psf_types::{FrameShape, PixelRegion};

/// The widest stamps that can be asked for; a larger number is a slip, and would ask for more memory than there is.
const MAX_STAMP: usize = 8192;

/// The precision of what is written, and of the work where that has one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Precision {
    F32,
    F64,
}

/// `NX,NY`, both above 0.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pair(pub(crate) usize, pub(crate) usize);

impl FromStr for Pair {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Option<Vec<usize>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
        match numbers.as_deref() {
            Some(&[nx, ny]) if nx > 0 && ny > 0 => Ok(Self(nx, ny)),
            _ => Err("two whole numbers above 0 are needed, as in 1024,512".to_owned()),
        }
    }
}

/// `X0,Y0,NX,NY`, the last two above 0.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Frame(pub(crate) PixelRegion);

impl FromStr for Frame {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Option<Vec<i64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
        match numbers.as_deref() {
            Some(&[x0, y0, nx, ny]) if nx > 0 && ny > 0 => {
                let shape = FrameShape::new(nx as usize, ny as usize).map_err(|e| e.to_string())?;
                Ok(Self(PixelRegion::new(x0, y0, shape)))
            }
            _ => Err("four whole numbers are needed, the last two above 0, as in 64,64,1024,1024".to_owned()),
        }
    }
}

/// Pixels of a stamp along each axis.
pub(crate) fn stamp_size(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(size) if (1..=MAX_STAMP).contains(&size) => Ok(size),
        _ => Err(format!("a whole number from 1 to {MAX_STAMP} is needed")),
    }
}

/// A finite number above 0.
pub(crate) fn above_zero(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("a number above 0 is needed".to_owned()),
    }
}

/// A finite number, 0 or above.
pub(crate) fn at_least_zero(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value >= 0.0 => Ok(value),
        _ => Err("a number, 0 or above, is needed".to_owned()),
    }
}

/// A number from 0 to below 1.
pub(crate) fn tolerance(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.0..1.0).contains(&value) => Ok(value),
        _ => Err("a number from 0 to below 1 is needed".to_owned()),
    }
}

/// Bytes: a whole number, perhaps followed by K, M or G (powers of 1024).
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
        }
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
