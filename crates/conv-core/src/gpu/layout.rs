//! The work of a plan in one direction, cut for a GPU.

use std::sync::Arc;

use super::batch_data::{BatchData, WorkBuffers};
use super::device::{Attempt, Pipelines};
use super::panels::{Limits, Panel, TileGrid, panels};
use crate::ConvReal;
use crate::error::GpuError;
use crate::plan::Plan;
use crate::plan::geometry::Direction;

/// Limits of the work on a GPU.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GpuOptions {
    memory_bytes: u64,
    piece_bytes: u64,
}

impl GpuOptions {
    /// What a plan keeps on the GPU unless told otherwise: 2 GiB.
    pub const DEFAULT_MEMORY_BYTES: u64 = 2 << 30;
    /// Pieces of work unless told otherwise: 64 MiB.
    pub const DEFAULT_PIECE_BYTES: u64 = 64 << 20;

    /// The same with another limit to what the plan keeps on the GPU: spectra and coefficients. What does not fit is made anew by each
    /// execution. What is in work comes on top, a few pieces of [`with_pieces`](Self::with_pieces).
    #[must_use]
    pub fn with_memory(self, bytes: u64) -> Self {
        Self {
            memory_bytes: bytes,
            ..self
        }
    }

    /// The same with other pieces of work, in bytes; the adapter's own limit holds beside it.
    #[must_use]
    pub fn with_pieces(self, bytes: u64) -> Self {
        Self {
            piece_bytes: bytes,
            ..self
        }
    }

    /// Bytes that a plan keeps on the GPU at most.
    pub fn memory_bytes(&self) -> u64 {
        self.memory_bytes
    }

    /// Bytes of a piece of work at most.
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

/// The work of a direction, and what is kept for it.
#[derive(Debug)]
pub(super) struct Layout {
    pub(super) direction: Direction,
    /// Stamps are applied turned by 180 degrees.
    pub(super) flip: bool,
    pub(super) panels: Vec<Panel>,
    /// By panel and batch, as far as the memory reaches.
    pub(super) kept: Vec<Vec<Option<BatchData>>>,
    /// Bytes of what is kept.
    pub(super) bytes: u64,
}

/// A plan's tiles, the shaders for its transforms, and the limits that its work is cut to.
#[derive(Debug)]
pub(super) struct GpuPlan {
    pub(super) pipelines: Arc<Pipelines>,
    pub(super) grid: TileGrid,
    pub(super) options: GpuOptions,
}

impl GpuPlan {
    /// The work of a direction, and as much of what it needs whatever the light as fits into the
    /// memory of the GPU that the options allow when some of it is taken.
    pub(super) fn layout<T: ConvReal>(
        &self,
        plan: &Plan<T>,
        device: &mut Attempt,
        working: &mut WorkBuffers,
        flip: bool,
        taken: u64,
    ) -> Result<Layout, GpuError> {
        let memory = self.options.memory_bytes().saturating_sub(taken);
        let adapter = device.adapter();
        let limits = Limits {
            adapter,
            piece: self.options.piece_bytes().min(adapter.most_at_once()),
        };
        let direction = plan.direction(flip);
        let panels = panels(&self.grid, &self.pipelines.source, direction, limits)?;
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
                let data = match BatchData::new(device, &self.pipelines, working, plan, (batch, flip), None) {
                    // What does not fit is made anew by each execution.
                    Err(GpuError::OutOfMemory { .. }) => {
                        device.forgive();
                        // wgpu may have given up the whole device.
                        device.check()?;
                        // Some of its buffers may be no buffers.
                        *working = WorkBuffers::new(device);
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
