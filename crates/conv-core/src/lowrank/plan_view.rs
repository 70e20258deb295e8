//! What a GPU needs to know of a plan to cut its work into pieces.

use std::ops::Range;

use super::axis_cuts::Stretch;
use super::block::Block;
use super::geometry::Geometry;
use super::plan::Plan;
use super::split::colours;
use super::tile_engine::TilePart;
use super::tile_light::{Direction, PlacedTile};
use crate::ConvReal;

/// A plan's tiles along both axes, one by one.
#[derive(Debug)]
pub(crate) struct PlanView {
    /// Along x and along y.
    pub(crate) tiles: [Vec<AxisTile>; 2],
    geometry: Geometry,
    /// By block, row by row.
    kernel_counts: Vec<usize>,
    blocks_across: usize,
    /// Rows of blocks that are in work at once.
    band: usize,
    /// Of tiles whose light spreads, along both axes.
    colours: [usize; 2],
}

/// A tile along an axis.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AxisTile {
    start: usize,
    length: usize,
    block: usize,
    /// Counted from the block's first pixel.
    corner: usize,
}

impl PlanView {
    pub(crate) fn new<T: ConvReal>(plan: &Plan<T>) -> Self {
        let along = |stretches: &[Stretch]| {
            let tiles = stretches.iter().enumerate().flat_map(|(block, stretch)| {
                stretch.tiles.iter().map(move |&(start, length)| AxisTile {
                    start,
                    length,
                    block,
                    corner: start - stretch.start() + stretch.lead,
                })
            });
            tiles.collect::<Vec<_>>()
        };
        let mut view = Self {
            tiles: [along(&plan.tiling.columns), along(&plan.tiling.rows)],
            geometry: plan.geometry,
            kernel_counts: plan.blocks.iter().map(Block::kernel_count).collect(),
            blocks_across: plan.tiling.columns.len(),
            band: plan.tiling.band(),
            colours: [1; 2],
        };
        view.colours = [0, 1].map(|axis| {
            let tiles = 0..view.tiles[axis].len();
            let extents = tiles.map(|tile| view.extent(Direction::Scatter, axis, tile..tile + 1));
            colours(&extents.map(|e| (e.start, e.end)).collect::<Vec<_>>())
        });
        view
    }

    /// The pixels along an axis that some tiles write to.
    pub(crate) fn extent(&self, direction: Direction, axis: usize, tiles: Range<usize>) -> Range<usize> {
        let (first, last) = (self.tiles[axis][tiles.start], self.tiles[axis][tiles.end - 1]);
        let (start, end) = (first.start, last.start + last.length);
        if direction == Direction::Gather {
            return start..end;
        }
        let (stamp, limit) = if axis == 0 {
            (self.geometry.stamp.0, self.geometry.other_size().0)
        } else {
            (self.geometry.stamp.1, self.geometry.other_size().1)
        };
        let reach = self.geometry.reach_from(start, start);
        let from = if axis == 0 { reach.0 } else { reach.1 };
        let clamp = |v: i64| v.clamp(0, limit as i64) as usize;
        clamp(from)..clamp(from + (end - start + stamp - 1) as i64)
    }

    /// Rows of tiles that belong to rows of blocks which are in work at once.
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

    /// Those of some tiles that belong to a block.
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

    /// Tiles of one colour do not overlap.
    pub(crate) fn colour(&self, direction: Direction, column: usize, row: usize) -> usize {
        match direction {
            Direction::Scatter => column % self.colours[0] + self.colours[0] * (row % self.colours[1]),
            Direction::Gather => 0,
        }
    }

    pub(crate) fn kernel_count(&self, (column, row): (usize, usize)) -> usize {
        self.kernel_counts[row * self.blocks_across + column]
    }

    /// Columns and rows of the light that a tile of some size takes.
    pub(crate) fn light_size(&self, direction: Direction, (columns, rows): (usize, usize)) -> (usize, usize) {
        match direction {
            Direction::Scatter => (columns, rows),
            Direction::Gather => (
                columns + self.geometry.stamp.0 - 1,
                rows + self.geometry.stamp.1 - 1,
            ),
        }
    }

    pub(crate) fn stamp(&self) -> (usize, usize) {
        self.geometry.stamp
    }

    pub(crate) fn stamp_values(&self) -> usize {
        self.geometry.stamp.0 * self.geometry.stamp.1
    }

    /// The pixel of the other side from which on a pixel of the weighted side reaches.
    pub(crate) fn reach_from(&self, (column, row): (usize, usize)) -> (i64, i64) {
        self.geometry.reach_from(column, row)
    }
}
