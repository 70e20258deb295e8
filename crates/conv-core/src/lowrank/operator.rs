//! The operator of a plan and its transpose, on many threads.

use ndarray::{ArrayView2, ArrayViewMut2, s};
use psf_types::{FieldError, Progress};
use rayon::prelude::*;

use super::block::Block;
use super::coefficient_table::CoefficientTable;
use super::execution::TileCounts;
use super::light::{Light, LitPixel, lit_pixels, look, take_bright};
use super::options::Paths;
use super::plan::Plan;
use super::split::{colours, split};
use super::tile_engine::{TileEngine, TilePart};
use super::workspace::Workspace;
use crate::ConvReal;
use crate::simd::{Lanes, WithIsa};

/// Spreads light of the weighted side: `output(q) += sum_p c(p) light(p) k(q - p)`.
pub(crate) struct Scatter<'a, T: ConvReal> {
    pub(crate) plan: &'a Plan<T>,
    /// Rows of blocks.
    pub(crate) rows: std::ops::Range<usize>,
    /// Light from row `first_light` of the weighted side on.
    pub(crate) light: ArrayView2<'a, T>,
    pub(crate) first_light: usize,
    /// The other side from row `first_output` on.
    pub(crate) output: ArrayViewMut2<'a, T>,
    pub(crate) first_output: usize,
    pub(crate) flip: bool,
    pub(crate) progress: &'a dyn Progress,
}

/// Gathers light of the other side: `output(p) += c(p) sum_q light(q) k(q - p)`.
pub(crate) struct Gather<'a, T: ConvReal> {
    pub(crate) plan: &'a Plan<T>,
    pub(crate) rows: std::ops::Range<usize>,
    /// Light from row `first_light` of the other side on.
    pub(crate) light: ArrayView2<'a, T>,
    pub(crate) first_light: usize,
    /// The weighted side from row `first_output` on.
    pub(crate) output: ArrayViewMut2<'a, T>,
    pub(crate) first_output: usize,
    pub(crate) flip: bool,
    pub(crate) progress: &'a dyn Progress,
}

/// How a tile is treated.
enum Treatment<T> {
    Dark,
    /// Stamp by stamp.
    Drawn(Vec<LitPixel<T>>),
    /// The rest of the light at once, after single pixels were taken out of it.
    Whole {
        direct: bool,
        apart: Vec<LitPixel<T>>,
    },
}

impl<T: ConvReal> WithIsa<T> for Scatter<'_, T> {
    type Output = Result<TileCounts, FieldError>;

    fn run<S: Lanes<T>>(mut self, simd: S) -> Self::Output {
        let plan = self.plan;
        let engine = plan.engine(self.flip);
        let height = self.output.nrows();
        let first_output = self.first_output;
        let columns: Vec<(usize, usize)> = plan.column_extents();
        let rows: Vec<(usize, usize)> = plan
            .row_extents()
            .into_iter()
            .map(|(from, to)| {
                (
                    from.saturating_sub(first_output).min(height),
                    to.saturating_sub(first_output).min(height),
                )
            })
            .collect();
        let column_colours = colours(&columns);
        // Of all rows, so that part of a frame is made like the whole of it.
        let row_colours = colours(&plan.row_extents());
        let mut counts = TileCounts::default();
        for band in self.rows.clone().step_by(plan.tiling.band()) {
            let band = band..(band + plan.tiling.band()).min(self.rows.end);
            for row_colour in 0..row_colours {
                let of_rows: Vec<usize> = band
                    .clone()
                    .filter(|row| row % row_colours == row_colour)
                    .collect();
                let row_ranges: Vec<(usize, usize)> = of_rows.iter().map(|&row| rows[row]).collect();
                for column_colour in 0..column_colours {
                    let of_columns: Vec<usize> =
                        (column_colour..columns.len()).step_by(column_colours).collect();
                    let column_ranges: Vec<(usize, usize)> = of_columns.iter().map(|&c| columns[c]).collect();
                    let mut tasks = Vec::new();
                    let parts = split(self.output.view_mut(), 0, &row_ranges);
                    for (&row, part) in of_rows.iter().zip(parts) {
                        let parts = split(part, 1, &column_ranges);
                        tasks.extend(
                            of_columns
                                .iter()
                                .zip(parts)
                                .map(|(&column, part)| (column, row, part)),
                        );
                    }
                    let done: Vec<Result<TileCounts, FieldError>> = tasks
                        .into_par_iter()
                        .with_max_len(1)
                        .map(|(column, row, output)| {
                            let origin = (columns[column].0, rows[row].0 + first_output);
                            plan.pool().with(&plan.fft, |workspace| {
                                scatter_block(
                                    simd,
                                    plan,
                                    engine,
                                    (column, row),
                                    (self.light, self.first_light),
                                    output,
                                    origin,
                                    workspace,
                                )
                            })
                        })
                        .collect();
                    for outcome in done {
                        counts += outcome?;
                    }
                }
            }
            self.progress.advance(band.len() as u64);
        }
        Ok(counts)
    }
}

