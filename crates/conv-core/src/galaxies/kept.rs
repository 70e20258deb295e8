//! Parts of a plan that are kept for later galaxies.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, OnceLock};

/// Values by their keys. A value is computed when it is first needed.
#[derive(Debug)]
pub(super) struct Kept<K, V>(Mutex<BTreeMap<K, Arc<OnceLock<Arc<V>>>>>);

impl<K, V> Default for Kept<K, V> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<K: Ord, V> Kept<K, V> {
    /// Returns the value, kept or computed now. Other threads that need it wait. So `make` must not
    /// share its work with other threads: it could be given the work of a galaxy that waits.
    pub(super) fn get(&self, key: K, make: impl FnOnce() -> V) -> Arc<V> {
        let make = || Arc::new(make());
        let cell = self
            .0
            .lock()
            .ok()
            .map(|mut kept| Arc::clone(kept.entry(key).or_default()));
        match cell {
            Some(cell) => Arc::clone(cell.get_or_init(make)),
            None => make(),
        }
    }

    pub(super) fn clear(&self) {
        if let Ok(mut kept) = self.0.lock() {
            kept.clear();
        }
    }
}
