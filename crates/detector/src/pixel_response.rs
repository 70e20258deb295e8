//! How pixels differ in their response to light.

use rand_distr::{Distribution, StandardNormal};

use crate::error::require;
use crate::noise_stream::{Step, noise_stream};
use crate::{DetectorError, DetectorParams};

/// Pixel-response non-uniformity: each pixel's charge from light is multiplied by a normal deviate about 1, never below 0. It belongs to
/// the sensor and is the same in every exposure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PixelResponse {
    rms: f64,
    seed: u64,
}

impl PixelResponse {
    pub(crate) fn new(params: &DetectorParams) -> Result<Option<Self>, DetectorError> {
        let rms = require(
            "response_rms",
            "a number from 0 to below 1",
            params.response_rms,
            |v| (0.0..1.0).contains(&v),
        )?;
        Ok((rms > 0.0).then_some(Self {
            rms,
            seed: params.pattern_seed,
        }))
    }

    pub(crate) fn apply(self, row: usize, electrons: &mut [f64]) {
        let mut rng = noise_stream(self.seed, Step::Response, row);
        for value in electrons {
            let normal: f64 = StandardNormal.sample(&mut rng);
            *value *= (1.0 + self.rms * normal).max(0.0);
        }
    }
}
