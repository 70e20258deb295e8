//! Plans on a GPU.

use std::sync::{Arc, Mutex, OnceLock};

use ndarray::ArrayViewMut2;

use super::batch_data::BatchData;
use super::device::{Attempt, GpuDevice, locked};
use super::error::GpuError;
use super::options::GpuOptions;
use super::panels::{Limits, Panel, panels};
use super::run::Run;
use super::shader::{Pipelines, PlaneSource};
use super::times::GpuTimes;
use super::working::Working;
use crate::lowrank::TileCounts;
use crate::lowrank::shared::{Direction, Job, PlanView};
use crate::{ConvError, ConvReal, Plan};

/// What a plan keeps on a GPU.
#[derive(Debug)]
pub(crate) struct GpuEngine {
    pub(super) device: GpuDevice,
    pub(super) pipelines: Arc<Pipelines>,
    pub(super) view: PlanView,
    options: GpuOptions,
    forward: Layout,
    /// Of the transpose, made when it is first asked for.
    adjoint: OnceLock<Layout>,
    /// Of executions that are done; those under way at the same time have one each.
    working: Mutex<Vec<Working>>,
    times: Mutex<Option<GpuTimes>>,
}

/// The work of a direction, and what is kept for it.
#[derive(Debug)]
pub(super) struct Layout {
    pub(super) direction: Direction,
    /// Stamps are applied turned by 180 degrees.
    pub(super) flip: bool,
    pub(super) panels: Vec<Panel>,
    /// By panel and batch, as far as the memory reaches.
    pub(super) kept: Vec<Vec<Option<BatchData>>>,
    bytes: u64,
}

impl GpuEngine {
    pub(crate) fn new<T: ConvReal>(
        plan: &Plan<T>,
        device: &GpuDevice,
        options: GpuOptions,
    ) -> Result<Self, GpuError> {
        if size_of::<T>() != size_of::<f32>() {
            return Err(GpuError::Precision { precision: T::NAME });
        }
        let mut attempt = device.attempt()?;
        let (nx, ny) = plan.transform();
        let pipelines = attempt.pipelines(PlaneSource::new(nx, ny, device.adapter())?)?;
        let view = PlanView::new(plan);
        let mut working = Working::new(device);
        let layout = LayoutMaker {
            plan,
            device: &mut attempt,
            pipelines: &pipelines,
            view: &view,
            options,
        };
        let forward = layout.make(&mut working, plan.direction(false), false, options.memory_bytes())?;
        Ok(Self {
            forward,
            device: device.clone(),
            pipelines,
            view,
            options,
            adjoint: OnceLock::new(),
            working: Mutex::new(vec![working]),
            times: Mutex::new(None),
        })
    }

    pub(crate) fn device(&self) -> &GpuDevice {
        &self.device
    }

    pub(crate) fn times(&self) -> Option<GpuTimes> {
        *locked(&self.times)
    }

    /// Sends light through the operator, to be added to `output`.
    pub(crate) fn run<T: ConvReal>(
        &self,
        job: &Job<'_, T>,
        output: ArrayViewMut2<'_, T>,
    ) -> Result<TileCounts, ConvError> {
        let mut attempt = self.device.attempt()?;
        // No lock is held while threads work: they may come back here with another execution.
        let taken = locked(&self.working).pop();
        let mut working = taken.unwrap_or_else(|| Working::new(&self.device));
        let layout = self.layout(&mut attempt, job, &mut working)?;
        let (counts, times) = T::dispatch(Run {
            device: &attempt,
            engine: self,
            layout,
            job,
            working: &mut working,
            output,
        })?;
        // After an error it is dropped: what is still under way may write to it.
        locked(&self.working).push(working);
        *locked(&self.times) = Some(times);
        Ok(counts)
    }

    fn layout<T: ConvReal>(
        &self,
        attempt: &mut Attempt,
        job: &Job<'_, T>,
        working: &mut Working,
    ) -> Result<&Layout, GpuError> {
        if !job.flip {
            return Ok(&self.forward);
        }
        if let Some(layout) = self.adjoint.get() {
            return Ok(layout);
        }
        let maker = LayoutMaker {
            plan: job.plan,
            device: attempt,
            pipelines: &self.pipelines,
            view: &self.view,
            options: self.options,
        };
        let left = self.options.memory_bytes().saturating_sub(self.forward.bytes);
        let layout = maker.make(working, job.plan.direction(true), true, left)?;
        Ok(self.adjoint.get_or_init(|| layout))
    }
}

struct LayoutMaker<'a, T: ConvReal> {
    plan: &'a Plan<T>,
    device: &'a mut Attempt,
    pipelines: &'a Pipelines,
    view: &'a PlanView,
    options: GpuOptions,
}

impl<T: ConvReal> LayoutMaker<'_, T> {
    fn make(
        self,
        working: &mut Working,
        direction: Direction,
        flip: bool,
        memory: u64,
    ) -> Result<Layout, GpuError> {
        let adapter = self.device.adapter();
        let most = adapter.largest_binding.min(adapter.largest_buffer);
        let limits = Limits {
            adapter: &adapter.name,
            piece: self.options.piece_bytes().min(most),
            most,
        };
        let panels = panels(self.view, &self.pipelines.source, direction, limits)?;
        let mut layout = Layout {
            direction,
            flip,
            kept: panels
                .iter()
                .map(|panel| panel.batches.iter().map(|_| None).collect())
                .collect(),
            panels,
            bytes: 0,
        };
        for (panel, kept) in layout.panels.iter().zip(&mut layout.kept) {
            for (batch, kept) in panel.batches.iter().zip(kept) {
                // The spectra are most of it.
                let least = batch.spectra as u64 * self.pipelines.source.bytes();
                if layout.bytes + least > memory {
                    return Ok(layout);
                }
                let data =
                    match working.batch_data(self.device, self.pipelines, self.plan, (batch, flip), None) {
                        // What does not fit is made anew by each execution.
                        Err(GpuError::OutOfMemory { .. }) => {
                            self.device.forgive();
                            // wgpu may have given up the whole device.
                            self.device.check()?;
                            // Some of its buffers may be no buffers.
                            *working = Working::new(self.device);
                            return Ok(layout);
                        }
                        made => made?,
                    };
                if layout.bytes + data.bytes() > memory {
                    return Ok(layout);
                }
                layout.bytes += data.bytes();
                *kept = Some(data);
            }
        }
        Ok(layout)
    }
}