#[allow(clippy::too_many_arguments)] // A block's worth of everything.
fn scatter_block<T: ConvReal, S: Lanes<T>>(
    simd: S,
    plan: &Plan<T>,
    engine: TileEngine<'_, T>,
    (column, row): (usize, usize),
    (light, first_light): (ArrayView2<'_, T>, usize),
    mut output: ArrayViewMut2<'_, T>,
    origin: (usize, usize),
    workspace: &mut Workspace<T>,
) -> Result<TileCounts, FieldError> {
    let block = plan.block(column, row);
    let (across, up) = (&plan.tiling.columns[column], &plan.tiling.rows[row]);
    let mut counts = TileCounts::default();
    let mut prepared = Prepared::new(plan, block);
    for &(y, rows) in &up.tiles {
        for &(x, columns) in &across.tiles {
            let part = TilePart {
                corner: (x - across.start(), y - up.start()),
                size: (columns, rows),
            };
            let seen = simd.vectorized(
                #[inline(always)]
                || {
                    let corner = (x as i64, y as i64 - first_light as i64);
                    engine.load(simd, light, corner, part.size, workspace.light.get_mut());
                    look(workspace.light.get(), plan.fft.pitch(), rows, columns)
                },
            );
            if seen.lit == 0 {
                counts.dark += 1;
                continue;
            }
            let table = prepared.table();
            if table.has_undefined() {
                let plane = workspace.light.get();
                let lit = |row: usize, column: usize| {
                    let inside = (
                        row.wrapping_sub(part.corner.1),
                        column.wrapping_sub(part.corner.0),
                    );
                    inside.0 < rows && inside.1 < columns && {
                        !plane[inside.0 * plan.fft.pitch() + inside.1].is_zero()
                    }
                };
                table.check(&plan.model, lit)?;
            }
            let reach = plan.geometry.reach_from(x, y);
            let place = (reach.0 - origin.0 as i64, reach.1 - origin.1 as i64);
            let treatment = treat(
                plan,
                &engine,
                seen,
                part.size,
                part.size,
                block.kernel_count(),
                workspace,
            );
            let drawn = match treatment {
                Treatment::Dark => continue,
                Treatment::Drawn(pixels) => {
                    counts.drawn += 1;
                    pixels
                }
                Treatment::Whole { direct, apart } => {
                    if direct {
                        counts.direct += 1;
                    } else {
                        counts.transformed += 1;
                        counts.modes += block.kernel_count();
                        prepared.kernels(simd, &engine, workspace);
                    }
                    let (table, stamps) = prepared.parts();
                    simd.vectorized(
                        #[inline(always)]
                        || {
                            if direct {
                                engine.scatter_directly(simd, table, part, stamps, workspace);
                            } else {
                                engine.scatter(simd, table, part, workspace);
                            }
                            let size = (columns + engine.stamp.0 - 1, rows + engine.stamp.1 - 1);
                            engine.add(simd, workspace.weighted.get(), size, &mut output, place);
                        },
                    );
                    apart
                }
            };
            if !drawn.is_empty() {
                counts.drawn_pixels += drawn.len();
                let (table, stamps) = prepared.parts();
                simd.vectorized(
                    #[inline(always)]
                    || engine.draw_scattered(simd, table, part, stamps, &drawn, &mut output, place),
                );
            }
        }
    }
    Ok(counts)
}

impl<T: ConvReal> WithIsa<T> for Gather<'_, T> {
    type Output = Result<TileCounts, FieldError>;

    fn run<S: Lanes<T>>(mut self, simd: S) -> Self::Output {
        let plan = self.plan;
        let engine = plan.engine(self.flip);
        let ranges = |stretches: &[super::axis_cuts::Stretch], first: usize| -> Vec<(usize, usize)> {
            stretches
                .iter()
                .map(|s| (s.start() - first, s.end() - first))
                .collect()
        };
        let columns = ranges(&plan.tiling.columns, 0);
        let rows = ranges(&plan.tiling.rows[self.rows.clone()], self.first_output);
        let mut counts = TileCounts::default();
        let mut tasks = Vec::new();
        let parts = split(self.output.view_mut(), 0, &rows);
        for (row, part) in self.rows.clone().zip(parts) {
            let parts = split(part, 1, &columns);
            tasks.extend(
                parts
                    .into_iter()
                    .enumerate()
                    .map(|(column, part)| (column, row, part)),
            );
        }
        let across = columns.len();
        let done: Vec<Result<TileCounts, FieldError>> = tasks
            .into_par_iter()
            .with_max_len(1)
            .map(|(column, row, output)| {
                let counts = plan.pool().with(&plan.fft, |workspace| {
                    gather_block(
                        simd,
                        plan,
                        engine,
                        (column, row),
                        (self.light, self.first_light),
                        output,
                        workspace,
                    )
                });
                if column + 1 == across {
                    self.progress.advance(1);
                }
                counts
            })
            .collect();
        for outcome in done {
            counts += outcome?;
        }
        Ok(counts)
    }
}

