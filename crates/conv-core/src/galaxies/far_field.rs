//! Draws the outskirts of galaxies, outside the windows that are drawn in Fourier space.
//!
//! There the light hardly changes over the extent of the PSF. So the image is the light at the
//! PSF's centroid, plus its second derivatives times half the PSF's covariance.

use std::ops::Range;

use ndarray::{Array2, ArrayViewMut2};
use psf_types::Progress;
use rayon::prelude::*;

use super::extent::Outside;
use crate::overlap::{Piece, add_pieces};
use crate::simd::{sum_of_products, vectorized};
use crate::{ConvError, ConvReal};

/// Pixels along each side of a tile. Tiles, their blocks and the windows of galaxies begin at
/// multiples of [`SMALLEST`] pixels, so a block lies inside or outside a window.
pub(super) const TILE: usize = 128;
/// The least number of pixels along each side of a block.
pub(super) const SMALLEST: usize = 8;
/// Number of nodes along an axis. The values at the nodes determine the polynomial of a block.
const NODES: usize = 6;
/// A group of periods is divided into this number of groups along each axis.
const GROUPS: i64 = 3;
/// Groups of at least this number of periods along each axis may be added up from a few of them.
const LEAST_GROUP: i64 = 9;
/// The most periods along each axis: the distance at which even the light of an index of 8 ends.
const MOST_PERIODS: i64 = GROUPS.pow(20);
/// A group whose light is below this part of all repeated light may have an error as large as that part
/// of it. A group or a block is left out if its light is below this part of the error that is allowed.
const SHARE: f64 = 1e-3;

/// The light of one galaxy far from its centre.
#[derive(Clone)]
pub(super) struct FarLight {
    pub(super) light: super::Light,
    pub(super) flux: f64,
    /// The centre of the galaxy plus the centroid of the PSF, in pixels of the frame.
    pub(super) centre: (f64, f64),
    /// The PSF's covariance: xx, xy, yy.
    pub(super) covariance: [f64; 3],
    /// First column and row of the galaxy's window, and its side.
    pub(super) window: (i64, i64, usize),
    /// Light farther than this from the centre is left out.
    pub(super) reach: f64,
    /// Light below this brightness, for a flux of 1, is left out.
    pub(super) faintest: f64,
    pub(super) outside: Outside,
}

impl FarLight {
    /// The offset of a point, in pixels of the frame, from the centre.
    pub(super) fn offset(&self, (x, y): (f64, f64)) -> [f32; 2] {
        [(x - self.centre.0) as f32, (y - self.centre.1) as f32]
    }

    /// Adds the light at offsets from the centre.
    pub(super) fn add_at(&self, offsets: &[[f32; 2]], values: &mut [f64]) {
        self.light
            .add_blurred(self.covariance, self.flux, offsets, values);
    }

    /// Adds the light at the nodes of the square of `size` pixels around a point.
    pub(super) fn add_at_nodes(&self, centre: (f64, f64), size: f64, values: &mut Block) {
        let [x, y] = self.offset(centre);
        let nodes = CHEBYSHEV_NODES.map(|node| (node * size) as f32);
        let offsets = nodes.map(|dy| nodes.map(|dx| [x + dx, y + dy]));
        self.add_at(offsets.as_flattened(), values.as_flattened_mut());
    }

    /// Adds the light in neighbouring pixels of a row, from a point on.
    pub(super) fn add_along_row(&self, first: (f64, f64), values: &mut [f64; SMALLEST]) {
        let [x, y] = self.offset(first);
        let mut offsets = [[x, y]; SMALLEST];
        for (i, [x, _]) in offsets.iter_mut().enumerate() {
            *x += i as f32;
        }
        self.add_at(&offsets, values);
    }

    /// Subtracts the light that the period of a drawn window brings in from outside. `values` are the
    /// window's rows from `first_row` on. `weights` are those of the window.
    pub(super) fn subtract_repeated<T: ConvReal>(
        &self,
        weights: &BlockWeights<T>,
        first_row: usize,
        values: &mut Array2<T>,
    ) {
        let side = self.window.2;
        let repeated = self.each_period(OnSquare::new(weights)).into_values();
        let values = values.as_slice_mut().expect("row-major");
        for (value, &repeated) in values.iter_mut().zip(&repeated[first_row * side..]) {
            *value -= repeated;
        }
    }

