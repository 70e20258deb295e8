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
use crate::ConvReal;
use crate::error::GpuError;
use crate::overlap::colours;
use crate::plan::Plan;
use crate::plan::geometry::{Direction, PlacedTile};

/// The extent of a tile along an axis, and the index of its block there.
#[derive(Debug, Clone, Copy)]
struct AxisTile {
    start: usize,
    length: usize,
    block: usize,
    /// The tile's first pixel, counted from the block's first pixel.
    corner: usize,
}

/// Tiles whose results share a buffer.
#[derive(Debug)]
pub(super) struct Panel {
    /// The rows of blocks to which its tiles belong.
    pub(super) block_rows: Range<usize>,
    /// The columns and rows of the output (of the image or, in the adjoint, of the light array) to
    /// which its tiles write.
    pub(super) output: [Range<usize>; 2],
    pub(super) batches: Vec<Batch>,
}

impl Panel {
    /// Bytes of its result.
    pub(super) fn bytes(&self) -> u64 {
        let [columns, rows] = &self.output;
        F32 * (columns.len() * rows.len()) as u64
    }
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
    /// Its index among all batches of the plan.
    pub(super) number: usize,
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

/// The most planes of a batch. A dispatch allows at most this many workgroups along an axis.
const MOST_PLANES: usize = 65_535;
const F32: u64 = 4;

/// Divides a plan's work into panels, from the first row of blocks to the last. Tiles scatter or
/// gather light, as `direction` says. A plane has `plane_bytes` bytes. A buffer of a piece has at
/// most `piece` bytes. If a piece cannot be that small, only the adapter's limit applies.
pub(super) fn panels<T: ConvReal>(
    plan: &Plan<T>,
    direction: Direction,
    plane_bytes: u64,
    adapter: &Adapter,
    piece: u64,
) -> Result<Vec<Panel>, GpuError> {
    let tiles = [&plan.tiling.columns, &plan.tiling.rows].map(|stretches| {
        let of_blocks = stretches.iter().enumerate().flat_map(|(block, stretch)| {
            stretch.placed().map(move |(start, length, corner)| AxisTile {
                start,
                length,
                block,
                corner,
            })
        });
        of_blocks.collect::<Vec<_>>()
    });
    let mut packing = Packing {
        plan,
        direction,
        tiles,
        colours: [1; 2],
        plane_bytes,
        adapter,
        piece,
    };
    let [column_extents, row_extents] = [0, 1].map(|axis| {
        let extents = (0..packing.tiles[axis].len()).map(|tile| packing.extent(axis, tile..tile + 1));
        extents.map(|e| (e.start, e.end)).collect::<Vec<_>>()
    });
    packing.colours = [colours(&column_extents), colours(&row_extents)];
    let tallest = row_extents.iter().map(|(start, end)| end - start).max();
    let columns = packing.groups(0, 0..column_extents.len(), tallest.unwrap_or(1))?;
    let widths = columns.iter().map(|group| packing.extent(0, group.clone()).len());
    let widest = widths.max().unwrap_or(1);
    let band = plan.tiling.band();
    let mut panels: Vec<Panel> = Vec::new();
    let mut first = 0;
    for of_band in packing.tiles[1].chunk_by(|a, b| a.block / band == b.block / band) {
        for rows in packing.groups(1, first..first + of_band.len(), widest)? {
            for columns in &columns {
                panels.push(packing.panel(columns.clone(), rows.clone())?);
            }
        }
        first += of_band.len();
    }
    let batches = panels.iter_mut().flat_map(|panel| &mut panel.batches);
    for (number, batch) in batches.enumerate() {
        batch.number = number;
    }
    Ok(panels)
}

/// A plan's tiles, and the limits of pieces.
struct Packing<'a, T: ConvReal> {
    plan: &'a Plan<T>,
    direction: Direction,
    /// The tiles along x, and the tiles along y.
    tiles: [Vec<AxisTile>; 2],
    /// The number of colours along each axis. No two tiles of one colour write to the same pixel.
    colours: [usize; 2],
    plane_bytes: u64,
    adapter: &'a Adapter,
    piece: u64,
}

