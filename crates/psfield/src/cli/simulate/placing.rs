//! On the processor or on a GPU.

use psfield::{CpuReason, Device, Gpus, Placement, PsfieldError};

use super::super::context::Context;
use super::SimulateArgs;

impl SimulateArgs {
    /// Opens the GPU that was asked for before the rest of the work, which would be in vain without.
    pub(super) fn open_gpu(&self, gpus: &mut Gpus, context: &Context) -> Result<(), PsfieldError> {
        // Stars alone need none.
        let needed = self.scene.scene.is_some() || !cfg!(feature = "gpu");
        if let (Device::Gpu { adapter }, true) = (self.device.options().device(), needed) {
            let _spinner = context.spinner("opening the GPU");
            gpus.open(adapter.as_deref())?;
        }
        Ok(())
    }

    /// Where methods without a plan run.
    pub(super) fn unplanned(&self) -> Placement {
        Placement::cpu(match self.device.options().device() {
            Device::Cpu => CpuReason::Asked,
            _ => CpuReason::Method,
        })
    }

    /// Says where the work is not done on a GPU that was meant to do it.
    pub(super) fn warn_of_placement(&self, placement: &Placement, context: &Context) {
        if placement.is_failure() {
            context.warn(&format!("the work is done {placement}"));
        } else if self.device.is_gpu() && placement.adapter().is_none() {
            context.warn(
                "--device gpu is of scenes with an image or galaxies: stars alone are drawn on the CPU",
            );
        }
    }
}