    /// Gives the light on a tile of the image, whose first pixel is given, to `leaves`.
    pub(super) fn each_block<L: TakesLight>(&self, (x, y): (i64, i64), leaves: L) -> L {
        let mut tile = Square::new(x, y, leaves);
        tile.add_block(self, (0, 0), 0, (0, 0));
        tile.leaves
    }

    /// Gives the light that the period of the window brings in from outside to `leaves`.
    pub(super) fn each_period<L: TakesLight>(&self, leaves: L) -> L {
        let (x0, y0, side) = self.window;
        let mut square = Square::new(x0, y0, leaves);
        let (outside, area) = (&self.outside, (side * side) as f64);
        square.repeated = Some(Repeated {
            edge: outside.brightness,
            mean: outside.flux / area,
            error: outside.repeated_error / outside.flux,
            faintest: SHARE * outside.repeated_error / area,
        });
        // The periods end where hardly any light is left.
        let mut count = GROUPS;
        let end = |count: i64| 0.5 * (count * side as i64) as f64;
        while count < MOST_PERIODS && self.light.flux_beyond(end(count)) > outside.repeated_error {
            count *= GROUPS;
        }
        square.add_periods(self, (0, 0), count);
        square.leaves
    }

    /// Whether there is light in the row of tiles that begins at a row of pixels.
    pub(super) fn reaches_row(&self, y: i64) -> bool {
        let middle = y as f64 + 0.5 * (TILE - 1) as f64;
        self.reaches((self.centre.0, middle), TILE as f64)
    }

    /// Whether the square of `size` pixels around a point contains light.
    fn reaches(&self, (x, y): (f64, f64), size: f64) -> bool {
        let reach = self.reach + 0.5 * size;
        (x - self.centre.0).abs() <= reach && (y - self.centre.1).abs() <= reach
    }
}

/// Limits for the light that the period of a galaxy's window brings in from outside. The brightness is
/// that of a flux of 1.
struct Repeated {
    /// The largest brightness at the window's edge. The errors of fainter light may be as large as those
    /// of this light.
    edge: f64,
    /// The mean brightness of all periods together.
    mean: f64,
    /// The largest error of their sum, relative to it.
    error: f64,
    /// Fainter light is left out.
    faintest: f64,
}

/// For each node along an axis, Lagrange's interpolation weights of its value at each pixel.
struct PolynomialWeights<T>([Vec<T>; NODES]);

impl<T: ConvReal> PolynomialWeights<T> {
    /// The weights on `size` pixels.
    fn new(size: usize) -> Self {
        let nodes = CHEBYSHEV_NODES;
        let weight = |k: usize, pixel: usize| {
            let at = (pixel as f64 + 0.5) / size as f64 - 0.5;
            let others = nodes.iter().enumerate().filter(|&(j, _)| j != k);
            T::nearest(others.map(|(_, node)| (at - node) / (nodes[k] - node)).product())
        };
        Self(std::array::from_fn(|k| {
            (0..size).map(|pixel| weight(k, pixel)).collect()
        }))
    }

    /// The values along a row of pixels, at the nodes.
    fn line(&self, block: &Block, row: usize) -> [T; NODES] {
        let mut line = [T::zero(); NODES];
        for (weights, values) in self.0.iter().zip(block) {
            for (sum, &value) in line.iter_mut().zip(values) {
                *sum += weights[row] * T::nearest(value);
            }
        }
        line
    }

    /// Adds the products of a row of an image with the polynomials that are 1 at one node and 0 at the others.
    #[inline(always)]
    fn add_products(&self, pixels: &[T], row: usize, block: &mut Block) {
        let products = self.0.each_ref().map(|weights| sum_of_products(weights, pixels));
        for (weights, sums) in self.0.iter().zip(block) {
            let weight = weights[row].as_f64();
            sums.iter_mut()
                .zip(products)
                .for_each(|(sum, product)| *sum += weight * product);
        }
    }

