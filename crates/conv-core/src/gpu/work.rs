//! The amount of data that an execution moves, and the time predicted from it.

use super::adapter::{Adapter, AdapterKind};
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
        let direction = self.direction(false);
        let values = |(nx, ny): (usize, usize)| (nx * ny) as u64;
        let plane = values(self.tiling.size);
        let image = match direction {
            Direction::Scatter => self.geometry.other_size(),
            Direction::Gather => self.geometry.weighted_size(),
        };
        // The upper half of the rows is the imaginary part of the lower.
        let (nx, half) = (self.tiling.size.0, self.tiling.size.1 / 2);
        // Returns the values of a tile over the bus, and to and from the GPU's memory.
        let of_tile = |kernels: u64, size: (usize, usize)| {
            let light = self.geometry.light_size(direction, size);
            let filled = values((2 * nx, light.1.min(half)));
            let (planes, result) = match direction {
                // The transforms along x write the filled part of a plane per kernel. The
                // transforms along y read these planes and write one plane. The transforms back
                // along x read it.
                Direction::Scatter => (2 * kernels * filled + 2 * plane, self.geometry.around(size)),
                // The transforms along x write the filled part of one plane. The transforms along y
                // read it and write a plane per kernel. The transforms back along x read these
                // planes.
                Direction::Gather => (2 * filled + 2 * kernels * plane, size),
            };
            // Reads the light, reads and writes the image.
            (values(light), planes + values(light) + 2 * values(result))
        };
        let (mut bus, mut memory) = (values(image), 0);
        for (y, rows) in self.tiling.rows.iter().enumerate() {
            for (x, columns) in self.tiling.columns.iter().enumerate() {
                let kernels = self.block(x, y).kernel_count() as u64;
                memory += kernels * plane;
                for &(_, height) in &rows.tiles {
                    for &(_, width) in &columns.tiles {
                        let of_tile = of_tile(kernels, (width, height));
                        bus += of_tile.0;
                        memory += of_tile.1;
                    }
                }
            }
        }
        GpuWork {
            bus_bytes: F32 * bus,
            memory_bytes: F32 * memory,
        }
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
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hardware_is_faster_than_software() {
        let work = GpuWork {
            bus_bytes: 1 << 20,
            memory_bytes: 1 << 24,
        };
        assert!(work.seconds(AdapterKind::Discrete) < work.seconds(AdapterKind::Software));
    }
}