fn gather_block<T: ConvReal, S: Lanes<T>>(
    simd: S,
    plan: &Plan<T>,
    engine: TileEngine<'_, T>,
    (column, row): (usize, usize),
    (light, first_light): (ArrayView2<'_, T>, usize),
    mut output: ArrayViewMut2<'_, T>,
    workspace: &mut Workspace<T>,
) -> Result<TileCounts, FieldError> {
    let block = plan.block(column, row);
    let (across, up) = (&plan.tiling.columns[column], &plan.tiling.rows[row]);
    let mut counts = TileCounts::default();
    let mut prepared = Prepared::new(plan, block);
    for &(y, rows) in &up.tiles {
        for &(x, columns) in &across.tiles {
            let part = TilePart {
                corner: (x - across.start(), y - up.start()),
                size: (columns, rows),
            };
            let around = (columns + engine.stamp.0 - 1, rows + engine.stamp.1 - 1);
            let seen = simd.vectorized(
                #[inline(always)]
                || {
                    let reach = plan.geometry.reach_from(x, y);
                    let corner = (reach.0, reach.1 - first_light as i64);
                    engine.load(simd, light, corner, around, workspace.light.get_mut());
                    look(workspace.light.get(), plan.fft.pitch(), around.1, around.0)
                },
            );
            if seen.lit == 0 {
                counts.dark += 1;
                continue;
            }
            let table = prepared.table();
            if table.has_undefined() {
                let plane = workspace.light.get();
                // A pixel needs its PSF where any light reaches it.
                let lit = |row: usize, column: usize| {
                    let (y, x) = (
                        row.wrapping_sub(part.corner.1),
                        column.wrapping_sub(part.corner.0),
                    );
                    y < rows && x < columns && {
                        (y..y + engine.stamp.1).any(|j| {
                            let row = &plane[j * plan.fft.pitch()..][x..x + engine.stamp.0];
                            row.iter().any(|v| !v.is_zero())
                        })
                    }
                };
                table.check(&plan.model, lit)?;
            }
            let mut output = output.slice_mut(s![
                part.corner.1..part.corner.1 + rows,
                part.corner.0..part.corner.0 + columns
            ]);
            let treatment = treat(
                plan,
                &engine,
                seen,
                around,
                part.size,
                block.kernel_count(),
                workspace,
            );
            let drawn = match treatment {
                Treatment::Dark => continue,
                Treatment::Drawn(pixels) => {
                    counts.drawn += 1;
                    pixels
                }
                Treatment::Whole { direct, apart } => {
                    if direct {
                        counts.direct += 1;
                    } else {
                        counts.transformed += 1;
                        counts.modes += block.kernel_count();
                        prepared.kernels(simd, &engine, workspace);
                    }
                    let (table, stamps) = prepared.parts();
                    simd.vectorized(
                        #[inline(always)]
                        || {
                            if direct {
                                engine.gather_directly(simd, table, part, stamps, workspace, &mut output);
                            } else {
                                engine.gather(simd, table, part, workspace, &mut output);
                            }
                        },
                    );
                    apart
                }
            };
            if !drawn.is_empty() {
                counts.drawn_pixels += drawn.len();
                let (table, stamps) = prepared.parts();
                let row = &mut workspace.row;
                simd.vectorized(
                    #[inline(always)]
                    || engine.draw_gathered(simd, table, part, stamps, &drawn, row, &mut output),
                );
            }
        }
    }
    Ok(counts)
}

/// Decides on the light in `workspace.light`, `lit_size` columns and rows; single pixels are taken out of it.
fn treat<T: ConvReal>(
    plan: &Plan<T>,
    engine: &TileEngine<'_, T>,
    light: Light,
    lit_size: (usize, usize),
    tile: (usize, usize),
    kernels: usize,
    workspace: &mut Workspace<T>,
) -> Treatment<T> {
    if light.lit == 0 || kernels == 0 {
        return Treatment::Dark;
    }
    if plan.options.paths() == Paths::Transforms {
        return Treatment::Whole {
            direct: false,
            apart: Vec::new(),
        };
    }
    let pitch = plan.fft.pitch();
    let draw = plan.cost.draw(engine.stamp, kernels);
    let (whole, direct) = plan.whole_tile(tile, kernels);
    if light.lit as f64 * draw <= whole {
        return Treatment::Drawn(lit_pixels(workspace.light.get(), pitch, lit_size.1, lit_size.0));
    }
    // The direct sum spreads no noise.
    let apart = if direct {
        Vec::new()
    } else {
        let most = (2.0 * whole / draw) as usize;
        take_bright(
            workspace.light.get_mut(),
            pitch,
            (lit_size.1, lit_size.0),
            light,
            most,
        )
    };
    Treatment::Whole { direct, apart }
}

/// What the tiles of a block share, made when the first of them needs it.
struct Prepared<'a, T: ConvReal> {
    plan: &'a Plan<T>,
    block: &'a Block<T>,
    table: Option<super::block::Table<'a, T>>,
    stamps: Option<std::borrow::Cow<'a, [T]>>,
    transformed: bool,
}

impl<'a, T: ConvReal> Prepared<'a, T> {
    fn new(plan: &'a Plan<T>, block: &'a Block<T>) -> Self {
        Self {
            plan,
            block,
            table: None,
            stamps: None,
            transformed: false,
        }
    }

    fn table(&mut self) -> &CoefficientTable<T> {
        let (block, model) = (self.block, &self.plan.model);
        self.table.get_or_insert_with(|| block.table(model))
    }

    fn parts(&mut self) -> (&CoefficientTable<T>, &[T]) {
        let (block, plan) = (self.block, self.plan);
        let stamps = self.stamps.get_or_insert_with(|| block.stamps(&plan.space));
        let table = self.table.get_or_insert_with(|| block.table(&plan.model));
        (table, stamps)
    }

    /// Sees to the kernels' spectra in the workspace.
    fn kernels<S: Lanes<T>>(&mut self, simd: S, engine: &TileEngine<'_, T>, workspace: &mut Workspace<T>) {
        if !self.transformed {
            let (_, stamps) = self.parts();
            simd.vectorized(
                #[inline(always)]
                || engine.transform_kernels(simd, stamps, workspace),
            );
            self.transformed = true;
        }
    }
}
