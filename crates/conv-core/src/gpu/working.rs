//! The memory that executions work in.

use std::time::Duration;

use super::batch_data::BatchData;
use super::buffers::{Growing, STORAGE};
use super::device::{Attempt, GpuDevice};
use super::error::GpuError;
use super::panels::Batch;
use super::passes::params_buffer;
use super::pipelines::Pipelines;
use super::readback::Readback;
use super::staging::Staging;
use super::stopwatch::{Marks, Stopwatch};
use crate::{ConvReal, Plan};

/// Buffers that executions share, one after the other.
#[derive(Debug)]
pub(super) struct Working {
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

impl Working {
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

    /// Does some copies, with marks about them where there is a stopwatch.
    pub(super) fn copies(
        &self,
        marks: &mut Marks,
        encoder: &mut wgpu::CommandEncoder,
        copies: impl FnOnce(&mut wgpu::CommandEncoder),
    ) {
        match &self.stopwatch {
            Some(stopwatch) => stopwatch.transfers(marks, encoder, copies),
            None => copies(encoder),
        }
    }

    /// What a batch needs whatever the light; where it is made during an execution, with `marks` about the work on it.
    pub(super) fn batch_data<T: ConvReal>(
        &mut self,
        device: &Attempt,
        pipelines: &Pipelines,
        plan: &Plan<T>,
        (batch, flip): (&Batch, bool),
        marks: Option<&mut Marks>,
    ) -> Result<BatchData, GpuError> {
        let stopwatch = self.stopwatch.as_ref().zip(marks);
        let writes = stopwatch.and_then(|(stopwatch, marks)| stopwatch.kernels(marks));
        let memory = (&mut self.planes, &mut self.params);
        BatchData::new(device, pipelines, memory, plan, (batch, flip), writes)
    }
}

/// What an execution took besides the whole.
#[derive(Debug, Default)]
pub(super) struct Taken {
    pub(super) kernels: Duration,
    pub(super) transfers: Duration,
    pub(super) host: Duration,
    /// The GPU's clock was asked too often to have told all.
    pub(super) incomplete: bool,
    pub(super) up: u64,
    pub(super) down: u64,
}
