//! Products of an image with the light of galaxies outside their windows.

use std::ops::Range;

use ndarray::{ArrayView2, s};
use psf_types::{PixelRegion, Progress, Real};
use rayon::prelude::*;

use super::far_field::{Block, BlockWeights, FarLight, SMALLEST, TILE, TakesLight, tiles};
use crate::overlap::shared;
use crate::{ConvError, ConvReal, view};

/// An image on a square, and its products with the polynomials on blocks of the square.
struct ImageOnSquare {
    side: usize,
    /// Rows first.
    pixels: Vec<f64>,
    blocks: Vec<Vec<Block>>,
}

impl ImageOnSquare {
    /// An image that is dark outside `part`, whose first pixel is at `(column, row)`.
    fn new<T: Real>(
        weights: &BlockWeights<f64>,
        side: usize,
        part: ArrayView2<'_, T>,
        (column, row): (usize, usize),
    ) -> Self {
        let mut pixels = vec![0.0; side * side];
        let rows = pixels.chunks_exact_mut(side).skip(row);
        for (to, values) in rows.zip(part.outer_iter()) {
            let to = to[column..].iter_mut();
            to.zip(values).for_each(|(to, v)| *to = v.as_f64());
        }
        Self {
            blocks: weights.products(&pixels),
            side,
            pixels,
        }
    }
}

/// Adds up the products of an image with several lights, which are drawn on the same blocks and pixels.
struct OfLights<'a> {
    image: &'a ImageOnSquare,
    lights: &'a [FarLight],
    sums: Vec<f64>,
}

impl<'a> OfLights<'a> {
    fn new(image: &'a ImageOnSquare, lights: &'a [FarLight]) -> Self {
        Self {
            image,
            lights,
            sums: vec![0.0; lights.len()],
        }
    }
}

impl TakesLight for OfLights<'_> {
    fn side_and_levels(&self) -> (usize, usize) {
        (self.image.side, self.image.blocks.len())
    }

    fn take_block(
        &mut self,
        _: &FarLight,
        (centre, size): ((f64, f64), f64),
        weight: f64,
        (level, number): (usize, usize),
    ) {
        let image = self.image.blocks[level][number].as_flattened();
        for (light, sum) in self.lights.iter().zip(&mut self.sums) {
            let mut values = Block::default();
            light.add_at_nodes(centre, size, &mut values);
            let products = values.as_flattened().iter().zip(image);
            *sum += weight * products.map(|(v, g)| v * g).sum::<f64>();
        }
    }

    fn take_pixels(&mut self, _: &FarLight, first: (f64, f64), at: Range<usize>) {
        let image = &self.image.pixels[at];
        for (light, sum) in self.lights.iter().zip(&mut self.sums) {
            let mut values = [0.0; SMALLEST];
            light.add_along_row(first, &mut values);
            *sum += values.iter().zip(image).map(|(v, g)| v * g).sum::<f64>();
        }
    }
}

/// The products of an image on a window with the light that the period of the window brings in from outside: for
/// each of several lights, which are drawn as the first one. The image is dark outside `part`, whose first pixel is at
/// `(column, row)` of the window.
pub(super) fn repeated_products<T: Real>(
    lights: &[FarLight],
    weights: &BlockWeights<f64>,
    part: ArrayView2<'_, T>,
    at: (usize, usize),
) -> Vec<f64> {
    let side = lights[0].window.2;
    let image = ImageOnSquare::new(weights, side, part, at);
    lights[0].each_period(OfLights::new(&image, lights)).sums
}

/// The products of an image, which holds the pixels of a region of the frame, with the light of galaxies outside
/// their windows: for each galaxy those of several lights, which are drawn as its first one.
pub(super) fn far_products<T: ConvReal>(
    galaxies: &[Vec<FarLight>],
    image: ArrayView2<'_, T>,
    region: PixelRegion,
    progress: &dyn Progress,
) -> Result<Vec<Vec<f64>>, ConvError> {
    let mut sums: Vec<Vec<f64>> = galaxies.iter().map(|lights| vec![0.0; lights.len()]).collect();
    if galaxies.is_empty() {
        return Ok(sums);
    }
    let weights = BlockWeights::<f64>::new(TILE);
    let columns: Vec<i64> = tiles(region.x0(), region.shape().nx()).collect();
    for y in tiles(region.y0(), region.shape().ny()) {
        let near: Vec<usize> = (0..galaxies.len())
            .filter(|&index| galaxies[index][0].reaches_row(y))
            .collect();
        if near.is_empty() {
            continue;
        }
        let of_tiles: Vec<Vec<Vec<f64>>> = columns
            .par_iter()
            .map(|&x| {
                progress.check_cancelled()?;
                let tile = view::region(x, y, (TILE, TILE));
                let Some([(columns, from_columns), (rows, from_rows)]) = shared(tile, region) else {
                    return Ok(Vec::new());
                };
                let part = image.slice(s![from_rows, from_columns]);
                let image = ImageOnSquare::new(&weights, TILE, part, (columns.start, rows.start));
                let of_galaxy = |&index: &usize| {
                    let lights = &galaxies[index];
                    lights[0].each_block((x, y), OfLights::new(&image, lights)).sums
                };
                Ok(near.iter().map(of_galaxy).collect())
            })
            .collect::<Result<_, ConvError>>()?;
        for of_tile in of_tiles {
            for (&index, of_galaxy) in near.iter().zip(of_tile) {
                sums[index]
                    .iter_mut()
                    .zip(of_galaxy)
                    .for_each(|(sum, v)| *sum += v);
            }
        }
    }
    Ok(sums)
}
