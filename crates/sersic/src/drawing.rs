//! Draws galaxies on an image, which is a part of a larger scene. The scene is divided into square
//! tiles, and many tiles are drawn at the same time. Within a tile, pixels near a galaxy's centre
//! are integrated one by one, and blocks of pixels far from the centre are drawn as polynomials.

use ndarray::{ArrayView2, ArrayViewMut2, s};
use psf_types::{Cancelled, NoProgress, Progress, Real, SersicSource};
use rayon::prelude::*;

use crate::profile::{Nearness, Profile};

/// Number of tiles that are drawn before they are added to the image. A limit keeps the memory
/// small.
const TILES_AT_ONCE: usize = 64;

/// Adds galaxies to an image `[y, x]`, which may be a part of a larger scene. The image's first
/// pixel is the pixel `(x0, y0) = first_pixel` of the scene. The galaxies' positions are in pixels
/// of the scene (0-based, an integer is the centre of a pixel).
///
/// Each pixel receives the flux that falls on its area. Galaxies may lie partly or wholly outside
/// the image. A galaxy's flux is the total to infinite radius, and light outside the image is lost.
/// For the accuracy, see the [crate's page](crate).
///
/// An image drawn in parts, each with its own first pixel, equals the image drawn at once. The
/// number of threads does not change the result. The additional memory is at most 15 MB for 64
/// tiles of 128 x 128 pixels, and 30 kB for each galaxy whose light reaches the image. The time
/// grows with the number of galaxies times the number of tiles that their light reaches. A galaxy
/// with a half-light radius of 3 pixels takes about 1 ms on one core. Most of this time is spent on
/// the pixels within about 50 pixels of the galaxy's centre.
pub fn add_galaxies<T: Real>(
    image: ArrayViewMut2<'_, T>,
    first_pixel: (i64, i64),
    galaxies: &[SersicSource],
) {
    add_galaxies_with_progress(image, first_pixel, galaxies, &NoProgress).expect("NoProgress never cancels");
}

/// Works like [`add_galaxies`], reports progress in tiles, and checks for cancellation every few
/// milliseconds.
///
/// # Errors
/// [`Cancelled`] if `progress` cancels. The image may then contain part of the light.
pub fn add_galaxies_with_progress<T: Real>(
    mut image: ArrayViewMut2<'_, T>,
    first_pixel: (i64, i64),
    galaxies: &[SersicSource],
    progress: &dyn Progress,
) -> Result<(), Cancelled> {
    let (ny, nx) = image.dim();
    if nx == 0 || ny == 0 {
        return Ok(());
    }
    let profiles: Vec<Profile> = galaxies
        .par_iter()
        .filter(|galaxy| galaxy.flux() != 0.0)
        .map(|galaxy| progress.check_cancelled().map(|()| Profile::new(galaxy)))
        .collect::<Result<_, Cancelled>>()?;
    if profiles.is_empty() {
        return Ok(());
    }
    let rules = Rules::new();
    // The grid of tiles is fixed in the scene, wherever the image begins.
    let tiles_along = |first: i64, length: usize| {
        let tile = TILE as i64;
        let start = first.div_euclid(tile) * tile;
        (start..first + length as i64).step_by(TILE)
    };
    let corners: Vec<(i64, i64)> = tiles_along(first_pixel.1, ny)
        .flat_map(|y| tiles_along(first_pixel.0, nx).map(move |x| (x, y)))
        .collect();
    progress.start(corners.len() as u64);
    for some in corners.chunks(TILES_AT_ONCE) {
        let drawn: Vec<Vec<f64>> = some
            .par_iter()
            .map(|&(x, y)| {
                let mut tile = Tile::new(&rules, x, y);
                for galaxy in &profiles {
                    tile.add(galaxy, progress)?;
                }
                progress.advance(1);
                Ok(tile.into_pixels())
            })
            .collect::<Result<_, Cancelled>>()?;
        for (&(x, y), pixels) in some.iter().zip(drawn) {
            add_tile(&mut image, x - first_pixel.0, y - first_pixel.1, &pixels);
        }
    }
    Ok(())
}

/// Adds a tile to the image, where both overlap. The tile begins at `row` and `column` of the
/// image, which may be negative.
fn add_tile<T: Real>(image: &mut ArrayViewMut2<'_, T>, column: i64, row: i64, pixels: &[f64]) {
    let tile = ArrayView2::from_shape((TILE, TILE), pixels).expect("a tile has TILE x TILE pixels");
    let overlap = |first: i64, length: usize| {
        let start = first.max(0);
        let end = (first + TILE as i64).min(length as i64);
        (
            start as usize..end as usize,
            (start - first) as usize..(end - first) as usize,
        )
    };
    let (ny, nx) = image.dim();
    let ((to_rows, from_rows), (to_columns, from_columns)) = (overlap(row, ny), overlap(column, nx));
    let mut target = image.slice_mut(s![to_rows, to_columns]);
    target.zip_mut_with(&tile.slice(s![from_rows, from_columns]), |pixel, &light| {
        *pixel += T::nearest(light);
    });
}

/// Pixels along each side of a tile.
const TILE: usize = 128;
/// Number of block sizes in a tile: 128, 64, 32, 16 and 8 pixels.
const LEVELS: usize = 5;

/// Largest estimated relative error of an integration rule or a polynomial. The actual errors are
/// smaller (`tests/accuracy.rs`).
const RELATIVE_ERROR: f64 = 5e-5;
/// Error that is always allowed in a pixel or a part of it, as a fraction of the galaxy's flux.
const ABSOLUTE_ERROR: f64 = 1e-10;
/// Largest relative size for which the estimates below hold.
const LARGEST_SIZE: f64 = 3.5;

