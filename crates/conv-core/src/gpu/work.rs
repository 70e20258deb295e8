//! What an execution has to move.

use super::adapter::AdapterKind;
use crate::lowrank::shared::Direction;

/// The bytes that an execution on a GPU moves at least, where every pixel is lit: the floor under the time it takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct GpuWork {
    /// Between the host's memory and the GPU's: light to it, the image from it.
    pub bus_bytes: u64,
    /// Through the GPU's own memory: what shaders read and write, each value of a plane, a spectrum, the light and the image once a pass.
    pub memory_bytes: u64,
}

const F32: u64 = 4;

impl GpuWork {
    /// A tile of some kernels: values of a plane, of its light and of its result.
    pub(crate) fn add_tile(&mut self, plane: u64, kernels: u64, light: u64, result: u64) {
        // Along x: the light in, a plane out for each kernel (or one, where kernels come after). Along y: those in, spectra in, one plane out (or
        // one for each kernel). Back along x: those in, the image in and out.
        let planes = 3 * kernels + 2;
        self.memory_bytes += F32 * (planes * plane + light + 2 * result);
        self.bus_bytes += F32 * light;
    }

    /// The image.
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

    /// Predicted seconds on a kind of adapter, rounded guesses from what such hardware usually is, not measurements: only good
    /// enough to choose a device.
    pub(crate) fn seconds(&self, kind: AdapterKind) -> f64 {
        // Bytes a second over the bus with what the host does for it, through memory, and what it takes to begin.
        let (bus, memory, start) = match kind {
            AdapterKind::Discrete | AdapterKind::Virtual => (8e9, 2e11, 1e-3),
            AdapterKind::Integrated | AdapterKind::Other => (8e9, 3e10, 1e-3),
            AdapterKind::Software => (4e9, 1e9, 1e-3),
        };
        self.bus_bytes as f64 / bus + self.memory_bytes as f64 / memory + start
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_are_counted_once_a_pass() {
        let mut work = GpuWork::default();
        work.add_tile(1000, 3, 100, 200);
        work.add_image((10, 20), (30, 40), Direction::Scatter);
        assert_eq!(work.memory_bytes, 4 * (11 * 1000 + 100 + 400));
        assert_eq!(work.bus_bytes, 4 * (100 + 1200));
        assert!(work.seconds(AdapterKind::Discrete) < work.seconds(AdapterKind::Software));
    }
}
