//! The work of a plan in one direction, cut for a GPU.

use super::batch_data::BatchData;
use super::device::Attempt;
use super::error::GpuError;
use super::options::GpuOptions;
use super::panels::{Limits, Panel, panels};
use super::pipelines::Pipelines;
use super::working::Working;
use crate::lowrank::shared::{Direction, PlanView};
use crate::{ConvReal, Plan};

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

/// Who cuts a direction's work and hands over what it needs whatever the light.
pub(super) struct LayoutMaker<'a, T: ConvReal> {
    pub(super) plan: &'a Plan<T>,
    pub(super) device: &'a mut Attempt,
    pub(super) pipelines: &'a Pipelines,
    pub(super) view: &'a PlanView,
    pub(super) options: GpuOptions,
}

impl<T: ConvReal> LayoutMaker<'_, T> {
    /// The work, and as much of what it needs as fits into some bytes of the GPU's memory.
    pub(super) fn make(self, working: &mut Working, flip: bool, memory: u64) -> Result<Layout, GpuError> {
        let adapter = self.device.adapter();
        let limits = Limits {
            adapter,
            piece: self.options.piece_bytes().min(adapter.most_at_once()),
        };
        let direction = self.plan.direction(flip);
        let panels = panels(self.view, &self.pipelines.source, direction, limits)?;
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
                let data =
                    match working.batch_data(self.device, self.pipelines, self.plan, (batch, flip), None) {
                        // What does not fit is made anew by each execution.
                        Err(GpuError::OutOfMemory { .. }) => {
                            self.device.forgive();
                            // wgpu may have given up the whole device.
                            self.device.check()?;
                            // Some of its buffers may be no buffers.
                            *working = Working::new(self.device);
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
