//! Draws the outskirts of galaxies, outside the windows that are drawn in Fourier space.
//!
//! There the light hardly changes over the extent of the PSF. So the image is the light at the
//! PSF's centroid, plus its second derivatives times half the PSF's covariance.

use ndarray::{ArrayViewMut2, Axis};
use psf_types::{LightProfile, Progress};
use rayon::prelude::*;

use crate::overlap::Piece;
use crate::{ConvError, ConvReal};

/// Pixels along each side of a tile. Tiles, their blocks and the windows of galaxies begin at
/// multiples of [`SMALLEST`] pixels, so a block lies inside or outside a window.
const TILE: usize = 128;
/// Pixels along each side of the smallest blocks of a tile.
pub(super) const SMALLEST: usize = 8;
/// Number of block sizes in a tile: 128, 64, 32, 16 and 8 pixels.
const LEVELS: usize = 5;
/// Number of nodes along an axis. The values at the nodes determine the polynomial of a block.
const NODES: usize = 6;
/// Light that comes to a window from more than this number of periods away is spread evenly.
const MOST_PERIODS: f64 = 12.0;
/// Number of tiles that are drawn before they are added to the image.
const TILES_AT_ONCE: usize = 64;

/// The light of one galaxy far from its centre.
pub(super) struct FarLight {
    pub(super) light: Box<dyn LightProfile + Send + Sync>,
    pub(super) flux: f64,
    /// The centre of the galaxy plus the centroid of the PSF, in pixels of the frame.
    pub(super) centre: (f64, f64),
    /// The PSF's covariance: xx, xy, yy.
    pub(super) covariance: [f64; 3],
    /// First column and row of the galaxy's window, and its side.
    pub(super) window: (i64, i64, usize),
    /// Light farther than this from the centre is left out. 0 if no light is drawn.
    pub(super) reach: f64,
    /// Light below this brightness, for a flux of 1, is left out.
    pub(super) faintest: f64,
    /// Largest error of the polynomial of a block relative to the brightest light in it.
    pub(super) relative_error: f64,
}

impl FarLight {
    /// The light at a pixel of the frame.
    pub(super) fn at(&self, x: f64, y: f64) -> f64 {
        let (dx, dy) = (x - self.centre.0, y - self.centre.1);
        let [brightness, by_xx, by_xy, by_yy] = self.light.brightness(dx, dy);
        let [xx, xy, yy] = self.covariance;
        self.flux * (brightness + 0.5 * (xx * by_xx + yy * by_yy) + xy * by_xy)
    }

    /// The polynomial, on the window, of the light that an image with the period of the window
    /// brings there from outside.
    pub(super) fn repeated(&self) -> Polynomial {
        let (x0, y0, side) = self.window;
        let period = side as f64;
        let most = (self.reach / period + 0.5).floor().min(MOST_PERIODS) as i64;
        // The light from still farther, spread evenly. It lies outside an ellipse as large as the
        // square of the periods.
        let half_side = (most as f64 + 0.5) * period;
        let ellipse = half_side * (4.0 / (std::f64::consts::PI * self.light.axis_ratio())).sqrt();
        let rest = self.flux * self.light.flux_beyond(ellipse) / (period * period);
        let mut values = [[rest; NODES]; NODES];
        for (row, node_y) in values.iter_mut().zip(chebyshev_nodes()) {
            for (value, node_x) in row.iter_mut().zip(chebyshev_nodes()) {
                let middle = 0.5 * (period - 1.0);
                let (x, y) = (
                    x0 as f64 + middle + node_x * period,
                    y0 as f64 + middle + node_y * period,
                );
                for j in -most..=most {
                    for i in -most..=most {
                        if (i, j) != (0, 0) {
                            *value += self.at(x + i as f64 * period, y + j as f64 * period);
                        }
                    }
                }
            }
        }
        Polynomial {
            values,
            weights: interpolation_weights(side),
        }
    }

    /// Whether the square of `size` pixels around a point contains light.
    fn reaches(&self, (x, y): (f64, f64), size: f64) -> bool {
        let reach = self.reach + 0.5 * size;
        (x - self.centre.0).abs() <= reach && (y - self.centre.1).abs() <= reach
    }
}

/// A polynomial on a square, by its values at the nodes.
pub(super) struct Polynomial {
    values: Block,
    weights: Vec<[f64; NODES]>,
}

impl Polynomial {
    /// Subtracts the polynomial from a row of the square.
    pub(super) fn subtract_from<T: ConvReal>(&self, row: usize, values: &mut [T]) {
        let line = line_of(&self.values, &self.weights[row]);
        for (value, weights) in values.iter_mut().zip(&self.weights) {
            let sum: f64 = weights.iter().zip(line).map(|(w, v)| w * v).sum();
            *value -= T::nearest(sum);
        }
    }
}

