//! The cost of the engine's steps.

use super::geometry::Direction;
use crate::ConvReal;
use crate::transform::{X_STEP, Y_STEP};

/// Predicted seconds of one thread. The constants are in the source code, so that plans are the
/// same on every machine. They were measured in f32 on one core of an AVX-512 machine
/// (`cargo bench -p conv-core`). Only ratios matter for the choice of tiles. A plane is the array
/// that is transformed: a tile and its padding.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CostModel {
    /// 1 for f32. 2 for f64, which moves twice the bytes through half the lanes.
    width: f64,
}

/// Seconds of a transform of `n` values, divided by `n log2 n`, if a plane and its spectra stay in
/// the L2 cache.
const TRANSFORM: f64 = 17e-12;
/// Like [`TRANSFORM`], for planes of up to 300 000 values, which do not stay in the L2 cache.
const TRANSFORM_LARGE: f64 = 20e-12;
/// Like [`TRANSFORM`], for still larger planes.
const TRANSFORM_HUGE: f64 = 24e-12;
/// A complex multiply-add, per value of the plane.
const MULTIPLY: f64 = 0.09e-9;
/// Reading a stored spectrum of a kernel, per value of the plane.
const READ_SPECTRUM: f64 = 0.08e-9;
/// Multiplication of a pixel's light by the coefficient of one mode.
const MULTIPLY_LIGHT: f64 = 0.10e-9;
/// Like [`MULTIPLY_LIGHT`], for a tile with several layers of light that do not stay in the L2 cache.
const MULTIPLY_LAYERS_LARGE: f64 = 0.30e-9;
/// About as many values of layers stay in the L2 cache, beside a plane and its spectra.
const LAYERS_IN_CACHE: f64 = 260_000.0;
/// Reading a pixel's light, or adding a pixel to the image, per pixel of the tile.
const READ_OR_ADD_PIXEL: f64 = 0.15e-9;
/// Adding a tile's plane to the image, per value of the plane.
const ADD: f64 = 0.20e-9;
/// Drawing a stamp and adding it to the image, per stamp pixel and mode.
const DRAW: f64 = 0.08e-9;
/// Factor on [`DRAW`] if every pixel that receives light has its own coefficients.
const DRAW_GATHERED: f64 = 6.0;
/// One product and sum of a star that is drawn between pixels.
const DRAW_STAR: f64 = 0.03e-9;
/// One product and sum of a star that is drawn in f64 from all components.
const PAINT_STAR: f64 = 0.3e-9;
/// Adding one tap of a star to a plane.
const SPREAD_STAR: f64 = 1e-9;
/// Preparing a star that is drawn photon by photon.
const SHOOT_STAR: f64 = 1e-6;
/// Preparing an extended source that is drawn photon by photon.
const SHOOT_EXTENDED: f64 = 5e-6;
/// Proposing the pixel of a photon.
const SHOOT_PHOTON: f64 = 15e-9;
/// A term of the value of the PSF there, which is computed if it may have terms of both signs.
const TERM_OF_PHOTON: f64 = 3e-9;
/// Sources of more photons are never drawn photon by photon to save time.
pub(crate) const MOST_PHOTONS: f64 = 1e6;
/// Drawing the place of an extended source's photon.
const PLACE_OF_PHOTON: f64 = 15e-9;
/// Making the table of a PSF, per pixel of the stamp.
const MAKE_TABLE: f64 = 35e-9;
/// Finding the PSF of a star that is drawn, and its weights.
const PREPARE_STAR: f64 = 1e-6;
/// Making a block of the frame in which sources are drawn as light.
const MAKE_SOURCE_BLOCK: f64 = 0.8e-3;
/// Drawing a galaxy of a few pixels through stamps of 64 pixels, with a tolerance of 1e-3.
const DRAW_GALAXY: f64 = 90e-6;
/// Drawing the photon noise of a pixel.
const NOISE: f64 = 14e-9;
/// Computing a local stamp, per stamp pixel and per stamp of the model.
const MAKE_STAMP: f64 = 0.012e-9;
/// Planning a block, without its stamps and cells.
const PLAN_BLOCK: f64 = 40e-6;
/// Planning a cell of a block, per mode.
const PLAN_CELL: f64 = 50e-9;
/// Computing the coefficients in a cell in its first and last row, per mode.
const EXPAND_CELL: f64 = 9e-9;
/// One product and sum of the direct convolution.
const DIRECT: f64 = 0.012e-9;

