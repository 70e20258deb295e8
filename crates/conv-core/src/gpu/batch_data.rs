//! Data of a batch on the GPU that do not depend on the light, and the working memory of
//! executions.

use std::ops::Range;

use pulp::bytemuck::cast_slice;
use rayon::prelude::*;

use super::buffers::{Growing, Readback, STORAGE, Staging};
use super::device::{Attempt, GpuDevice, Pipelines};
use super::panels::{Batch, Part};
use super::passes::{Calls, params_buffer};
use super::shader::{Params, Place, Shader, Tile};
use super::stopwatch::{Marks, Stopwatch};
use crate::ConvReal;
use crate::cpu::processor::BlockKernels;
use crate::error::GpuError;
use crate::plan::Plan;
use crate::plan::coefficient_table::CoefficientTable;

/// Buffers that executions use, one execution after the other.
#[derive(Debug)]
pub(super) struct WorkBuffers {
    pub(super) staging: Staging,
    pub(super) readback: [Readback; 2],
    pub(super) stopwatch: Option<Stopwatch>,
    pub(super) params: Growing,
    pub(super) light: Growing,
    pub(super) planes: Growing,
    pub(super) tiles: Growing,
    pub(super) work: Growing,
    pub(super) draws: Growing,
    pub(super) pixels: Growing,
    pub(super) amounts: Growing,
    pub(super) panel: Growing,
}

impl WorkBuffers {
    pub(super) fn new(device: &GpuDevice) -> Self {
        let storage = |label| Growing::new(label, STORAGE);
        Self {
            staging: Staging::new(),
            readback: [Readback::new(), Readback::new()],
            stopwatch: Stopwatch::new(device),
            params: params_buffer(),
            light: storage("light"),
            planes: storage("planes"),
            tiles: storage("tiles"),
            work: storage("work"),
            draws: storage("draws"),
            pixels: storage("pixels"),
            amounts: storage("amounts"),
            panel: storage("panel"),
        }
    }
}

/// Coefficients, stamps and spectra of a batch's kernels.
#[derive(Debug)]
pub(super) struct BatchData {
    pub(super) tables: wgpu::Buffer,
    /// The index in `tables` of the first word of each part's table.
    pub(super) table_starts: Vec<u32>,
    pub(super) stamps: wgpu::Buffer,
    pub(super) spectra: wgpu::Buffer,
}

impl BatchData {
    /// Computes the data. If `marks` is given, the stopwatch measures this work as a part of an
    /// execution. If `flip` is true, the spectra are computed from stamps turned by 180 degrees.
    pub(super) fn new<T: ConvReal>(
        device: &Attempt,
        pipelines: &Pipelines,
        working: &mut WorkBuffers,
        plan: &Plan<T>,
        (batch, flip): (&Batch, bool),
        marks: Option<&mut Marks>,
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
            .fits("the coefficients of one piece of work", 4 * tables.len() as u64)?;
        device
            .adapter()
            .fits("the stamps of one piece of work", 4 * stamps.len() as u64)?;
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
        let params = Params {
            flip,
            stamp: plan.geometry.stamp,
            ..Params::default()
        };
        data.transform_stamps(device, pipelines, working, params, batch.spectra, marks)?;
        Ok(data)
    }

    /// Bytes on the GPU.
    pub(super) fn bytes(&self) -> u64 {
        self.tables.size() + self.stamps.size() + self.spectra.size()
    }

    /// Bytes that the host copied to the GPU.
    pub(super) fn host_bytes(&self) -> u64 {
        self.tables.size() + self.stamps.size()
    }

