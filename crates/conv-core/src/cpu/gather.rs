//! Gathering: each pixel of the weighted side collects light of the other side. One side is the
//! light, the other is the image. PSFs belong to the pixels of the weighted side.

use ndarray::{Array2, ArrayViewMut2, s};
use rayon::prelude::*;

use super::processor::LightPass;
use super::tile_engine::Workspace;
use super::treatment::{TileCounts, TileMethod, each_tile};
use crate::overlap::split;
use crate::plan::axis_cuts::Stretch;
use crate::plan::geometry::Direction;
use crate::simd::{Lanes, WithIsa, vectorized};
use crate::{ConvError, ConvReal};

/// Gathers light of the other side: `output(p) += c(p) sum_q light(q) k(p - q)`, or `k(q - p)` in
/// the adjoint. The sum is added for each kernel `k` of the block at `p`, with the kernel's
/// coefficients `c`. Every block writes to its own pixels.
pub(crate) struct Gather<'j, 'o, T: ConvReal> {
    pub(crate) pass: LightPass<'j, T>,
    pub(crate) output: ArrayViewMut2<'o, T>,
}

impl<T: ConvReal> WithIsa<T> for Gather<'_, '_, T> {
    type Output = Result<TileCounts, ConvError>;

    fn run<S: Lanes<T>>(mut self, simd: S) -> Self::Output {
        let (processor, plan) = (self.pass.processor, &self.pass.processor.plan);
        let ranges = |stretches: &[Stretch], first: usize| -> Vec<(usize, usize)> {
            stretches
                .iter()
                .map(|s| (s.start() - first, s.end() - first))
                .collect()
        };
        let columns = ranges(&plan.tiling.columns, 0);
        let rows = ranges(&plan.tiling.rows[self.pass.rows.clone()], self.pass.first_output);
        let mut tasks = Vec::new();
        let parts = split(self.output.view_mut(), 0, &rows);
        for (row, part) in self.pass.rows.clone().zip(parts) {
            let parts = split(part, 1, &columns);
            tasks.extend(
                parts
                    .into_iter()
                    .enumerate()
                    .map(|(column, part)| (column, row, part)),
            );
        }
        let pass = &self.pass;
        let done: Vec<Result<TileCounts, ConvError>> = tasks
            .into_par_iter()
            .with_max_len(1)
            .map(|(column, row, output)| {
                let counts = processor
                    .with_workspace(|workspace| gather_block(simd, pass, (column, row), output, workspace));
                if column + 1 == columns.len() {
                    pass.progress.advance(1);
                }
                counts
            })
            .collect();
        let mut counts = TileCounts::default();
        for outcome in done {
            counts += outcome?;
        }
        Ok(counts)
    }
}

fn gather_block<T: ConvReal, S: Lanes<T>>(
    simd: S,
    pass: &LightPass<'_, T>,
    (column, row): (usize, usize),
    mut output: ArrayViewMut2<'_, T>,
    workspace: &mut Workspace<T>,
) -> Result<TileCounts, ConvError> {
    let plan = &pass.processor.plan;
    let engine = pass.tile_engine();
    let first = (plan.tiling.columns[column].start(), plan.tiling.rows[row].start());
    let block = (column, row);
    each_tile(
        simd,
        pass,
        Direction::Gather,
        block,
        workspace,
        |local, (x, y), treatment, workspace| {
            let ((columns, rows), (i, j)) = (local.part.size, (x - first.0, y - first.1));
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
