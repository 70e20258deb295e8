//! Runs work on threads that do not hold the interpreter, so that Python can interrupt it.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::Duration;

use psfield::conv_core::ConvError;
use psfield::psf_types::{Cancelled, Progress};
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::error::{Failure, invalid};

/// The thread pool of one process.
struct Pool {
    process: u32,
    pool: Arc<ThreadPool>,
}

/// The current pool. A forked process, such as a worker of a data loader, inherits the memory of
/// its parent but none of its threads. It therefore makes a new pool.
static POOL: Mutex<Option<Pool>> = Mutex::new(None);

/// The thread pool of this process.
pub(crate) fn pool() -> PyResult<Arc<ThreadPool>> {
    let mut kept = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    let process = std::process::id();
    if let Some(pool) = kept.as_ref()
        && pool.process == process
    {
        return Ok(Arc::clone(&pool.pool));
    }
    // Dropping the pool of the parent would take locks of threads that do not exist in this
    // process, and could wait for such a lock forever.
    std::mem::forget(kept.take());
    let made = made(0)?;
    *kept = Some(Pool {
        process,
        pool: Arc::clone(&made),
    });
    Ok(made)
}

/// Makes a pool of `count` threads. If `count` is 0, the environment variable `RAYON_NUM_THREADS`
/// gives the number, or else there is one thread per core.
pub(crate) fn made(count: usize) -> PyResult<Arc<ThreadPool>> {
    ThreadPoolBuilder::new()
        .num_threads(count)
        .thread_name(|i| format!("psfield-{i}"))
        .build()
        .map(Arc::new)
        .map_err(|error| invalid(format!("threads cannot be started: {error}")))
}

/// Sets the number of threads. 0 selects the default.
#[pyfunction]
pub(crate) fn set_threads(py: Python<'_>, count: usize) -> PyResult<()> {
    let previous = pool()?;
    let made = made(count)?;
    POOL.lock().unwrap_or_else(PoisonError::into_inner).replace(Pool {
        process: std::process::id(),
        pool: made,
    });
    // Dropping the last reference takes a lock of each thread of the pool. The interpreter is
    // released meanwhile.
    py.detach(|| drop(previous));
    Ok(())
}

/// The number of threads.
#[pyfunction]
pub(crate) fn threads() -> PyResult<usize> {
    Ok(pool()?.current_num_threads())
}

/// The interval between two checks for signals (Ctrl-C) and progress.
const TICK: Duration = Duration::from_millis(50);

/// The progress of some work, and a flag that cancels it.
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

/// Reports progress to a function of the caller.
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

    /// Calls `progress(done, total)` if one of these numbers has changed.
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

    /// Waits for the end of the work, without holding the interpreter. If a signal or the caller's
    /// function raises an exception, the work is cancelled.
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

/// Runs work on the pool without holding the interpreter.
///
/// Meanwhile this thread checks for signals and calls `progress(done, total)`, if given. Ctrl-C or
/// an exception in `progress` cancels the work at its next check.
pub(crate) fn run<R: Send>(
    py: Python<'_>,
    progress: Option<&Py<PyAny>>,
    work: impl FnOnce(&Watch) -> R + Send,
) -> PyResult<R> {
    run_beside(py, progress, &*pool()?, |watch, pool| {
        pool.install(|| work(watch))
    })
}

/// Works like [`run`], but runs the work on an extra thread outside the pool. The work itself sends
/// its parallel parts to the pool.
///
/// The extra thread may wait for a lock or for Python. A thread of the pool must not wait, because
/// it would do no work meanwhile. It must not hold a lock either, because it may start another task
/// that needs the same lock.
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
                // The drop of `_ended` signals the end, also when the work panics.
                let _ended = ended;
                work(watch, pool)
            });
            let waited = teller.wait(&end);
            // The work borrows arrays of the caller. It must therefore end before this function
            // returns.
            let result = worker
                .join()
                .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            waited.map(|()| result)
        })
    })?;
    teller.tell(py)?;
    Ok(result)
}

/// Works like [`run`], for work that borrows nothing from the caller. After an interruption this
/// function returns at once. The work then goes on in the background until it ends or checks whether it
/// is cancelled, and its result is dropped.
pub(crate) fn run_apart<R: Send + 'static, E: Into<Failure> + Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(&Watch) -> Result<R, E> + Send + 'static,
) -> PyResult<R> {
    let pool = pool()?;
    let watch = Arc::new(Watch::default());
    let made = py.detach(|| -> PyResult<_> {
        let (ended, end) = channel::<()>();
        let of_work = Arc::clone(&watch);
        let worker = std::thread::spawn(move || {
            let _ended = ended;
            pool.install(|| work(&of_work))
        });
        Teller::new(None, &watch).wait(&end)?;
        Ok(worker
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })?;
    Ok(made.map_err(Into::into)?)
}

/// The interval between two attempts to take a lock.
const RETRY_INTERVAL: Duration = Duration::from_millis(2);

/// Waits for a lock and takes it, or returns an error when the work is cancelled. Call it on a
/// thread outside the pool.
pub(crate) fn turn<'a, T>(mutex: &'a Mutex<T>, watch: &Watch) -> Result<MutexGuard<'a, T>, ConvError> {
    loop {
        match mutex.try_lock() {
            Ok(guard) => return Ok(guard),
            Err(TryLockError::Poisoned(poisoned)) => return Ok(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) if watch.cancelled() => return Err(Cancelled.into()),
            Err(TryLockError::WouldBlock) => std::thread::sleep(RETRY_INTERVAL),
        }
    }
}
