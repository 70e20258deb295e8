//! The light of galaxies on one tile of the scene.

use psf_types::{Cancelled, Progress};

use crate::profile::{Nearness, Profile};
use crate::rules::{GAUSS_2, GAUSS_3, GAUSS_4, NODES, chebyshev_nodes, interpolation_weights};

/// Pixels along a tile.
pub(crate) const TILE: usize = 128;
/// Blocks of a tile are divided in halves this many times: 128 to 8 pixels.
const LEVELS: usize = 5;

/// Relative error at which a rule is good enough.
const RELATIVE_ERROR: f64 = 5e-5;
/// Error, as a fraction of the flux, at which a rule is good enough for one pixel or a part of it, however faint.
const ABSOLUTE_ERROR: f64 = 1e-10;
/// Beyond this relative size the estimates below do not hold.
const LARGEST_SIZE: f64 = 3.5;

/// Estimates of the rules' relative errors on a square of relative size `t` (see [`Nearness`](crate::profile::Nearness)), for both
/// axes: `t^m` stands for the m-th derivative.
fn error_of_polynomial(t: f64) -> f64 {
    4.0 * (0.25 * t).powi(6) / 720.0
}

fn error_of_gauss_2(t: f64) -> f64 {
    2.0 * t.powi(4) / 4320.0
}

fn error_of_gauss_3(t: f64) -> f64 {
    2.0 * t.powi(6) / 2_016_000.0
}

fn error_of_gauss_4(t: f64) -> f64 {
    2.0 * t.powi(8) / 1.778e9
}

/// What the tiles of an image share.
pub(crate) struct Rules {
    nodes: [f64; NODES],
    /// By level.
    weights: Vec<Vec<[f64; NODES]>>,
}

impl Rules {
    pub(crate) fn new() -> Self {
        Self {
            nodes: chebyshev_nodes(),
            weights: (0..LEVELS)
                .map(|level| interpolation_weights(TILE >> level))
                .collect(),
        }
    }
}

/// The values at the nodes of a block, rows first.
type Block = [[f64; NODES]; NODES];

/// The light on a square of [`TILE`] pixels, as single pixels and as polynomials on blocks.
pub(crate) struct Tile<'a> {
    rules: &'a Rules,
    /// First column and row in pixels of the scene.
    x0: f64,
    y0: f64,
    pixels: Vec<f64>,
    /// By level, rows first; empty where no galaxy has needed them.
    blocks: [Vec<Block>; LEVELS],
}

impl<'a> Tile<'a> {
    pub(crate) fn new(rules: &'a Rules, x0: i64, y0: i64) -> Self {
        Self {
            rules,
            x0: x0 as f64,
            y0: y0 as f64,
            pixels: vec![0.0; TILE * TILE],
            blocks: std::array::from_fn(|_| Vec::new()),
        }
    }

    /// Adds a galaxy.
    pub(crate) fn add(&mut self, galaxy: &Profile, progress: &dyn Progress) -> Result<(), Cancelled> {
        self.add_block(galaxy, 0, (0, 0), progress)
    }