    /// Adds the values at the pixels of a row.
    fn add(&self, line: [T; NODES], pixels: &mut [T]) {
        vectorized!({
            // Half of the nodes at a time, which fit the processor's registers.
            for (weights, line) in self.0.chunks_exact(NODES / 2).zip(line.chunks_exact(NODES / 2)) {
                let [a, b, c] = [&weights[0], &weights[1], &weights[2]];
                for (((pixel, &a), &b), &c) in pixels.iter_mut().zip(a).zip(b).zip(c) {
                    *pixel += a * line[0] + b * line[1] + c * line[2];
                }
            }
        });
    }
}

/// The first pixels, along an axis, of the tiles that cover some pixels.
pub(super) fn tiles(first: i64, count: usize) -> impl Iterator<Item = i64> {
    let start = first.div_euclid(TILE as i64) * TILE as i64;
    (start..first + count as i64).step_by(TILE)
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
    let weights = BlockWeights::<f64>::new(TILE);
    let columns: Vec<i64> = tiles(first.0, image.ncols()).collect();
    for y in tiles(first.1, image.nrows()) {
        let near: Vec<&FarLight> = galaxies.iter().filter(|galaxy| galaxy.reaches_row(y)).collect();
        let drawn: Vec<Piece<T>> = columns
            .par_iter()
            .map(|&x| {
                progress.check_cancelled()?;
                let mut tile = Square::new(x, y, OnSquare::new(&weights));
                for galaxy in &near {
                    tile.add_block(galaxy, (0, 0), 0, (0, 0));
                }
                Ok(tile.leaves.into_piece((x, y)))
            })
            .filter_map(Result::transpose)
            .collect::<Result<_, ConvError>>()?;
        add_pieces(drawn.iter(), image.view_mut(), first, SMALLEST);
    }
    Ok(())
}

/// The least distance of a window's edge from the galaxy's centre. A window begins at a multiple of
/// [`SMALLEST`] pixels, so it is not centred on the galaxy.
pub(super) fn nearest_edge(side: usize) -> f64 {
    0.5 * (side - SMALLEST) as f64
}

/// The largest distance of a window's edge from the galaxy's centre along an axis.
pub(super) fn farthest_edge(side: usize) -> f64 {
    (side / 2 + SMALLEST) as f64
}

/// The values at the nodes of a block, rows first.
pub(super) type Block = [[f64; NODES]; NODES];

/// The weights of the blocks of a square. The first level is one block. Each next level has blocks of
/// half the side.
pub(super) struct BlockWeights<T> {
    /// The side of the square in pixels.
    side: usize,
    levels: Vec<PolynomialWeights<T>>,
}

impl<T: ConvReal> BlockWeights<T> {
    /// The products of an image `[pixel]` of the square, rows first, with the polynomials of each level and block that
    /// are 1 at one node and 0 at the others.
    pub(super) fn products(&self, pixels: &[T]) -> Vec<Vec<Block>> {
        let of_level = |(level, weights): (usize, &PolynomialWeights<T>)| {
            let size = self.side >> level;
            let block = |number: usize| {
                let (row, column) = (number >> level, number & ((1 << level) - 1));
                let mut block = Block::default();
                vectorized!(for j in 0..size {
                    let start = (row * size + j) * self.side + column * size;
                    weights.add_products(&pixels[start..start + size], j, &mut block);
                });
                block
            };
            (0..1 << (2 * level)).map(block).collect()
        };
        self.levels.iter().enumerate().map(of_level).collect()
    }

    /// The weights for a square of `side` pixels, down to blocks of less than twice [`SMALLEST`].
    pub(super) fn new(side: usize) -> Self {
        let sizes = std::iter::successors(Some(side), |size| {
            (size % 2 == 0 && size / 2 >= SMALLEST).then_some(size / 2)
        });
        Self {
            side,
            levels: sizes.map(PolynomialWeights::new).collect(),
        }
    }
}

