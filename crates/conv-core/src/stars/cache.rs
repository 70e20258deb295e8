//! Blocks that are kept from one catalogue to the next.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use super::star_block::StarBlock;
use crate::ConvReal;

/// Column and row of a block of the field, row first so that blocks are in the order of rows.
pub(super) type BlockKey = (i64, i64);

/// Blocks made so far, as many as the memory allowed holds.
#[derive(Debug)]
pub(super) struct BlockCache<T>(Mutex<Kept<T>>, usize);

#[derive(Debug)]
struct Kept<T> {
    blocks: BTreeMap<BlockKey, Arc<StarBlock<T>>>,
    bytes: usize,
}

impl<T: ConvReal> BlockCache<T> {
    pub(super) fn new(memory_bytes: usize) -> Self {
        let kept = Kept {
            blocks: BTreeMap::new(),
            bytes: 0,
        };
        Self(Mutex::new(kept), memory_bytes)
    }

    /// The block, kept or made anew; what is in a block does not depend on which.
    pub(super) fn get(&self, key: BlockKey, make: impl FnOnce() -> StarBlock<T>) -> Arc<StarBlock<T>> {
        if let Some(block) = self.0.lock().ok().and_then(|kept| kept.blocks.get(&key).cloned()) {
            return block;
        }
        let block = Arc::new(make());
        if let Ok(mut kept) = self.0.lock()
            && kept.bytes + block.bytes() <= self.1
        {
            kept.bytes += block.bytes();
            kept.blocks.insert(key, Arc::clone(&block));
        }
        block
    }
}
