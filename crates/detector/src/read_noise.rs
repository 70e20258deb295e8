//! Read noise.

use rand_distr::{Distribution, StandardNormal};

use crate::error::at_least_zero;
use crate::noise_stream::{Step, noise_stream};
use crate::{DetectorError, DetectorParams};

/// Normal noise of the amplifier, the same everywhere, in electrons.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ReadNoise {
    sigma_e: f64,
}

impl ReadNoise {
    pub(crate) fn new(params: &DetectorParams) -> Result<Option<Self>, DetectorError> {
        let sigma_e = at_least_zero("read_noise_e", params.read_noise_e)?;
        Ok((sigma_e > 0.0).then_some(Self { sigma_e }))
    }

    pub(crate) fn add(self, seed: u64, row: usize, electrons: &mut [f64]) {
        let mut rng = noise_stream(seed, Step::ReadNoise, row);
        for value in electrons {
            let normal: f64 = StandardNormal.sample(&mut rng);
            *value += self.sigma_e * normal;
        }
    }
}