/// Takes the light of a galaxy on a square.
pub(super) trait TakesLight {
    /// The side of the square in pixels, and the number of levels of its blocks.
    fn side_and_levels(&self) -> (usize, usize);
    /// Takes the light on the square of `size` pixels around a point, times a weight, as the light of a block of a
    /// level.
    fn take_block(
        &mut self,
        galaxy: &FarLight,
        square: ((f64, f64), f64),
        weight: f64,
        block: (usize, usize),
    );
    /// Takes the light in pixels of a row, from a point on. `at` holds the numbers of these pixels, [`SMALLEST`] at
    /// most.
    fn take_pixels(&mut self, galaxy: &FarLight, first: (f64, f64), at: Range<usize>);
}

/// The light on a square: values of single pixels, and polynomials on blocks.
struct OnSquare<'a, T> {
    weights: &'a BlockWeights<T>,
    /// Empty until it is needed.
    pixels: Vec<T>,
    /// Blocks by level, rows first. A level is empty until a galaxy needs it.
    blocks: Vec<Vec<Block>>,
}

impl<'a, T: ConvReal> OnSquare<'a, T> {
    fn new(weights: &'a BlockWeights<T>) -> Self {
        Self {
            weights,
            pixels: Vec::new(),
            blocks: vec![Vec::new(); weights.levels.len()],
        }
    }
}

impl<T: ConvReal> TakesLight for OnSquare<'_, T> {
    fn side_and_levels(&self) -> (usize, usize) {
        (self.weights.side, self.weights.levels.len())
    }

    fn take_block(
        &mut self,
        galaxy: &FarLight,
        (centre, size): ((f64, f64), f64),
        weight: f64,
        (level, number): (usize, usize),
    ) {
        let mut values = Block::default();
        galaxy.add_at_nodes(centre, size, &mut values);
        let blocks = &mut self.blocks[level];
        blocks.resize(1 << (2 * level), Block::default());
        let sums = blocks[number].as_flattened_mut().iter_mut();
        sums.zip(values.as_flattened())
            .for_each(|(sum, value)| *sum += weight * value);
    }

    fn take_pixels(&mut self, galaxy: &FarLight, first: (f64, f64), at: Range<usize>) {
        let side = self.weights.side;
        self.pixels.resize(side * side, T::zero());
        let mut values = [0.0; SMALLEST];
        galaxy.add_along_row(first, &mut values);
        for (pixel, v) in self.pixels[at].iter_mut().zip(values) {
            *pixel += T::nearest(v);
        }
    }
}

/// A square of pixels of the frame, and what takes the light on it.
struct Square<L> {
    x0: i64,
    y0: i64,
    side: usize,
    levels: usize,
    /// `None` if the square is a part of the image.
    repeated: Option<Repeated>,
    leaves: L,
}

impl<L: TakesLight> Square<L> {
    fn new(x0: i64, y0: i64, leaves: L) -> Self {
        let (side, levels) = leaves.side_and_levels();
        Self {
            x0,
            y0,
            side,
            levels,
            repeated: None,
            leaves,
        }
    }

    /// Adds the light of a galaxy in a square of `count` periods along each axis around the period
    /// `(i, j)`, except the galaxy's own window `(0, 0)`. Far from the galaxy, a few points stand for
    /// all periods of a group.
    fn add_periods(&mut self, galaxy: &FarLight, (i, j): (i64, i64), count: i64) {
        let Some(limits) = &self.repeated else { return };
        let side = self.side as i64;
        let is_outside = i.abs().max(j.abs()) > count / 2;
        if is_outside && count > 1 {
            let middle = 0.5 * (side - 1) as f64;
            let centre = |start: i64, number: i64| (start + number * side) as f64 + middle;
            let centre = (centre(self.x0, i), centre(self.y0, j));
            let to_centre = (centre.0 - galaxy.centre.0, centre.1 - galaxy.centre.1);
            let around = galaxy.light.around(to_centre, 0.5 * (count * side) as f64);
            let brightness = around.brightness * (count * count) as f64;
            if brightness <= limits.faintest {
                return;
            }
            let error = error_of_group((count * side) as f64 / around.scale_px);
            if count >= LEAST_GROUP
                && error * brightness <= limits.error * brightness.max(SHARE * limits.mean)
            {
                let points = points_of_group(count);
                for (dy, weight_y) in points {
                    for (dx, weight_x) in points {
                        let centre = (centre.0 + dx * side as f64, centre.1 + dy * side as f64);
                        let square = (centre, side as f64);
                        self.leaves
                            .take_block(galaxy, square, weight_x * weight_y, (0, 0));
                    }
                }
                return;
            }
        }
        if count == 1 {
            if is_outside {
                self.add_block(galaxy, (-i * side, -j * side), 0, (0, 0));
            }
            return;
        }
        let step = count / GROUPS;
        for down in -1..=1 {
            for along in -1..=1 {
                self.add_periods(galaxy, (i + along * step, j + down * step), step);
            }
        }
    }