    /// Computes the spectra of `count` stamps.
    fn transform_stamps(
        &self,
        device: &Attempt,
        pipelines: &Pipelines,
        working: &mut WorkBuffers,
        params: Params,
        count: usize,
        marks: Option<&mut Marks>,
    ) -> Result<(), GpuError> {
        let planes = working.planes.with_room(device, self.spectra.size());
        device.check()?;
        // Each stamp is transformed like the light of a tile with one kernel.
        let place = Place {
            kernels: 1,
            ..Place::default()
        };
        let tiles = (0..count).map(|kernel| Tile {
            light: kernel * params.stamp.0 * params.stamp.1,
            size: params.stamp,
            plane: kernel,
            spectrum: kernel,
            place,
            ..Tile::default()
        });
        let tiles: Vec<u32> = tiles.flat_map(|tile| tile.words()).collect();
        let work: Vec<u32> = (0..count as u32).flat_map(|kernel| [kernel, 0]).collect();
        let tiles = device.filled("stamps' places", &tiles);
        let work = device.filled("stamps' planes", &work);
        let stopwatch = working.stopwatch.as_ref().zip(marks);
        let writes = stopwatch.and_then(|(stopwatch, marks)| stopwatch.kernels(marks));
        let mut encoder = device.encoder();
        let mut calls = Calls::new(device, pipelines, &mut working.params, 2, &mut encoder, writes);
        let (source, roots) = (&pipelines.source, &pipelines.row_roots);
        calls.add(
            Shader::WeighRows,
            params.words(),
            &[&tiles, &work, &self.tables, &self.stamps, roots, &planes],
            (source.row_groups(), count as u32),
        );
        calls.add(
            Shader::SpectrumColumns,
            params.words(),
            &[&tiles, &pipelines.column_roots, &planes, &self.spectra],
            (source.column_groups(), count as u32),
        );
        calls.end();
        device.queue().submit([encoder.finish()]);
        device.check()
    }
}

/// A part's coefficients and stamps as 32-bit words.
fn words_of<T: ConvReal>(plan: &Plan<T>, part: &Part) -> (Vec<u32>, Vec<u32>) {
    let kernels = BlockKernels::new(plan, part.block);
    let (table, stamps) = (kernels.table(), kernels.stamps());
    let size = plan.geometry.stamp_values();
    let stamps = &stamps[part.kernels.start * size..part.kernels.end * size];
    (table.packed(part.kernels.clone()), cast_slice(stamps).to_vec())
}

/// The number of words in the header of a table: see `coefficients.wgsl`.
const HEADER: usize = 6;

impl<T: ConvReal> CoefficientTable<T> {
    /// Packs the coefficients of some kernels in f32 for `coefficients.wgsl`. A coefficient is a
    /// function of the pixel, which is linear along the *runs* of a row. The words of the header are,
    /// in order:
    ///
    /// - the number of functions,
    /// - whether the other functions are divided by the first,
    /// - the number of kernels without a function, whose coefficient is 1,
    /// - the indices at which three arrays begin: row starts, first columns of the runs, and values.
    ///
    /// The values of a run are the number of its columns less 1, at least 1, then per function those at
    /// its first and its last column, both divided by this number.
    ///
    /// The arrays follow the header. The indices count from the table's first word.
    pub(crate) fn packed(&self, kernels: Range<usize>) -> Vec<u32> {
        // If there is a divisor, it is the first of the functions.
        let divisor = self.role.divides().then_some(0).into_iter();
        let of_kernels = kernels.clone().filter_map(|kernel| self.role.function_of(kernel));
        let functions: Vec<usize> = divisor.chain(of_kernels).collect();
        let plain = kernels
            .filter(|&kernel| self.role.function_of(kernel).is_none())
            .count();
        let bits = |value: T| (value.as_f64() as f32).to_bits();
        let (mut row_starts, mut runs, mut values) = (vec![0], Vec::new(), Vec::new());
        for row in 0..self.region.shape().ny() {
            for &(column, length) in self.cells_in(row) {
                runs.push(column);
                let steps = T::nearest(f64::from((length - 1).max(1)));
                values.push(bits(steps));
                let ends = [column, column + length - 1].map(|column| self.pixel(row, column as usize));
                for &function in &functions {
                    values.extend([&ends[0], &ends[1]].map(|end| bits(end.function(function) / steps)));
                }
            }
            row_starts.push(runs.len() as u32);
        }
        let first_run = HEADER + row_starts.len();
        let header = [
            functions.len(),
            usize::from(self.role.divides()),
            plain,
            HEADER,
            first_run,
            first_run + runs.len(),
        ];
        let words = header.map(|word| word as u32).into_iter();
        words.chain(row_starts).chain(runs).chain(values).collect()
    }
}
