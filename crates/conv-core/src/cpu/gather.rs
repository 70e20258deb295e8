//! Gathering: each pixel of the weighted side collects light of the other side. One side is the
//! light, the other is the image. PSFs belong to the pixels of the weighted side.

use std::cmp::Reverse;

use ndarray::{Array2, ArrayViewMut2, s};
use rayon::prelude::*;

use super::processor::{BlockKernels, LightPass};
use super::tile_engine::Workspace;
use super::treatment::{TileCounts, TileMethod, each_tile};
use crate::overlap::split;
use crate::plan::axis_cuts::Stretch;
use crate::simd::{Lanes, WithIsa, vectorized};
use crate::{ConvError, ConvReal};

/// Gathers light of the other side: `output(p) += c(p) sum_q light(q) k(p - q)`, or `k(q - p)` in
/// the adjoint. The sum is added for each kernel `k` of the block at `p`, with the kernel's
/// coefficients `c`. Blocks are executed in parallel, and every block writes to its own pixels.
pub(crate) struct Gather<'j, 'o, T: ConvReal> {
    pub(crate) pass: LightPass<'j, T>,
    pub(crate) output: ArrayViewMut2<'o, T>,
}

/// A block (column and row), its part of the output, and the part's first column and row on the
/// output's side.
pub(super) struct Task<'a, T> {
    pub(super) block: (usize, usize),
    pub(super) output: ArrayViewMut2<'a, T>,
    pub(super) origin: (usize, usize),
}

impl<T: ConvReal> WithIsa<T> for Gather<'_, '_, T> {
    type Output = Result<TileCounts, ConvError>;

    fn run<S: Lanes<T>>(self, simd: S) -> Self::Output {
        let pass = &self.pass;
        let plan = &pass.processor.plan;
        let height = self.output.nrows();
        let within = |row: usize| row.saturating_sub(pass.first_output).min(height);
        let range = |stretch: &Stretch| (stretch.start(), stretch.end());
        let columns: Vec<_> = plan.tiling.columns.iter().map(range).collect();
        let rows = plan.tiling.rows[pass.rows.clone()].iter().map(range);
        let rows: Vec<_> = rows.map(|(start, end)| (within(start), within(end))).collect();
        let mut tasks = Vec::with_capacity(rows.len() * columns.len());
        let parts = split(self.output, 0, &rows);
        for ((row, &(top, _)), part) in pass.rows.clone().zip(&rows).zip(parts) {
            let parts = split(part, 1, &columns).into_iter().zip(&columns);
            tasks.extend(parts.enumerate().map(|(column, (output, &(left, _)))| Task {
                block: (column, row),
                output,
                origin: (left, top + pass.first_output),
            }));
        }
        // Each thread takes the next block when it is free. Those with most kernels come first, so that all
        // threads end at about the same time.
        tasks.sort_by_key(|task| Reverse(plan.block(task.block.0, task.block.1).kernel_count()));
        let mut done: Vec<_> = tasks
            .into_iter()
            .par_bridge()
            .map(|task| {
                let (column, row) = task.block;
                let mut kernels = BlockKernels::new(plan, task.block);
                let counts = pass
                    .processor
                    .with_workspace(|workspace| gather_block(simd, pass, task, &mut kernels, workspace));
                pass.progress.advance(u64::from(column + 1 == columns.len()));
                ((row, column), counts)
            })
            .collect();
        // Of several errors, returns that of the first block.
        done.sort_by_key(|&(place, _)| place);
        done.into_iter().map(|(_, counts)| counts).sum()
    }
}

pub(super) fn gather_block<T: ConvReal, S: Lanes<T>>(
    simd: S,
    pass: &LightPass<'_, T>,
    task: Task<'_, T>,
    kernels: &mut BlockKernels<'_, T>,
    workspace: &mut Workspace<T>,
) -> Result<TileCounts, ConvError> {
    let engine = pass.tile_engine();
    let (origin, mut output) = (task.origin, task.output);
    each_tile(
        simd,
        pass,
        task.block,
        kernels,
        workspace,
        |local, treatment, workspace| {
            let ((columns, rows), (x, y)) = (local.tile.size, local.tile.first);
            let (i, j) = (x - origin.0, y - origin.1);
            let mut output = output.slice_mut(s![j..j + rows, i..i + columns]);
            if let Some(method) = treatment.method {
                let gather = |workspace: &mut Workspace<T>, output: &mut ArrayViewMut2<'_, T>| {
                    vectorized!(
                        simd,
                        match method {
                            TileMethod::Directly => engine.gather_directly(local, workspace, output),
                            TileMethod::ByTransforms => engine.gather(simd, local, workspace, output),
                        }
                    );
                };
                match treatment.back {
                    None => gather(workspace, &mut output),
                    // Scales back only the tile's result, not the values already in the output.
                    Some(back) => {
                        let mut near_one = Array2::zeros(output.dim());
                        gather(workspace, &mut near_one.view_mut());
                        output.zip_mut_with(&near_one, |value, &v| *value += v * back);
                    }
                }
            }
            if !treatment.drawn.is_empty() {
                vectorized!(simd, engine.draw_gathered(local, &treatment.drawn, &mut output));
            }
        },
    )
}
