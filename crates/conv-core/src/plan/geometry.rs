//! Positions of the light and of its image.

use std::ops::Range;

use psf_types::{Anchor, PixelRegion};

use crate::view::Reach;

/// The direction in which light passes through an operator, which is a convolution or its adjoint.
/// PSFs belong to the pixels of one side of the operator: the light or the image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Direction {
    /// From the side that PSFs belong to: the tile's own light spreads.
    Scatter,
    /// To the side that PSFs belong to: a tile gathers the light around it.
    Gather,
}

/// A tile of the weighted side ([`Geometry`]).
#[derive(Debug, Clone, Copy)]
pub(crate) struct PlacedTile {
    /// Its first pixel on the weighted side.
    pub(crate) first: (usize, usize),
    /// Its first column and row, counted from its block's first pixel.
    pub(crate) corner: (usize, usize),
    /// Columns and rows.
    pub(crate) size: (usize, usize),
}

/// The two sides of the operator, in field positions. PSFs belong to pixels of the `weighted` side:
/// the light (source-anchored) or the frame (output-anchored).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Geometry {
    pub(crate) weighted: PixelRegion,
    pub(crate) other: PixelRegion,
    /// The number of columns and rows that a pixel of the weighted side reaches towards smaller
    /// indices of the other side.
    pub(crate) before: (usize, usize),
    /// Columns and rows of the stamps.
    pub(crate) stamp: (usize, usize),
}

impl Geometry {
    /// `light` is the part of the scene that reaches `region`. `region` is the frame or a part of
    /// it.
    pub(crate) fn new(light: PixelRegion, region: PixelRegion, reach: Reach, anchor: Anchor) -> Self {
        let stamp = (reach.left + reach.right + 1, reach.below + reach.above + 1);
        match anchor {
            Anchor::Output => Self {
                weighted: region,
                other: light,
                before: (reach.right, reach.above),
                stamp,
            },
            _ => Self {
                weighted: light,
                other: region,
                before: (reach.left, reach.below),
                stamp,
            },
        }
    }

    /// The first pixel of the other side that pixel (`column`, `row`) of the weighted side reaches.
    /// Both pixels count from the first pixels of their regions. The result may lie outside its
    /// region.
    pub(crate) fn reach_from(&self, column: usize, row: usize) -> (i64, i64) {
        (
            column as i64 + self.weighted.x0() - self.other.x0() - self.before.0 as i64,
            row as i64 + self.weighted.y0() - self.other.y0() - self.before.1 as i64,
        )
    }

    /// The columns (axis 0) or rows (axis 1) of the other side that `pixels` of the weighted side
    /// reach.
    pub(crate) fn reached(&self, axis: usize, pixels: Range<usize>) -> Range<usize> {
        let reach = self.reach_from(pixels.start, pixels.start);
        let (from, stamp, limit) = if axis == 0 {
            (reach.0, self.stamp.0, self.other_size().0)
        } else {
            (reach.1, self.stamp.1, self.other_size().1)
        };
        let clamp = |v: i64| v.clamp(0, limit as i64) as usize;
        clamp(from)..clamp(from + (pixels.len() + stamp - 1) as i64)
    }

    /// Columns and rows of a tile plus the margin that its stamps reach.
    pub(crate) fn around(&self, (columns, rows): (usize, usize)) -> (usize, usize) {
        (columns + self.stamp.0 - 1, rows + self.stamp.1 - 1)
    }

    /// The first pixel and the size of the light that a tile needs, and of its result.
    pub(crate) fn light_and_result(
        &self,
        direction: Direction,
        tile: PlacedTile,
    ) -> [((i64, i64), (usize, usize)); 2] {
        let (x, y) = tile.first;
        let own = ((x as i64, y as i64), tile.size);
        let around = (self.reach_from(x, y), self.around(tile.size));
        match direction {
            Direction::Scatter => [own, around],
            Direction::Gather => [around, own],
        }
    }

    /// Columns and rows of the light needed for a tile of the given size.
    #[cfg(feature = "gpu")]
    pub(crate) fn light_size(&self, direction: Direction, tile: (usize, usize)) -> (usize, usize) {
        match direction {
            Direction::Scatter => tile,
            Direction::Gather => self.around(tile),
        }
    }

    /// The number of values in a stamp.
    #[cfg(feature = "gpu")]
    pub(crate) fn stamp_values(&self) -> usize {
        self.stamp.0 * self.stamp.1
    }

    pub(crate) fn weighted_size(&self) -> (usize, usize) {
        (self.weighted.shape().nx(), self.weighted.shape().ny())
    }

    pub(crate) fn other_size(&self) -> (usize, usize) {
        (self.other.shape().nx(), self.other.shape().ny())
    }
}