/// Estimates the relative error of the polynomial on a block of relative size `t` (see
/// [`Nearness`]), for both axes together. The estimate assumes that the m-th derivative times the
/// m-th power of the size is `t^m` times the brightness. The next three functions estimate the
/// errors of the Gauss-Legendre rules with 2, 3 and 4 nodes under the same assumption.
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

/// The nodes and the interpolation weights of the polynomials, which all tiles share.
struct Rules {
    nodes: [f64; NODES],
    /// For each level, the interpolation weights of each pixel along a block.
    weights: Vec<Vec<[f64; NODES]>>,
}

impl Rules {
    fn new() -> Self {
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

/// The light on a square of [`TILE`] x [`TILE`] pixels: values of single pixels, and polynomials on
/// blocks.
struct Tile<'a> {
    rules: &'a Rules,
    /// First column and row in pixels of the scene.
    x0: f64,
    y0: f64,
    pixels: Vec<f64>,
    /// Blocks by level, rows first. A level is empty until a galaxy needs it.
    blocks: [Vec<Block>; LEVELS],
}

impl<'a> Tile<'a> {
    fn new(rules: &'a Rules, x0: i64, y0: i64) -> Self {
        Self {
            rules,
            x0: x0 as f64,
            y0: y0 as f64,
            pixels: vec![0.0; TILE * TILE],
            blocks: std::array::from_fn(|_| Vec::new()),
        }
    }

    /// Adds a galaxy's light on the whole tile.
    fn add(&mut self, galaxy: &Profile, progress: &dyn Progress) -> Result<(), Cancelled> {
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
        progress.check_cancelled()?;
        let size = TILE >> level;
        let centre = |first: f64, index: usize| first + (index * size) as f64 + 0.5 * (size - 1) as f64;
        let dx = centre(self.x0, column) - galaxy.x;
        let dy = centre(self.y0, row) - galaxy.y;
        let nearness = galaxy.nearness(dx, dy, size as f64);
        // The comparison is also false for a galaxy so far away that the radius is not finite.
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
            // If one rule is accurate enough for every pixel of the block, no pixel needs a choice
            // of its own.
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

    /// Returns the flux in every pixel, rows first.
    fn into_pixels(mut self) -> Vec<f64> {
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

/// The allowed relative error where the light is at most the fraction `at_most` of the galaxy's
/// flux.
fn allowed_error(at_most: f64) -> f64 {
    RELATIVE_ERROR.max(ABSOLUTE_ERROR / at_most)
}

/// The light on a square, for a galaxy of flux 1. The square is at most one pixel large. Its centre
/// is at (`dx`, `dy`) from the galaxy's centre.
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

/// The integration rule for a square of at most one pixel, or `None` if no rule is accurate enough
/// and the square must be divided.
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

/// Integrates the brightness by a rule over a square whose centre is at (`dx`, `dy`) from the
/// galaxy's centre.
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

/// Number of nodes along an axis. The values at the nodes determine the polynomial of a block.
const NODES: usize = 6;

/// Two Gauss-Legendre nodes with weights for an interval of length 1 around 0.
const GAUSS_2: [(f64, f64); 2] = [(-0.288_675_134_594_812_9, 0.5), (0.288_675_134_594_812_9, 0.5)];
/// Three Gauss-Legendre nodes with weights for an interval of length 1 around 0.
const GAUSS_3: [(f64, f64); 3] = [
    (-0.387_298_334_620_741_7, 5.0 / 18.0),
    (0.0, 8.0 / 18.0),
    (0.387_298_334_620_741_7, 5.0 / 18.0),
];
/// Four Gauss-Legendre nodes with weights for an interval of length 1 around 0.
const GAUSS_4: [(f64, f64); 4] = [
    (-0.430_568_155_797_026_3, 0.173_927_422_568_726_9),
    (-0.169_990_521_792_428_1, 0.326_072_577_431_273_1),
    (0.169_990_521_792_428_1, 0.326_072_577_431_273_1),
    (0.430_568_155_797_026_3, 0.173_927_422_568_726_9),
];

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
    use super::*;

    #[test]
    fn gauss_rules_are_exact_up_to_their_degree() {
        let rules: [(&[(f64, f64)], i32); 3] = [(&GAUSS_2, 3), (&GAUSS_3, 5), (&GAUSS_4, 7)];
        for (rule, degree) in rules {
            let integral = |m: i32| rule.iter().map(|(x, w)| w * x.powi(m)).sum::<f64>();
            let exact = |m: i32| {
                if m % 2 == 0 {
                    0.5_f64.powi(m) / f64::from(m + 1)
                } else {
                    0.0
                }
            };
            for m in 0..=degree {
                assert!((integral(m) - exact(m)).abs() < 1e-16, "degree {m} of {degree}");
            }
            assert!((integral(degree + 1) - exact(degree + 1)).abs() > 1e-8);
        }
    }

    #[test]
    fn polynomials_of_degree_5_are_interpolated_exactly() {
        let nodes = chebyshev_nodes();
        let polynomial = |x: f64| 1.0 + x * (2.0 - x * (3.0 + x * (1.0 - x * (4.0 + 5.0 * x))));
        for (pixel, weights) in interpolation_weights(16).iter().enumerate() {
            let at = (pixel as f64 + 0.5) / 16.0 - 0.5;
            let value: f64 = weights.iter().zip(nodes).map(|(w, x)| w * polynomial(x)).sum();
            assert!((value - polynomial(at)).abs() < 1e-14);
        }
    }
}
