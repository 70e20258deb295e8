//! Where the time goes.

use std::time::Duration;

/// How long the parts of an execution took. What the host does overlaps with the rest, so that the sum may be more than the whole.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct GpuTimes {
    /// From the light in the host's memory to the image there.
    pub total: Duration,
    /// Shaders, by the GPU's own clock. None where it has none that can be read.
    pub kernels: Option<Duration>,
    /// Copies of the light to the GPU's memory and of the image from it, by the GPU's own clock. None where it has none that can be read.
    pub transfers: Option<Duration>,
    /// What the host did meanwhile: looking at the light and handing it over, adding the result to the image.
    pub host: Duration,
    /// Bytes copied to the GPU, and from it.
    pub bytes: (u64, u64),
}
