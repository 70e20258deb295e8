//! A scene to be convolved.

use ndarray::Array2;
use psf_types::{DataError, FrameShape, Image, Real, Scene};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A scene in which every pixel is lit: exponential noise of mean 1 on a smooth background between 1 and 3.
///
/// Nothing in it is dark or sparse, so that no method gains by skipping. The same seed gives the same scene.
///
/// # Errors
/// [`DataError`] never for a valid shape; it is the type's constructor that checks.
pub fn lit_scene<T: Real>(shape: FrameShape, seed: u64) -> Result<Scene<T>, DataError> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let wave = |i: usize, n: usize| (WAVE * i as f64 / n as f64).sin();
    let across: Vec<f64> = (0..shape.nx()).map(|x| wave(x, shape.nx())).collect();
    let mut pixels = Array2::zeros((shape.ny(), shape.nx()));
    for (y, mut row) in pixels.outer_iter_mut().enumerate() {
        let up = wave(y, shape.ny());
        for (pixel, across) in row.iter_mut().zip(&across) {
            let noise = -(1.0 - rng.random_range(0.0..1.0f64)).ln();
            *pixel = T::nearest(2.0 + across * up + noise);
        }
    }
    Ok(Scene::from_image(Image::new(pixels)?))
}

/// Radians of the background's wave over the frame.
const WAVE: f64 = 7.0;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pixel_is_lit_and_the_seed_decides() {
        let shape = FrameShape::new(40, 30).unwrap();
        let pixels = |seed| {
            lit_scene::<f32>(shape, seed)
                .unwrap()
                .pixels()
                .unwrap()
                .to_owned()
        };
        assert!(pixels(1).iter().all(|&v| v >= 1.0));
        assert_eq!(pixels(1), pixels(1));
        assert_ne!(pixels(1), pixels(2));
        // The mean of the noise is 1, that of the background near 2; 1200 pixels know it to a few percent.
        assert!((pixels(3).mean().unwrap() - 3.0).abs() < 0.3);
    }
}
