//! What a scene has for a batch to do.

use pulp::bytemuck::cast_slice;
use rayon::prelude::*;

use super::device::Attempt;
use super::engine::GpuEngine;
use super::error::GpuError;
use super::panels::{Batch, Panel, Part, TileSlot};
use super::words::{Draw, Tile};
use super::work_layout::Layout;
use crate::lowrank::TileCounts;
use crate::lowrank::shared::{Direction, Job, Prepared, Treatment, Ways, treated};
use crate::simd::Lanes;
use crate::{ConvError, ConvReal};

/// Tiles with light, by colour, and the single pixels that are drawn. For the place of their table they have the number of their part.
#[derive(Debug, Default)]
pub(super) struct LitBatch {
    pub(super) tiles: Vec<(usize, Tile)>,
    pub(super) drawn: Vec<(usize, DrawnTile)>,
    /// First values and lengths of the light that was written.
    pub(super) light: Vec<(usize, usize)>,
    pub(super) counts: TileCounts,
}

impl LitBatch {
    pub(super) fn is_dark(&self) -> bool {
        self.tiles.is_empty() && self.drawn.is_empty()
    }

    /// Puts the places of the parts' tables where their numbers are.
    pub(super) fn find_tables(&mut self, starts: &[u32]) {
        let tables = self.tiles.iter_mut().map(|(_, tile)| &mut tile.table);
        let of_drawn = self.drawn.iter_mut().map(|(_, tile)| &mut tile.draw.table);
        for table in tables.chain(of_drawn) {
            *table = starts[*table as usize];
        }
    }
}

/// Single pixels of a tile, and what it takes to draw them.
#[derive(Debug)]
pub(super) struct DrawnTile {
    /// Without the places of pixels and amounts.
    pub(super) draw: Draw,
    /// Row and column of each stamp's first pixel within the result.
    pub(super) pixels: Vec<[i32; 2]>,
    pub(super) amounts: Vec<f32>,
}

/// The light of a batch's tiles written to a mapped buffer, and what is to be done with it.
pub(super) struct Examination<'a, 'j, T: ConvReal> {
    pub(super) device: &'a Attempt,
    pub(super) engine: &'a GpuEngine,
    pub(super) layout: &'a Layout,
    pub(super) panel: &'a Panel,
    pub(super) batch: &'a Batch,
    pub(super) job: &'a Job<'j, T>,
    pub(super) staging: &'a wgpu::Buffer,
}

impl<T: ConvReal> Examination<'_, '_, T> {
    pub(super) fn examine<S: Lanes<T>>(&self, simd: S) -> Result<LitBatch, ConvError> {
        let parts = self.batch.parts.iter().zip(0..);
        // Tile by tile, unless a block's tiles share what is made for them.
        let tasks: Vec<(&Part, u32, &[TileSlot])> = parts
            .flat_map(|(part, number)| {
                let together = if self.job.plan.keeps(part.block) {
                    1
                } else {
                    part.tiles.len()
                };
                let tasks = part.tiles.chunks(together.max(1));
                tasks.map(move |tiles| (part, number, tiles))
            })
            .collect();
        let parts: Vec<Result<LitBatch, ConvError>> = tasks
            .into_par_iter()
            .with_max_len(1)
            .map(|(part, number, tiles)| self.tiles(simd, part, number, tiles))
            .collect();
        let mut all = LitBatch::default();
        for part in parts {
            let part = part?;
            all.tiles.extend(part.tiles);
            all.drawn.extend(part.drawn);
            all.light.extend(part.light);
            all.counts += part.counts;
        }
        // Stable: within a colour they keep their order.
        all.tiles.sort_by_key(|(colour, _)| *colour);
        all.drawn.sort_by_key(|(colour, _)| *colour);
        Ok(all)
    }

    /// Some tiles of a part.
    fn tiles<S: Lanes<T>>(
        &self,
        simd: S,
        part: &Part,
        number: u32,
        tiles: &[TileSlot],
    ) -> Result<LitBatch, ConvError> {
        let plan = self.job.plan;
        let mut lit = LitBatch::default();
        let mut prepared = Prepared::of_block(plan, part.block);
        plan.with_workspace(|workspace| {
            for slot in tiles {
                let treatment = treated(
                    simd,
                    self.job,
                    &mut prepared,
                    self.layout.direction,
                    slot.tile,
                    Ways::Transforms,
                    workspace,
                )?;
                // A tile whose kernels come in several parts counts once.
                let first = part.kernels.start == 0;
                let Some(treatment) = treatment else {
                    lit.counts.dark += usize::from(first);
                    continue;
                };
                if first {
                    lit.counts.count(&treatment, prepared.kernel_count());
                }
                if treatment.whole.is_some() {
                    let plane = workspace.light.get();
                    self.write_light(plane, slot)?;
                    let (columns, rows) = self.light_size(slot);
                    lit.light.push((slot.light, columns * rows));
                    lit.tiles
                        .push((slot.colour, self.tile(part, slot, number, &treatment)));
                }
                if !treatment.drawn.is_empty() {
                    let drawn = self.drawn(&mut prepared, part, slot, number, &treatment);
                    lit.drawn.push((slot.colour, drawn));
                }
            }
            Ok(lit)
        })
    }