    /// Adds the light of a galaxy, moved by an offset in pixels, on one block of a level.
    fn add_block(
        &mut self,
        galaxy: &FarLight,
        offset: (i64, i64),
        level: usize,
        (row, column): (usize, usize),
    ) {
        let side = self.side;
        let size = side >> level;
        // Where the block lies from the galaxy that is not moved.
        let x = self.x0 - offset.0 + (column * size) as i64;
        let y = self.y0 - offset.1 + (row * size) as i64;
        let middle = 0.5 * (size - 1) as f64;
        let centre = (x as f64 + middle, y as f64 + middle);
        let (edge, faintest) = match &self.repeated {
            Some(limits) => (limits.edge, limits.faintest),
            None if !galaxy.reaches(centre, size as f64) => return,
            None => (0.0, galaxy.faintest),
        };
        let (left, top, width) = galaxy.window;
        let within = |at: i64, start: i64| at >= start && at + size as i64 <= start + width as i64;
        let beside = |at: i64, start: i64| at + size as i64 <= start || at >= start + width as i64;
        if within(x, left) && within(y, top) {
            return;
        }
        let is_smooth = if beside(x, left) || beside(y, top) {
            let to_centre = (centre.0 - galaxy.centre.0, centre.1 - galaxy.centre.1);
            let around = galaxy.light.around(to_centre, 0.5 * size as f64);
            if around.brightness <= faintest {
                return;
            }
            let error = around.brightness * error_of_polynomial(size as f64 / around.scale_px);
            error <= galaxy.outside.relative_error * around.brightness.max(edge)
        } else {
            false
        };
        if is_smooth {
            let block = (level, (row << level) + column);
            self.leaves.take_block(galaxy, (centre, size as f64), 1.0, block);
        } else if level + 1 < self.levels {
            for (j, i) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                self.add_block(galaxy, offset, level + 1, (2 * row + j, 2 * column + i));
            }
        } else {
            for j in 0..size {
                let at = (row * size + j) * side + column * size;
                for first in (0..size).step_by(SMALLEST) {
                    let pixels = at + first..at + size.min(first + SMALLEST);
                    let place = ((x + first as i64) as f64, (y + j as i64) as f64);
                    self.leaves.take_pixels(galaxy, place, pixels);
                }
            }
        }
    }
}

impl<T: ConvReal> OnSquare<'_, T> {
    /// Returns the light in every pixel, rows first.
    fn into_values(mut self) -> Vec<T> {
        let side = self.weights.side;
        self.pixels.resize(side * side, T::zero());
        for (level, (blocks, weights)) in self.blocks.iter().zip(&self.weights.levels).enumerate() {
            let size = side >> level;
            for (number, block) in blocks.iter().enumerate() {
                if block.iter().flatten().all(|&value| value == 0.0) {
                    continue;
                }
                let (row, column) = (number >> level, number & ((1 << level) - 1));
                for j in 0..size {
                    let start = (row * size + j) * side + column * size;
                    weights.add(weights.line(block, j), &mut self.pixels[start..start + size]);
                }
            }
        }
        self.pixels
    }

    /// Returns the light in every pixel, or `None` if there is none.
    fn into_piece<U: ConvReal>(self, first: (i64, i64)) -> Option<Piece<U>> {
        if self.pixels.is_empty() && self.blocks.iter().all(Vec::is_empty) {
            return None;
        }
        let side = self.weights.side;
        let values = self.into_values().into_iter();
        let values = values.map(|v| U::nearest(v.as_f64())).collect();
        let values = Array2::from_shape_vec((side, side), values).expect("the pixels of a square");
        Some(Piece { first, values })
    }
}

