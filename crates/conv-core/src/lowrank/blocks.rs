//! All blocks of a plan.

use psf_types::PsfModel;
use rayon::prelude::*;

use super::block::Block;
use super::geometry::Geometry;
use super::psf_space::PsfSpace;
use super::tiling::Tiling;
use crate::ConvReal;

/// Blocks that are planned at once.
const BLOCKS_AT_ONCE: usize = 64;

/// The blocks of a tiling, row by row, with coefficients as far as the memory reaches, and the memory that is left.
pub(crate) fn blocks<T: ConvReal>(
    model: &PsfModel,
    space: &PsfSpace,
    geometry: &Geometry,
    tiling: &Tiling,
    tolerance: f64,
    memory_bytes: usize,
) -> (Vec<Block<T>>, usize) {
    let across = tiling.columns.len();
    let count = across * tiling.rows.len();
    let mut blocks: Vec<Block<T>> = Vec::with_capacity(count);
    let mut left = memory_bytes;
    let mut full = false;
    // A few at a time, so that tables for which there is no room do not pile up.
    for first in (0..count).step_by(BLOCKS_AT_ONCE) {
        let made: Vec<Block<T>> = (first..(first + BLOCKS_AT_ONCE).min(count))
            .into_par_iter()
            .map(|i| {
                let region = tiling.region(geometry, i % across, i / across);
                Block::new(model, space, region, tolerance, !full)
            })
            .collect();
        for mut block in made {
            match left.checked_sub(block.table_bytes()) {
                Some(rest) if !full => left = rest,
                _ => {
                    full = true;
                    block.forget_table();
                }
            }
            blocks.push(block);
        }
    }
    (blocks, left)
}
