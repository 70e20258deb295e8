//! Refuses work for which the system has no memory. Without this, Rust would end the interpreter when an
//! allocation fails.

use std::hint::black_box;

use pyo3::exceptions::PyMemoryError;
use pyo3::prelude::*;

/// Memory beside the large arrays.
const BESIDE: usize = 64 << 20;

/// Asks the system for as much memory as some work needs at least, and gives it back.
///
/// # Errors
/// `MemoryError` if the system or a limit refuses it.
pub(crate) fn check(what: &str, bytes: usize) -> PyResult<()> {
    let needed = bytes.saturating_add(BESIDE);
    let mut probe = Vec::<u8>::new();
    let got = probe.try_reserve_exact(needed);
    black_box(&probe);
    got.map_err(|_| {
        let megabytes = needed.div_ceil(1 << 20);
        PyMemoryError::new_err(format!(
            "{what} needs at least {megabytes} MiB, which the system or a limit (ulimit -v) refuses"
        ))
    })
}
