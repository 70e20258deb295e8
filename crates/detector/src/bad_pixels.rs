//! Bad pixels drawn at random.

use rand::RngExt;

use crate::error::{at_least_zero, require};
use crate::noise_stream::{Step, noise_stream};
use crate::{DetectorError, DetectorParams, PixelFlags};

/// Dead and hot pixels and bad columns, each with its chance. They belong to the sensor and are the same in every exposure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BadPixels {
    dead: f64,
    dead_or_hot: f64,
    column: f64,
    seed: u64,
    /// Dark current of hot pixels, electrons a second.
    pub(crate) hot_dark_e_per_s: f64,
}

impl BadPixels {
    pub(crate) fn new(params: &DetectorParams) -> Result<Self, DetectorError> {
        let bad = params.bad_pixels;
        let fraction = |key, value| require(key, "a number from 0 to 1", value, |v| (0.0..=1.0).contains(&v));
        let dead = fraction("bad_pixels.dead_fraction", bad.dead_fraction)?;
        let hot = fraction("bad_pixels.hot_fraction", bad.hot_fraction)?;
        require(
            "bad_pixels.hot_fraction",
            "at most 1 with bad_pixels.dead_fraction",
            hot,
            |hot| dead + hot <= 1.0,
        )?;
        let hot_dark_e_per_s = at_least_zero("bad_pixels.hot_dark_e_per_s", bad.hot_dark_e_per_s)?;
        if hot > 0.0 && hot_dark_e_per_s == 0.0 {
            return Err(DetectorError::Needs {
                key: "bad_pixels.hot_fraction",
                other: "bad_pixels.hot_dark_e_per_s",
            });
        }
        if hot_dark_e_per_s > 0.0 && params.exposure_s.is_none() {
            return Err(DetectorError::Needs {
                key: "bad_pixels.hot_dark_e_per_s",
                other: "exposure_s",
            });
        }
        Ok(Self {
            dead,
            dead_or_hot: dead + hot,
            column: fraction("bad_pixels.bad_column_fraction", bad.bad_column_fraction)?,
            seed: params.pattern_seed,
            hot_dark_e_per_s,
        })
    }

    /// The flags that a frame's columns give to all their pixels.
    pub(crate) fn columns(&self, nx: usize) -> Vec<u8> {
        let mut rng = noise_stream(self.seed, Step::BadColumns, 0);
        let mut flag = || {
            if rng.random::<f64>() < self.column {
                PixelFlags::BAD_COLUMN
            } else {
                0
            }
        };
        (0..nx).map(|_| flag()).collect()
    }

    /// Adds the flags of single pixels of a row.
    pub(crate) fn mark(&self, row: usize, flags: &mut [u8]) {
        if self.dead_or_hot == 0.0 {
            return;
        }
        let mut rng = noise_stream(self.seed, Step::BadPixels, row);
        for flag in flags {
            let chance: f64 = rng.random();
            if chance < self.dead {
                *flag |= PixelFlags::DEAD;
            } else if chance < self.dead_or_hot {
                *flag |= PixelFlags::HOT;
            }
        }
    }
}
