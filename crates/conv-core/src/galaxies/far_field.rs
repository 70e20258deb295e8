//! Draws the outskirts of galaxies, outside the windows that are drawn in Fourier space.
//!
//! There the light hardly changes over the extent of the PSF. So the image is the light at the
//! PSF's centroid, plus its second derivatives times half the PSF's covariance.

use ndarray::{Array2, ArrayViewMut2};
use psf_types::{LightProfile, Progress};
use rayon::prelude::*;

use crate::overlap::{Piece, add_pieces};
use crate::simd::vectorized;
use crate::{ConvError, ConvReal};

/// Pixels along each side of a tile. Tiles, their blocks and the windows of galaxies begin at
/// multiples of [`SMALLEST`] pixels, so a block lies inside or outside a window.
pub(super) const TILE: usize = 128;
/// The least number of pixels along each side of a block.
pub(super) const SMALLEST: usize = 8;
/// Number of nodes along an axis. The values at the nodes determine the polynomial of a block.
const NODES: usize = 6;
/// Light that comes to a window from more than this number of periods away is spread evenly.
const MOST_PERIODS: f64 = 12.0;

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
    /// Light farther than this from the centre is left out.
    pub(super) reach: f64,
    /// Light below this brightness, for a flux of 1, is left out.
    pub(super) faintest: f64,
    /// Largest error of the polynomial of a block relative to the brightest light in it.
    pub(super) relative_error: f64,
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
    fn add_at_nodes(&self, centre: (f64, f64), size: f64, values: &mut Block) {
        let [x, y] = self.offset(centre);
        let nodes = CHEBYSHEV_NODES.map(|node| (node * size) as f32);
        let offsets = nodes.map(|dy| nodes.map(|dx| [x + dx, y + dy]));
        self.add_at(offsets.as_flattened(), values.as_flattened_mut());
    }

    /// Subtracts the light that the period of a drawn window brings in from outside. `values` are the
    /// window's rows from `first_row` on. `weights` are those of the window.
    pub(super) fn subtract_repeated<T: ConvReal>(
        &self,
        weights: &BlockWeights<T>,
        first_row: usize,
        values: &mut Array2<T>,
    ) {
        let (x0, y0, side) = self.window;
        let period = side as f64;
        let most = (self.reach / period + 0.5).floor().min(MOST_PERIODS) as i64;
        // The light from still farther, spread evenly. It lies outside an ellipse as large as the
        // square of the periods.
        let half_side = (most as f64 + 0.5) * period;
        let ellipse = half_side * (4.0 / (std::f64::consts::PI * self.light.axis_ratio())).sqrt();
        let rest = self.flux * self.light.flux_beyond(ellipse) / (period * period);
        let mut square = Square::new(x0, y0, weights);
        // The errors of fainter light may be as large as those at the nearest edge.
        square.least_brightness = self.light.outskirts(nearest_edge(side)).brightness;
        square.blocks[0] = vec![[[rest; NODES]; NODES]];
        for j in -most..=most {
            for i in -most..=most {
                if (i, j) != (0, 0) {
                    let offset = (i * side as i64, j * side as i64);
                    square.add_block(self, offset, 0, (0, 0));
                }
            }
        }
        let repeated = square.into_values();
        let values = values.as_slice_mut().expect("row-major");
        for (value, &repeated) in values.iter_mut().zip(&repeated[first_row * side..]) {
            *value -= repeated;
        }
    }

    /// Whether the square of `size` pixels around a point contains light.
    fn reaches(&self, (x, y): (f64, f64), size: f64) -> bool {
        let reach = self.reach + 0.5 * size;
        (x - self.centre.0).abs() <= reach && (y - self.centre.1).abs() <= reach
    }
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
    let size = TILE as i64;
    let start = |first: i64| first.div_euclid(size) * size;
    let weights = BlockWeights::<f64>::new(TILE);
    let columns: Vec<i64> = (start(first.0)..first.0 + image.ncols() as i64)
        .step_by(TILE)
        .collect();
    for y in (start(first.1)..first.1 + image.nrows() as i64).step_by(TILE) {
        // The galaxies that reach this row of tiles.
        let middle = y as f64 + 0.5 * (size - 1) as f64;
        let near: Vec<&FarLight> = galaxies
            .iter()
            .filter(|galaxy| galaxy.reaches((galaxy.centre.0, middle), size as f64))
            .collect();
        let drawn: Vec<Piece<T>> = columns
            .par_iter()
            .map(|&x| {
                progress.check_cancelled()?;
                let mut tile = Square::new(x, y, &weights);
                for galaxy in &near {
                    tile.add_block(galaxy, (0, 0), 0, (0, 0));
                }
                Ok(tile.into_piece())
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
type Block = [[f64; NODES]; NODES];

/// The weights of the blocks of a square. The first level is one block. Each next level has blocks of
/// half the side.
pub(super) struct BlockWeights<T> {
    /// The side of the square in pixels.
    side: usize,
    levels: Vec<PolynomialWeights<T>>,
}

impl<T: ConvReal> BlockWeights<T> {
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

/// The light on a square: values of single pixels, and polynomials on blocks.
struct Square<'a, T> {
    x0: i64,
    y0: i64,
    weights: &'a BlockWeights<T>,
    /// Fainter light may have errors as large as light of this brightness.
    least_brightness: f64,
    /// Empty until it is needed.
    pixels: Vec<T>,
    /// Blocks by level, rows first. A level is empty until a galaxy needs it.
    blocks: Vec<Vec<Block>>,
}

impl<'a, T: ConvReal> Square<'a, T> {
    fn new(x0: i64, y0: i64, weights: &'a BlockWeights<T>) -> Self {
        Self {
            x0,
            y0,
            weights,
            least_brightness: 0.0,
            pixels: Vec::new(),
            blocks: vec![Vec::new(); weights.levels.len()],
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
        let side = self.weights.side;
        let size = side >> level;
        // Where the block lies from the galaxy that is not moved.
        let x = self.x0 - offset.0 + (column * size) as i64;
        let y = self.y0 - offset.1 + (row * size) as i64;
        let middle = 0.5 * (size - 1) as f64;
        let centre = (x as f64 + middle, y as f64 + middle);
        if !galaxy.reaches(centre, size as f64) {
            return;
        }
        let (left, top, width) = galaxy.window;
        let within = |at: i64, start: i64| at >= start && at + size as i64 <= start + width as i64;
        let beside = |at: i64, start: i64| at + size as i64 <= start || at >= start + width as i64;
        if within(x, left) && within(y, top) {
            return;
        }
        let is_smooth = if beside(x, left) || beside(y, top) {
            let to_centre = (centre.0 - galaxy.centre.0, centre.1 - galaxy.centre.1);
            let around = galaxy.light.around(to_centre, 0.5 * size as f64);
            if around.brightness <= galaxy.faintest {
                return;
            }
            let error = around.brightness * error_of_polynomial(size as f64 / around.scale_px);
            error <= galaxy.relative_error * around.brightness.max(self.least_brightness)
        } else {
            false
        };
        if is_smooth {
            let blocks = &mut self.blocks[level];
            blocks.resize(1 << (2 * level), Block::default());
            galaxy.add_at_nodes(centre, size as f64, &mut blocks[(row << level) + column]);
        } else if level + 1 < self.blocks.len() {
            for (j, i) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                self.add_block(galaxy, offset, level + 1, (2 * row + j, 2 * column + i));
            }
        } else {
            self.pixels.resize(side * side, T::zero());
            for j in 0..size {
                let at = (row * size + j) * side + column * size;
                for (first, pixels) in (0..)
                    .step_by(SMALLEST)
                    .zip(self.pixels[at..at + size].chunks_mut(SMALLEST))
                {
                    let [x, y] = galaxy.offset(((x + first) as f64, (y + j as i64) as f64));
                    let mut offsets = [[x, y]; SMALLEST];
                    for (i, [x, _]) in offsets.iter_mut().enumerate() {
                        *x += i as f32;
                    }
                    let mut values = [0.0; SMALLEST];
                    galaxy.add_at(&offsets, &mut values);
                    for (pixel, v) in pixels.iter_mut().zip(values) {
                        *pixel += T::nearest(v);
                    }
                }
            }
        }
    }

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
    fn into_piece<U: ConvReal>(self) -> Option<Piece<U>> {
        if self.pixels.is_empty() && self.blocks.iter().all(Vec::is_empty) {
            return None;
        }
        let (side, first_column, first_row) = (self.weights.side, self.x0, self.y0);
        let values = self
            .into_values()
            .into_iter()
            .map(|v| U::nearest(v.as_f64()))
            .collect();
        Some(Piece {
            first_column,
            first_row,
            values: Array2::from_shape_vec((side, side), values).expect("the pixels of a square"),
        })
    }
}

/// Estimates the error of the polynomial on a block, relative to the brightest light in it. The
/// size of the block is `t` times the scale of the light ([`psf_types::Outskirts`]).
///
/// For both axes together, the error would be at most `4 (t / 4)^6 / 6!` if the scale held for the
/// sixth derivatives everywhere in the block. It holds for the fourth. The sixth may be larger at the
/// edge nearest to the galaxy, and are smaller in most of the block. The factor 0.8 in place of 4 is
/// measured (see the test).
pub(super) fn error_of_polynomial(t: f64) -> f64 {
    0.8 * (0.25 * t).powi(6) / 720.0
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
    use psf_types::{Position, SersicProfile, SersicSource};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use sersic::SersicLight;

    use super::*;
    use crate::galaxies::extent::RELATIVE_ERROR;

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
            if !(RELATIVE_ERROR[0]..=1e-1).contains(&estimate) || around.brightness < 1e-30 {
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
                error <= estimate * brightest,
                "{error:e} {estimate:e} {size} {distance} {source:?}"
            );
        }
    }
}
