//! Plans whose executions run on a GPU.

use super::plan::Plan;
use super::plan_view::PlanView;
use super::tile_light::Direction;
use super::workspace::Workspace;
use crate::ConvReal;
use crate::gpu::{Adapter, GpuDevice, GpuEngine, GpuError, GpuOptions, GpuTimes, GpuWork};

impl<T: ConvReal> Plan<T> {
    /// Runs the executions of this plan on a GPU from now on, all of them: [`execute`](Self::execute), [`stream`](Self::stream) and
    /// [`adjoint`](Self::adjoint). Tiles, modes and treatments stay the same, so that the result differs by f32 rounding alone.
    /// Point sources are drawn on the processor.
    ///
    /// # Errors
    /// [`GpuError`] for plans in f64, and where the GPU's limits are too low for the plan.
    pub fn use_gpu(&mut self, gpu: &GpuDevice, options: GpuOptions) -> Result<(), GpuError> {
        self.gpu = Some(GpuEngine::new(self, gpu, options)?);
        Ok(())
    }

    /// The GPU that executions run on, if they do.
    pub fn gpu(&self) -> Option<&GpuDevice> {
        self.gpu.as_ref().map(GpuEngine::device)
    }

    /// How long the parts of the last execution on the GPU took.
    pub fn gpu_times(&self) -> Option<GpuTimes> {
        self.gpu.as_ref().and_then(GpuEngine::times)
    }

    /// What an execution on a GPU has to move where every pixel is lit.
    pub fn gpu_work(&self) -> GpuWork {
        let mut work = GpuWork::default();
        let view = PlanView::new(self);
        let direction = self.direction(false);
        let plane = (self.tiling.size.0 * self.tiling.size.1) as u64;
        for row in 0..view.tiles[1].len() {
            for column in 0..view.tiles[0].len() {
                let block = (view.block_of(0, column), view.block_of(1, row));
                let size = view.tile(column, row).part.size;
                let light = view.light_size(direction, size);
                let result = match direction {
                    Direction::Scatter => view.light_size(Direction::Gather, size),
                    Direction::Gather => size,
                };
                // The upper half of the rows is the imaginary part of the lower.
                let (nx, half) = (self.tiling.size.0, self.tiling.size.1 / 2);
                let filled = (2 * nx * light.1.min(half)) as u64;
                let of_tile = ((light.0 * light.1) as u64, (result.0 * result.1) as u64);
                let kernels = view.kernel_count(block) as u64;
                work.add_tile(kernels, (plane, filled), of_tile, direction);
            }
        }
        for block in &self.blocks {
            work.add_block(block.kernel_count() as u64, plane);
        }
        work.add_image(
            self.geometry.weighted_size(),
            self.geometry.other_size(),
            direction,
        );
        work
    }

    /// Predicted seconds of an execution on a GPU where every pixel is lit, from host memory to host memory; to be compared with
    /// [`PlanSummary::predicted_seconds`](crate::PlanSummary::predicted_seconds) over the number of threads. None where the GPU cannot run the plan.
    pub fn predicted_gpu_seconds(&self, adapter: &Adapter) -> Option<f64> {
        let (nx, ny) = self.tiling.size;
        (size_of::<T>() == size_of::<f32>() && adapter.can_transform(nx, ny))
            .then(|| self.gpu_work().seconds(adapter.kind))
    }
}

/// What the engine on a GPU shares with the one on the processor.
impl<T: ConvReal> Plan<T> {
    /// Columns and rows of the transforms.
    pub(crate) fn transform(&self) -> (usize, usize) {
        self.tiling.size
    }

    /// Columns and rows of the stamps.
    pub(crate) fn stamp(&self) -> (usize, usize) {
        self.geometry.stamp
    }

    /// Values from one row of a workspace's plane to the next.
    pub(crate) fn pitch(&self) -> usize {
        self.fft.pitch()
    }

    /// Whether a block's coefficients and stamps are there, and need not be made anew.
    pub(crate) fn keeps(&self, (column, row): (usize, usize)) -> bool {
        let block = self.block(column, row);
        block.has_table() && block.has_stamps()
    }

    /// 0, 1, 2 ...
    pub(crate) fn ramp(&self) -> &[T] {
        &self.ramp
    }

    /// Lends a workspace to `work`.
    pub(crate) fn with_workspace<R>(&self, work: impl FnOnce(&mut Workspace<T>) -> R) -> R {
        self.pool().with(&self.fft, work)
    }
}
