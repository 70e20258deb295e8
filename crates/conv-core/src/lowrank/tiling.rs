//! The choice of tiles: sizes, and whether they follow the cells of the field.

use std::ops::Range;

use psf_types::{FrameShape, PixelRegion, Progress, PsfModel};
use rayon::prelude::*;

use super::axis_cuts::{Stretch, at_cuts, even, longest, within};
use super::cost_model::{CostModel, sizes, transform_size};
use super::geometry::Geometry;
use super::local_modes::LocalModes;
use super::psf_space::PsfSpace;
use super::region_cells::RegionCells;
use crate::ConvError;

/// Tiles along both axes and their transforms.
#[derive(Debug, Clone)]
pub(crate) struct Tiling {
    pub(crate) columns: Vec<Stretch>,
    pub(crate) rows: Vec<Stretch>,
    /// Columns and rows of the transforms.
    pub(crate) size: (usize, usize),
}

/// Blocks whose rank is looked at to judge a tiling.
const SAMPLES: usize = 5;
/// Transforms larger than this many stamps gain nothing: padding is small already, and ranks grow.
const LARGEST_IN_STAMPS: usize = 10;
const LARGEST_AT_LEAST: usize = 640;
/// Transforms beyond this are for stamps that leave no choice: they outgrow the caches, and the memory that a GPU's threads share.
const LARGEST_BY_CHOICE: usize = 2048;
/// A tile has at least this part of the stamp's size.
const SMALLEST_IN_STAMPS: f64 = 0.4;
/// The number of threads that blocks must suffice for. A constant: plans do not depend on the machine.
const THREADS: usize = 4;
/// Rows of pixels in work at once: few enough for the outer caches, enough to keep threads busy.
const BAND_ROWS: usize = 1024;
/// The part of the memory that coefficients leave to stamps.
const TABLES: f64 = 0.85;
/// Tiles of a block in each direction, where blocks do not follow cells.
const TOGETHER: [usize; 3] = [1, 2, 4];

/// The cheapest tiling that the cost model finds.
pub(crate) fn best_tiling(
    model: &PsfModel,
    space: &PsfSpace,
    geometry: &Geometry,
    tolerance: f64,
    cost: CostModel,
    memory_bytes: usize,
    progress: &dyn Progress,
) -> Result<Tiling, ConvError> {
    let (nx, ny) = geometry.weighted_size();
    let stamp = geometry.stamp;
    let side = stamp.0.max(stamp.1);
    let whole = transform_size((nx + stamp.0 - 1, ny + stamp.1 - 1));
    let smallest = side + (SMALLEST_IN_STAMPS * side as f64) as usize;
    let largest = (LARGEST_IN_STAMPS * side).max(LARGEST_AT_LEAST);
    let largest = largest
        .max(2 * smallest)
        .min(LARGEST_BY_CHOICE.max(smallest + smallest / 4));
    let mut ways = Vec::new();
    for n in sizes().filter(|&n| n >= smallest.min(whole.0.max(whole.1)) && n <= largest) {
        let tile = (
            (n + 1).saturating_sub(stamp.0).max(1),
            (n + 1).saturating_sub(stamp.1).max(1),
        );
        for together in TOGETHER {
            ways.push((even(nx, tile.0, together), even(ny, tile.1, together)));
        }
        if let Some([xs, ys]) = cuts(model, geometry) {
            for split in [false, true] {
                ways.push((at_cuts(nx, &xs, tile.0, split), at_cuts(ny, &ys, tile.1, split)));
            }
        }
        if n >= whole.0.max(whole.1) {
            break;
        }
    }
    let judged: Vec<(f64, Tiling)> = ways
        .into_par_iter()
        .map(|(columns, rows)| {
            progress.still_wanted()?;
            let at_least = (longest(&columns) + stamp.0 - 1, longest(&rows) + stamp.1 - 1);
            let tiling = Tiling {
                columns,
                rows,
                size: transform_size(at_least),
            };
            let seconds = tiling.seconds(model, space, geometry, tolerance, cost, memory_bytes);
            Ok((seconds, tiling))
        })
        .collect::<Result<_, ConvError>>()?;
    // The first of equals, so that the choice does not depend on the order of threads.
    let best = judged.into_iter().reduce(|a, b| if b.0 < a.0 { b } else { a });
    Ok(best.expect("at least one size is tried").1)
}

