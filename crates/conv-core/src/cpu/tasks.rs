//! Blocks that are executed in parallel, each with its own part of the output.

use std::cmp::Reverse;

use ndarray::ArrayViewMut2;
use rayon::prelude::*;

use super::processor::LightPass;
use super::tile_engine::Workspace;
use super::treatment::TileCounts;
use crate::overlap::split;
use crate::{ConvError, ConvReal};

/// A block (column and row), its part of the output, and the part's first column and row on the
/// output's side.
pub(super) struct Task<'a, T> {
    pub(super) block: (usize, usize),
    pub(super) output: ArrayViewMut2<'a, T>,
    pub(super) origin: (usize, usize),
}

/// Executes the blocks at some columns and rows in parallel, each with its part of the output. A
/// column or row is given by its number, and by the first pixel and the end of its range on the
/// output's side. The ranges do not overlap. Of several errors, returns that of the first block.
pub(super) fn together<T: ConvReal>(
    pass: &LightPass<'_, T>,
    output: ArrayViewMut2<'_, T>,
    columns: &[(usize, (usize, usize))],
    rows: &[(usize, (usize, usize))],
    execute: impl Fn(Task<'_, T>, &mut Workspace<T>) -> Result<TileCounts, ConvError> + Sync,
) -> Result<TileCounts, ConvError> {
    let height = output.nrows();
    let within = |row: usize| row.saturating_sub(pass.first_output).min(height);
    let in_output = rows.iter().map(|&(_, (start, end))| (within(start), within(end)));
    let row_ranges: Vec<(usize, usize)> = in_output.collect();
    let column_ranges: Vec<(usize, usize)> = columns.iter().map(|&(_, range)| range).collect();
    let mut tasks = Vec::with_capacity(rows.len() * columns.len());
    let parts = split(output, 0, &row_ranges);
    for ((&(row, _), part), &(top, _)) in rows.iter().zip(parts).zip(&row_ranges) {
        let parts = split(part, 1, &column_ranges);
        for (&(column, (left, _)), output) in columns.iter().zip(parts) {
            tasks.push(Task {
                block: (column, row),
                output,
                origin: (left, top + pass.first_output),
            });
        }
    }
    // Each thread takes the next block when it is free. Those with most kernels come first, so that all
    // threads end at about the same time.
    let kernels = |(column, row)| pass.processor.plan.block(column, row).kernel_count();
    tasks.sort_by_key(|task| Reverse(kernels(task.block)));
    let mut done: Vec<_> = tasks
        .into_iter()
        .par_bridge()
        .map(|task| {
            let place = (task.block.1, task.block.0);
            (place, pass.processor.with_workspace(|w| execute(task, w)))
        })
        .collect();
    done.sort_by_key(|&(place, _)| place);
    let mut counts = TileCounts::default();
    for (_, outcome) in done {
        counts += outcome?;
    }
    Ok(counts)
}
