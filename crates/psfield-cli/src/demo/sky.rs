//! The scene of the demonstration: an image of galaxies, and a list of stars. Galaxies and stars
//! may lie anywhere between the pixel centres.

use ndarray::Array2;
use psf_types::{FrameShape, Image, PointSource, Position, SersicProfile, SersicSource};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

pub(super) const GALAXIES: usize = 400;
pub(super) const STARS: usize = 2500;

/// The stars and galaxies of a frame.
pub(super) struct Sky {
    pub(super) galaxies: Image<f32>,
    pub(super) stars: Vec<PointSource>,
}

impl Sky {
    /// Makes galaxies, one of them large, and stars, some of them just outside the frame.
    pub(super) fn new(frame: FrameShape, seed: u64) -> anyhow::Result<Self> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (nx, ny) = (frame.nx() as f64, frame.ny() as f64);
        let galaxy = |(x, y), flux, re_px, index, axis_ratio, angle_deg| -> anyhow::Result<_> {
            let profile = SersicProfile::new(re_px, index, axis_ratio, angle_deg)?;
            Ok(SersicSource::new(Position::new(x, y)?, flux, profile)?)
        };
        let mut galaxies = vec![galaxy((0.72 * nx, 0.66 * ny), 2e6, 32.0, 1.2, 0.45, 34.0)?];
        for _ in 0..GALAXIES {
            let at = (rng.random_range(-0.5..nx - 0.5), rng.random_range(-0.5..ny - 0.5));
            galaxies.push(galaxy(
                at,
                power_law(&mut rng, 1.2, 2e3, 4e5),
                power_law(&mut rng, 2.0, 1.5, 9.0),
                rng.random_range(0.8..3.5),
                rng.random_range(0.25..1.0),
                rng.random_range(0.0..180.0),
            )?);
        }
        // Sources just outside the frame still contribute light.
        let margin = 16.0;
        let stars = (0..STARS)
            .map(|_| {
                let position = Position::new(
                    rng.random_range(-margin..nx + margin),
                    rng.random_range(-margin..ny + margin),
                )?;
                Ok(PointSource::new(position, power_law(&mut rng, 0.8, 5e2, 5e5))?)
            })
            .collect::<anyhow::Result<Vec<_>>>()?;
        Ok(Self {
            galaxies: psfield::light_on_pixels(&galaxies, frame)?,
            stars,
        })
    }

    /// Returns the scene on pixels, with each star in the pixel on which it lies, as a perfect
    /// telescope would show it.
    pub(super) fn sharp(&self) -> Array2<f32> {
        let mut pixels = self.galaxies.pixels().to_owned();
        for star in &self.stars {
            let (x, y) = (star.position().x().round(), star.position().y().round());
            if x >= 0.0
                && y >= 0.0
                && let Some(pixel) = pixels.get_mut((y as usize, x as usize))
            {
                *pixel += star.flux() as f32;
            }
        }
        pixels
    }
}

/// Draws a value from the power law `N(> f) ~ f^-slope`, between `smallest` and `largest`.
fn power_law(rng: &mut ChaCha8Rng, slope: f64, smallest: f64, largest: f64) -> f64 {
    let (a, b) = (smallest.powf(-slope), largest.powf(-slope));
    (a + rng.random::<f64>() * (b - a)).powf(-1.0 / slope)
}