/// Estimates the error of the polynomial on a block, relative to the brightest light in it. The
/// size of the block is `t` times the scale of the light ([`psf_types::Outskirts`]).
///
/// For both axes together, the error would be at most `4 (t / 4)^6 / 6!` if the scale held for the
/// sixth derivatives everywhere in the block. It holds for the fourth. The sixth may be larger at the
/// edge nearest to the galaxy, and are smaller in most of the block. On a large block, most of the light
/// is near that edge, and the factor is 0.8 in place of 4. On a small block it is up to ten times as much.
/// Both are measured (see the test).
pub(super) fn error_of_polynomial(t: f64) -> f64 {
    let t = 0.25 * t;
    0.8 * t.powi(6) / 720.0 * t.powi(-3).clamp(1.0, 10.0)
}

/// Estimates the error of the sum over a group of periods, relative to the brightest light in it. The
/// side of the group is `t` times the scale of the light. The factor is measured (see the test).
fn error_of_group(t: f64) -> f64 {
    1e-4 * (0.25 * t).powi(8)
}

/// The points and weights along an axis that stand for `count` equal steps around 0. They are Gauss's for
/// sums: exact for polynomials up to the seventh degree. The recurrence of the orthogonal polynomials
/// `p_(k+1) = x p_k - beta_k p_(k-1)` has `beta_k = k^2 (count^2 - k^2) / (4 (4 k^2 - 1))` (Abramowitz
/// and Stegun 22.17, with 0 in the middle).
fn points_of_group(count: i64) -> [(f64, f64); 4] {
    let count = count as f64;
    let beta = |k: f64| k * k * (count * count - k * k) / (4.0 * (4.0 * k * k - 1.0));
    let [first, second, third] = [1.0, 2.0, 3.0].map(beta);
    let sum = first + second + third;
    let root = (sum * sum - 4.0 * first * third).sqrt();
    let squares = [0.5 * (sum - root), 0.5 * (sum + root)];
    // The weights sum to the count, and those times the squares to `count * beta_1`.
    let outer = 0.5 * count * (first - squares[0]) / (squares[1] - squares[0]);
    let weights = [0.5 * count - outer, outer];
    let [inner, outer] = [0, 1].map(|i: usize| (squares[i].sqrt(), weights[i]));
    [(-outer.0, outer.1), (-inner.0, inner.1), inner, outer]
}

/// Chebyshev's nodes on an interval of length 1 around 0: half the cosines of 15, 45, 75 ... degrees.
const CHEBYSHEV_NODES: [f64; NODES] = [
    0.482_962_913_144_534_16,
    0.353_553_390_593_273_8,
    0.129_409_522_551_260_37,
    -0.129_409_522_551_260_37,
    -0.353_553_390_593_273_8,
    -0.482_962_913_144_534_16,
];

#[cfg(test)]
mod tests {
    use psf_types::{LightProfile, Position, SersicProfile, SersicSource};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use sersic::SersicLight;

    use super::*;

    /// Single precision, as a fraction of the light (see the test of `sersic`).
    const ROUNDING_OF_VALUES: f64 = 4e-5;

