//! Working memory that threads borrow.

use std::sync::Mutex;

/// Workspaces that threads take and give back, so that there are hardly more of them than threads.
#[derive(Debug)]
pub(crate) struct Workspaces<W>(Mutex<Vec<W>>);

impl<W> Default for Workspaces<W> {
    fn default() -> Self {
        Self(Mutex::new(Vec::new()))
    }
}

impl<W> Workspaces<W> {
    /// Lends a workspace to `work`. `make` makes one if none is free.
    pub(crate) fn lend<R>(&self, make: impl FnOnce() -> W, work: impl FnOnce(&mut W) -> R) -> R {
        let free = self.0.lock().ok().and_then(|mut free| free.pop());
        let mut workspace = free.unwrap_or_else(make);
        let result = work(&mut workspace);
        if let Ok(mut free) = self.0.lock() {
            free.push(workspace);
        }
        result
    }
}