/// Adds the light of galaxies outside their windows to an image, whose first pixel is the pixel
/// `first` of the frame.
pub(super) fn add_far_light<T: ConvReal>(
    galaxies: &[FarLight],
    mut image: ArrayViewMut2<'_, T>,
    first: (i64, i64),
    progress: &dyn Progress,
) -> Result<(), ConvError> {
    if galaxies.is_empty() {
        return Ok(());
    }
    let tiles_along = |first: i64, length: usize| {
        let start = first.div_euclid(TILE as i64) * TILE as i64;
        (start..first + length as i64).step_by(TILE)
    };
    let corners: Vec<(i64, i64)> = tiles_along(first.1, image.nrows())
        .flat_map(|y| tiles_along(first.0, image.ncols()).map(move |x| (x, y)))
        .collect();
    for some in corners.chunks(TILES_AT_ONCE) {
        let drawn: Vec<Option<Piece<T>>> = some
            .par_iter()
            .map(|&(x, y)| {
                progress.check_cancelled()?;
                let mut tile = Tile::new(x, y);
                for galaxy in galaxies {
                    tile.add_block(galaxy, 0, (0, 0));
                }
                Ok(tile.into_piece())
            })
            .collect::<Result<_, ConvError>>()?;
        let bands = image
            .axis_chunks_iter_mut(Axis(0), SMALLEST)
            .into_par_iter()
            .enumerate();
        bands.for_each(|(band, mut rows)| {
            for tile in drawn.iter().flatten() {
                tile.add_to(&mut rows, (first.0, first.1 + (band * SMALLEST) as i64));
            }
        });
    }
    Ok(())
}

/// The values at the nodes of a block, rows first.
type Block = [[f64; NODES]; NODES];

/// The light on a square of [`TILE`] x [`TILE`] pixels: values of single pixels, and polynomials on
/// blocks.
struct Tile {
    x0: i64,
    y0: i64,
    pixels: Vec<f64>,
    /// Blocks by level, rows first. A level is empty until a galaxy needs it.
    blocks: [Vec<Block>; LEVELS],
}

impl Tile {
    fn new(x0: i64, y0: i64) -> Self {
        Self {
            x0,
            y0,
            pixels: Vec::new(),
            blocks: std::array::from_fn(|_| Vec::new()),
        }
    }

    /// Adds a galaxy's light on one block of a level.
    fn add_block(&mut self, galaxy: &FarLight, level: usize, (row, column): (usize, usize)) {
        let size = TILE >> level;
        let (x, y) = (self.x0 + (column * size) as i64, self.y0 + (row * size) as i64);
        let middle = 0.5 * (size - 1) as f64;
        let centre = (x as f64 + middle, y as f64 + middle);
        if !galaxy.reaches(centre, size as f64) {
            return;
        }
        let (left, top, side) = galaxy.window;
        let within = |at: i64, start: i64| at >= start && at + size as i64 <= start + side as i64;
        let beside = |at: i64, start: i64| at + size as i64 <= start || at >= start + side as i64;
        if within(x, left) && within(y, top) {
            return;
        }
        let outside = beside(x, left) || beside(y, top);
        let offset = (centre.0 - galaxy.centre.0, centre.1 - galaxy.centre.1);
        let around = galaxy
            .light
            .around(offset, 0.5 * size as f64 * std::f64::consts::SQRT_2);
        if around.brightness <= galaxy.faintest {
            return;
        }
        if outside && error_of_polynomial(size as f64 / around.scale_px) <= galaxy.relative_error {
            let blocks = &mut self.blocks[level];
            blocks.resize(1 << (2 * level), Block::default());
            for (values, node_y) in blocks[(row << level) + column].iter_mut().zip(chebyshev_nodes()) {
                for (value, node_x) in values.iter_mut().zip(chebyshev_nodes()) {
                    *value += galaxy.at(centre.0 + node_x * size as f64, centre.1 + node_y * size as f64);
                }
            }
        } else if level + 1 < LEVELS {
            for (j, i) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                self.add_block(galaxy, level + 1, (2 * row + j, 2 * column + i));
            }
        } else {
            self.pixels.resize(TILE * TILE, 0.0);
            for j in 0..size {
                for i in 0..size {
                    let at = (row * size + j) * TILE + column * size + i;
                    self.pixels[at] += galaxy.at((x + i as i64) as f64, (y + j as i64) as f64);
                }
            }
        }
    }

    /// Returns the light in every pixel, or `None` for a dark tile.
    fn into_piece<T: ConvReal>(mut self) -> Option<Piece<T>> {
        if self.pixels.is_empty() && self.blocks.iter().all(Vec::is_empty) {
            return None;
        }
        self.pixels.resize(TILE * TILE, 0.0);
        for (level, blocks) in self.blocks.iter().enumerate() {
            let size = TILE >> level;
            let weights = interpolation_weights(size);
            for (number, block) in blocks.iter().enumerate() {
                if block.iter().flatten().all(|&value| value == 0.0) {
                    continue;
                }
                let (row, column) = (number >> level, number & ((1 << level) - 1));
                for (j, by_row) in weights.iter().enumerate() {
                    let line = line_of(block, by_row);
                    let start = (row * size + j) * TILE + column * size;
                    for (pixel, by_column) in self.pixels[start..start + size].iter_mut().zip(&weights) {
                        *pixel += by_column.iter().zip(line).map(|(w, v)| w * v).sum::<f64>();
                    }
                }
            }
        }
        let values = self.pixels.into_iter().map(T::nearest).collect();
        Some(Piece {
            first_column: self.x0,
            first_row: self.y0,
            values: ndarray::Array2::from_shape_vec((TILE, TILE), values).expect("the pixels of a tile"),
        })
    }
}

