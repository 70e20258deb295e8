//! Random numbers, and the steps of the chain that draw them. The numbers depend only on the seed,
//! the step and the row.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Binomial, Distribution, Poisson, StandardNormal};

/// A step of the chain that draws random numbers. The value of a variant selects the random stream
/// and must not change, because results would change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Step {
    Photons = 1,
    ReadNoise = 2,
    Response = 3,
    BadPixels = 4,
    BadColumns = 5,
    Thinning = 6,
}

/// Row numbers must be below 2 to this power. No frame has so many rows.
const ROW_BITS: u32 = 56;

/// The random stream of a row in a step. The streams of a seed never overlap.
pub(crate) fn noise_stream(seed: u64, step: Step, row: usize) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(((step as u64) << ROW_BITS) | row as u64);
    rng
}

/// Multiplies the charge that light causes in each pixel by the pixel's response. The response is a
/// normal deviate of mean 1, or 0 if the deviate is negative. It belongs to the sensor: it follows
/// from `pattern_seed` and is equal in every exposure.
pub(crate) fn apply_response(pattern_seed: u64, row: usize, rms: f64, electrons: &mut [f64]) {
    for (value, response) in electrons.iter_mut().zip(responses(pattern_seed, row, rms)) {
        *value *= response;
    }
}

/// The response of each pixel of a row.
fn responses(pattern_seed: u64, row: usize, rms: f64) -> impl Iterator<Item = f64> {
    let mut rng = noise_stream(pattern_seed, Step::Response, row);
    std::iter::repeat_with(move || {
        let normal: f64 = StandardNormal.sample(&mut rng);
        (1.0 + rms * normal).max(0.0)
    })
}

/// The response of a pixel exceeds the mean by at most so many standard deviations. In one of 10^15 pixels it is
/// larger.
const MOST_DEVIATIONS: f64 = 8.0;

/// The largest response of a pixel.
pub(crate) fn largest_response(rms: f64) -> f64 {
    1.0 + MOST_DEVIATIONS * rms
}

/// Keeps each photon with the probability of the pixel's response over the largest one. A pixel's count may be
/// negative: then its size is thinned.
pub(crate) fn thin_by_response<'a>(
    (pattern_seed, seed): (u64, u64),
    row: usize,
    rms: f64,
    counts: impl Iterator<Item = &'a mut i32>,
) {
    let mut rng = noise_stream(seed, Step::Thinning, row);
    let largest = largest_response(rms);
    for (count, response) in counts.zip(responses(pattern_seed, row, rms)) {
        let kept = Binomial::new(count.unsigned_abs().into(), (response / largest).min(1.0));
        let kept = kept.expect("a probability").sample(&mut rng);
        *count = count.signum() * kept as i32;
    }
}

/// Replaces the expected charges of a row by Poisson deviates. A negative charge is replaced by minus a
/// deviate of its size, so the mean stays what was expected.
pub(crate) fn add_photon_noise(seed: u64, row: usize, electrons: &mut [f64]) {
    // Dark pixels are skipped so many at a time: they draw no random numbers.
    const TOGETHER: usize = 16;
    let mut rng = noise_stream(seed, Step::Photons, row);
    let mut poisson = PoissonDeviates::default();
    for values in electrons.chunks_mut(TOGETHER) {
        if values.iter().filter(|value| **value != 0.0).count() == 0 {
            continue;
        }
        for value in values {
            let deviate = poisson.draw(value.abs(), &mut rng);
            *value = if *value < 0.0 { 0.0 - deviate } else { deviate };
        }
    }
}

/// Draws Poisson deviates. It keeps the last distribution, because neighbouring dark pixels have equal means.
#[derive(Default)]
struct PoissonDeviates {
    mean: f64,
    /// None above a mean of 1.8e19, which the library refuses, and for the default.
    distribution: Option<Poisson<f64>>,
}

impl PoissonDeviates {
    /// Draws a deviate. The mean must be finite and not negative.
    fn draw(&mut self, mean: f64, rng: &mut impl Rng) -> f64 {
        if mean <= 0.0 {
            return 0.0;
        }
        if mean != self.mean {
            let distribution = Poisson::new(mean).ok();
            *self = Self { mean, distribution };
        }
        if let Some(distribution) = &self.distribution {
            return distribution.sample(rng);
        }
        let normal: f64 = StandardNormal.sample(rng);
        (mean + mean.sqrt() * normal).round()
    }
}

/// Adds Gaussian read noise with a standard deviation of `sigma_e` electrons to every pixel.
pub(crate) fn add_read_noise(seed: u64, row: usize, sigma_e: f64, electrons: &mut [f64]) {
    let mut rng = noise_stream(seed, Step::ReadNoise, row);
    for value in electrons {
        let normal: f64 = StandardNormal.sample(&mut rng);
        *value += sigma_e * normal;
    }
}

#[cfg(test)]
mod tests {
    use rand::RngExt;

    use super::*;

    #[test]
    fn streams_differ_by_seed_step_and_row() {
        let first = |seed, step, row| noise_stream(seed, step, row).random::<u64>();
        let all = [
            first(1, Step::Photons, 0),
            first(2, Step::Photons, 0),
            first(1, Step::ReadNoise, 0),
            first(1, Step::Response, 0),
            first(1, Step::BadPixels, 0),
            first(1, Step::BadColumns, 0),
            first(1, Step::Photons, 1),
            first(1, Step::Photons, 1 << 40),
        ];
        for (i, a) in all.iter().enumerate() {
            assert!(!all[..i].contains(a), "stream {i}");
        }
        assert_eq!(all[0], first(1, Step::Photons, 0));
    }

    #[test]
    fn deviates_lie_near_their_mean_at_every_mean() {
        let mut rng = noise_stream(3, Step::Photons, 0);
        let mut poisson = PoissonDeviates::default();
        for mean in [0.0, 1e-300, 1e-9] {
            assert_eq!(poisson.draw(mean, &mut rng), 0.0);
        }
        // Means on both sides of the largest mean of the library's method, and a very large one.
        for mean in [1e3, 1e9, 1.8e19, 1.9e19, 1e30, 1e300] {
            let off = (poisson.draw(mean, &mut rng) - mean) / mean.sqrt();
            assert!(off.abs() < 6.0, "{mean}: {off} standard deviations");
        }
    }
}
