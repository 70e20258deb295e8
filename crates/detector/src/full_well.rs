//! The largest charge of a pixel.

use crate::error::above_zero;
use crate::{DetectorError, DetectorParams, PixelFlags};

/// Charge beyond the full well is lost; it does not flow into the neighbours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FullWell {
    pub(crate) electrons: f64,
}

impl FullWell {
    pub(crate) fn new(params: &DetectorParams) -> Result<Option<Self>, DetectorError> {
        let checked = |electrons| above_zero("full_well_e", electrons).map(|electrons| Self { electrons });
        params.full_well_e.map(checked).transpose()
    }

    /// Cuts the charges of a row, and flags pixels that are full.
    pub(crate) fn clip(self, electrons: &mut [f64], flags: &mut [u8]) {
        for (value, flag) in electrons.iter_mut().zip(flags) {
            if *value >= self.electrons {
                *value = self.electrons;
                *flag |= PixelFlags::SATURATED;
            }
        }
    }
}