impl CostModel {
    pub(crate) fn of<T: ConvReal>() -> Self {
        Self {
            width: size_of::<T>() as f64 / 4.0,
        }
    }

    /// One forward or inverse transform of `nx x ny` values.
    pub(crate) fn transform(self, (nx, ny): (usize, usize)) -> f64 {
        let values = (nx * ny) as f64;
        let unit = match nx * ny {
            ..=80_000 => TRANSFORM,
            80_001..=300_000 => TRANSFORM_LARGE,
            _ => TRANSFORM_HUGE,
        };
        self.width * unit * values * values.log2()
    }

    /// The transform of a stamp. Empty columns are skipped.
    pub(crate) fn kernel(self, size: (usize, usize), stamp: (usize, usize)) -> f64 {
        self.transform(size) * (0.42 + 0.5 * stamp.0 as f64 / size.0 as f64)
    }

    /// Planning a block without its stamps, and expanding its cells once.
    pub(crate) fn plan_and_expand(cells: f64, kernels: f64) -> f64 {
        PLAN_BLOCK + (PLAN_CELL + EXPAND_CELL) * cells * kernels
    }

    /// Computing the kernels of a block from the `stamps` of the model, when the block is planned. An
    /// execution computes a part `made_anew` of the kernels again.
    pub(crate) fn make_stamps(stamp: (usize, usize), stamps: usize, kernels: f64, made_anew: f64) -> f64 {
        (1.0 + made_anew) * MAKE_STAMP * kernels * (stamp.0 * stamp.1 * stamps) as f64
    }

    pub(crate) fn stamp_bytes(self, stamp: (usize, usize)) -> f64 {
        4.0 * self.width * (stamp.0 * stamp.1) as f64
    }

    pub(crate) fn multiply(self, (nx, ny): (usize, usize)) -> f64 {
        self.width * MULTIPLY * (nx * ny) as f64
    }

    /// Reading the kernels' spectra from memory, for a tile of a block of several tiles.
    pub(crate) fn read_spectra(self, (nx, ny): (usize, usize), kernels: f64) -> f64 {
        self.width * READ_SPECTRUM * (nx * ny) as f64 * kernels
    }

    /// Convolving a tile of some layers by transforms of `size`, without the cost of the kernels'
    /// spectra.
    pub(crate) fn tile(self, tile: (usize, usize), size: (usize, usize), kernels: f64, layers: usize) -> f64 {
        let pixels = (tile.0 * tile.1 * layers) as f64;
        let plane = (size.0 * size.1) as f64;
        let r = kernels;
        let multiply_light = if layers > 1 && self.width * pixels > LAYERS_IN_CACHE {
            MULTIPLY_LAYERS_LARGE
        } else {
            MULTIPLY_LIGHT
        };
        r * (self.transform(size) + self.multiply(size) + self.width * multiply_light * pixels)
            + self.transform(size)
            + self.width * (READ_OR_ADD_PIXEL * pixels + ADD * plane)
    }

    /// Drawing one lit pixel. This costs more if light is gathered, because every pixel that the
    /// light reaches then has its own coefficients.
    pub(crate) fn draw(self, direction: Direction, stamp: (usize, usize), kernels: usize) -> f64 {
        let scattered = self.width * DRAW * (stamp.0 * stamp.1) as f64 * (kernels as f64 + 1.5);
        match direction {
            Direction::Scatter => scattered,
            Direction::Gather => DRAW_GATHERED * scattered,
        }
    }

    /// Drawing a star between pixels, by a number of products.
    pub(crate) fn draw_star(self, products: usize) -> f64 {
        self.width * DRAW_STAR * products as f64
    }

    /// Drawing a star from all components one by one, with so many products and sums.
    pub(crate) fn paint_star(products: usize) -> f64 {
        PAINT_STAR * products as f64
    }

    /// A star and a small galaxy, drawn as light or photon by photon. The star takes `draw_star` seconds beside
    /// finding its PSF.
    pub(crate) fn of_kinds(draw_star: f64, work: PhotonWork) -> [KindCosts; 2] {
        let photon = work.proposals * SHOOT_PHOTON + work.terms * TERM_OF_PHOTON;
        let star = KindCosts {
            draw: PREPARE_STAR + draw_star,
            shoot: SHOOT_STAR,
            photon,
        };
        let extended = KindCosts {
            draw: DRAW_GALAXY,
            shoot: SHOOT_EXTENDED,
            photon: photon + work.proposals * PLACE_OF_PHOTON,
        };
        [star, extended]
    }

