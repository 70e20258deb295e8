//! Plans on a GPU.

use std::sync::{Arc, Mutex, OnceLock};

use ndarray::ArrayViewMut2;

use super::device::{Attempt, GpuDevice, locked};
use super::error::GpuError;
use super::options::GpuOptions;
use super::pipelines::Pipelines;
use super::plane_source::PlaneSource;
use super::run::Run;
use super::times::GpuTimes;
use super::work_layout::{Layout, LayoutMaker};
use super::working::Working;
use crate::lowrank::TileCounts;
use crate::lowrank::shared::{Job, PlanView};
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
        let forward = layout.make(&mut working, false, options.memory_bytes())?;
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
        let layout = maker.make(working, true, left)?;
        Ok(self.adjoint.get_or_init(|| layout))
    }
}
