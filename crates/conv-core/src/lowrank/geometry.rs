//! Where the light is and where it goes.

use psf_types::{Anchor, PixelRegion};

use crate::kernel::Reach;

/// The two sides of the operator, in field positions. PSFs belong to pixels of the `weighted` side: the light
/// (source-anchored) or the frame (output-anchored).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Geometry {
    pub(crate) weighted: PixelRegion,
    pub(crate) other: PixelRegion,
    /// How far a pixel of the weighted side reaches to smaller columns and rows of the other side.
    pub(crate) before: (usize, usize),
    /// Columns and rows of the stamps.
    pub(crate) stamp: (usize, usize),
}

impl Geometry {
    /// `light` is the part of the scene that reaches `region`, a part of the frame or all of it.
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

    /// The pixel of the other side from which on pixel (`column`, `row`) of the weighted side reaches, both counted from
    /// their region's first pixels.
    pub(crate) fn reach_from(&self, column: usize, row: usize) -> (i64, i64) {
        (
            column as i64 + self.weighted.x0() - self.other.x0() - self.before.0 as i64,
            row as i64 + self.weighted.y0() - self.other.y0() - self.before.1 as i64,
        )
    }

    pub(crate) fn weighted_size(&self) -> (usize, usize) {
        (self.weighted.shape().nx(), self.weighted.shape().ny())
    }

    pub(crate) fn other_size(&self) -> (usize, usize) {
        (self.other.shape().nx(), self.other.shape().ny())
    }
}