/// The values of a polynomial along a row, at the nodes.
fn line_of(block: &Block, by_row: &[f64; NODES]) -> [f64; NODES] {
    std::array::from_fn(|i| (0..NODES).map(|k| by_row[k] * block[k][i]).sum())
}

/// Estimates the error of the polynomial on a block, relative to the brightest light in it. The
/// size of the block is `t` times the scale of the light ([`psf_types::Outskirts`]).
///
/// For both axes together, the error is at most `4 (t / 4)^6 / 6!` if the sixth derivatives are
/// everywhere as large as the scale allows. They are smaller in most of a block, so a tenth of this
/// limit is enough (see the test).
pub(super) fn error_of_polynomial(t: f64) -> f64 {
    0.4 * (0.25 * t).powi(6) / 720.0
}

/// Chebyshev's nodes on an interval of length 1 around 0.
fn chebyshev_nodes() -> [f64; NODES] {
    std::array::from_fn(|k| {
        let angle = (2 * k + 1) as f64 * std::f64::consts::PI / (2 * NODES) as f64;
        0.5 * angle.cos()
    })
}

/// For each pixel along a block of `size` pixels, Lagrange's interpolation weights of the values at
/// the nodes.
fn interpolation_weights(size: usize) -> Vec<[f64; NODES]> {
    let nodes = chebyshev_nodes();
    let weights_at = |at: f64| {
        std::array::from_fn(|k| {
            (0..NODES)
                .filter(|&j| j != k)
                .map(|j| (at - nodes[j]) / (nodes[k] - nodes[j]))
                .product()
        })
    };
    (0..size)
        .map(|pixel| weights_at((pixel as f64 + 0.5) / size as f64 - 0.5))
        .collect()
}

#[cfg(test)]
mod tests {
    use psf_types::{Position, SersicProfile, SersicSource};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use sersic::SersicLight;

    use super::*;

    #[test]
    fn polynomials_are_within_their_estimated_errors() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut count = 0;
        while count < 3000 {
            let profile = SersicProfile::new(
                rng.random_range(0.3..8.0),
                rng.random_range(0.5..6.0),
                rng.random_range(0.1..1.0),
                rng.random_range(0.0..180.0),
            );
            let source = SersicSource::new(Position::of_pixel(0, 0), 1.0, profile.unwrap()).unwrap();
            let light = SersicLight::new(&source);
            let size = SMALLEST << rng.random_range(0..LEVELS);
            let angle: f64 = rng.random_range(0.0..std::f64::consts::TAU);
            let distance = size as f64 * rng.random_range(0.8..6.0);
            let centre = (distance * angle.cos(), distance * angle.sin());
            let around = light.around(centre, 0.5 * size as f64 * std::f64::consts::SQRT_2);
            let estimate = error_of_polynomial(size as f64 / around.scale_px);
            if !(1e-5..=1e-1).contains(&estimate) || around.brightness < 1e-30 {
                continue;
            }
            count += 1;
            let at =
                |x: f64, y: f64| light.brightness(centre.0 + x * size as f64, centre.1 + y * size as f64)[0];
            let nodes = chebyshev_nodes();
            let block: Block = nodes.map(|y| nodes.map(|x| at(x, y)));
            let weights = interpolation_weights(size);
            let (mut error, mut brightest) = (0.0_f64, 0.0_f64);
            for (j, by_row) in weights.iter().enumerate() {
                let line = line_of(&block, by_row);
                for (i, by_column) in weights.iter().enumerate() {
                    let value: f64 = by_column.iter().zip(line).map(|(w, v)| w * v).sum();
                    let place = |i: usize| (i as f64 + 0.5) / size as f64 - 0.5;
                    let truth = at(place(i), place(j));
                    error = error.max((value - truth).abs());
                    brightest = brightest.max(truth);
                }
            }
            assert!(
                error <= estimate * brightest,
                "{error:e} {estimate:e} {size} {distance} {source:?}"
            );
        }
    }
}
