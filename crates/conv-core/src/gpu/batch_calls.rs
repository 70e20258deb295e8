//! The shader calls for a batch, in order.

use std::ops::Range;

use pulp::bytemuck::cast_slice;

use super::batch_data::{BatchData, WorkBuffers};
use super::buffers::Growing;
use super::device::{GpuDevice, Pipelines};
use super::lit_batch::LitBatch;
use super::panels::Batch;
use super::passes::Calls;
use super::shader::{Draw, Params, STRIP, Shader, Tile};
use super::stopwatch::Marks;
use crate::error::GpuError;
use crate::plan::geometry::Direction;

/// Makes the shader calls for a batch. Holds the data that these calls share.
pub(super) struct BatchCalls<'a> {
    pub(super) device: &'a GpuDevice,
    pub(super) pipelines: &'a Pipelines,
    pub(super) direction: Direction,
    /// The parameters common to all calls.
    pub(super) params: Params,
    pub(super) data: &'a BatchData,
    pub(super) batch: &'a Batch,
    pub(super) lit: &'a LitBatch,
    pub(super) light: &'a wgpu::Buffer,
    pub(super) panel: &'a wgpu::Buffer,
}

impl BatchCalls<'_> {
    /// Encodes the calls for the lit tiles of a batch.
    pub(super) fn encode(
        &self,
        working: &mut WorkBuffers,
        encoder: &mut wgpu::CommandEncoder,
        marks: &mut Marks,
    ) -> Result<(), GpuError> {
        let lit = self.lit;
        let tiles = colours(&lit.tiles);
        let drawn = colours(&lit.drawn);
        let most = 2 + tiles.len() + drawn.len();
        let writes = working
            .stopwatch
            .as_ref()
            .and_then(|stopwatch| stopwatch.kernels(marks));
        let params = &mut working.params;
        let mut calls = Calls::new(self.device, self.pipelines, params, most, encoder, writes);
        if !lit.tiles.is_empty() {
            self.transforms(&mut calls, working, &tiles);
        }
        if !lit.drawn.is_empty() {
            self.draws(&mut calls, working, &drawn)?;
        }
        calls.end();
        Ok(())
    }

    fn transforms(&self, calls: &mut Calls<'_>, working: &mut WorkBuffers, colours: &[Range<usize>]) {
        let (device, source, lit) = (self.device, &self.pipelines.source, self.lit);
        let (rows, columns) = (&self.pipelines.row_roots, &self.pipelines.column_roots);
        let spreads = self.direction == Direction::Scatter;
        let words: Vec<u32> = lit.tiles.iter().flat_map(|(_, tile)| tile.words()).collect();
        let tiles = handed_over(device, &mut working.tiles, &words);
        let work = planes_of(lit.tiles.iter().map(|(_, tile)| tile), spreads);
        let count = (work.len() / 2) as u32;
        let work = handed_over(device, &mut working.work, &work);
        let planes = source.bytes() * self.batch.planes as u64;
        let planes = working.planes.with_room(device, planes);
        let tables = &self.data.tables;
        let params = self.params;
        let weigh = Params {
            weighted: spreads,
            flip: false,
            ..params
        };
        calls.add(
            Shader::WeighRows,
            weigh.words(),
            &[&tiles, &work, tables, self.light, rows, &planes],
            (source.row_groups(), count),
        );
        let (along_y, back, back_buffers) = if spreads {
            let buffers = vec![&tiles, rows, &planes, self.panel];
            (Shader::SumColumns, Shader::AddRows, buffers)
        } else {
            let buffers = vec![&tiles, tables, rows, &planes, self.panel];
            (Shader::SpreadColumns, Shader::GatherRows, buffers)
        };
        calls.add(
            along_y,
            params.words(),
            &[&tiles, columns, &self.data.spectra, &planes],
            (source.column_groups(), lit.tiles.len() as u32),
        );
        for range in colours {
            let params = Params {
                first: range.start as u32,
                ..params
            };
            let groups = (source.row_groups(), range.len() as u32);
            calls.add(back, params.words(), &back_buffers, groups);
        }
    }

    fn draws(
        &self,
        calls: &mut Calls<'_>,
        working: &mut WorkBuffers,
        colours: &[Range<usize>],
    ) -> Result<(), GpuError> {
        let device = self.device;
        let (mut draws, mut pixels, mut amounts) = (Vec::new(), Vec::new(), Vec::new());
        for (_, tile) in &self.lit.drawn {
            let draw = Draw {
                first_pixel: pixels.len() / 2,
                first_amount: amounts.len(),
                ..tile.draw
            };
            draws.extend(draw.words());
            pixels.extend(tile.pixels.iter().flatten().map(|v| v.cast_unsigned()));
            amounts.extend(tile.amounts.iter().map(|v| v.to_bits()));
        }
        device.adapter().fits(
            "the pixels that one piece of work draws one by one",
            4 * pixels.len().max(amounts.len()) as u64,
        )?;
        let draws = handed_over(device, &mut working.draws, &draws);
        let pixels = handed_over(device, &mut working.pixels, &pixels);
        let amounts = handed_over(device, &mut working.amounts, &amounts);
        let highest = self
            .lit
            .drawn
            .iter()
            .map(|(_, tile)| tile.draw.place.size.1)
            .max();
        for range in colours {
            let params = Params {
                first: range.start as u32,
                weighted: self.direction == Direction::Gather,
                ..self.params
            };
            calls.add(
                Shader::DrawStamps,
                params.words(),
                &[
                    &draws,
                    &pixels,
                    &amounts,
                    &self.data.stamps,
                    &self.data.tables,
                    self.panel,
                ],
                (highest.unwrap_or(0).div_ceil(STRIP) as u32, range.len() as u32),
            );
        }
        Ok(())
    }
}

