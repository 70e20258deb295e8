//! The shaders of a batch, in order.

use std::ops::Range;

use pulp::bytemuck::cast_slice;

use super::batch_data::BatchData;
use super::buffers::Growing;
use super::device::GpuDevice;
use super::error::GpuError;
use super::lit_batch::{DrawnTile, LitBatch};
use super::panels::Batch;
use super::passes::Calls;
use super::pipelines::Pipelines;
use super::shader::{STRIP, Shader};
use super::words::{Draw, Params, Tile};
use super::working::Working;
use crate::lowrank::shared::Direction;

/// What the shaders of a batch share.
pub(super) struct BatchCalls<'a> {
    pub(super) device: &'a GpuDevice,
    pub(super) pipelines: &'a Pipelines,
    pub(super) direction: Direction,
    /// What holds for all calls.
    pub(super) params: Params,
    pub(super) data: &'a BatchData,
    pub(super) light: &'a wgpu::Buffer,
    pub(super) panel: &'a wgpu::Buffer,
}

impl<'a> BatchCalls<'a> {
    /// The calls for the tiles of a batch that have light.
    pub(super) fn calls(
        &self,
        working: &mut Working,
        batch: &Batch,
        lit: &LitBatch,
    ) -> Result<Calls<'a>, GpuError> {
        let tiles = colours(lit.tiles.iter().map(|(colour, _)| *colour));
        let drawn = colours(lit.drawn.iter().map(|(colour, _)| *colour));
        let most = 2 + tiles.len() + drawn.len();
        let mut calls = Calls::new(self.device, self.pipelines, &mut working.params, most);
        if !lit.tiles.is_empty() {
            self.transforms(&mut calls, working, batch, lit, &tiles);
        }
        if !lit.drawn.is_empty() {
            self.draws(&mut calls, working, &lit.drawn, &drawn)?;
        }
        Ok(calls)
    }

    fn transforms(
        &self,
        calls: &mut Calls<'a>,
        working: &mut Working,
        batch: &Batch,
        lit: &LitBatch,
        colours: &[Range<usize>],
    ) {
        let (device, source) = (self.device, &self.pipelines.source);
        let (rows, columns) = (&self.pipelines.row_roots, &self.pipelines.column_roots);
        let spreads = self.direction == Direction::Scatter;
        let words: Vec<u32> = lit.tiles.iter().flat_map(|(_, tile)| tile.words()).collect();
        let tiles = handed_over(device, &mut working.tiles, &words);
        let work = planes_of(lit.tiles.iter().map(|(_, tile)| tile), spreads);
        let count = (work.len() / 2) as u32;
        let work = handed_over(device, &mut working.work, &work);
        let planes = source.bytes() * batch.planes as u64;
        let planes = working.planes.with_room(device, planes).clone();
        let tables = &self.data.tables;
        let params = self.params;
        let weigh = Params {
            weighted: spreads,
            flip: false,
            ..params
        };
        calls.add(
            Shader::WeighRows,
            weigh,
            &[&tiles, &work, tables, self.light, rows, &planes],
            (source.row_groups(), count),
        );
        let along_y = if spreads {
            Shader::SumColumns
        } else {
            Shader::SpreadColumns
        };
        calls.add(
            along_y,
            params,
            &[&tiles, columns, &self.data.spectra, &planes],
            (source.column_groups(), lit.tiles.len() as u32),
        );
        for range in colours {
            let params = Params {
                first: range.start as u32,
                ..params
            };
            let groups = (source.row_groups(), range.len() as u32);
            if spreads {
                calls.add(
                    Shader::AddRows,
                    params,
                    &[&tiles, rows, &planes, self.panel],
                    groups,
                );
            } else {
                calls.add(
                    Shader::GatherRows,
                    params,
                    &[&tiles, tables, rows, &planes, self.panel],
                    groups,
                );
            }
        }
    }

    fn draws(
        &self,
        calls: &mut Calls<'a>,
        working: &mut Working,
        drawn: &[(usize, DrawnTile)],
        colours: &[Range<usize>],
    ) -> Result<(), GpuError> {
        let device = self.device;
        let (mut draws, mut pixels, mut amounts) = (Vec::new(), Vec::new(), Vec::new());
        for (_, tile) in drawn {
            let draw = Draw {
                first_pixel: (pixels.len() / 2) as u32,
                first_amount: amounts.len() as u32,
                ..tile.draw
            };
            draws.extend(draw.words());
            pixels.extend(tile.pixels.iter().flatten().map(|v| v.cast_unsigned()));
            amounts.extend(tile.amounts.iter().map(|v| v.to_bits()));
        }
        device.adapter().fits(
            "single pixels of a piece",
            4 * pixels.len().max(amounts.len()) as u64,
        )?;
        let draws = handed_over(device, &mut working.draws, &draws);
        let pixels = handed_over(device, &mut working.pixels, &pixels);
        let amounts = handed_over(device, &mut working.amounts, &amounts);
        let highest = drawn.iter().map(|(_, tile)| tile.draw.out_height).max();
        for range in colours {
            let params = Params {
                first: range.start as u32,
                weighted: self.direction == Direction::Gather,
                ..self.params
            };
            calls.add(
                Shader::DrawStamps,
                params,
                &[
                    &draws,
                    &pixels,
                    &amounts,
                    &self.data.stamps,
                    &self.data.tables,
                    self.panel,
                ],
                (highest.unwrap_or(0).div_ceil(STRIP as u32), range.len() as u32),
            );
        }
        Ok(())
    }
}

/// Tile and kernel of each plane that is loaded: one for each kernel where light is weighed first, else one a tile.
fn planes_of<'t>(tiles: impl Iterator<Item = &'t Tile>, each_kernel: bool) -> Vec<u32> {
    tiles
        .enumerate()
        .flat_map(|(tile, of_tile)| {
            let planes = if each_kernel { of_tile.kernels } else { 1 };
            (0..planes).flat_map(move |kernel| [tile as u32, kernel])
        })
        .collect()
}

/// Words in a buffer, there before whatever is submitted next.
fn handed_over(device: &GpuDevice, buffer: &mut Growing, words: &[u32]) -> wgpu::Buffer {
    let buffer = buffer.with_room(device, 4 * words.len() as u64).clone();
    device.queue().write_buffer(&buffer, 0, cast_slice(words));
    buffer
}

/// Where runs of equal colours lie.
fn colours(of_all: impl Iterator<Item = usize>) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    let mut last = None;
    for (place, colour) in of_all.enumerate() {
        match runs.last_mut() {
            Some(run) if last == Some(colour) => run.end = place + 1,
            _ => runs.push(place..place + 1),
        }
        last = Some(colour);
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_of_colours() {
        assert_eq!(colours([0, 0, 2, 3, 3].into_iter()), [0..2, 2..3, 3..5]);
        assert_eq!(colours(std::iter::empty()), []);
    }

    #[test]
    fn a_plane_for_each_kernel_or_one_a_tile() {
        let tiles = [2, 1].map(|kernels| Tile {
            kernels,
            ..Tile::default()
        });
        assert_eq!(planes_of(tiles.iter(), true), [0, 0, 0, 1, 1, 0]);
        assert_eq!(planes_of(tiles.iter(), false), [0, 0, 1, 0]);
    }
}
