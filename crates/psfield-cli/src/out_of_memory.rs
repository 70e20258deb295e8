//! Ends the program with a message and exit status 1 when memory runs out. Without this, Rust would
//! abort the process.

use std::alloc::{GlobalAlloc, Layout, System};
use std::io::Write as _;
use std::path::PathBuf;
use std::sync::OnceLock;

/// The files that the command reads, for the message.
static INPUTS: OnceLock<String> = OnceLock::new();

/// Sets the files that the message names.
pub(crate) fn name(inputs: &[PathBuf]) {
    let inputs: Vec<String> = inputs.iter().map(|path| path.display().to_string()).collect();
    if !inputs.is_empty() {
        let _ = INPUTS.set(format!(" (inputs: {})", inputs.join(", ")));
    }
}

/// The system's allocator, except that the program ends if a request for memory fails.
struct Checked;

#[global_allocator]
static ALLOCATOR: Checked = Checked;

#[allow(
    unsafe_code,
    reason = "in stable Rust, only a global allocator learns that memory has run out"
)]
// SAFETY: all calls go unchanged to `System`, and a null pointer is never returned.
unsafe impl GlobalAlloc for Checked {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        checked(unsafe { System.alloc(layout) }, layout.size())
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        checked(unsafe { System.alloc_zeroed(layout) }, layout.size())
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        checked(unsafe { System.realloc(memory, layout, size) }, size)
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        unsafe { System.dealloc(memory, layout) }
    }
}

/// Returns the memory, or ends the program if the allocator returned none. Temporary files of this
/// run stay. On Unix, the next run that writes in their folder removes them.
fn checked(memory: *mut u8, bytes: usize) -> *mut u8 {
    if memory.is_null() {
        let megabytes = bytes.div_ceil(1 << 20);
        // Formatting numbers takes no memory.
        let _ = writeln!(
            std::io::stderr(),
            "psfield: error: not enough memory{}: the system or a limit (ulimit -v) refuses {megabytes} MiB more",
            INPUTS.get().map_or("", String::as_str)
        );
        end();
    }
    memory
}

/// Ends the process at once. Other threads may still be working, so nothing is cleaned up.
fn end() -> ! {
    #[cfg(unix)]
    signal_hook::low_level::exit(1);
    #[cfg(not(unix))]
    std::process::exit(1)
}