/// The tile and the kernel of each plane to be transformed along x. If `each_kernel` is true, each
/// kernel's coefficients multiply the light first, so a tile has one plane per kernel. Otherwise it
/// has one plane.
fn planes_of<'t>(tiles: impl Iterator<Item = &'t Tile>, each_kernel: bool) -> Vec<u32> {
    tiles
        .enumerate()
        .flat_map(|(tile, of_tile)| {
            let planes = if each_kernel { of_tile.place.kernels } else { 1 };
            (0..planes).flat_map(move |kernel| [tile as u32, kernel])
        })
        .collect()
}

/// Writes words to a buffer, for the next submission. Returns the buffer.
fn handed_over(device: &GpuDevice, buffer: &mut Growing, words: &[u32]) -> wgpu::Buffer {
    let buffer = buffer.with_room(device, 4 * words.len() as u64);
    device.queue().write_buffer(&buffer, 0, cast_slice(words));
    buffer
}

/// The index ranges of neighbours with equal colours.
fn colours<V>(of_all: &[(usize, V)]) -> Vec<Range<usize>> {
    let mut end = 0;
    let runs = of_all.chunk_by(|a, b| a.0 == b.0).map(|run| {
        end += run.len();
        end - run.len()..end
    });
    runs.collect()
}

#[cfg(test)]
mod tests {
    use super::super::shader::Place;
    use super::*;

    #[test]
    fn runs_of_colours() {
        assert_eq!(
            colours(&[0, 0, 2, 3, 3].map(|colour| (colour, ()))),
            [0..2, 2..3, 3..5]
        );
        assert!(colours::<()>(&[]).is_empty());
    }

    #[test]
    fn a_plane_for_each_kernel_or_one_a_tile() {
        let place = |kernels| Place {
            kernels,
            ..Place::default()
        };
        let tiles = [2, 1].map(|kernels| Tile {
            place: place(kernels),
            ..Tile::default()
        });
        assert_eq!(planes_of(tiles.iter(), true), [0, 0, 0, 1, 1, 0]);
        assert_eq!(planes_of(tiles.iter(), false), [0, 0, 1, 0]);
    }
}
