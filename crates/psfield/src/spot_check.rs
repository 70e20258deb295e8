//! An image checked against the direct sum at random pixels.

use psf_types::{Image, Real};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::PsfieldError;

/// The difference of an image from the direct sum in f64 at random pixels: what the engine adds to the model. It says nothing of
/// the model itself, nor of stamps too coarse for the stars drawn between their pixels.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct SpotCheck {
    /// How many pixels were looked at.
    pub pixels: usize,
    /// The seed that chose them.
    pub seed: u64,
    /// The largest absolute difference.
    pub max_abs: f64,
    /// The root mean square of the differences.
    pub rms: f64,
    /// The largest absolute difference over the image's largest absolute value; none for a dark image.
    pub max_over_peak: Option<f64>,
}

impl SpotCheck {
    /// Compares `count` pixels of an image, chosen by `seed`, with what `exact` says of them.
    ///
    /// # Errors
    /// Those of `exact`.
    pub fn run<T: Real>(
        image: &Image<T>,
        count: usize,
        seed: u64,
        exact: impl FnOnce(&[(usize, usize)]) -> Result<Vec<f64>, PsfieldError>,
    ) -> Result<Self, PsfieldError> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let shape = image.shape();
        let pixels: Vec<(usize, usize)> = (0..count)
            .map(|_| (rng.random_range(0..shape.nx()), rng.random_range(0..shape.ny())))
            .collect();
        let values = image.pixels();
        let differences: Vec<f64> = pixels
            .iter()
            .zip(exact(&pixels)?)
            .map(|(&(x, y), exact)| (values[[y, x]].as_f64() - exact).abs())
            .collect();
        let max_abs = differences.iter().copied().fold(0.0, f64::max);
        let peak = values.iter().fold(0.0f64, |m, v| m.max(v.as_f64().abs()));
        Ok(Self {
            pixels: count,
            seed,
            max_abs,
            rms: (differences.iter().map(|d| d * d).sum::<f64>() / count.max(1) as f64).sqrt(),
            max_over_peak: (peak > 0.0).then(|| max_abs / peak),
        })
    }
}
