//! Executes the plan on the GPU. The host examines the light of the next batch while the GPU
//! computes the batches submitted before it.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use ndarray::{ArrayViewMut2, Axis, s};
use pulp::bytemuck::cast_slice;
use rayon::prelude::*;

use super::batch_calls::BatchCalls;
use super::batch_data::{BatchData, WorkBuffers};
use super::buffers::InFlight;
use super::device::{Attempt, Pipelines};
use super::layout::Layout;
use super::lit_batch::{Examination, LitBatch};
use super::panels::{Batch, Panel};
use super::shader::Params;
use super::stopwatch::{GpuTimes, Marks, Stopwatch};
use crate::cpu::processor::LightPass;
use crate::cpu::treatment::TileCounts;
use crate::error::GpuError;
use crate::{ConvError, ConvReal};

/// The most batches submitted and not finished. This number limits the memory for their data.
const MOST_BATCHES: usize = 3;

/// One execution of the plan on the GPU.
pub(super) struct Run<'a, 'j, T: ConvReal> {
    device: &'a Attempt,
    pipelines: &'a Pipelines,
    layout: &'a Layout,
    pass: &'a LightPass<'j, T>,
    working: &'a mut WorkBuffers,
    output: ArrayViewMut2<'a, T>,
    times: GpuTimes,
    counts: TileCounts,
    /// The panel that the GPU computes while the host prepares the next one.
    pending: Option<(&'a Panel, InFlight)>,
    /// Submitted batches, the oldest first.
    batches: VecDeque<wgpu::SubmissionIndex>,
    /// The index of the next readback buffer, 0 or 1.
    slot: usize,
}

impl<'a, 'j, T: ConvReal> Run<'a, 'j, T> {
    pub(super) fn new(
        device: &'a Attempt,
        (pipelines, layout): (&'a Pipelines, &'a Layout),
        pass: &'a LightPass<'j, T>,
        working: &'a mut WorkBuffers,
        output: ArrayViewMut2<'a, T>,
    ) -> Self {
        let measured = working.stopwatch.is_some().then_some(Duration::ZERO);
        Self {
            device,
            pipelines,
            layout,
            pass,
            output,
            times: GpuTimes {
                kernels: measured,
                transfers: measured,
                ..GpuTimes::default()
            },
            working,
            counts: TileCounts::default(),
            pending: None,
            batches: VecDeque::new(),
            slot: 0,
        }
    }

    /// Executes the pass. Returns the numbers of tiles, and the times.
    pub(super) fn run(mut self) -> Result<(TileCounts, GpuTimes), ConvError> {
        let clock = Instant::now();
        let rows = &self.pass.rows;
        let mut done = rows.start;
        for panel in &self.layout.panels {
            if panel.block_rows.start < rows.start || panel.block_rows.end > rows.end {
                continue;
            }
            let submitted = self.submit(panel)?;
            self.finish()?;
            self.pending = submitted.map(|submitted| (panel, submitted));
            if panel.block_rows.start > done {
                self.pass.progress.advance((panel.block_rows.start - done) as u64);
                done = panel.block_rows.start;
            }
        }
        self.finish()?;
        self.pass.progress.advance((rows.end - done) as u64);
        let total = clock.elapsed();
        Ok((self.counts, GpuTimes { total, ..self.times }))
    }

    /// Submits a panel to the GPU. Returns `None` if the panel is dark.
    fn submit(&mut self, panel: &Panel) -> Result<Option<InFlight>, ConvError> {
        let mut marks = Marks::default();
        let bytes = panel.bytes();
        let mut begun = false;
        for batch in &panel.batches {
            let (staging, mut lit) = self.examine(panel, batch)?;
            self.counts += lit.counts;
            if lit.is_dark() {
                staging.unmap();
                self.working.staging.give_back(staging);
                continue;
            }
            while self.batches.len() >= MOST_BATCHES {
                let oldest = self.batches.pop_front();
                self.device.wait(oldest.expect("batches are in progress"))?;
            }
            let made;
            let data = if let Some(data) = self.layout.kept.get(batch.number) {
                data
            } else {
                made = BatchData::new(
                    self.device,
                    self.pipelines,
                    self.working,
                    &self.pass.processor.plan,
                    (batch, self.pass.flip),
                    Some(&mut marks),
                )?;
                self.times.bytes.0 += made.host_bytes();
                &made
            };
            lit.find_tables(&data.table_starts);
            let first = !std::mem::replace(&mut begun, true);
            self.submit_batch(panel, batch, data, (staging, lit), first, &mut marks)?;
        }
        if !begun {
            return Ok(None);
        }
        let device = self.device;
        let readback = self.working.readback[self.slot].with_room(device, bytes);
        self.slot = 1 - self.slot;
        let mut encoder = device.encoder();
        let result = self.working.panel.with_room(device, bytes);
        Stopwatch::transfers(
            self.working.stopwatch.as_ref(),
            &mut marks,
            &mut encoder,
            |encoder| {
                encoder.copy_buffer_to_buffer(&result, 0, &readback.0, 0, Some(bytes));
            },
        );
        if let Some(stopwatch) = &self.working.stopwatch {
            stopwatch.read(&marks, &mut encoder, &readback.1);
        }
        let submission = device.queue().submit([encoder.finish()]);
        self.times.bytes.1 += bytes;
        device.check()?;
        Ok(Some(InFlight::new(bytes, marks, readback, submission)))
    }

