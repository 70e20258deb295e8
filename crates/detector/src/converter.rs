//! The analogue-to-digital converter.

use crate::{DetectorError, DetectorParams, PixelFlags};

/// Counts become the nearest whole number, of two equally near ones the even one, from 0 to `2^bits - 1`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Converter {
    pub(crate) highest: f64,
}

impl Converter {
    /// Every count is exact in single precision.
    const MAX_BITS: u32 = f32::MANTISSA_DIGITS;

    pub(crate) fn new(params: &DetectorParams) -> Result<Option<Self>, DetectorError> {
        let checked = |bits: u32| {
            if (1..=Self::MAX_BITS).contains(&bits) {
                Ok(Self {
                    highest: f64::from((1_u32 << bits) - 1),
                })
            } else {
                Err(DetectorError::Setting {
                    key: "bits",
                    allowed: "a whole number from 1 to 24",
                    got: f64::from(bits),
                })
            }
        };
        params.bits.map(checked).transpose()
    }

    /// Converts a row; flags what is at the upper end and returns how many pixels were cut at 0.
    pub(crate) fn convert(self, counts: &mut [f64], flags: &mut [u8]) -> usize {
        let mut below = 0;
        for (value, flag) in counts.iter_mut().zip(flags) {
            let rounded = value.round_ties_even();
            if rounded >= self.highest {
                *flag |= PixelFlags::SATURATED;
            }
            below += usize::from(rounded < 0.0);
            // Adding 0 makes -0 a plain 0.
            *value = rounded.clamp(0.0, self.highest) + 0.0;
        }
        below
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ends_and_the_halves() {
        let params = DetectorParams {
            bits: Some(8),
            ..DetectorParams::default()
        };
        let converter = Converter::new(&params).unwrap().unwrap();
        let mut counts = [-7.0, -0.6, -0.5, 0.5, 1.5, 2.4999, 254.4, 254.6, 255.0, 1e30];
        let mut flags = [0; 10];
        assert_eq!(converter.convert(&mut counts, &mut flags), 2);
        assert_eq!(counts, [0.0, 0.0, 0.0, 0.0, 2.0, 2.0, 254.0, 255.0, 255.0, 255.0]);
        assert!(counts.iter().all(|v| v.is_sign_positive()));
        let saturated: Vec<bool> = flags.iter().map(|f| f & PixelFlags::SATURATED != 0).collect();
        assert_eq!(
            saturated,
            [false, false, false, false, false, false, false, true, true, true]
        );
    }
}
