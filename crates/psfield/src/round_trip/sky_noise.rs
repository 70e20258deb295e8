//! Background and noise of a simulated frame.

use ndarray::{Array2, Zip};
use psf_stars::{Background, StarSamples};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Poisson, StandardNormal};

/// Adds what the optics do not: background, noise, saturation.
pub(crate) struct SkyNoise<'a> {
    background: &'a Background,
    saturation: Option<f64>,
    noise: bool,
    gain: Option<f64>,
    seed: u64,
}

impl<'a> SkyNoise<'a> {
    pub(crate) fn new(stars: &'a StarSamples, noise: bool, gain: Option<f64>, seed: u64) -> Self {
        Self {
            background: &stars.background,
            saturation: stars.saturation.level,
            noise,
            gain,
            seed,
        }
    }

    /// The frame that shows `light` `[y, x]`, with the noise of this realisation.
    pub(crate) fn frame(&self, light: &Array2<f64>, realisation: u64) -> Array2<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(realisation);
        let mut frame = light.clone();
        Zip::from(&mut frame)
            .and(self.background.level())
            .and(self.background.rms())
            .for_each(|value, level, rms| {
                let mut signal = *value;
                if self.noise {
                    if let Some(gain) = self.gain
                        && let Ok(photons) = Poisson::new(gain * signal)
                    {
                        signal = photons.sample(&mut rng) / gain;
                    }
                    let sky: f64 = StandardNormal.sample(&mut rng);
                    signal += rms * sky;
                }
                *value = signal + level;
                if let Some(saturation) = self.saturation {
                    *value = value.min(saturation);
                }
            });
        frame
    }
}
