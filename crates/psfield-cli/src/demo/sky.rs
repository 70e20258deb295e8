//! The scene of the demonstration: galaxies on pixels, and stars between pixel centres.

use ndarray::Array2;
use psf_types::{FrameShape, Image, PointSource, Position};
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
        let mut image = Array2::zeros((frame.ny(), frame.nx()));
        let large = Galaxy {
            x: 0.72 * nx,
            y: 0.66 * ny,
            flux: 2e6,
            re_px: 32.0,
            index: 1.2,
            axis_ratio: 0.45,
            angle_rad: 0.6,
        };
        large.add_to(&mut image);
        for _ in 0..GALAXIES {
            let galaxy = Galaxy {
                x: rng.random_range(-0.5..nx - 0.5),
                y: rng.random_range(-0.5..ny - 0.5),
                flux: power_law(&mut rng, 1.2, 2e3, 4e5),
                re_px: power_law(&mut rng, 2.0, 1.5, 9.0),
                index: rng.random_range(0.8..3.5),
                axis_ratio: rng.random_range(0.25..1.0),
                angle_rad: rng.random_range(0.0..std::f64::consts::PI),
            };
            galaxy.add_to(&mut image);
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
            galaxies: Image::new(image)?,
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

/// A galaxy with a Sersic profile, `I(r) ~ exp(-b_n ((r / r_e)^(1/n) - 1))` on ellipses (Sersic
/// 1963), truncated at 6 `r_e`.
#[derive(Debug, Clone, Copy)]
struct Galaxy {
    x: f64,
    y: f64,
    flux: f64,
    /// Half-light radius along the major axis (pixels).
    re_px: f64,
    index: f64,
    axis_ratio: f64,
    angle_rad: f64,
}

/// Samples per pixel along each axis, because of the profile's cusp.
const SUBPIXELS: usize = 5;
const CUT: f64 = 6.0;

impl Galaxy {
    /// Adds the galaxy's light. It is normalised to `flux` before the part outside the image is
    /// dropped.
    fn add_to(self, image: &mut Array2<f32>) {
        let (ny, nx) = image.dim();
        let reach = (CUT * self.re_px).ceil();
        let (x0, y0) = ((self.x - reach).floor(), (self.y - reach).floor());
        let side = (2.0 * reach) as usize + 2;
        let (sin, cos) = self.angle_rad.sin_cos();
        // First terms of Ciotti and Bertin 1999.
        let b = 2.0 * self.index - 1.0 / 3.0 + 4.0 / (405.0 * self.index);
        let profile = |dx: f64, dy: f64| {
            let (u, v) = (dx * cos + dy * sin, (dy * cos - dx * sin) / self.axis_ratio);
            let r = u.hypot(v) / self.re_px;
            if r < CUT {
                (-b * (r.powf(1.0 / self.index) - 1.0)).exp()
            } else {
                0.0
            }
        };
        let offset = |k: usize| (k as f64 + 0.5) / SUBPIXELS as f64 - 0.5;
        let values = Array2::from_shape_fn((side, side), |(j, i)| {
            let (dx, dy) = (x0 + i as f64 - self.x, y0 + j as f64 - self.y);
            let samples = (0..SUBPIXELS * SUBPIXELS)
                .map(|k| profile(dx + offset(k % SUBPIXELS), dy + offset(k / SUBPIXELS)));
            samples.sum::<f64>()
        });
        let scale = self.flux / values.sum();
        for ((j, i), value) in values.indexed_iter() {
            let (x, y) = (x0 as i64 + i as i64, y0 as i64 + j as i64);
            if (0..nx as i64).contains(&x) && (0..ny as i64).contains(&y) {
                image[[y as usize, x as usize]] += (value * scale) as f32;
            }
        }
    }
}

/// Draws from a power law of fluxes, `N(> f) ~ f^-slope`, between `faintest` and `brightest`.
fn power_law(rng: &mut ChaCha8Rng, slope: f64, faintest: f64, brightest: f64) -> f64 {
    let (a, b) = (faintest.powf(-slope), brightest.powf(-slope));
    (a + rng.random::<f64>() * (b - a)).powf(-1.0 / slope)
}

/// Draws positions that are uniform over the frame.
pub(crate) fn random_positions(frame: FrameShape, count: usize, seed: u64) -> anyhow::Result<Vec<Position>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count)
        .map(|_| {
            let x = rng.random_range(0.0..(frame.nx() - 1) as f64);
            let y = rng.random_range(0.0..(frame.ny() - 1) as f64);
            Ok(Position::new(x, y)?)
        })
        .collect()
}
