//! Scattering: light of the weighted side spreads to the other side. One side is the light, the
//! other is the image. PSFs belong to the pixels of the weighted side.

use ndarray::ArrayViewMut2;

use super::processor::{BlockKernels, LightPass};
use super::tasks::{Task, together};
use super::tile_engine::Workspace;
use super::treatment::{TileCounts, TileMethod, each_tile};
use crate::overlap::colours;
use crate::simd::{Lanes, WithIsa, vectorized};
use crate::{ConvError, ConvReal};

/// Spreads light of the weighted side: `output(q) += sum_p c(p) light(p) k(q - p)`, or `k(p - q)`
/// in the adjoint. The sum over the pixels `p` of a block is added for each kernel `k` of this
/// block, with the kernel's coefficients `c`.
///
/// Blocks whose outputs overlap never run at the same time. In each band of rows of blocks, the
/// blocks at every n-th row and every m-th column have one colour and run together. The colours run
/// one after the other. So the order of additions to a pixel is always the same.
pub(crate) struct Scatter<'j, 'o, T: ConvReal> {
    pub(crate) pass: LightPass<'j, T>,
    pub(crate) output: ArrayViewMut2<'o, T>,
}

impl<T: ConvReal> WithIsa<T> for Scatter<'_, '_, T> {
    type Output = Result<TileCounts, ConvError>;

    fn run<S: Lanes<T>>(mut self, simd: S) -> Self::Output {
        let pass = &self.pass;
        let mut counts = TileCounts::default();
        for round in rounds(pass) {
            let output = self.output.view_mut();
            counts += together(pass, output, &round.columns, &round.rows, |task, workspace| {
                let mut kernels = BlockKernels::new(&pass.processor.plan, task.block);
                scatter_block(simd, pass, task, &mut kernels, workspace)
            })?;
            pass.progress.advance(round.finished);
        }
        Ok(counts)
    }
}

/// Blocks that may run together.
pub(super) struct Round {
    /// Columns and rows of blocks, as in [`together`].
    pub(super) columns: Vec<(usize, (usize, usize))>,
    pub(super) rows: Vec<(usize, (usize, usize))>,
    /// The number of rows of blocks that are finished after this round.
    finished: u64,
}

/// The rounds of an execution, in order.
pub(super) fn rounds<T: ConvReal>(pass: &LightPass<'_, T>) -> Vec<Round> {
    let plan = &pass.processor.plan;
    let [columns, rows] = [0, 1].map(|axis| plan.extents(axis));
    // The numbers of colours depend on all rows of blocks, so that a band has the same colours
    // even if it is executed alone.
    let (column_colours, row_colours) = (colours(&columns), colours(&rows));
    let numbered = |extents: Vec<(usize, usize)>| extents.into_iter().enumerate();
    let (columns, rows) = (numbered(columns), numbered(rows));
    let mut rounds = Vec::new();
    for first in pass.rows.clone().step_by(plan.tiling.band()) {
        let band = first..(first + plan.tiling.band()).min(pass.rows.end);
        for (row_colour, column_colour) in
            (0..row_colours).flat_map(|row| (0..column_colours).map(move |column| (row, column)))
        {
            let of_colour = |row: &usize| band.contains(row) && row % row_colours == row_colour;
            let is_last = row_colour + 1 == row_colours && column_colour + 1 == column_colours;
            rounds.push(Round {
                columns: columns
                    .clone()
                    .skip(column_colour)
                    .step_by(column_colours)
                    .collect(),
                rows: rows.clone().filter(|(row, _)| of_colour(row)).collect(),
                finished: if is_last { band.len() as u64 } else { 0 },
            });
        }
    }
    rounds
}

pub(super) fn scatter_block<T: ConvReal, S: Lanes<T>>(
    simd: S,
    pass: &LightPass<'_, T>,
    task: Task<'_, T>,
    kernels: &mut BlockKernels<'_, T>,
    workspace: &mut Workspace<T>,
) -> Result<TileCounts, ConvError> {
    let plan = &pass.processor.plan;
    let engine = pass.tile_engine();
    let (origin, mut output) = (task.origin, task.output);
    each_tile(
        simd,
        pass,
        task.block,
        kernels,
        workspace,
        |local, (x, y), treatment, workspace| {
            let reach = plan.geometry.reach_from(x, y);
            let place = (reach.0 - origin.0 as i64, reach.1 - origin.1 as i64);
            if let Some(method) = treatment.method {
                vectorized!(simd, {
                    match method {
                        TileMethod::Directly => engine.scatter_directly(local, workspace),
                        TileMethod::ByTransforms => engine.scatter(simd, local, workspace),
                    }
                    let size = plan.geometry.around(local.part.size);
                    if let Some(back) = treatment.back {
                        for value in workspace.weighted.get_mut() {
                            *value *= back;
                        }
                    }
                    engine.add(workspace.weighted.get(), size, &mut output, place);
                });
            }
            if !treatment.drawn.is_empty() {
                vectorized!(
                    simd,
                    engine.draw_scattered(simd, local, &treatment.drawn, &mut output, place)
                );
            }
        },
    )
}