    /// Making tables for photons, of so many pixels in all.
    pub(crate) fn make_tables(pixels: usize) -> f64 {
        MAKE_TABLE * pixels as f64
    }

    /// Making blocks in which sources are drawn as light.
    pub(crate) fn source_blocks(count: usize) -> f64 {
        MAKE_SOURCE_BLOCK * count as f64
    }

    /// Drawing the photon noise of pixels.
    pub(crate) fn noise(pixels: usize) -> f64 {
        NOISE * pixels as f64
    }

    /// Spreading a star over a number of taps.
    pub(crate) fn spread_star(self, taps: usize) -> f64 {
        self.width * SPREAD_STAR * taps as f64
    }

    /// Convolving a tile by the direct sum.
    pub(crate) fn direct(self, tile: (usize, usize), stamp: (usize, usize), kernels: usize) -> f64 {
        let out = ((tile.0 + stamp.0 - 1) * (tile.1 + stamp.1 - 1)) as f64;
        self.width
            * kernels as f64
            * (DIRECT * out * (stamp.0 * stamp.1) as f64 + MULTIPLY_LIGHT * (tile.0 * tile.1) as f64)
    }
}

/// The work of a photon.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PhotonWork {
    /// The number of pixels that are proposed.
    pub(crate) proposals: f64,
    /// The number of terms of the PSF that are computed at these pixels.
    pub(crate) terms: f64,
}

impl Default for PhotonWork {
    fn default() -> Self {
        Self {
            proposals: 1.0,
            terms: 0.0,
        }
    }
}

/// The seconds to draw sources of one kind.
#[derive(Debug, Clone, Copy)]
pub(crate) struct KindCosts {
    /// Seconds to draw a source as light.
    pub(crate) draw: f64,
    /// Seconds to prepare a source for photons.
    pub(crate) shoot: f64,
    /// Seconds of a photon.
    pub(crate) photon: f64,
}

impl KindCosts {
    /// The most photons for which a source alone is faster photon by photon.
    pub(crate) fn most_photons(&self) -> f64 {
        ((self.draw - self.shoot) / self.photon).clamp(0.0, MOST_PHOTONS)
    }

    /// The seconds of some sources of which those of fewer photons than `below` are shot, the number of sources
    /// that are shot, and that of the others.
    pub(crate) fn seconds(&self, photons: &[f64], below: f64) -> (f64, usize, usize) {
        let shot = photons.iter().filter(|&&n| n < below);
        let (count, sum) = shot.fold((0, 0.0), |(count, sum), n| (count + 1, sum + n));
        let drawn = photons.len() - count;
        let seconds = count as f64 * self.shoot + sum * self.photon + drawn as f64 * self.draw;
        (seconds, count, drawn)
    }
}

/// Returns the sizes of the transforms along both axes: `at_least` or a little more.
pub(crate) fn transform_size(at_least: (usize, usize)) -> (usize, usize) {
    (fast_size(at_least.0, X_STEP), fast_size(at_least.1, Y_STEP))
}

/// Candidate sizes, ascending: the fast sizes ([`is_fast`]) that suit both axes.
pub(crate) fn sizes() -> impl Iterator<Item = usize> {
    (1..=512).map(|i| i * Y_STEP).filter(|&n| is_fast(n))
}

/// Returns the smallest fast size ([`is_fast`]) of at least `at_least` that is a multiple of `step`.
pub(crate) fn fast_size(at_least: usize, step: usize) -> usize {
    let mut n = at_least.next_multiple_of(step);
    while !is_fast(n) {
        n += step;
    }
    n
}

/// Returns whether a size is a power of 2 times at most two factors of 3 or 5. More of these
/// factors are not allowed, because each costs more than a factor of 2.
fn is_fast(n: usize) -> bool {
    let mut odd = n >> n.trailing_zeros();
    let mut factors = 0;
    for p in [3, 5] {
        while odd.is_multiple_of(p) {
            odd /= p;
            factors += 1;
        }
    }
    odd == 1 && factors <= 2
}
