//! From the other side to the weighted one.

use ndarray::{Array2, ArrayViewMut2, s};
use rayon::prelude::*;

use super::axis_cuts::Stretch;
use super::execution::TileCounts;
use super::job::Job;
use super::prepared::Prepared;
use super::split::split;
use super::tile_engine::{TileEngine, TilePart};
use super::tile_light::{Direction, PlacedTile, treated};
use super::treatment::{Ways, Whole};
use super::workspace::Workspace;
use crate::simd::{Lanes, WithIsa};
use crate::{ConvError, ConvReal};

/// Gathers light of the other side: `output(p) += c(p) sum_q light(q) k(p - q)`, or `k(q - p)` where stamps
/// are turned. Every block writes to its own pixels.
pub(crate) struct Gather<'j, 'o, T: ConvReal> {
    pub(crate) job: Job<'j, T>,
    pub(crate) output: ArrayViewMut2<'o, T>,
}

impl<T: ConvReal> WithIsa<T> for Gather<'_, '_, T> {
    type Output = Result<TileCounts, ConvError>;

    fn run<S: Lanes<T>>(mut self, simd: S) -> Self::Output {
        let plan = self.job.plan;
        let ranges = |stretches: &[Stretch], first: usize| -> Vec<(usize, usize)> {
            stretches
                .iter()
                .map(|s| (s.start() - first, s.end() - first))
                .collect()
        };
        let columns = ranges(&plan.tiling.columns, 0);
        let rows = ranges(&plan.tiling.rows[self.job.rows.clone()], self.job.first_output);
        let mut tasks = Vec::new();
        let parts = split(self.output.view_mut(), 0, &rows);
        for (row, part) in self.job.rows.clone().zip(parts) {
            let parts = split(part, 1, &columns);
            tasks.extend(
                parts
                    .into_iter()
                    .enumerate()
                    .map(|(column, part)| (column, row, part)),
            );
        }
        let job = &self.job;
        let done: Vec<Result<TileCounts, ConvError>> = tasks
            .into_par_iter()
            .with_max_len(1)
            .map(|(column, row, output)| {
                let counts = plan.pool().with(&plan.fft, |workspace| {
                    gather_block(simd, job, (column, row), output, workspace)
                });
                if column + 1 == columns.len() {
                    job.progress.advance(1);
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
    job: &Job<'_, T>,
    (column, row): (usize, usize),
    mut output: ArrayViewMut2<'_, T>,
    workspace: &mut Workspace<T>,
) -> Result<TileCounts, ConvError> {
    let plan = job.plan;
    let mut block = GatherBlock {
        simd,
        job,
        engine: plan.engine(job.flip),
        prepared: Prepared::new(plan, plan.block(column, row)),
        workspace,
        counts: TileCounts::default(),
    };
    let (across, up) = (&plan.tiling.columns[column], &plan.tiling.rows[row]);
    for &(y, rows) in &up.tiles {
        for &(x, columns) in &across.tiles {
            let (i, j) = (x - across.start(), y - up.start());
            let part = TilePart {
                corner: (i + across.lead, j + up.lead),
                size: (columns, rows),
            };
            block.tile((x, y), part, output.slice_mut(s![j..j + rows, i..i + columns]))?;
        }
    }
    Ok(block.counts)
}

/// Views are invariant: the job's and the work's lifetimes stay apart.
struct GatherBlock<'w, 'j, T: ConvReal, S> {
    simd: S,
    job: &'w Job<'j, T>,
    engine: TileEngine<'w, T>,
    prepared: Prepared<'w, T>,
    workspace: &'w mut Workspace<T>,
    counts: TileCounts,
}

impl<T: ConvReal, S: Lanes<T>> GatherBlock<'_, '_, T, S> {
    /// One tile, whose first pixel is (`x`, `y`) of the weighted side.
    fn tile(
        &mut self,
        (x, y): (usize, usize),
        part: TilePart,
        mut output: ArrayViewMut2<'_, T>,
    ) -> Result<(), ConvError> {
        let (simd, engine) = (self.simd, self.engine);
        let workspace = &mut *self.workspace;
        let tile = PlacedTile { first: (x, y), part };
        let (job, prepared) = (self.job, &mut self.prepared);
        let Some(treatment) = treated(
            simd,
            job,
            prepared,
            Direction::Gather,
            tile,
            Ways::Both,
            workspace,
        )?
        else {
            self.counts.dark += 1;
            return Ok(());
        };
        self.counts.count(&treatment, self.prepared.kernel_count());
        if treatment.whole == Some(Whole::ByTransforms) {
            self.prepared.kernels(simd, &engine, workspace);
        }
        let local = self.prepared.local(part);
        if let Some(whole) = treatment.whole {
            let gather = |workspace: &mut Workspace<T>, output: &mut ArrayViewMut2<'_, T>| {
                simd.vectorized(
                    #[inline(always)]
                    || match whole {
                        Whole::Directly => engine.gather_directly(simd, local, workspace, output),
                        Whole::ByTransforms => engine.gather(simd, local, workspace, output),
                    },
                );
            };
            match treatment.back {
                None => gather(workspace, &mut output),
                // What is in the output already has its own light.
                Some(back) => {
                    let mut near_one = Array2::zeros(output.dim());
                    gather(workspace, &mut near_one.view_mut());
                    output.zip_mut_with(&near_one, |value, &v| *value += v * back);
                }
            }
        }
        if !treatment.drawn.is_empty() {
            let row = &mut workspace.row;
            simd.vectorized(
                #[inline(always)]
                || engine.draw_gathered(simd, local, &treatment.drawn, row, &mut output),
            );
        }
        Ok(())
    }
}