    /// Adds a galaxy's light on one block of a level.
    fn add_block(
        &mut self,
        galaxy: &Profile,
        level: usize,
        (row, column): (usize, usize),
        progress: &dyn Progress,
    ) -> Result<(), Cancelled> {
        progress.still_wanted()?;
        let size = TILE >> level;
        let centre = |first: f64, index: usize| first + (index * size) as f64 + 0.5 * (size - 1) as f64;
        let dx = centre(self.x0, column) - galaxy.x;
        let dy = centre(self.y0, row) - galaxy.y;
        let nearness = galaxy.nearness(dx, dy, size as f64);
        // Also false for positions so far off that the distance is not finite.
        let in_reach = nearness.radius < galaxy.last_radius.min(f64::MAX);
        if !in_reach {
            return Ok(());
        }
        let allowed = allowed_error(galaxy.brightness_at(nearness.radius));
        let t = nearness.relative_size;
        if t <= LARGEST_SIZE && error_of_polynomial(t) <= allowed {
            let blocks = &mut self.blocks[level];
            blocks.resize(1 << (2 * level), Block::default());
            for (values, node_y) in blocks[(row << level) + column].iter_mut().zip(self.rules.nodes) {
                for (value, node_x) in values.iter_mut().zip(self.rules.nodes) {
                    let at = (dx + node_x * size as f64, dy + node_y * size as f64);
                    *value += galaxy.flux * galaxy.pixel_flux(at.0, at.1);
                }
            }
        } else if level + 1 < LEVELS {
            for (j, i) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                self.add_block(galaxy, level + 1, (2 * row + j, 2 * column + i), progress)?;
            }
        } else {
            // Where one rule does for every pixel of the block, it need not be looked for pixel by pixel.
            let of_pixels = Nearness {
                relative_size: nearness.relative_size / size as f64,
                ..nearness
            };
            let rule = rule_for(galaxy, &of_pixels, 1.0);
            for y in row * size..(row + 1) * size {
                for x in column * size..(column + 1) * size {
                    let (dx, dy) = (self.x0 + x as f64 - galaxy.x, self.y0 + y as f64 - galaxy.y);
                    let light = match rule {
                        Some(rule) => product(rule, galaxy, dx, dy, 1.0),
                        None => light_on_square(galaxy, dx, dy, 1.0),
                    };
                    self.pixels[y * TILE + x] += galaxy.flux * light;
                }
            }
        }
        Ok(())
    }

    /// The flux in every pixel, rows first.
    pub(crate) fn into_pixels(mut self) -> Vec<f64> {
        for (level, blocks) in self.blocks.iter().enumerate() {
            let (size, weights) = (TILE >> level, &self.rules.weights[level]);
            for (number, block) in blocks.iter().enumerate() {
                if block.iter().flatten().all(|&value| value == 0.0) {
                    continue;
                }
                let (row, column) = (number >> level, number & ((1 << level) - 1));
                for (j, by_row) in weights.iter().enumerate() {
                    let line: [f64; NODES] =
                        std::array::from_fn(|i| (0..NODES).map(|k| by_row[k] * block[k][i]).sum());
                    let start = (row * size + j) * TILE + column * size;
                    for (pixel, by_column) in self.pixels[start..start + size].iter_mut().zip(weights) {
                        *pixel += by_column.iter().zip(line).map(|(w, v)| w * v).sum::<f64>();
                    }
                }
            }
        }
        self.pixels
    }
}

/// The relative error allowed where no more than this fraction of the flux is at stake.
fn allowed_error(at_most: f64) -> f64 {
    RELATIVE_ERROR.max(ABSOLUTE_ERROR / at_most)
}

/// The light on a square of at most one pixel around an offset from the centre, for a flux of 1.
fn light_on_square(galaxy: &Profile, dx: f64, dy: f64, size: f64) -> f64 {
    let nearness = galaxy.nearness(dx, dy, size);
    if let Some(rule) = rule_for(galaxy, &nearness, size) {
        return product(rule, galaxy, dx, dy, size);
    }
    let (half, quarter) = (0.5 * size, 0.25 * size);
    [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)]
        .map(|(i, j)| light_on_square(galaxy, dx + i * quarter, dy + j * quarter, half))
        .iter()
        .sum()
}

/// The rule that is good enough for a square of at most one pixel; `None` when it must be divided.
fn rule_for(galaxy: &Profile, nearness: &Nearness, size: f64) -> Option<&'static [(f64, f64)]> {
    let at_most = galaxy.brightness_at(nearness.radius) * size * size;
    let (t, allowed) = (nearness.relative_size, allowed_error(at_most));
    if at_most <= ABSOLUTE_ERROR {
        return Some(&GAUSS_2);
    }
    match t {
        _ if t > LARGEST_SIZE => None,
        _ if error_of_gauss_2(t) <= allowed => Some(&GAUSS_2),
        _ if error_of_gauss_3(t) <= allowed => Some(&GAUSS_3),
        _ if error_of_gauss_4(t) <= allowed => Some(&GAUSS_4),
        _ => None,
    }
}

/// The integral over a square around an offset from the centre.
fn product(rule: &[(f64, f64)], galaxy: &Profile, dx: f64, dy: f64, size: f64) -> f64 {
    let mut sum = 0.0;
    for &(y, weight_y) in rule {
        let line: f64 = rule
            .iter()
            .map(|&(x, weight_x)| weight_x * galaxy.brightness(dx + size * x, dy + size * y))
            .sum();
        sum += weight_y * line;
    }
    sum * size * size
}
