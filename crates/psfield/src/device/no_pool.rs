//! In place of open GPUs where this build has no support of them.

use conv_core::{ConvReal, Plan};

use super::{CpuReason, Placement};
use crate::PsfieldError;

#[derive(Debug, Default)]
pub(super) struct Pool;

#[allow(clippy::unused_self, reason = "the twin of what opens GPUs")]
impl Pool {
    pub(super) fn open(&mut self, _adapter: Option<&str>) -> Result<String, PsfieldError> {
        Err(PsfieldError::NoGpuSupport)
    }

    pub(super) fn attach<T: ConvReal>(
        &mut self,
        _plan: &mut Plan<T>,
        _adapter: Option<&str>,
        _memory: Option<u64>,
    ) -> Result<String, PsfieldError> {
        Err(PsfieldError::NoGpuSupport)
    }

    pub(super) fn attach_if_faster<T: ConvReal>(
        &mut self,
        _plan: &mut Plan<T>,
        _adapter: Option<&str>,
        _memory: Option<u64>,
        _cpu_seconds: f64,
    ) -> Placement {
        Placement::cpu(CpuReason::NotBuilt)
    }
}
