//! Long work without the interpreter, which stays able to interrupt it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use psfield::psf_types::Progress;
use pyo3::prelude::*;
use rayon::ThreadPool;

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
    fn stop(&self) {
        self.stopped.store(true, Ordering::Relaxed);
    }

    fn steps(&self) -> (u64, u64) {
        (
            self.done.load(Ordering::Relaxed),
            self.total.load(Ordering::Relaxed),
        )
    }
}

/// Tells a function of the caller's how far work has come.
struct Teller<'a> {
    progress: Option<&'a Py<PyAny>>,
    watch: &'a Watch,
    last: (u64, u64),
}

impl<'a> Teller<'a> {
    fn new(progress: Option<&'a Py<PyAny>>, watch: &'a Watch) -> Self {
        Self {
            progress,
            watch,
            last: (0, 0),
        }
    }

    /// Calls `progress(done, total)` where something happened.
    fn tell(&mut self, py: Python<'_>) -> PyResult<()> {
        let steps = self.watch.steps();
        match self.progress {
            Some(callback) if steps != self.last => {
                self.last = steps;
                callback.call1(py, steps).map(drop)
            }
            _ => Ok(()),
        }
    }

    /// Waits for the end of the work, or for an exception: of a signal, or of the caller's function. Without the interpreter.
    fn wait(&mut self, end: &Receiver<()>) -> PyResult<()> {
        while let Err(RecvTimeoutError::Timeout) = end.recv_timeout(TICK) {
            Python::attach(|py| {
                py.check_signals()?;
                self.tell(py)
            })?;
        }
        Ok(())
    }
}

/// Runs work on psfield's threads without holding the interpreter. Meanwhile this thread looks after signals, so that Ctrl-C stops the work when it next
/// asks whether it is still wanted, and tells `progress(done, total)`, if there is one; an exception in it stops the work too.
pub(crate) fn run<R: Send>(
    py: Python<'_>,
    progress: Option<&Py<PyAny>>,
    work: impl FnOnce(&Watch) -> R + Send,
) -> PyResult<R> {
    run_beside(py, progress, &*pool()?, |watch, pool| {
        pool.install(|| work(watch))
    })
}

/// The same on a thread beside a pool, which the work hands its parts to. What it waits for (a lock that is held for long, Python) is waited for here: a
/// thread of a pool that waits keeps it from others, and one that holds a lock may meanwhile take up a task that wants the same lock.
pub(crate) fn run_beside<R: Send>(
    py: Python<'_>,
    progress: Option<&Py<PyAny>>,
    pool: &ThreadPool,
    work: impl FnOnce(&Watch, &ThreadPool) -> R + Send,
) -> PyResult<R> {
    let watch = Watch::default();
    let mut teller = Teller::new(progress, &watch);
    let result = py.detach(|| {
        std::thread::scope(|scope| {
            let (ended, end) = channel::<()>();
            let watch = &watch;
            let worker = scope.spawn(move || {
                // Told by being dropped, also where the work panics.
                let _ended = ended;
                work(watch, pool)
            });
            let waited = teller.wait(&end);
            if waited.is_err() {
                watch.stop();
            }
            // Its arrays are the caller's: it must have ended before they are given back.
            let result = worker
                .join()
                .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            waited.map(|()| result)
        })
    })?;
    teller.tell(py)?;
    Ok(result)
}

/// The same as [`run_beside`] for work that borrows nothing of the caller's, and is left behind where it is interrupted: it ends by itself, and what it gives is dropped.
pub(crate) fn run_apart<R: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(&Watch, &ThreadPool) -> R + Send + 'static,
) -> PyResult<R> {
    let pool = pool()?;
    let watch = Arc::new(Watch::default());
    py.detach(|| {
        let (ended, end) = channel::<()>();
        let of_work = Arc::clone(&watch);
        let worker = std::thread::spawn(move || {
            let _ended = ended;
            work(&of_work, &pool)
        });
        let waited = Teller::new(None, &watch).wait(&end);
        if waited.is_err() {
            watch.stop();
        }
        waited?;
        Ok(worker
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })
}
