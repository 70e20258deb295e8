//! The work of a plan for one operation (the convolution or its adjoint), divided for a GPU into
//! panels and batches (`panels.rs` explains them).

use super::batch_data::{BatchData, WorkBuffers};
use super::device::{Attempt, Pipelines};
use super::panels::{Panel, panels};
use crate::ConvReal;
use crate::error::GpuError;
use crate::plan::Plan;

/// Limits of the work on a GPU.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GpuOptions {
    memory_bytes: u64,
    piece_bytes: u64,
}

impl GpuOptions {
    /// The default limit of the GPU memory that a plan keeps: 2 GiB.
    pub const DEFAULT_MEMORY_BYTES: u64 = 2 << 30;
    /// The default size of pieces of work: 64 MiB.
    pub const DEFAULT_PIECE_BYTES: u64 = 64 << 20;

    /// Limits the GPU memory that the plan keeps for spectra, stamps and coefficients. Each
    /// execution computes again the data that do not fit. The limit does not include the working
    /// memory, which has the size of a few pieces of work ([`with_pieces`](Self::with_pieces)).
    #[must_use]
    pub fn with_memory(self, bytes: u64) -> Self {
        Self {
            memory_bytes: bytes,
            ..self
        }
    }

    /// Sets the size of pieces of work: the most bytes of a piece's light, and likewise of its
    /// planes, spectra, stamps and result. A piece that cannot be that small may exceed this limit,
    /// but not the adapter's own limit.
    #[must_use]
    pub fn with_pieces(self, bytes: u64) -> Self {
        Self {
            piece_bytes: bytes,
            ..self
        }
    }

    /// The most bytes that the plan keeps on the GPU.
    pub fn memory_bytes(&self) -> u64 {
        self.memory_bytes
    }

    /// The size of pieces of work in bytes, as set by [`with_pieces`](Self::with_pieces).
    pub fn piece_bytes(&self) -> u64 {
        self.piece_bytes
    }
}

impl Default for GpuOptions {
    fn default() -> Self {
        Self {
            memory_bytes: Self::DEFAULT_MEMORY_BYTES,
            piece_bytes: Self::DEFAULT_PIECE_BYTES,
        }
    }
}

/// The work of a plan for one operation (the convolution or its adjoint), and the data kept for it.
#[derive(Debug)]
pub(super) struct Layout {
    pub(super) panels: Vec<Panel>,
    /// The data of the first batches, as far as they fit into the memory limit.
    pub(super) kept: Vec<BatchData>,
    /// The size of the kept data in bytes.
    pub(super) bytes: u64,
}

impl Layout {
    /// Divides the work of the convolution, or of its adjoint if `flip` is true. Then computes, for
    /// each batch, the data that do not depend on the light, as far as they fit into the memory
    /// limit of the options.
    pub(super) fn new<T: ConvReal>(
        plan: &Plan<T>,
        pipelines: &Pipelines,
        options: GpuOptions,
        device: &mut Attempt,
        working: &mut WorkBuffers,
        flip: bool,
    ) -> Result<Self, GpuError> {
        let plane_bytes = pipelines.source.bytes();
        let piece = options.piece_bytes.min(device.adapter().most_at_once());
        let mut layout = Self {
            panels: panels(plan, plan.direction(flip), plane_bytes, device.adapter(), piece)?,
            kept: Vec::new(),
            bytes: 0,
        };
        for batch in layout.panels.iter().flat_map(|panel| &panel.batches) {
            // The spectra are the largest part of the data. If they alone do not fit, the data of
            // this batch and of later batches are not computed.
            if layout.bytes + batch.spectra as u64 * plane_bytes > options.memory_bytes {
                break;
            }
            let data = match BatchData::new(device, pipelines, working, plan, (batch, flip), None) {
                // Keeps no more data: each execution computes the data that are not kept.
                Err(GpuError::OutOfMemory { .. }) => {
                    device.forgive();
                    // Returns an error if wgpu has closed the whole device.
                    device.check()?;
                    // Some of the working buffers may be invalid.
                    *working = WorkBuffers::new(device);
                    break;
                }
                made => made?,
            };
            if layout.bytes + data.bytes() > options.memory_bytes {
                break;
            }
            layout.bytes += data.bytes();
            layout.kept.push(data);
        }
        Ok(layout)
    }
}
