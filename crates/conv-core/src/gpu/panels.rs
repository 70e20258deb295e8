//! Division of a plan's work into pieces that a GPU can access at once.
//!
//! A *panel* is a rectangle of tiles whose result fits into one buffer. It lies within one *band*:
//! a few rows of the plan's blocks that are processed together. A panel's tiles are processed in
//! *batches*. The planes (the arrays that shaders transform) of a batch fit into one buffer, and so
//! do its spectra, its light and its stamps. A *part* is the share of a block in a batch: some of
//! the block's tiles and some of its kernels (the PSFs of its local basis), in most cases all of
//! both. A tile's result is the sum over all parts that hold the tile. So a tile whose planes do
//! not fit at once can be processed in several batches.

use std::ops::Range;

use super::adapter::Adapter;
use super::plane_source::PlaneSource;
use crate::ConvReal;
use crate::error::GpuError;
use crate::overlap::colours;
use crate::plan::Plan;
use crate::plan::axis_cuts::Stretch;
use crate::plan::block::Block;
use crate::plan::geometry::{Direction, Geometry, PlacedTile, TilePart};

/// A plan's tiles, listed along x and along y.
#[derive(Debug)]
pub(crate) struct TileGrid {
    /// The tiles along x, and the tiles along y.
    pub(crate) tiles: [Vec<AxisTile>; 2],
    geometry: Geometry,
    /// The number of kernels per block, row by row.
    kernel_counts: Vec<usize>,
    blocks_across: usize,
    /// The number of rows of blocks processed together.
    band: usize,
    /// The number of colours along each axis, for tiles that scatter their light. No two tiles of
    /// one colour write to the same pixel.
    colours: [usize; 2],
}

/// The extent of a tile along an axis, and the index of its block there.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AxisTile {
    start: usize,
    length: usize,
    block: usize,
    /// The tile's first pixel, counted from the block's first pixel.
    corner: usize,
}

impl TileGrid {
    pub(crate) fn new<T: ConvReal>(plan: &Plan<T>) -> Self {
        let along = |stretches: &[Stretch]| {
            let tiles = stretches.iter().enumerate().flat_map(|(block, stretch)| {
                stretch.placed().map(move |(start, length, corner)| AxisTile {
                    start,
                    length,
                    block,
                    corner,
                })
            });
            tiles.collect::<Vec<_>>()
        };
        let mut grid = Self {
            tiles: [along(&plan.tiling.columns), along(&plan.tiling.rows)],
            geometry: plan.geometry,
            kernel_counts: plan.blocks.iter().map(Block::kernel_count).collect(),
            blocks_across: plan.tiling.columns.len(),
            band: plan.tiling.band(),
            colours: [1; 2],
        };
        grid.colours = [0, 1].map(|axis| {
            let tiles = 0..grid.tiles[axis].len();
            let extents = tiles.map(|tile| grid.extent(Direction::Scatter, axis, tile..tile + 1));
            colours(&extents.map(|e| (e.start, e.end)).collect::<Vec<_>>())
        });
        grid
    }

    /// The pixels along an axis that some tiles write to.
    pub(crate) fn extent(&self, direction: Direction, axis: usize, tiles: Range<usize>) -> Range<usize> {
        let (first, last) = (self.tiles[axis][tiles.start], self.tiles[axis][tiles.end - 1]);
        let (start, end) = (first.start, last.start + last.length);
        match direction {
            Direction::Gather => start..end,
            Direction::Scatter => self.geometry.reached(axis, start..end),
        }
    }

    /// For each band (some rows of blocks that are processed together), the rows of its tiles.
    pub(crate) fn bands(&self) -> Vec<Range<usize>> {
        let rows = &self.tiles[1];
        let mut bands: Vec<Range<usize>> = Vec::new();
        for (row, tile) in rows.iter().enumerate() {
            match bands.last_mut() {
                Some(band) if rows[band.start].block / self.band == tile.block / self.band => {
                    band.end = row + 1;
                }
                _ => bands.push(row..row + 1),
            }
        }
        bands
    }