impl<T: ConvReal> Packing<'_, T> {
    /// The pixels along an axis that some tiles write to.
    fn extent(&self, axis: usize, tiles: Range<usize>) -> Range<usize> {
        let (first, last) = (self.tiles[axis][tiles.start], self.tiles[axis][tiles.end - 1]);
        let (start, end) = (first.start, last.start + last.length);
        match self.direction {
            Direction::Gather => start..end,
            Direction::Scatter => self.plan.geometry.reached(axis, start..end),
        }
    }

    /// The blocks that some tiles belong to.
    fn blocks_of(&self, axis: usize, tiles: &Range<usize>) -> Range<usize> {
        self.tiles[axis][tiles.start].block..self.tiles[axis][tiles.end - 1].block + 1
    }

    /// The tiles in the range `among` that belong to a block.
    fn tiles_of(&self, axis: usize, block: usize, among: &Range<usize>) -> Range<usize> {
        let of_axis = &self.tiles[axis];
        let first = of_axis.partition_point(|tile| tile.block < block);
        let end = of_axis.partition_point(|tile| tile.block <= block);
        first.max(among.start)..end.min(among.end)
    }

    /// A tile, without places for its data.
    fn tile(&self, column: usize, row: usize) -> TileSlot {
        let (x, y) = (self.tiles[0][column], self.tiles[1][row]);
        let tile = PlacedTile {
            first: (x.start, y.start),
            corner: (x.corner, y.corner),
            size: (x.length, y.length),
        };
        TileSlot {
            tile,
            colour: column % self.colours[0] + self.colours[0] * (row % self.colours[1]),
            light: 0,
            plane: 0,
        }
    }

    /// Groups neighbouring tiles along an axis so that the results of each group fit into a piece.
    /// Along the other axis, results have at most `across` pixels.
    fn groups(&self, axis: usize, tiles: Range<usize>, across: usize) -> Result<Vec<Range<usize>>, GpuError> {
        let bytes = |range: Range<usize>| F32 * (self.extent(axis, range).len() * across) as u64;
        let mut groups: Vec<Range<usize>> = Vec::new();
        for tile in tiles {
            match groups.last_mut() {
                Some(group) if bytes(group.start..tile + 1) <= self.piece => group.end = tile + 1,
                _ => {
                    self.adapter.fits("the result of a tile", bytes(tile..tile + 1))?;
                    groups.push(tile..tile + 1);
                }
            }
        }
        Ok(groups)
    }

    fn panel(&self, columns: Range<usize>, rows: Range<usize>) -> Result<Panel, GpuError> {
        let mut batches = Vec::new();
        let block_rows = self.blocks_of(1, &rows);
        for block_row in block_rows.clone() {
            for block_column in self.blocks_of(0, &columns) {
                let mut tiles = Vec::new();
                for row in self.tiles_of(1, block_row, &rows) {
                    let of_block = self.tiles_of(0, block_column, &columns);
                    tiles.extend(of_block.map(|column| self.tile(column, row)));
                }
                let kernels = 0..self.plan.block(block_column, block_row).kernel_count();
                self.add(&mut batches, (block_column, block_row), &tiles, kernels)?;
            }
        }
        Ok(Panel {
            block_rows,
            output: [self.extent(0, columns), self.extent(1, rows)],
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
        if last.is_some_and(|batch| self.place(batch, block, tiles, kernels.clone(), false)) {
            return Ok(());
        }
        let mut batch = Batch::default();
        if !self.place(&mut batch, block, tiles, kernels.clone(), false) {
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
            let values = self
                .light_values(&tiles[0])
                .max(self.plan.geometry.stamp_values());
            let planes = self.planes_a_tile(1) as u64 * self.plane_bytes;
            self.adapter.fits("a tile", planes.max(F32 * values as u64))?;
            self.place(&mut batch, block, tiles, kernels, true);
        }
        batches.push(batch);
        Ok(())
    }

    /// The number of values of a tile's light, rounded up so that the next tile's light begins at
    /// an offset to which the host may write.
    fn light_values(&self, slot: &TileSlot) -> usize {
        let (columns, rows) = self.plan.geometry.light_size(self.direction, slot.tile.size);
        (columns * rows).next_multiple_of(4)
    }

    fn planes_a_tile(&self, kernels: usize) -> usize {
        match self.direction {
            Direction::Scatter => kernels,
            Direction::Gather => kernels + 1,
        }
    }

    /// Adds a part to a batch if the part fits into a piece, or in any case if `force` is true.
    /// Returns whether it added the part.
    fn place(
        &self,
        batch: &mut Batch,
        block: (usize, usize),
        tiles: &[TileSlot],
        kernels: Range<usize>,
        force: bool,
    ) -> bool {
        let (mut light, mut planes) = (batch.light, batch.planes);
        let slots = tiles.iter().map(|slot| {
            let placed = TileSlot {
                light,
                plane: planes,
                ..*slot
            };
            light += self.light_values(slot);
            planes += self.planes_a_tile(kernels.len());
            placed
        });
        let part = Part {
            block,
            number: batch.parts.len() as u32,
            tiles: slots.collect(),
            spectrum: batch.spectra,
            stamp: batch.stamps,
            kernels: kernels.clone(),
        };
        let spectra = batch.spectra + kernels.len();
        let stamps = batch.stamps + kernels.len() * self.plan.geometry.stamp_values();
        let fits = planes.max(spectra) as u64 * self.plane_bytes <= self.piece
            && planes.max(spectra) <= MOST_PLANES
            && F32 * light.max(stamps) as u64 <= self.piece;
        if fits || force {
            batch.parts.push(part);
            (batch.light, batch.planes) = (light, planes);
            (batch.spectra, batch.stamps) = (spectra, stamps);
        }
        fits || force
    }
}