/// The first pixels, counted from the weighted side's, of the field's cells, if it has any.
fn cuts(model: &PsfModel, geometry: &Geometry) -> Option<[Vec<usize>; 2]> {
    let [xs, ys] = model.field().grid_lines()?;
    let cuts = |lines: &[f64], first: i64, length: usize| {
        let pixels = lines.iter().map(|line| line.ceil() - first as f64);
        let inside = pixels.filter(|&p| p >= 1.0 && p < length as f64);
        let mut cuts: Vec<usize> = inside.map(|p| p as usize).collect();
        cuts.dedup();
        cuts
    };
    let (nx, ny) = geometry.weighted_size();
    Some([
        cuts(&xs, geometry.weighted.x0(), nx),
        cuts(&ys, geometry.weighted.y0(), ny),
    ])
}

impl Tiling {
    /// What lies within some columns and rows, cut to them and counted from the first of them, and the columns and rows of blocks that it is
    /// of. Transforms keep their size.
    pub(crate) fn within(&self, columns: &Range<usize>, rows: &Range<usize>) -> (Self, [Range<usize>; 2]) {
        let (columns, across) = within(&self.columns, columns);
        let (rows, up) = within(&self.rows, rows);
        let size = self.size;
        (Self { columns, rows, size }, [across, up])
    }

    /// The region of a block, in field positions.
    pub(crate) fn region(&self, geometry: &Geometry, column: usize, row: usize) -> PixelRegion {
        let (x, y) = (&self.columns[column], &self.rows[row]);
        PixelRegion::new(
            geometry.weighted.x0() + x.start() as i64,
            geometry.weighted.y0() + y.start() as i64,
            FrameShape::new(x.length(), y.length()).expect("stretches are not empty"),
        )
    }

    /// Predicted seconds where every pixel is lit, from the ranks of a few blocks.
    fn seconds(
        &self,
        model: &PsfModel,
        space: &PsfSpace,
        geometry: &Geometry,
        tolerance: f64,
        cost: CostModel,
        memory_bytes: usize,
    ) -> f64 {
        let (across, up) = (self.columns.len(), self.rows.len());
        let blocks = across * up;
        let samples = SAMPLES.min(blocks);
        let tiles = |stretches: &[Stretch]| stretches.iter().map(|s| s.tiles.len()).sum::<usize>();
        let count = tiles(&self.columns) * tiles(&self.rows);
        let mut short_runs = false;
        let kernels: usize = (0..samples)
            .map(|i| {
                // Spread over rows and columns.
                let row = (2 * i + 1) * up / (2 * samples);
                let column = ((3 * i + 1) % samples * 2 + 1) * across / (2 * samples);
                let region = self.region(geometry, column.min(across - 1), row.min(up - 1));
                let cells = RegionCells::sampled(model.field(), region);
                short_runs |= cells.are_short();
                LocalModes::new(space, &cells, tolerance).rank() + 1
            })
            .sum();
        if short_runs && count > blocks {
            // Coefficients pixel by pixel: blocks of several tiles would take too much memory.
            return f64::INFINITY;
        }
        let kernels = kernels as f64 / samples as f64;
        let (nx, ny) = geometry.weighted_size();
        let tile = (nx.div_ceil(tiles(&self.columns)), ny.div_ceil(tiles(&self.rows)));
        let tiles_a_block = count as f64 / blocks as f64;
        // Stamps that do not fit into the memory are made anew by each execution.
        let stamps = cost.stamp_bytes(geometry.stamp) * kernels * blocks as f64;
        let made_anew = (1.0 - TABLES * memory_bytes as f64 / stamps).clamp(0.0, 1.0);
        let block = kernels * cost.kernel(self.size, geometry.stamp)
            + made_anew * kernels * CostModel::make_stamp(geometry.stamp, space.dimension())
            + tiles_a_block * cost.tile(tile, self.size, kernels);
        self.rounds() as f64 * block
    }

    /// Rows of blocks that are in work at once: about [`BAND_ROWS`] rows of pixels. The order of additions follows from it, so it must
    /// not depend on the machine.
    pub(crate) fn band(&self) -> usize {
        let pixels: usize = self.rows.iter().map(Stretch::length).sum();
        (BAND_ROWS * self.rows.len())
            .div_ceil(pixels.max(1))
            .clamp(1, self.rows.len())
    }

    /// How often [`THREADS`] threads take a block each, given that neighbours must wait for each other.
    fn rounds(&self) -> usize {
        let halves = |n: usize| [n.div_ceil(2), n / 2];
        let band = self.band();
        let bands = (0..self.rows.len()).step_by(band);
        bands
            .flat_map(|first| halves(band.min(self.rows.len() - first)))
            .flat_map(|rows| halves(self.columns.len()).map(|columns| (rows * columns).div_ceil(THREADS)))
            .sum()
    }
}
