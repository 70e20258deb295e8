//! Photon noise.

use ndarray::ArrayView2;
use psf_types::{FrameShape, Image, Real};
use rand::Rng;
use rand_distr::{Distribution, Poisson, StandardNormal};

use crate::noise_stream::{Step, noise_stream};
use crate::{Detector, DetectorError, DetectorParams, ExposedRows, Exposure};

/// The photon step alone: `N ~ Poisson(S)` in every pixel, `P(N = k) = S^k exp(-S) / k!`.
///
/// The mean `S` is the image's flux, in photons (or electrons) in the exposure. Exact at every mean that a picture can have: Knuth's
/// products of uniform numbers below 12, the rejection method PD of Ahrens and Dieter (1982, ACM Trans. Math. Softw. 8, 163) above, in
/// double precision. Beyond 1.8e19, where one count is less than the spacing of doubles and the skewness below 3e-10, it is a normal
/// deviate of variance `S`, rounded.
///
/// The same seed gives the same counts as a [`Detector`] with `photon_noise` and nothing else. Means below 0 give 0 and are
/// counted in the report.
///
/// ```
/// use detector::PhotonNoise;
/// use psf_types::Image;
/// let expected = Image::new(ndarray::Array2::from_elem((100, 100), 4.0_f32))?;
/// let photons = PhotonNoise::new(1).apply(&expected)?;
/// assert!(photons.counts().pixels().iter().all(|n| *n >= 0.0 && n.fract() == 0.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PhotonNoise {
    seed: u64,
}

impl PhotonNoise {
    /// Photon noise of a seed.
    pub fn new(seed: u64) -> Self {
        Self { seed }
    }

    /// Draws the counts of an image of expected counts.
    ///
    /// # Errors
    /// [`DetectorError::TooLarge`] for counts that `T` cannot hold.
    pub fn apply<T: Real>(&self, expected: &Image<T>) -> Result<Exposure<T>, DetectorError> {
        Self::detector().expose(expected, self.seed)
    }

    /// Draws the counts of some rows `[y, x]` of an image that is `rows_in_all` high, the first of which is row `first_row`.
    ///
    /// # Errors
    /// [`DetectorError::NonFinite`] for NaN and infinities, [`DetectorError::Rows`], and as [`apply`](Self::apply).
    pub fn apply_to_rows<T: Real>(
        &self,
        rows_in_all: usize,
        first_row: usize,
        expected: ArrayView2<'_, T>,
    ) -> Result<ExposedRows<T>, DetectorError> {
        let frame = FrameShape::new(expected.ncols(), rows_in_all)?;
        Self::detector()
            .exposer(frame, self.seed)?
            .expose_rows(first_row, expected)
    }

    fn detector() -> Detector {
        Detector::new(DetectorParams {
            photon_noise: true,
            ..DetectorParams::default()
        })
        .expect("a valid detector")
    }

    /// Replaces the expected charges of a row, none below 0, by what was caught.
    pub(crate) fn catch(self, row: usize, electrons: &mut [f64]) {
        let mut rng = noise_stream(self.seed, Step::Photons, row);
        for value in electrons {
            *value = poisson(*value, &mut rng);
        }
    }
}

/// A Poisson deviate of a mean that is finite and not negative.
fn poisson(mean: f64, rng: &mut impl Rng) -> f64 {
    if mean <= 0.0 {
        return 0.0;
    }
    if let Ok(distribution) = Poisson::new(mean) {
        return distribution.sample(rng);
    }
    let normal: f64 = StandardNormal.sample(rng);
    (mean + mean.sqrt() * normal).round()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_mean_has_a_deviate_near_it() {
        let mut rng = noise_stream(3, Step::Photons, 0);
        for mean in [0.0, 1e-300, 1e-9] {
            assert_eq!(poisson(mean, &mut rng), 0.0);
        }
        // Both sides of the limit of the library's method, and the largest double that stays finite.
        for mean in [1e3, 1e9, 1.8e19, 1.9e19, 1e30, 1e300] {
            let off = (poisson(mean, &mut rng) - mean) / mean.sqrt();
            assert!(off.abs() < 6.0, "{mean}: {off} standard deviations");
        }
    }
}
