//! Execution of plans on a GPU.

use std::sync::{Arc, Mutex, OnceLock};

use ndarray::ArrayViewMut2;

use super::batch_data::WorkBuffers;
use super::device::{GpuDevice, Pipelines, locked};
use super::layout::{GpuOptions, Layout};
use super::plane_source::PlaneSource;
use super::run::Run;
use super::stopwatch::GpuTimes;
use crate::cpu::processor::LightPass;
use crate::cpu::treatment::TileCounts;
use crate::error::GpuError;
use crate::plan::Plan;
use crate::{ConvError, ConvReal};

/// A plan on a GPU, with the data that stay there from one execution to the next.
#[derive(Debug)]
pub(crate) struct GpuEngine {
    pub(crate) device: GpuDevice,
    /// The shaders for the plan's transforms.
    pipelines: Arc<Pipelines>,
    options: GpuOptions,
    forward: Layout,
    /// The layout of the adjoint, made when it is first needed.
    adjoint: OnceLock<Layout>,
    /// Sets of buffers that no execution uses at present. Each execution takes one set and puts it
    /// back.
    working: Mutex<Vec<WorkBuffers>>,
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
        if plan.models().len() > 1 {
            return Err(GpuError::Layers);
        }
        let mut attempt = device.attempt()?;
        let (nx, ny) = plan.tiling.size;
        let pipelines = attempt.pipelines(PlaneSource::new(nx, ny, attempt.adapter())?)?;
        let mut working = WorkBuffers::new(device);
        Ok(Self {
            forward: Layout::new(plan, &pipelines, options, &mut attempt, &mut working, false)?,
            device: device.clone(),
            pipelines,
            options,
            adjoint: OnceLock::new(),
            working: Mutex::new(vec![working]),
            times: Mutex::new(None),
        })
    }

    pub(crate) fn times(&self) -> Option<GpuTimes> {
        *locked(&self.times)
    }

    /// Applies the plan's operator, or its adjoint if `pass.flip` is true, to the light of `pass`.
    /// Adds the result to `output`.
    pub(crate) fn run<T: ConvReal>(
        &self,
        pass: &LightPass<'_, T>,
        output: ArrayViewMut2<'_, T>,
    ) -> Result<TileCounts, ConvError> {
        let mut attempt = self.device.attempt()?;
        // Holds no lock while rayon's threads work, because one of them may begin another execution
        // of this engine.
        let taken = locked(&self.working).pop();
        let mut working = taken.unwrap_or_else(|| WorkBuffers::new(&self.device));
        let layout = match self.adjoint.get() {
            _ if !pass.flip => &self.forward,
            Some(layout) => layout,
            None => {
                let left = self.options.memory_bytes().saturating_sub(self.forward.bytes);
                let (plan, options) = (&pass.processor.plan, self.options.with_memory(left));
                let layout = Layout::new(plan, &self.pipelines, options, &mut attempt, &mut working, true)?;
                self.adjoint.get_or_init(|| layout)
            }
        };
        let run = Run::new(&attempt, (&self.pipelines, layout), pass, &mut working, output);
        let (counts, times) = run.run()?;
        // After an error the buffers are not put back, because work in progress may still write to
        // them.
        locked(&self.working).push(working);
        *locked(&self.times) = Some(times);
        Ok(counts)
    }
}
