//! The work of a batch for given light.

use pulp::bytemuck::cast_slice;
use rayon::prelude::*;

use super::device::Attempt;
use super::panels::{Batch, Panel, Part, TileSlot};
use super::shader::{Draw, Place, Tile};
use crate::cpu::processor::{BlockKernels, LightPass};
use crate::cpu::treatment::{TileCounts, Treatment, treated};
use crate::error::GpuError;
use crate::plan::geometry::{Direction, Geometry};
use crate::{ConvError, ConvReal};

/// The lit tiles to be transformed, and the tiles of which single pixels are drawn. Each tile comes
/// with its colour: the results of tiles of one colour do not overlap. `place.table` of a tile is
/// at first the index of the tile's part. [`find_tables`](Self::find_tables) replaces this index by
/// the place of the part's table.
#[derive(Debug, Default)]
pub(super) struct LitBatch {
    pub(super) tiles: Vec<(usize, Tile)>,
    pub(super) drawn: Vec<(usize, DrawnTile)>,
    /// Index of the first value and number of values of each tile's light in the mapped buffer.
    pub(super) light: Vec<(usize, usize)>,
    pub(super) counts: TileCounts,
}

impl LitBatch {
    pub(super) fn is_dark(&self) -> bool {
        self.tiles.is_empty() && self.drawn.is_empty()
    }

    /// Replaces the part index in each tile's `place.table` by the index of the first word of the
    /// part's table. `starts` holds the latter index for each part.
    pub(super) fn find_tables(&mut self, starts: &[u32]) {
        let tables = self.tiles.iter_mut().map(|(_, tile)| &mut tile.place.table);
        let of_drawn = self.drawn.iter_mut().map(|(_, tile)| &mut tile.draw.place.table);
        for table in tables.chain(of_drawn) {
            *table = starts[*table as usize];
        }
    }
}

/// Single pixels of a tile, and the data needed to draw them.
#[derive(Debug)]
pub(super) struct DrawnTile {
    /// `first_pixel` and `first_amount` are 0. `BatchCalls` sets them later.
    pub(super) draw: Draw,
    /// Row and column of each stamp's first pixel within the result.
    pub(super) pixels: Vec<[i32; 2]>,
    /// The light of each pixel or, if the tile scatters light, this light times the coefficient of
    /// each kernel.
    pub(super) amounts: Vec<f32>,
}

/// Inspects the light of a batch's tiles and writes it to a mapped buffer.
pub(super) struct Examination<'a, 'j, T: ConvReal> {
    pub(super) device: &'a Attempt,
    pub(super) panel: &'a Panel,
    pub(super) batch: &'a Batch,
    pub(super) pass: &'a LightPass<'j, T>,
    pub(super) staging: &'a wgpu::Buffer,
}

impl<T: ConvReal> Examination<'_, '_, T> {
    pub(super) fn examine(&self) -> Result<LitBatch, ConvError> {
        let parts = self.batch.parts.iter();
        // Each tile is a task. But if the plan does not keep a block's data, the block's tiles are
        // one task, which computes the data once.
        let tasks: Vec<(&Part, &[TileSlot])> = parts
            .flat_map(|part| {
                let block = self.pass.processor.plan.block(part.block.0, part.block.1);
                let is_kept = block.table.is_some() && block.stamps.is_some();
                let together = if is_kept { 1 } else { part.tiles.len().max(1) };
                part.tiles.chunks(together).map(move |tiles| (part, tiles))
            })
            .collect();
        let parts: Vec<Result<LitBatch, ConvError>> = tasks
            .into_par_iter()
            .with_max_len(1)
            .map(|(part, tiles)| self.tiles(part, tiles))
            .collect();
        let mut all = LitBatch::default();
        for part in parts {
            let part = part?;
            all.tiles.extend(part.tiles);
            all.drawn.extend(part.drawn);
            all.light.extend(part.light);
            all.counts += part.counts;
        }
        // The sort is stable: tiles of a colour keep their order.
        all.tiles.sort_by_key(|(colour, _)| *colour);
        all.drawn.sort_by_key(|(colour, _)| *colour);
        Ok(all)
    }

