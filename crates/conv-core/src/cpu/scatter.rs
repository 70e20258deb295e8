//! Scattering: light of the weighted side spreads to the other side. One side is the light, the
//! other is the image. PSFs belong to the pixels of the weighted side.

use ndarray::ArrayViewMut2;
use rayon::prelude::*;

use super::processor::LightPass;
use super::tile_engine::Workspace;
use super::treatment::{TileCounts, TileMethod, each_tile};
use crate::overlap::{colours, split};
use crate::plan::geometry::Direction;
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

/// The first pixel and the end of the range that each column or row of blocks reaches on the other
/// side.
type Extents = Vec<(usize, usize)>;

/// A block's part of the output, and the part's first column and row on the other side.
struct Task<'a, T> {
    column: usize,
    row: usize,
    output: ArrayViewMut2<'a, T>,
    origin: (usize, usize),
}

impl<T: ConvReal> WithIsa<T> for Scatter<'_, '_, T> {
    type Output = Result<TileCounts, ConvError>;

    fn run<S: Lanes<T>>(mut self, simd: S) -> Self::Output {
        let plan = &self.pass.processor.plan;
        let extents = (plan.extents(0), plan.extents(1));
        let columns = &extents.0;
        // The numbers of colours depend on all rows of blocks, so that a band has the same colours
        // even if it is executed alone.
        let (column_colours, row_colours) = (colours(columns), colours(&extents.1));
        let bands: Vec<usize> = self.pass.rows.clone().step_by(plan.tiling.band()).collect();
        let mut counts = TileCounts::default();
        for first in bands {
            let band = first..(first + plan.tiling.band()).min(self.pass.rows.end);
            for row_colour in 0..row_colours {
                let rows: Vec<usize> = band
                    .clone()
                    .filter(|row| row % row_colours == row_colour)
                    .collect();
                for column_colour in 0..column_colours {
                    let of_colour: Vec<usize> =
                        (column_colour..columns.len()).step_by(column_colours).collect();
                    counts += self.together(simd, &extents, &rows, &of_colour)?;
                }
            }
            self.pass.progress.advance(band.len() as u64);
        }
        Ok(counts)
    }
}

impl<T: ConvReal> Scatter<'_, '_, T> {
    /// Executes the blocks at some rows and columns. Their outputs do not overlap.
    fn together<S: Lanes<T>>(
        &mut self,
        simd: S,
        (column_extents, row_extents): &(Extents, Extents),
        rows: &[usize],
        columns: &[usize],
    ) -> Result<TileCounts, ConvError> {
        let first_output = self.pass.first_output;
        let height = self.output.nrows();
        let within = |row: usize| row.saturating_sub(first_output).min(height);
        let row_ranges: Vec<(usize, usize)> = rows
            .iter()
            .map(|&row| (within(row_extents[row].0), within(row_extents[row].1)))
            .collect();
        let column_ranges: Vec<(usize, usize)> = columns.iter().map(|&c| column_extents[c]).collect();
        let mut tasks = Vec::with_capacity(rows.len() * columns.len());
        let parts = split(self.output.view_mut(), 0, &row_ranges);
        for ((&row, part), &(top, _)) in rows.iter().zip(parts).zip(&row_ranges) {
            let parts = split(part, 1, &column_ranges);
            for ((&column, output), &(left, _)) in columns.iter().zip(parts).zip(&column_ranges) {
                tasks.push(Task {
                    column,
                    row,
                    output,
                    origin: (left, top + first_output),
                });
            }
        }
        let pass = &self.pass;
        let done: Vec<Result<TileCounts, ConvError>> = tasks
            .into_par_iter()
            .with_max_len(1)
            .map(|task| {
                pass.processor
                    .with_workspace(|workspace| scatter_block(simd, pass, task, workspace))
            })
            .collect();
        let mut counts = TileCounts::default();
        for outcome in done {
            counts += outcome?;
        }
        Ok(counts)
    }
}

fn scatter_block<T: ConvReal, S: Lanes<T>>(
    simd: S,
    pass: &LightPass<'_, T>,
    task: Task<'_, T>,
    workspace: &mut Workspace<T>,
) -> Result<TileCounts, ConvError> {
    let plan = &pass.processor.plan;
    let engine = pass.tile_engine();
    let (block, origin, mut output) = ((task.column, task.row), task.origin, task.output);
    each_tile(
        simd,
        pass,
        Direction::Scatter,
        block,
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
