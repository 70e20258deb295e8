//! The threads that do the work, without the interpreter, which stays able to interrupt it.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::Duration;

use psfield::conv_core::ConvError;
use psfield::psf_types::{Cancelled, Progress};
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::error::invalid;

/// The pool of one process.
struct Pool {
    process: u32,
    pool: Arc<ThreadPool>,
}

/// A forked process (a data loader's worker) inherits the memory of its parent but none of its threads: it makes a pool of its own.
static POOL: Mutex<Option<Pool>> = Mutex::new(None);

/// This process's threads.
pub(crate) fn pool() -> PyResult<Arc<ThreadPool>> {
    let mut kept = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    let process = std::process::id();
    if let Some(pool) = kept.as_ref()
        && pool.process == process
    {
        return Ok(Arc::clone(&pool.pool));
    }
    // Dropping the parent's pool would wait for threads that are not here.
    std::mem::forget(kept.take());
    let made = made(0)?;
    *kept = Some(Pool {
        process,
        pool: Arc::clone(&made),
    });
    Ok(made)
}

/// A pool of as many threads as asked for; 0: as `RAYON_NUM_THREADS` says, or one a core.
pub(crate) fn made(count: usize) -> PyResult<Arc<ThreadPool>> {
    ThreadPoolBuilder::new()
        .num_threads(count)
        .thread_name(|i| format!("psfield-{i}"))
        .build()
        .map(Arc::new)
        .map_err(|error| invalid(format!("threads cannot be started: {error}")))
}

/// Sets the number of threads; 0 for the default.
#[pyfunction]
pub(crate) fn set_threads(py: Python<'_>, count: usize) -> PyResult<()> {
    let previous = pool()?;
    let made = made(count)?;
    POOL.lock().unwrap_or_else(PoisonError::into_inner).replace(Pool {
        process: std::process::id(),
        pool: made,
    });
    // The last one out waits for its threads.
    py.detach(|| drop(previous));
    Ok(())
}

/// The number of threads.
#[pyfunction]
pub(crate) fn threads() -> PyResult<usize> {
    Ok(pool()?.current_num_threads())
}

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
        let of = |count: &AtomicU64| count.load(Ordering::Relaxed);
        let steps = (of(&self.watch.done), of(&self.watch.total));
        match self.progress {
            Some(callback) if steps != self.last => {
                self.last = steps;
                callback.call1(py, steps).map(drop)
            }
            _ => Ok(()),
        }
    }

    /// Waits for the end of the work, or for an exception, which stops it: of a signal, or of the caller's function. Without the
    /// interpreter.
    fn wait(&mut self, end: &Receiver<()>) -> PyResult<()> {
        while let Err(RecvTimeoutError::Timeout) = end.recv_timeout(TICK) {
            let told = Python::attach(|py| py.check_signals().and_then(|()| self.tell(py)));
            if told.is_err() {
                self.watch.stopped.store(true, Ordering::Relaxed);
                return told;
            }
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
        Teller::new(None, &watch).wait(&end)?;
        Ok(worker
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })
}

/// How often it is asked whether somebody who waits for a lock still wants it.
const ASKED_EVERY: Duration = Duration::from_millis(2);

/// Waits for a lock as long as the work is wanted; on a thread beside the pool.
pub(crate) fn turn<'a>(mutex: &'a Mutex<()>, watch: &Watch) -> Result<MutexGuard<'a, ()>, ConvError> {
    loop {
        match mutex.try_lock() {
            Ok(guard) => return Ok(guard),
            Err(TryLockError::Poisoned(poisoned)) => return Ok(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) if watch.cancelled() => return Err(Cancelled.into()),
            Err(TryLockError::WouldBlock) => std::thread::sleep(ASKED_EVERY),
        }
    }
}
