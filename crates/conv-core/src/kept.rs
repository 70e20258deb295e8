//! Parts of a plan that are kept for later sources.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, OnceLock};

/// Values by their keys. A value is computed when it is first needed, and kept while all values
/// together need at most a limit of memory.
#[derive(Debug)]
pub(crate) struct Kept<K, V> {
    values: Mutex<Values<K, V>>,
    memory_bytes: usize,
}

#[derive(Debug)]
struct Values<K, V> {
    by_key: BTreeMap<K, Arc<OnceLock<Arc<V>>>>,
    /// Keys and sizes of the values in the order in which they were computed.
    computed: Vec<(K, usize)>,
    bytes: usize,
}

impl<K: Copy + Ord, V> Kept<K, V> {
    /// Keeps values up to the given memory.
    pub(crate) fn new(memory_bytes: usize) -> Self {
        let values = Values {
            by_key: BTreeMap::new(),
            computed: Vec::new(),
            bytes: 0,
        };
        Self {
            values: Mutex::new(values),
            memory_bytes,
        }
    }

    /// Returns the value, kept or computed now. `bytes` returns its size. Other threads that need
    /// the value wait. So `make` must not share its work with other threads: it could be given work
    /// that waits for the same value.
    pub(crate) fn get(&self, key: K, make: impl FnOnce() -> V, bytes: impl Fn(&V) -> usize) -> Arc<V> {
        let cell = self
            .values
            .lock()
            .ok()
            .map(|mut values| Arc::clone(values.by_key.entry(key).or_default()));
        let Some(cell) = cell else {
            return Arc::new(make());
        };
        let mut size = None;
        let value = cell.get_or_init(|| {
            let made = Arc::new(make());
            size = Some(bytes(&made));
            made
        });
        if let Some(size) = size
            && let Ok(mut values) = self.values.lock()
        {
            if size > self.memory_bytes {
                values.by_key.remove(&key);
            } else {
                values.make_room(self.memory_bytes - size);
                values.computed.push((key, size));
                values.bytes += size;
            }
        }
        Arc::clone(value)
    }
}

impl<K: Ord, V> Values<K, V> {
    /// Removes values until the others need at most a number of bytes. Catalogues ask for
    /// values in a similar order each time. So the value computed last is removed first: the next
    /// image finds all values before it.
    fn make_room(&mut self, bytes: usize) {
        while self.bytes > bytes
            && let Some((key, size)) = self.computed.pop()
        {
            self.by_key.remove(&key);
            self.bytes -= size;
        }
    }
}
