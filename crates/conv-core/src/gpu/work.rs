//! The amount of data that an execution moves, and the time predicted from it.

use super::adapter::{Adapter, AdapterKind};
use super::panels::TileGrid;
use crate::ConvReal;
use crate::plan::Plan;
use crate::plan::geometry::Direction;

/// The bytes that an execution on a GPU moves if every pixel is lit. Divided by the hardware's
/// bandwidths, they give the shortest time of an execution, unless caches hold whole planes. With
/// such caches, an execution may be faster.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct GpuWork {
    /// Between the host's memory and the GPU's: light to the GPU, the image from it.
    pub bus_bytes: u64,
    /// To and from the GPU's own memory. Each pass of shaders over a tile counts a value of a plane
    /// (an array that shaders transform), of the light or of the image: once if it is read, and
    /// once if it is written. A kernel's spectrum counts once per execution.
    pub memory_bytes: u64,
}

const F32: u64 = 4;

impl GpuWork {
    /// Adds the bytes of a tile with some kernels. The two pairs are numbers of values: `plane` in
    /// a plane, `filled` in the part of a plane that the light fills, `light` in the tile's light,
    /// and `result` in the tile's result.
    pub(crate) fn add_tile(
        &mut self,
        kernels: u64,
        (plane, filled): (u64, u64),
        (light, result): (u64, u64),
        direction: Direction,
    ) {
        let planes = match direction {
            // The transforms along x write the filled part of a plane per kernel. The transforms
            // along y read these planes and write one plane. The transforms back along x read it.
            Direction::Scatter => 2 * kernels * filled + 2 * plane,
            // The transforms along x write the filled part of one plane. The transforms along y
            // read it and write a plane per kernel. The transforms back along x read these planes.
            Direction::Gather => 2 * filled + 2 * kernels * plane,
        };
        // Reads the light, reads and writes the image.
        self.memory_bytes += F32 * (planes + light + 2 * result);
        self.bus_bytes += F32 * light;
    }

    /// Adds the bytes of the spectra of a block's kernels.
    pub(crate) fn add_block(&mut self, kernels: u64, plane: u64) {
        self.memory_bytes += F32 * kernels * plane;
    }

    /// Adds the bytes of the image that is copied to the host. `weighted` is the size of the side
    /// that PSFs belong to (the light or the image), and `other` the size of the other side.
    pub(crate) fn add_image(
        &mut self,
        weighted: (usize, usize),
        other: (usize, usize),
        direction: Direction,
    ) {
        let (columns, rows) = match direction {
            Direction::Scatter => other,
            Direction::Gather => weighted,
        };
        self.bus_bytes += F32 * (columns * rows) as u64;
    }

    /// Predicted seconds on a kind of adapter. The constants are rounded guesses for such hardware,
    /// not measurements. They are only good enough to choose a device.
    pub(crate) fn seconds(&self, kind: AdapterKind) -> f64 {
        // Bytes per second over the bus (including the work of the host), bytes per second of the
        // GPU's memory, and seconds to start.
        let (bus, memory, start) = match kind {
            AdapterKind::Discrete | AdapterKind::Virtual => (8e9, 2e11, 1e-3),
            AdapterKind::Integrated | AdapterKind::Other => (8e9, 3e10, 1e-3),
            AdapterKind::Software => (4e9, 1e9, 1e-3),
        };
        self.bus_bytes as f64 / bus + self.memory_bytes as f64 / memory + start
    }
}

impl<T: ConvReal> Plan<T> {
    /// The amount of data that an execution on a GPU moves if every pixel is lit.
    pub fn gpu_work(&self) -> GpuWork {
        let mut work = GpuWork::default();
        let grid = TileGrid::new(self);
        let direction = self.direction(false);
        let plane = (self.tiling.size.0 * self.tiling.size.1) as u64;
        for row in 0..grid.tiles[1].len() {
            for column in 0..grid.tiles[0].len() {
                let size = grid.tile(column, row).part.size;
                let light = self.geometry.light_size(direction, size);
                let result = match direction {
                    Direction::Scatter => self.geometry.around(size),
                    Direction::Gather => size,
                };
                // The upper half of the rows is the imaginary part of the lower.
                let (nx, half) = (self.tiling.size.0, self.tiling.size.1 / 2);
                let filled = (2 * nx * light.1.min(half)) as u64;
                let of_tile = ((light.0 * light.1) as u64, (result.0 * result.1) as u64);
                let kernels = self
                    .block(grid.block_of(0, column), grid.block_of(1, row))
                    .kernel_count() as u64;
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

    /// Predicted seconds of an execution on a GPU if every pixel is lit, including the copies
    /// between the host's memory and the GPU's. Compare them with
    /// [`PlanSummary::predicted_seconds`](crate::PlanSummary::predicted_seconds) divided by the
    /// number of threads. `None` if the plan is in f64, or if its transforms are too long for the
    /// GPU.
    pub fn predicted_gpu_seconds(&self, adapter: &Adapter) -> Option<f64> {
        let (nx, ny) = self.tiling.size;
        (size_of::<T>() == size_of::<f32>() && adapter.can_transform(nx, ny))
            .then(|| self.gpu_work().seconds(adapter.kind))
    }

    /// Returns whether the plan keeps a block's coefficients and stamps.
    pub(crate) fn keeps(&self, (column, row): (usize, usize)) -> bool {
        let block = self.block(column, row);
        block.table.is_some() && block.stamps.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_are_counted_once_a_pass_and_spectra_once() {
        let mut work = GpuWork::default();
        work.add_tile(3, (1000, 800), (100, 200), Direction::Scatter);
        work.add_block(3, 1000);
        work.add_image((10, 20), (30, 40), Direction::Scatter);
        assert_eq!(work.memory_bytes, 4 * (6 * 800 + 2 * 1000 + 100 + 400 + 3 * 1000));
        assert_eq!(work.bus_bytes, 4 * (100 + 1200));
        assert!(work.seconds(AdapterKind::Discrete) < work.seconds(AdapterKind::Software));
    }
}