    #[test]
    fn polynomials_are_within_their_estimated_errors() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut count = 0;
        while count < 1000 {
            let profile = SersicProfile::new(
                rng.random_range(0.3..8.0),
                rng.random_range(0.5..6.0),
                rng.random_range(0.1..1.0),
                rng.random_range(0.0..180.0),
            );
            let source = SersicSource::new(Position::of_pixel(0, 0), 1.0, profile.unwrap()).unwrap();
            let light = SersicLight::new(&source);
            let size = SMALLEST << rng.random_range(0..5);
            let angle: f64 = rng.random_range(0.0..std::f64::consts::TAU);
            let distance = size as f64 * rng.random_range(0.8..6.0);
            let centre = (distance * angle.cos(), distance * angle.sin());
            let around = light.around(centre, 0.5 * size as f64);
            let estimate = error_of_polynomial(size as f64 / around.scale_px);
            if !(1e-6..=1e-1).contains(&estimate) || around.brightness < 1e-30 {
                continue;
            }
            count += 1;
            let at = |x: f64, y: f64| {
                let offset = [centre.0 + x * size as f64, centre.1 + y * size as f64];
                let mut value = [0.0];
                light.add_blurred([0.0; 3], 1.0, &[offset.map(|v| v as f32)], &mut value);
                value[0]
            };
            let nodes = CHEBYSHEV_NODES;
            let block: Block = nodes.map(|y| nodes.map(|x| at(x, y)));
            let weights = PolynomialWeights::<f64>::new(size);
            let mut line = vec![0.0; size];
            let (mut error, mut brightest) = (0.0_f64, 0.0_f64);
            for j in 0..size {
                line.fill(0.0);
                weights.add(weights.line(&block, j), &mut line);
                for (i, value) in line.iter().enumerate() {
                    let place = |i: usize| (i as f64 + 0.5) / size as f64 - 0.5;
                    let truth = at(place(i), place(j));
                    error = error.max((value - truth).abs());
                    brightest = brightest.max(truth);
                }
            }
            assert!(
                error <= (estimate + ROUNDING_OF_VALUES) * brightest,
                "{error:e} {estimate:e} {size} {distance} {source:?}"
            );
        }
    }

    /// Single precision, as a fraction of a sum of light: smaller than for one value, because the
    /// exponents of bright light are small, and errors differ in sign.
    const ROUNDING_OF_SUMS: f64 = 1e-6;

    #[test]
    fn groups_of_periods_are_within_their_estimated_errors() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let mut tested = 0;
        while tested < 1000 {
            let profile = SersicProfile::new(
                10.0_f64.powf(rng.random_range(0.0..3.0)),
                rng.random_range(0.5..8.0),
                10.0_f64.powf(rng.random_range(-1.0..0.0)),
                rng.random_range(0.0..180.0),
            );
            let source = SersicSource::new(Position::of_pixel(0, 0), 1.0, profile.unwrap()).unwrap();
            let light = SersicLight::new(&source);
            let count = if rng.random_bool(0.5) { 9 } else { 27 };
            let side = rng.random_range(32.0..100.0);
            let width = side * count as f64;
            let angle: f64 = rng.random_range(0.0..std::f64::consts::TAU);
            let distance = width * rng.random_range(0.8..6.0);
            let centre = (distance * angle.cos(), distance * angle.sin());
            let around = light.around(centre, 0.5 * width);
            let estimate = error_of_group(width / around.scale_px);
            if !(1e-6..=1e-2).contains(&estimate) || around.brightness < 1e-30 {
                continue;
            }
            tested += 1;
            let at = |dx: f64, dy: f64| {
                let offset = [centre.0 + dx * side, centre.1 + dy * side];
                let mut value = [0.0];
                light.add_blurred([0.0; 3], 1.0, &[offset.map(|v| v as f32)], &mut value);
                value[0]
            };
            let steps = |i: i64| (i - count / 2) as f64;
            let all = (0..count).flat_map(|j| (0..count).map(move |i| (steps(i), steps(j))));
            let truth: f64 = all.map(|(dx, dy)| at(dx, dy)).sum();
            let points = points_of_group(count);
            let mut sum = 0.0;
            for (dy, weight_y) in points {
                for (dx, weight_x) in points {
                    sum += weight_x * weight_y * at(dx, dy);
                }
            }
            let error = (sum - truth).abs() / (around.brightness * (count * count) as f64);
            assert!(
                error <= estimate + ROUNDING_OF_SUMS,
                "{error:e} {estimate:e} {count} x {side} at {distance}, {source:?}"
            );
        }
        // All of some equal steps, up to the seventh power.
        for count in [9, 81] {
            for power in [0, 2, 4, 6] {
                let exact: f64 = (0..count).map(|i| ((i - count / 2) as f64).powi(power)).sum();
                let sum: f64 = points_of_group(count)
                    .map(|(x, weight)| weight * x.powi(power))
                    .iter()
                    .sum();
                assert!(
                    (sum / exact - 1.0).abs() < 1e-12,
                    "{count}, {power}: {sum} {exact}"
                );
            }
        }
    }
}
