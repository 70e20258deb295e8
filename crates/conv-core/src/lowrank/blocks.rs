//! All blocks of a plan.

use std::ops::Range;

use psf_types::{Progress, PsfModel};
use rayon::prelude::*;

use super::block::Block;
use super::whole_frame::WholeFrame;
use crate::{ConvError, ConvReal};

/// Blocks that are planned at once.
const BLOCKS_AT_ONCE: usize = 64;

/// The blocks at some columns and rows, row by row, with coefficients as far as the memory reaches, and the memory that is left.
pub(crate) fn blocks<T: ConvReal>(
    model: &PsfModel,
    whole: &WholeFrame,
    [columns, rows]: &[Range<usize>; 2],
    tolerance: f64,
    memory_bytes: usize,
    progress: &dyn Progress,
) -> Result<(Vec<Block<T>>, usize), ConvError> {
    let across = columns.len();
    let count = across * rows.len();
    let mut blocks: Vec<Block<T>> = Vec::with_capacity(count);
    let mut left = memory_bytes;
    let mut full = false;
    // A few at a time, so that tables for which there is no room do not pile up.
    for first in (0..count).step_by(BLOCKS_AT_ONCE) {
        let made: Vec<Block<T>> = (first..(first + BLOCKS_AT_ONCE).min(count))
            .into_par_iter()
            .map(|i| {
                progress.still_wanted()?;
                let region = whole.block(columns.start + i % across, rows.start + i / across);
                Ok(Block::new(model, &whole.space, region, tolerance, !full))
            })
            .collect::<Result<_, ConvError>>()?;
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
    Ok((blocks, left))
}
