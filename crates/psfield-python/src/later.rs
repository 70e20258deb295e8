//! What is made when it is first needed, and kept.

use std::sync::{Mutex, MutexGuard, OnceLock, TryLockError};
use std::time::Duration;

use psfield::conv_core::{ConvError, ConvReal};
use psfield::psf_types::{Cancelled, Progress};

use crate::error::Failure;
use crate::interruptible::Watch;
use crate::prepared::Prepared;

/// What is made when it is first needed, and kept.
pub(crate) struct Later<T: ConvReal> {
    made: OnceLock<Prepared<T>>,
    /// Held while it is made, by a thread beside the pool.
    making: Mutex<()>,
}

impl<T: ConvReal> Default for Later<T> {
    fn default() -> Self {
        Self {
            made: OnceLock::new(),
            making: Mutex::new(()),
        }
    }
}

impl<T: ConvReal> Later<T> {
    pub(crate) fn get(
        &self,
        watch: &Watch,
        make: impl FnOnce() -> Result<Prepared<T>, Failure>,
    ) -> Result<&Prepared<T>, Failure> {
        if let Some(made) = self.made.get() {
            return Ok(made);
        }
        let _making = turn(&self.making, watch)?;
        if let Some(made) = self.made.get() {
            return Ok(made);
        }
        let made = make()?;
        Ok(self.made.get_or_init(|| made))
    }
}

/// How often it is asked whether somebody who waits for a lock still wants it.
const ASKED_EVERY: Duration = Duration::from_millis(2);

/// Waits for a lock as long as the work is wanted; on a thread beside the pool.
pub(crate) fn turn<'a, M>(mutex: &'a Mutex<M>, watch: &Watch) -> Result<MutexGuard<'a, M>, ConvError> {
    loop {
        match mutex.try_lock() {
            Ok(guard) => return Ok(guard),
            Err(TryLockError::Poisoned(poisoned)) => return Ok(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) if watch.cancelled() => return Err(Cancelled.into()),
            Err(TryLockError::WouldBlock) => std::thread::sleep(ASKED_EVERY),
        }
    }
}
