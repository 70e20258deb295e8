//! The exact values that images are compared with.

use conv_core::{ConvReal, Direct};
use ndarray::ArrayView2;
use psf_types::{Anchor, PsfModel, Scene};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::PsfieldError;

/// The direct sum in double precision at random pixels.
#[derive(Debug)]
pub(super) struct Reference {
    /// `(column, row)`.
    pixels: Vec<(usize, usize)>,
    values: Vec<f64>,
}

impl Reference {
    pub(super) fn new<T: ConvReal>(
        model: &PsfModel,
        scene: &Scene<T>,
        anchor: Anchor,
        count: usize,
        seed: u64,
    ) -> Result<Self, PsfieldError> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let frame = scene.frame().shape();
        let pixels: Vec<(usize, usize)> = (0..count.max(1))
            .map(|_| (rng.random_range(0..frame.nx()), rng.random_range(0..frame.ny())))
            .collect();
        let values = Direct::new(anchor).at_pixels(model, scene, &pixels)?;
        Ok(Self { pixels, values })
    }

    /// `|F - E| / |E|` over the pixels; none where they are dark.
    pub(super) fn relative_l2<T: ConvReal>(&self, image: ArrayView2<'_, T>) -> Option<f64> {
        let (mut error, mut norm) = (0.0, 0.0);
        for (&(x, y), exact) in self.pixels.iter().zip(&self.values) {
            error += (image[[y, x]].as_f64() - exact).powi(2);
            norm += exact * exact;
        }
        (norm > 0.0).then(|| (error / norm).sqrt())
    }
}