    pub(crate) fn block_of(&self, axis: usize, tile: usize) -> usize {
        self.tiles[axis][tile].block
    }

    /// The blocks that some tiles belong to.
    pub(crate) fn blocks_of(&self, axis: usize, tiles: Range<usize>) -> Range<usize> {
        self.block_of(axis, tiles.start)..self.block_of(axis, tiles.end - 1) + 1
    }

    /// The tiles in the range `among` that belong to a block.
    pub(crate) fn tiles_of(&self, axis: usize, block: usize, among: &Range<usize>) -> Range<usize> {
        let of_axis = &self.tiles[axis];
        let first = of_axis.partition_point(|tile| tile.block < block);
        let end = of_axis.partition_point(|tile| tile.block <= block);
        first.max(among.start)..end.min(among.end)
    }

    pub(crate) fn tile(&self, column: usize, row: usize) -> PlacedTile {
        let (x, y) = (self.tiles[0][column], self.tiles[1][row]);
        PlacedTile {
            first: (x.start, y.start),
            part: TilePart {
                corner: (x.corner, y.corner),
                size: (x.length, y.length),
            },
        }
    }

    /// The colour of a tile. The results of tiles of one colour do not overlap.
    pub(crate) fn colour(&self, direction: Direction, column: usize, row: usize) -> usize {
        match direction {
            Direction::Scatter => column % self.colours[0] + self.colours[0] * (row % self.colours[1]),
            Direction::Gather => 0,
        }
    }

    pub(crate) fn kernel_count(&self, (column, row): (usize, usize)) -> usize {
        self.kernel_counts[row * self.blocks_across + column]
    }
}

/// A rectangle of the output: of the image or, in the adjoint, of the light array.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Rectangle {
    pub(super) column: usize,
    pub(super) row: usize,
    pub(super) columns: usize,
    pub(super) rows: usize,
}

impl Rectangle {
    /// Bytes of its values.
    pub(super) fn bytes(&self) -> u64 {
        F32 * (self.columns * self.rows) as u64
    }
}

/// Tiles whose results share a buffer.
#[derive(Debug)]
pub(super) struct Panel {
    /// The rows of blocks to which its tiles belong.
    pub(super) block_rows: Range<usize>,
    /// The pixels to which its tiles write.
    pub(super) output: Rectangle,
    pub(super) batches: Vec<Batch>,
}

/// Tiles processed together.
#[derive(Debug, Default)]
pub(super) struct Batch {
    pub(super) parts: Vec<Part>,
    /// The number of values of light.
    pub(super) light: usize,
    /// The number of planes.
    pub(super) planes: usize,
    /// The number of spectra.
    pub(super) spectra: usize,
    /// The number of values of all stamps.
    pub(super) stamps: usize,
}

/// Some tiles and some kernels of one block.
#[derive(Debug, Clone)]
pub(super) struct Part {
    /// Column and row of the block.
    pub(super) block: (usize, usize),
    /// The index of this part in its batch.
    pub(super) number: u32,
    pub(super) kernels: Range<usize>,
    pub(super) tiles: Vec<TileSlot>,
    /// The index of its first spectrum in the batch.
    pub(super) spectrum: usize,
    /// The index of the first value of its stamps in the batch.
    pub(super) stamp: usize,
}

/// A tile and the places of its data in a batch.
#[derive(Debug, Clone, Copy)]
pub(super) struct TileSlot {
    pub(super) tile: PlacedTile,
    /// The results of tiles of one colour do not overlap.
    pub(super) colour: usize,
    /// The index of the first value of its light in the batch.
    pub(super) light: usize,
    /// The index of its first plane in the batch.
    pub(super) plane: usize,
}

/// The limits of pieces.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits<'a> {
    pub(super) adapter: &'a Adapter,
    /// The most bytes that a buffer of a piece should have. If a piece cannot be that small, only
    /// the adapter's limit applies.
    pub(super) piece: u64,
}

