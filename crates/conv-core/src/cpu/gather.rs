//! Gathering: each pixel of the weighted side collects light of the other side. One side is the
//! light, the other is the image. PSFs belong to the pixels of the weighted side.

use ndarray::{Array2, ArrayViewMut2, s};

use super::processor::{BlockKernels, LightPass};
use super::tasks::{Task, together};
use super::tile_engine::Workspace;
use super::treatment::{TileCounts, TileMethod, each_tile};
use crate::plan::axis_cuts::Stretch;
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

    fn run<S: Lanes<T>>(self, simd: S) -> Self::Output {
        let (pass, tiling) = (&self.pass, &self.pass.processor.plan.tiling);
        let numbered = |stretches: &[Stretch]| -> Vec<(usize, (usize, usize))> {
            let ranges = stretches.iter().map(|stretch| (stretch.start(), stretch.end()));
            ranges.enumerate().collect()
        };
        let (columns, rows) = (numbered(&tiling.columns), numbered(&tiling.rows));
        let rows = &rows[pass.rows.clone()];
        together(pass, self.output, &columns, rows, |task, workspace| {
            let is_last = task.block.0 + 1 == columns.len();
            let mut kernels = BlockKernels::new(&pass.processor.plan, task.block);
            let counts = gather_block(simd, pass, task, &mut kernels, workspace);
            if is_last {
                pass.progress.advance(1);
            }
            counts
        })
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
        |local, (x, y), treatment, workspace| {
            let ((columns, rows), (i, j)) = (local.part.size, (x - origin.0, y - origin.1));
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
