//! What can go wrong with a GPU.

use thiserror::Error;

/// Errors of GPUs. None of them comes with an image: what was not computed is not returned. (An image that light was to be added to holds some of it then.)
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum GpuError {
    /// There is no adapter.
    #[error(
        "there is no GPU that Vulkan, Metal, DirectX 12 or OpenGL could drive here; is its driver installed?"
    )]
    NoAdapter,
    /// There is none of this name.
    #[error("no GPU answers to {wanted:?}; there is {}", present.join(", "))]
    NoSuchAdapter {
        /// The name asked for.
        wanted: String,
        /// The adapters that are there.
        present: Vec<String>,
    },
    /// The adapter cannot be used.
    #[error("{adapter} cannot be used: {reason}")]
    Unusable {
        /// The adapter.
        adapter: String,
        /// Why.
        reason: String,
    },
    /// GPUs compute in f32 alone.
    #[error("GPUs compute in f32, this plan is in {precision}")]
    Precision {
        /// The plan's precision.
        precision: &'static str,
    },
    /// The plan's transforms are too large.
    #[error("{adapter}: transforms of {size} values are too large for it, {most} is the most")]
    TransformSize {
        /// The adapter.
        adapter: String,
        /// The length asked for.
        size: usize,
        /// The longest that it can do.
        most: usize,
    },
    /// A piece of work that cannot be made smaller does not fit.
    #[error("{adapter}: {what} takes {needed} bytes at once, {limit} is the most that it can see")]
    TooLarge {
        /// The adapter.
        adapter: String,
        /// What does not fit.
        what: &'static str,
        /// Bytes.
        needed: u64,
        /// The adapter's limit, in bytes.
        limit: u64,
    },
    /// Its memory is full.
    #[error("{adapter} is out of memory; a smaller memory limit may help, or what else uses the GPU")]
    OutOfMemory {
        /// The adapter.
        adapter: String,
    },
    /// It is gone: unplugged, reset by its driver, or taken by the system.
    #[error("{adapter} was lost: {reason}")]
    Lost {
        /// The adapter.
        adapter: String,
        /// What the driver says.
        reason: String,
    },
    /// Anything else: the driver refused something.
    #[error("{adapter}: {reason}")]
    Driver {
        /// The adapter.
        adapter: String,
        /// What it says.
        reason: String,
    },
}
