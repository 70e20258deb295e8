//! Many arrays of light, such as the frames of a training set, through one plan.

use ndarray::ArrayViewMut2;
use rayon::prelude::*;

use super::gather::{Task, gather_block};
use super::ordered_image::{TileResult, order};
use super::processor::{BlockKernels, LightPass};
use super::scatter::scatter_block;
use super::treatment::TileCounts;
use crate::plan::geometry::Direction;
use crate::simd::{Lanes, WithIsa, vectorized};
use crate::{ConvError, ConvReal};

/// Executes one plan for several arrays of light, each with its own output. The passes differ only
/// in their light.
///
/// A task executes all blocks, one after the other, for a few arrays of light. So the spectra of a
/// block's kernels serve all of them. Blocks are added in the order of single executions, so the images
/// are equal, bit by bit.
pub(crate) struct Many<'j, 'o, T: ConvReal> {
    pub(crate) passes: Vec<(LightPass<'j, T>, ArrayViewMut2<'o, T>)>,
}

/// The most arrays of light of a task. More of them hardly save time, and need more of the cache.
const MOST_PER_TASK: usize = 16;
/// Each thread gets at least this many tasks if there are enough arrays of light.
const TASKS_PER_THREAD: usize = 4;

impl<T: ConvReal> WithIsa<T> for Many<'_, '_, T> {
    type Output = Result<TileCounts, ConvError>;

    fn run<S: Lanes<T>>(mut self, simd: S) -> Self::Output {
        let tasks = TASKS_PER_THREAD * rayon::current_num_threads();
        let per_task = self.passes.len().div_ceil(tasks).clamp(1, MOST_PER_TASK);
        let done: Vec<_> = self
            .passes
            .par_chunks_mut(per_task)
            .map(|passes| few(simd, passes))
            .collect();
        done.into_iter().sum()
    }
}

/// Executes all blocks for a few arrays of light.
fn few<T: ConvReal, S: Lanes<T>>(
    simd: S,
    passes: &mut [(LightPass<'_, T>, ArrayViewMut2<'_, T>)],
) -> Result<TileCounts, ConvError> {
    let first = passes[0].0.clone();
    let plan = &first.processor.plan;
    let engine = first.tile_engine();
    let blocks = order(&first);
    first.processor.with_workspace(|workspace| {
        let mut counts = TileCounts::default();
        for block in blocks {
            let mut kernels = BlockKernels::new(plan, block);
            kernels.are_shared = passes.len() > 1;
            for (pass, output) in passes.iter_mut() {
                pass.progress.check_cancelled()?;
                counts += match pass.direction() {
                    Direction::Scatter => {
                        scatter_block(simd, pass, block, &mut kernels, workspace, |result| {
                            let TileResult { plane, size, place } = result;
                            vectorized!(simd, engine.add(plane, size, output, place));
                        })
                    }
                    Direction::Gather => {
                        let task = Task {
                            block,
                            output: output.view_mut(),
                            origin: (0, 0),
                        };
                        gather_block(simd, pass, task, &mut kernels, workspace)
                    }
                }?;
            }
        }
        first.progress.advance(passes.len() as u64);
        Ok(counts)
    })
}
