//! Work that may be stopped.

use psf_types::Progress;

use crate::ConvError;

/// Asks whether work is still wanted; an error where it is not.
pub(crate) fn still_wanted(progress: &dyn Progress) -> Result<(), ConvError> {
    if progress.cancelled() {
        Err(ConvError::Cancelled)
    } else {
        Ok(())
    }
}

/// Asks whether work is still wanted and does not tell how far it has come: for parts of work whose steps are not counted.
pub(crate) struct Uncounted<'a>(pub(crate) &'a dyn Progress);

impl Progress for Uncounted<'_> {
    fn start(&self, _total: u64) {}
    fn advance(&self, _steps: u64) {}
    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}
