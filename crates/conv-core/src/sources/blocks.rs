//! Blocks of the field, each with a local basis.

use psf_types::PixelRegion;

use crate::view::region;

/// Row and column of a block of the field. The row is first, so that blocks are sorted by rows.
pub(crate) type BlockKey = (i64, i64);

/// The block that holds a pixel, if blocks have `side` pixels along each side.
pub(crate) fn block_of((column, row): (i64, i64), side: i64) -> BlockKey {
    (row.div_euclid(side), column.div_euclid(side))
}

/// The pixels of such a block.
pub(crate) fn region_of((row, column): BlockKey, side: i64) -> PixelRegion {
    region(column * side, row * side, (side as usize, side as usize))
}