    /// Inspects some tiles of a part.
    fn tiles(&self, part: &Part, tiles: &[TileSlot]) -> Result<LitBatch, ConvError> {
        let processor = self.pass.processor;
        let mut lit = LitBatch::default();
        let kernels = BlockKernels::new(&processor.plan, part.block);
        processor.with_workspace(|workspace| {
            for slot in tiles {
                let treatment = treated(self.pass, &kernels, slot.tile, workspace)?;
                // A tile whose kernels are in several parts counts once.
                let first = part.kernels.start == 0;
                let Some(treatment) = treatment else {
                    lit.counts.dark += usize::from(first);
                    continue;
                };
                if first {
                    lit.counts.count(&treatment, kernels.block.kernel_count());
                }
                if treatment.method.is_some() {
                    let plane = workspace.light.get();
                    self.write_light(plane, slot)?;
                    let (columns, rows) = self.light_size(slot);
                    lit.light.push((slot.light, columns * rows));
                    lit.tiles.push((slot.colour, self.tile(part, slot, &treatment)));
                }
                if !treatment.drawn.is_empty() {
                    let drawn = self.drawn(&kernels, part, slot, &treatment);
                    lit.drawn.push((slot.colour, drawn));
                }
            }
            Ok(lit)
        })
    }

    fn geometry(&self) -> &Geometry {
        &self.pass.processor.plan.geometry
    }

    fn light_size(&self, slot: &TileSlot) -> (usize, usize) {
        self.geometry().light_size(self.pass.direction(), slot.tile.size)
    }

    /// Copies a tile's light to its place in the mapped buffer.
    fn write_light(&self, plane: &[T], slot: &TileSlot) -> Result<(), GpuError> {
        let (columns, rows) = self.light_size(slot);
        let (first, bytes) = (4 * slot.light as u64, 4 * columns);
        let range = first..first + (rows * bytes) as u64;
        let view = self.staging.slice(range).get_mapped_range_mut();
        let mut view = view.map_err(|error| self.device.failed(&error))?;
        let rows_of_plane = plane.chunks_exact(self.pass.processor.fft.pitch());
        for (row, values) in rows_of_plane.take(rows).enumerate() {
            view.slice(row * bytes..(row + 1) * bytes)
                .copy_from_slice(cast_slice(&values[..columns]));
        }
        Ok(())
    }

    /// The part's kernels and coefficients for a tile, and the place of the tile's result within
    /// the panel.
    fn place(&self, part: &Part, slot: &TileSlot) -> Place {
        let [_, (first, size)] = self.geometry().light_and_result(self.pass.direction(), slot.tile);
        let [columns, rows] = &self.panel.output;
        let out = (
            (first.0 - columns.start as i64) as i32,
            (first.1 - rows.start as i64) as i32,
        );
        Place {
            kernels: part.kernels.len() as u32,
            table: part.number,
            corner: slot.tile.corner,
            out,
            size,
        }
    }

    /// Column and row of a result's first pixel in the tile's plane.
    fn skip(&self) -> (usize, usize) {
        let stamp = self.geometry().stamp;
        match self.pass.direction() {
            Direction::Scatter => (0, 0),
            Direction::Gather => (stamp.0 - 1, stamp.1 - 1),
        }
    }

    fn tile(&self, part: &Part, slot: &TileSlot, treatment: &Treatment<T>) -> Tile {
        Tile {
            light: slot.light,
            size: self.light_size(slot),
            plane: slot.plane,
            spectrum: part.spectrum,
            place: self.place(part, slot),
            skip: self.skip(),
            back: treatment.back.map_or(1.0, |back| back.as_f64() as f32),
        }
    }

    fn drawn(
        &self,
        kernels: &BlockKernels<'_, T>,
        part: &Part,
        slot: &TileSlot,
        treatment: &Treatment<T>,
    ) -> DrawnTile {
        let skip = self.skip();
        let corner = slot.tile.corner;
        let pixels = treatment
            .drawn
            .iter()
            .map(|&(row, column, _)| [row as i32 - skip.1 as i32, column as i32 - skip.0 as i32])
            .collect();
        let drawn = treatment.drawn.iter();
        let amounts = match self.pass.direction() {
            Direction::Gather => drawn.map(|(_, _, value)| value.as_f64() as f32).collect(),
            Direction::Scatter => drawn
                .flat_map(|&(row, column, value)| {
                    let here = kernels.table().pixel(corner.1 + row, corner.0 + column);
                    let weigh = move |kernel| here.weigh(kernel, value).as_f64() as f32;
                    part.kernels.clone().map(weigh)
                })
                .collect(),
        };
        DrawnTile {
            draw: Draw {
                pixels: treatment.drawn.len(),
                stamps: part.stamp,
                place: self.place(part, slot),
                ..Draw::default()
            },
            pixels,
            amounts,
        }
    }
}
