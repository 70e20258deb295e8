//! Long work without the interpreter, which stays able to interrupt it.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use psfield::psf_types::Progress;
use pyo3::prelude::*;

use crate::threads::pool;

/// How often signals and progress are looked at.
const TICK: Duration = Duration::from_millis(50);

/// How far work has come, and whether it is to stop.
#[derive(Debug, Default)]
pub(crate) struct Watch {
    total: AtomicU64,
    done: AtomicU64,
    stopped: AtomicBool,
}

impl Progress for Watch {
    fn start(&self, total: u64) {
        self.total.store(total, Ordering::Relaxed);
    }

    fn advance(&self, steps: u64) {
        self.done.fetch_add(steps, Ordering::Relaxed);
    }

    fn cancelled(&self) -> bool {
        self.stopped.load(Ordering::Relaxed)
    }
}

impl Watch {
    fn steps(&self) -> (u64, u64) {
        (
            self.done.load(Ordering::Relaxed),
            self.total.load(Ordering::Relaxed),
        )
    }
}

/// Runs work on psfield's threads without holding the interpreter. Meanwhile this thread looks after signals, so that Ctrl-C stops the work at its next
/// step, and tells `progress(done, total)`, if there is one; an exception in it stops the work too.
///
/// Work that never asks whether it is cancelled is waited for.
pub(crate) fn run<R: Send>(
    py: Python<'_>,
    progress: Option<&Py<PyAny>>,
    work: impl FnOnce(&Watch) -> R + Send,
) -> PyResult<R> {
    let pool = pool()?;
    let watch = Watch::default();
    let told = |py: Python<'_>, last: &mut (u64, u64)| -> PyResult<()> {
        let steps = watch.steps();
        match progress {
            Some(callback) if steps != *last => {
                *last = steps;
                callback.call1(py, steps).map(drop)
            }
            _ => Ok(()),
        }
    };
    let mut last = (0, 0);
    let (result, failure) = py.detach(|| {
        std::thread::scope(|scope| {
            let (ended, end) = channel::<()>();
            let (pool, watch) = (&pool, &watch);
            let worker = scope.spawn(move || {
                // Told by being dropped, also where the work panics.
                let _ended = ended;
                pool.install(|| work(watch))
            });
            let mut failure = None;
            while let Err(RecvTimeoutError::Timeout) = end.recv_timeout(TICK) {
                if failure.is_none() {
                    let looked = Python::attach(|py| {
                        py.check_signals()?;
                        told(py, &mut last)
                    });
                    if let Err(error) = looked {
                        watch.stopped.store(true, Ordering::Relaxed);
                        failure = Some(error);
                    }
                }
            }
            let result = worker
                .join()
                .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            (result, failure)
        })
    });
    if let Some(error) = failure {
        return Err(error);
    }
    told(py, &mut last)?;
    Ok(result)
}
