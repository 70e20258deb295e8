//! Three steps of the detector that draw no random numbers: the sky, the full well and the
//! analogue-to-digital converter.

use psf_types::FrameShape;

use crate::bad_pixels::PixelFlags;
use crate::{DetectorError, DetectorParams, SkyGradient};

/// The sky over a frame. It is nowhere negative, and is constant or has a constant gradient:
/// `level + gx (x - (nx - 1) / 2) + gy (y - (ny - 1) / 2)` electrons.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FrameSky {
    at_origin_e: f64,
    gradient: SkyGradient,
}

impl FrameSky {
    pub(crate) fn new(params: &DetectorParams, frame: FrameShape) -> Result<Self, DetectorError> {
        let gradient = params.sky_gradient_e_per_px.unwrap_or_default();
        let middle = |n: usize| (n - 1) as f64 / 2.0;
        let sky = Self {
            at_origin_e: params.sky_e - gradient.x * middle(frame.nx()) - gradient.y * middle(frame.ny()),
            gradient,
        };
        let lowest = |slope: f64, n: usize| if slope < 0.0 { n - 1 } else { 0 };
        let (x, y) = (lowest(gradient.x, frame.nx()), lowest(gradient.y, frame.ny()));
        let lowest_e = sky.at(x, y);
        // A sky that falls exactly to 0 may be slightly negative by rounding.
        if lowest_e < -1e-9 * params.sky_e || !lowest_e.is_finite() {
            return Err(DetectorError::NegativeSky {
                lowest_e,
                index: [y, x],
            });
        }
        Ok(sky)
    }

    /// Adds the electrons from the sky in row `y`.
    pub(crate) fn add_to_row(&self, y: usize, electrons: &mut [f64]) {
        if self.gradient == SkyGradient::default() {
            if self.at_origin_e != 0.0 {
                for value in electrons {
                    *value += self.at_origin_e;
                }
            }
        } else {
            for (x, value) in electrons.iter_mut().enumerate() {
                *value += self.at(x, y);
            }
        }
    }

    /// Electrons from the sky in pixel (`x`, `y`).
    pub(crate) fn at(&self, x: usize, y: usize) -> f64 {
        self.at_origin_e + self.gradient.x * x as f64 + self.gradient.y * y as f64
    }
}

/// Clips the charges of a row at the full well, and flags pixels that are full. The excess charge
/// is lost and does not flow into neighbouring pixels.
pub(crate) fn clip(full_well_e: f64, electrons: &mut [f64], flags: &mut [u8]) {
    // Most rows have no full pixel.
    if electrons.iter().filter(|value| **value >= full_well_e).count() == 0 {
        return;
    }
    for (value, flag) in electrons.iter_mut().zip(flags) {
        if *value >= full_well_e {
            *value = full_well_e;
            *flag |= PixelFlags::SATURATED;
        }
    }
}

/// Rounds a row to the nearest whole numbers from 0 to `highest`. Halves are rounded to the even
/// number. Flags pixels at the upper end, and returns how many negative counts were set to 0.
pub(crate) fn convert(highest: f64, counts: &mut [f64], flags: &mut [u8]) -> usize {
    let mut below = 0;
    for (value, flag) in counts.iter_mut().zip(flags) {
        let rounded = value.round_ties_even();
        if rounded >= highest {
            *flag |= PixelFlags::SATURATED;
        }
        below += usize::from(rounded < 0.0);
        // Adding 0 converts -0 to 0.
        *value = rounded.clamp(0.0, highest) + 0.0;
    }
    below
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sky(level: f64, x: f64, y: f64) -> Result<FrameSky, DetectorError> {
        let params = DetectorParams {
            sky_e: level,
            sky_gradient_e_per_px: Some(SkyGradient { x, y }),
            ..DetectorParams::default()
        };
        FrameSky::new(&params, FrameShape::new(11, 21).unwrap())
    }

    #[test]
    fn sky_e_is_the_sky_at_the_middle_of_the_frame() {
        let sky = sky(100.0, 2.0, -0.5).unwrap();
        assert_eq!(sky.at(5, 10), 100.0);
        assert_eq!(sky.at(6, 10), 102.0);
        assert_eq!(sky.at(5, 12), 99.0);
        assert_eq!(sky.at(0, 20), 85.0);
    }

    #[test]
    fn a_sky_below_zero_is_refused_with_its_corner() {
        assert!(sky(15.0, 2.0, -0.5).is_ok());
        match sky(14.0, 2.0, -0.5) {
            Err(DetectorError::NegativeSky { lowest_e, index }) => {
                assert_eq!((lowest_e, index), (-1.0, [20, 0]));
            }
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn counts_are_clipped_at_both_ends_and_halves_round_to_even() {
        let mut counts = [-7.0, -0.6, -0.5, 0.5, 1.5, 2.4999, 254.4, 254.6, 255.0, 1e30];
        let mut flags = [0; 10];
        assert_eq!(convert(255.0, &mut counts, &mut flags), 2);
        assert_eq!(counts, [0.0, 0.0, 0.0, 0.0, 2.0, 2.0, 254.0, 255.0, 255.0, 255.0]);
        assert!(counts.iter().all(|v| v.is_sign_positive()));
        let saturated: Vec<bool> = flags.iter().map(|f| f & PixelFlags::SATURATED != 0).collect();
        assert_eq!(
            saturated,
            [false, false, false, false, false, false, false, true, true, true]
        );
    }
}
