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
