//! Limits of time and memory for a read.

use std::time::Instant;

/// Seconds of processor time for a read, or of wall-clock time if the system does not measure
/// processor time.
const SECONDS: f64 = 1.0;
/// Seconds of processor time for the plan of a telescope. The author of a description chooses the
/// size of the transforms, up to a limit.
const PLAN_SECONDS: f64 = 60.0;
/// The largest growth of the process's address space.
const MEMORY_BYTES: u64 = 256 << 20;
/// If more than this is mapped, a sanitizer uses address space itself. The measurement is then
/// invalid.
const SANITIZER_BYTES: u64 = 1 << 40;

/// Runs a read and checks the limits.
///
/// # Panics
/// When it takes longer than a second or more than 256 MiB.
pub fn within_limits<T>(work: impl FnOnce() -> T) -> T {
    within(SECONDS, work)
}

/// Runs a plan and checks the limits.
///
/// # Panics
/// When it takes longer than a minute or more than 256 MiB.
pub fn within_limits_of_plans<T>(work: impl FnOnce() -> T) -> T {
    within(PLAN_SECONDS, work)
}

fn within<T>(most_seconds: f64, work: impl FnOnce() -> T) -> T {
    let memory = peak_memory_bytes();
    let (clock, processor) = (Instant::now(), processor_seconds());
    let result = work();
    let seconds = match (processor, processor_seconds()) {
        (Some(before), Some(after)) => after - before,
        _ => clock.elapsed().as_secs_f64(),
    };
    assert!(seconds < most_seconds, "the work took {seconds:.2} s");
    if let (Some(before), Some(after)) = (memory, peak_memory_bytes()) {
        let grown = after - before;
        assert!(
            before > SANITIZER_BYTES || grown < MEMORY_BYTES,
            "the work took {} MiB",
            grown >> 20
        );
    }
    result
}

/// Processor time that this thread has used so far.
fn processor_seconds() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    let nanoseconds: f64 = text.split_whitespace().next()?.parse().ok()?;
    Some(nanoseconds * 1e-9)
}

/// The most memory that this process has had mapped, used or not.
fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmPeak:"))?;
    let kilobytes: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kilobytes * 1024)
}
