//! What a read may take.

use std::time::Instant;

/// Seconds of a processor that reading takes. Wall time where the system does not tell processor time.
const SECONDS: f64 = 1.0;
/// The same for a plan of a telescope, whose transforms may have as many points as its author asks for, up to a limit.
const PLAN_SECONDS: f64 = 60.0;
/// Address space that the process grows by.
const MEMORY_BYTES: u64 = 256 << 20;
/// With more than this mapped, a sanitizer keeps books in address space, which says nothing about reads then.
const SANITIZER_BYTES: u64 = 1 << 40;

/// Reads something.
///
/// # Panics
/// When it takes longer than a second or more than 256 MiB.
pub fn within_limits<T>(work: impl FnOnce() -> T) -> T {
    within(SECONDS, work)
}

/// Plans something.
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
    assert!(seconds < most_seconds, "it took {seconds:.2} s");
    if let (Some(before), Some(after)) = (memory, peak_memory_bytes()) {
        let grown = after - before;
        assert!(
            before > SANITIZER_BYTES || grown < MEMORY_BYTES,
            "it took {} MiB",
            grown >> 20
        );
    }
    result
}

/// What this thread has used so far.
fn processor_seconds() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    let nanoseconds: f64 = text.split_whitespace().next()?.parse().ok()?;
    Some(nanoseconds * 1e-9)
}

/// The most that this process has had mapped, used or not.
fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmPeak:"))?;
    let kilobytes: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kilobytes * 1024)
}
