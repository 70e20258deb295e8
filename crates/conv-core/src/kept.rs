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
    by_key: BTreeMap<K, Arc<V>>,
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

    /// Returns the value, kept or computed now. `bytes` returns its size. No thread waits for another
    /// ([`get_or_make`]): several threads that need a value at the same time compute it, and keep one of the
    /// results.
    pub(crate) fn get(&self, key: K, make: impl FnOnce() -> V, bytes: impl Fn(&V) -> usize) -> Arc<V> {
        let kept = |values: &Values<K, V>| values.by_key.get(&key).map(Arc::clone);
        if let Ok(values) = self.values.lock()
            && let Some(value) = kept(&values)
        {
            return value;
        }
        let made = Arc::new(make());
        let size = bytes(&made);
        if let Ok(mut values) = self.values.lock() {
            if let Some(value) = kept(&values) {
                return value;
            }
            if size <= self.memory_bytes {
                values.make_room(self.memory_bytes - size);
                values.by_key.insert(key, Arc::clone(&made));
                values.computed.push((key, size));
                values.bytes += size;
            }
        }
        made
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

/// Returns the kept value. Makes it first if it does not exist yet. No thread waits for another: one that waits
/// takes up other work, which may need the value, too.
pub(crate) fn get_or_make<V>(kept: &OnceLock<V>, make: impl FnOnce() -> V) -> &V {
    if let Some(value) = kept.get() {
        return value;
    }
    let made = make();
    kept.get_or_init(|| made)
}