    fn light_size(&self, slot: &TileSlot) -> (usize, usize) {
        self.engine
            .view
            .light_size(self.layout.direction, slot.tile.part.size)
    }

    /// Copies a tile's light to its place in the mapped buffer.
    fn write_light(&self, plane: &[T], slot: &TileSlot) -> Result<(), GpuError> {
        let (columns, rows) = self.light_size(slot);
        let (first, bytes) = (4 * slot.light as u64, 4 * columns);
        let range = first..first + (rows * bytes) as u64;
        let view = self.staging.slice(range).get_mapped_range_mut();
        let mut view = view.map_err(|error| self.device.failed(&error))?;
        let rows_of_plane = plane.chunks_exact(self.job.plan.pitch());
        for (row, values) in rows_of_plane.take(rows).enumerate() {
            view.slice(row * bytes..(row + 1) * bytes)
                .copy_from_slice(cast_slice(&values[..columns]));
        }
        Ok(())
    }

    /// First pixel of a tile's result within the panel, and the result's size.
    fn result(&self, slot: &TileSlot) -> ((i32, i32), (usize, usize)) {
        let view = &self.engine.view;
        let (first, size) = match self.layout.direction {
            Direction::Scatter => (
                view.reach_from(slot.tile.first),
                view.light_size(Direction::Gather, slot.tile.part.size),
            ),
            Direction::Gather => (
                (slot.tile.first.0 as i64, slot.tile.first.1 as i64),
                slot.tile.part.size,
            ),
        };
        let output = self.panel.output;
        let place = (
            (first.0 - output.column as i64) as i32,
            (first.1 - output.row as i64) as i32,
        );
        (place, size)
    }

    /// Columns and rows by which the light that a tile takes begins before its result.
    fn skip(&self) -> (usize, usize) {
        let stamp = self.engine.view.stamp();
        match self.layout.direction {
            Direction::Scatter => (0, 0),
            Direction::Gather => (stamp.0 - 1, stamp.1 - 1),
        }
    }

    fn tile(&self, part: &Part, slot: &TileSlot, number: u32, treatment: &Treatment<T>) -> Tile {
        let (columns, rows) = self.light_size(slot);
        let (place, size) = self.result(slot);
        let skip = self.skip();
        Tile {
            light: slot.light as u32,
            width: columns as u32,
            height: rows as u32,
            plane: slot.plane as u32,
            spectrum: part.spectrum as u32,
            kernels: part.kernels.len() as u32,
            table: number,
            column: slot.tile.part.corner.0 as u32,
            row: slot.tile.part.corner.1 as u32,
            out_column: place.0,
            out_row: place.1,
            out_width: size.0 as u32,
            out_height: size.1 as u32,
            skip_column: skip.0 as u32,
            skip_row: skip.1 as u32,
            back: treatment.back.map_or(1.0, |back| back.as_f64() as f32),
        }
    }

    fn drawn(
        &self,
        prepared: &mut Prepared<'_, T>,
        part: &Part,
        slot: &TileSlot,
        number: u32,
        treatment: &Treatment<T>,
    ) -> DrawnTile {
        let (place, size) = self.result(slot);
        let skip = self.skip();
        let corner = slot.tile.part.corner;
        let pixels = treatment
            .drawn
            .iter()
            .map(|&(row, column, _)| [row as i32 - skip.1 as i32, column as i32 - skip.0 as i32])
            .collect();
        let amounts = match self.layout.direction {
            Direction::Gather => treatment
                .drawn
                .iter()
                .map(|(_, _, value)| value.as_f64() as f32)
                .collect(),
            Direction::Scatter => {
                let ramp = self.job.plan.ramp();
                let (table, _) = prepared.table_and_stamps();
                let pairs = treatment
                    .drawn
                    .iter()
                    .flat_map(|pixel| part.kernels.clone().map(move |kernel| (pixel, kernel)));
                pairs
                    .map(|(&(row, column, value), kernel)| {
                        let mut amount = [T::zero()];
                        let (row, column) = (corner.1 + row, corner.0 + column);
                        table.weigh(kernel, row, column, &[value], ramp, &mut amount);
                        amount[0].as_f64() as f32
                    })
                    .collect()
            }
        };
        DrawnTile {
            draw: Draw {
                pixels: treatment.drawn.len() as u32,
                stamps: part.stamp as u32,
                kernels: part.kernels.len() as u32,
                table: number,
                column: corner.0 as u32,
                row: corner.1 as u32,
                out_column: place.0,
                out_row: place.1,
                out_width: size.0 as u32,
                out_height: size.1 as u32,
                ..Draw::default()
            },
            pixels,
            amounts,
        }
    }
}
