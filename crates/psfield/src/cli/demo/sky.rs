//! The sky of the demonstration.

use psf_types::{FrameShape, Image, PointSource};

use super::scene_maker::make_scene;

pub(super) const GALAXIES: usize = 400;
pub(super) const STARS: usize = 2500;

/// Stars and galaxies of a frame.
pub(super) struct Sky {
    pub(super) galaxies: Image<f32>,
    pub(super) stars: Vec<PointSource>,
}

impl Sky {
    pub(super) fn new(frame: FrameShape, seed: u64) -> anyhow::Result<Self> {
        let (galaxies, stars) = make_scene(frame, GALAXIES, STARS, seed)?;
        Ok(Self {
            galaxies: Image::new(galaxies)?,
            stars,
        })
    }

    /// The sky on pixels, each star in the pixel it falls on: what a perfect telescope would show.
    pub(super) fn sharp(&self) -> ndarray::Array2<f32> {
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
