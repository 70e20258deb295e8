//! The threads that do the work.

use std::sync::{Arc, Mutex, PoisonError};

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
