//! What a batch of a plan needs on the GPU whatever the light.

use pulp::bytemuck::cast_slice;
use rayon::prelude::*;

use super::buffers::{Growing, STORAGE};
use super::device::Attempt;
use super::error::GpuError;
use super::panels::{Batch, Part};
use super::passes::Calls;
use super::pipelines::Pipelines;
use super::shader::Shader;
use super::words::{Params, Tile};
use crate::lowrank::shared::Prepared;
use crate::{ConvReal, Plan};

/// Coefficients, stamps and spectra of a batch's kernels.
#[derive(Debug)]
pub(super) struct BatchData {
    pub(super) tables: wgpu::Buffer,
    /// Where each part's table begins.
    pub(super) table_starts: Vec<u32>,
    pub(super) stamps: wgpu::Buffer,
    pub(super) spectra: wgpu::Buffer,
}

impl BatchData {
    /// Makes it; `planes` and `params` are working memory. Stamps are turned by 180 degrees where `flip`. `writes` is where the time that shaders take is
    /// written to.
    pub(super) fn new<T: ConvReal>(
        device: &Attempt,
        pipelines: &Pipelines,
        (planes, params): (&mut Growing, &mut Growing),
        plan: &Plan<T>,
        (batch, flip): (&Batch, bool),
        writes: Option<wgpu::ComputePassTimestampWrites<'_>>,
    ) -> Result<Self, GpuError> {
        let parts: Vec<(Vec<u32>, Vec<u32>)> =
            batch.parts.par_iter().map(|part| words_of(plan, part)).collect();
        let (mut tables, mut stamps, mut table_starts) = (Vec::new(), Vec::new(), Vec::new());
        for (table, of_part) in parts {
            table_starts.push(tables.len() as u32);
            tables.extend(table);
            stamps.extend(of_part);
        }
        device
            .adapter()
            .fits("the coefficients of a piece", 4 * tables.len() as u64)?;
        device
            .adapter()
            .fits("the stamps of a piece", 4 * stamps.len() as u64)?;
        let tables = device.filled("coefficients", &tables);
        let stamps = device.filled("stamps", &stamps);
        let bytes = pipelines.source.bytes() * batch.spectra as u64;
        let spectra = device.buffer("spectra", bytes, STORAGE);
        let data = Self {
            tables,
            table_starts,
            stamps,
            spectra,
        };
        device.check()?;
        let planes = planes.with_room(device, bytes).clone();
        device.check()?;
        let stamp = Params {
            flip,
            stamp: plan.stamp(),
            ..Params::default()
        };
        let calls = data.stamp_calls(device, pipelines, (&planes, params), stamp, batch);
        let mut encoder = device.encoder();
        calls.encode(&mut encoder, writes);
        device.queue().submit([encoder.finish()]);
        device.check()?;
        Ok(data)
    }

    /// Bytes on the GPU.
    pub(super) fn bytes(&self) -> u64 {
        self.tables.size() + self.stamps.size() + self.spectra.size()
    }

    /// Bytes that came from the host.
    pub(super) fn host_bytes(&self) -> u64 {
        self.tables.size() + self.stamps.size()
    }

    /// The shaders that make spectra of stamps.
    fn stamp_calls<'a>(
        &self,
        device: &'a Attempt,
        pipelines: &'a Pipelines,
        (planes, buffer): (&wgpu::Buffer, &mut Growing),
        params: Params,
        batch: &Batch,
    ) -> Calls<'a> {
        let stamp = params.stamp;
        // One kernel a tile.
        let tiles: Vec<u32> = (0..batch.spectra as u32)
            .flat_map(|kernel| {
                let tile = Tile {
                    light: kernel * (stamp.0 * stamp.1) as u32,
                    width: stamp.0 as u32,
                    height: stamp.1 as u32,
                    plane: kernel,
                    spectrum: kernel,
                    kernels: 1,
                    ..Tile::default()
                };
                tile.words()
            })
            .collect();
        let work: Vec<u32> = (0..batch.spectra as u32).flat_map(|kernel| [kernel, 0]).collect();
        let tiles = device.filled("stamps' places", &tiles);
        let work = device.filled("stamps' planes", &work);
        let source = &pipelines.source;
        let mut calls = Calls::new(device, pipelines, buffer, 2);
        let all = batch.spectra as u32;
        calls.add(
            Shader::WeighRows,
            params,
            &[
                &tiles,
                &work,
                &self.tables,
                &self.stamps,
                &pipelines.row_roots,
                planes,
            ],
            (source.row_groups(), all),
        );
        calls.add(
            Shader::SpectrumColumns,
            params,
            &[&tiles, &pipelines.column_roots, planes, &self.spectra],
            (source.column_groups(), all),
        );
        calls
    }
}

/// A part's coefficients and stamps.
fn words_of<T: ConvReal>(plan: &Plan<T>, part: &Part) -> (Vec<u32>, Vec<u32>) {
    let mut prepared = Prepared::of_block(plan, part.block);
    let (table, stamps) = prepared.table_and_stamps();
    let size = plan.stamp().0 * plan.stamp().1;
    let stamps = &stamps[part.kernels.start * size..part.kernels.end * size];
    (table.packed(part.kernels.clone()), cast_slice(stamps).to_vec())
}