/// The most planes of a batch. A dispatch allows at most this many workgroups along an axis.
const MOST_PLANES: usize = 65_535;
const F32: u64 = 4;

/// Divides a plan's work into panels, from the first row of blocks to the last. Tiles scatter or
/// gather light, as `direction` says.
pub(super) fn panels(
    plan: &TileGrid,
    source: &PlaneSource,
    direction: Direction,
    limits: Limits<'_>,
) -> Result<Vec<Panel>, GpuError> {
    let packing = Packing {
        plan,
        plane_bytes: source.bytes(),
        direction,
        limits,
    };
    let columns = packing.groups(0, &(0..plan.tiles[0].len()), 1)?;
    let widest = columns
        .iter()
        .map(|group| plan.extent(direction, 0, group.clone()).len())
        .max();
    let mut panels = Vec::new();
    for band in plan.bands() {
        for rows in packing.groups(1, &band, widest.unwrap_or(1))? {
            for columns in &columns {
                panels.push(packing.panel(columns.clone(), rows.clone())?);
            }
        }
    }
    Ok(panels)
}

struct Packing<'a> {
    plan: &'a TileGrid,
    plane_bytes: u64,
    direction: Direction,
    limits: Limits<'a>,
}

impl Packing<'_> {
    /// Groups neighbouring tiles along an axis so that the results of each group fit into a piece.
    /// Along y (axis 1), results are `across` pixels wide. Along x (axis 0), `across` is not used:
    /// results are as high as the result of the tallest tile.
    fn groups(
        &self,
        axis: usize,
        tiles: &Range<usize>,
        across: usize,
    ) -> Result<Vec<Range<usize>>, GpuError> {
        let across = if axis == 0 {
            let rows =
                (0..self.plan.tiles[1].len()).map(|row| self.plan.extent(self.direction, 1, row..row + 1));
            rows.map(|extent| extent.len()).max().unwrap_or(1)
        } else {
            across
        };
        let bytes =
            |range: Range<usize>| F32 * (self.plan.extent(self.direction, axis, range).len() * across) as u64;
        let mut groups: Vec<Range<usize>> = Vec::new();
        for tile in tiles.clone() {
            match groups.last_mut() {
                Some(group) if bytes(group.start..tile + 1) <= self.limits.piece => group.end = tile + 1,
                _ => {
                    self.limits
                        .adapter
                        .fits("the result of a tile", bytes(tile..tile + 1))?;
                    groups.push(tile..tile + 1);
                }
            }
        }
        Ok(groups)
    }

    fn panel(&self, columns: Range<usize>, rows: Range<usize>) -> Result<Panel, GpuError> {
        let plan = self.plan;
        let x = plan.extent(self.direction, 0, columns.clone());
        let y = plan.extent(self.direction, 1, rows.clone());
        let mut batches = Vec::new();
        for block_row in plan.blocks_of(1, rows.clone()) {
            for block_column in plan.blocks_of(0, columns.clone()) {
                let block = (block_column, block_row);
                let mut tiles = Vec::new();
                for row in plan.tiles_of(1, block_row, &rows) {
                    for column in plan.tiles_of(0, block_column, &columns) {
                        tiles.push(TileSlot {
                            tile: plan.tile(column, row),
                            colour: plan.colour(self.direction, column, row),
                            light: 0,
                            plane: 0,
                        });
                    }
                }
                self.add(&mut batches, block, &tiles, 0..plan.kernel_count(block))?;
            }
        }
        Ok(Panel {
            block_rows: plan.blocks_of(1, rows),
            output: Rectangle {
                column: x.start,
                row: y.start,
                columns: x.len(),
                rows: y.len(),
            },
            batches,
        })
    }

    /// Adds a block's tiles with some kernels to the last batch, or to new batches. A block without
    /// kernels needs batches, too, because an execution must inspect all light: lit pixels without a
    /// PSF are errors.
    fn add(
        &self,
        batches: &mut Vec<Batch>,
        block: (usize, usize),
        tiles: &[TileSlot],
        kernels: Range<usize>,
    ) -> Result<(), GpuError> {
        // Only the first kernels of a tile may share a batch with earlier parts, because the results
        // of two parts with the same tile overlap.
        let last = batches.last_mut().filter(|_| kernels.start == 0);
        if last.is_some_and(|batch| self.place(batch, block, tiles, kernels.clone())) {
            return Ok(());
        }
        let mut batch = Batch::default();
        if !self.place(&mut batch, block, tiles, kernels.clone()) {
            if tiles.len() > 1 {
                let mut each = tiles.chunks(1);
                return each.try_for_each(|tile| self.add(batches, block, tile, kernels.clone()));
            }
            if kernels.len() > 1 {
                let middle = kernels.start + kernels.len() / 2;
                self.add(batches, block, tiles, kernels.start..middle)?;
                return self.add(batches, block, tiles, middle..kernels.end);
            }
            // The smallest piece may be larger than the limit in the options.
            self.limits.adapter.fits("a tile", self.least(&tiles[0]))?;
            self.force(&mut batch, block, tiles, kernels);
        }
        batches.push(batch);
        Ok(())
    }

    /// Bytes of the largest buffer that a tile needs with one kernel.
    fn least(&self, tile: &TileSlot) -> u64 {
        let planes = self.planes_a_tile(1) as u64 * self.plane_bytes;
        planes
            .max(F32 * self.light_values(tile) as u64)
            .max(F32 * self.plan.geometry.stamp_values() as u64)
    }

    /// The number of values of a tile's light, rounded up so that the next tile's light begins at
    /// an offset to which the host may write.
    fn light_values(&self, slot: &TileSlot) -> usize {
        let (columns, rows) = self.plan.geometry.light_size(self.direction, slot.tile.part.size);
        (columns * rows).next_multiple_of(4)
    }

    fn planes_a_tile(&self, kernels: usize) -> usize {
        match self.direction {
            Direction::Scatter => kernels,
            Direction::Gather => kernels + 1,
        }
    }

    /// Adds a part to a batch if the part fits. Returns whether it fits.
    fn place(
        &self,
        batch: &mut Batch,
        block: (usize, usize),
        tiles: &[TileSlot],
        kernels: Range<usize>,
    ) -> bool {
        let light: usize = tiles.iter().map(|slot| self.light_values(slot)).sum();
        let planes = batch.planes + tiles.len() * self.planes_a_tile(kernels.len());
        let spectra = batch.spectra + kernels.len();
        let stamps = batch.stamps + kernels.len() * self.plan.geometry.stamp_values();
        let piece = self.limits.piece;
        let fits = planes.max(spectra) as u64 * self.plane_bytes <= piece
            && planes.max(spectra) <= MOST_PLANES
            && F32 * (batch.light + light) as u64 <= piece
            && F32 * stamps as u64 <= piece;
        if fits {
            self.force(batch, block, tiles, kernels);
        }
        fits
    }

    fn force(&self, batch: &mut Batch, block: (usize, usize), tiles: &[TileSlot], kernels: Range<usize>) {
        let mut part = Part {
            block,
            number: batch.parts.len() as u32,
            tiles: Vec::with_capacity(tiles.len()),
            spectrum: batch.spectra,
            stamp: batch.stamps,
            kernels: kernels.clone(),
        };
        for slot in tiles {
            part.tiles.push(TileSlot {
                light: batch.light,
                plane: batch.planes,
                ..*slot
            });
            batch.light += self.light_values(slot);
            batch.planes += self.planes_a_tile(kernels.len());
        }
        batch.spectra += kernels.len();
        batch.stamps += kernels.len() * self.plan.geometry.stamp_values();
        batch.parts.push(part);
    }
}