    /// Inspects the light of a batch and writes it to a buffer from which the GPU can copy.
    fn examine(&mut self, panel: &Panel, batch: &Batch) -> Result<(wgpu::Buffer, LitBatch), ConvError> {
        let clock = Instant::now();
        let staging = self.working.staging.take(self.device, 4 * batch.light as u64);
        let examination = Examination {
            device: self.device,
            panel,
            batch,
            pass: self.pass,
            staging: &staging,
        };
        let lit = examination.examine()?;
        self.times.host += clock.elapsed();
        Ok((staging, lit))
    }

    /// Copies a batch's light to the GPU and submits the shaders for it. For the panel's first lit
    /// batch (`first` is true), clears the panel's result beforehand.
    fn submit_batch(
        &mut self,
        panel: &Panel,
        batch: &Batch,
        data: &BatchData,
        (staging, lit): (wgpu::Buffer, LitBatch),
        first: bool,
        marks: &mut Marks,
    ) -> Result<(), GpuError> {
        let device = self.device;
        let bytes = panel.bytes();
        let light = self.working.light.with_room(device, 4 * batch.light as u64);
        let result = self.working.panel.with_room(device, bytes);
        device.check()?;
        staging.unmap();
        let mut encoder = device.encoder();
        if first {
            encoder.clear_buffer(&result, 0, Some(bytes));
        }
        let copied = joined(&lit.light);
        Stopwatch::transfers(self.working.stopwatch.as_ref(), marks, &mut encoder, |encoder| {
            for &(from, count) in &copied {
                let (from, bytes) = (4 * from as u64, 4 * count as u64);
                encoder.copy_buffer_to_buffer(&staging, from, &light, from, Some(bytes));
            }
        });
        self.times.bytes.0 += copied.iter().map(|&(_, count)| 4 * count as u64).sum::<u64>();
        let work = BatchCalls {
            device,
            pipelines: self.pipelines,
            direction: self.pass.direction(),
            params: Params {
                flip: self.pass.flip,
                panel: (panel.output[0].len(), panel.output[1].len()),
                stamp: self.pass.processor.plan.geometry.stamp,
                ..Params::default()
            },
            data,
            batch,
            lit: &lit,
            light: &light,
            panel: &result,
        };
        work.encode(self.working, &mut encoder, marks)?;
        self.batches.push_back(device.queue().submit([encoder.finish()]));
        self.working.staging.give_back(staging);
        device.check()
    }

    /// Waits for the panel that the GPU computes, if any, and adds it to the output.
    fn finish(&mut self) -> Result<(), GpuError> {
        let Some((panel, submitted)) = self.pending.take() else {
            return Ok(());
        };
        let (first_output, output, times) = (self.pass.first_output, &mut self.output, &mut self.times);
        let stopwatch = self.working.stopwatch.as_ref();
        submitted.read(self.device, |submitted, values, marks| {
            let clock = Instant::now();
            let [columns, rows] = panel.output.clone();
            let rows = rows.start - first_output..rows.end - first_output;
            let values = cast_slice::<_, T>(values).par_chunks_exact(columns.len());
            output
                .slice_mut(s![rows, columns])
                .axis_iter_mut(Axis(0))
                .into_par_iter()
                .zip(values)
                .for_each(|(mut row, values)| {
                    for (pixel, value) in row.iter_mut().zip(values) {
                        *pixel += *value;
                    }
                });
            times.host += clock.elapsed();
            // The sums become `None` if the times of a panel were not measured.
            let taken = stopwatch.and_then(|stopwatch| stopwatch.durations(&submitted.marks, marks));
            times.kernels = times.kernels.zip(taken).map(|(sum, (kernels, _))| sum + kernels);
            times.transfers = times.transfers.zip(taken).map(|(sum, (_, copies))| sum + copies);
        })
    }
}

/// Merges neighbouring ranges `(first, count)`.
fn joined(ranges: &[(usize, usize)]) -> Vec<(usize, usize)> {
    let mut joined: Vec<(usize, usize)> = Vec::new();
    for &(first, count) in ranges {
        match joined.last_mut() {
            // Merges over gaps of up to 3 values. Tiles leave such gaps, because the light of each
            // tile begins at a multiple of 4. No shader reads the values in gaps.
            Some(last) if first - (last.0 + last.1) < 4 => last.1 = first + count - last.0,
            _ => joined.push((first, count)),
        }
    }
    joined
}
