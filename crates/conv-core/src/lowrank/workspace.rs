//! The memory that one thread works in.

use std::sync::Mutex;

use crate::ConvReal;
use crate::transform::TileTransform;

/// Values that start at a cache line.
#[derive(Debug)]
pub(crate) struct Aligned<T> {
    values: Vec<T>,
    start: usize,
    length: usize,
}

const CACHE_LINE: usize = 64;

impl<T: ConvReal> Aligned<T> {
    pub(crate) fn zeros(length: usize) -> Self {
        let values = vec![T::zero(); length + CACHE_LINE / size_of::<T>()];
        // A vector is aligned to its values at least.
        let past = values.as_ptr() as usize % CACHE_LINE;
        Self {
            start: (CACHE_LINE - past) % CACHE_LINE / size_of::<T>(),
            values,
            length,
        }
    }

    pub(crate) fn get(&self) -> &[T] {
        &self.values[self.start..self.start + self.length]
    }

    pub(crate) fn get_mut(&mut self) -> &mut [T] {
        &mut self.values[self.start..self.start + self.length]
    }

    /// At least so many values; what they hold is undefined.
    pub(crate) fn at_least(&mut self, length: usize) {
        if self.length < length {
            *self = Self::zeros(length);
        }
    }
}

/// Planes and spectra of one transform size; what they hold between tiles is undefined.
#[derive(Debug)]
pub(crate) struct Workspace<T> {
    /// The tile's light.
    pub(crate) light: Aligned<T>,
    /// The light times a coefficient, or a result.
    pub(crate) weighted: Aligned<T>,
    pub(crate) spectrum: Aligned<T>,
    pub(crate) sum: Aligned<T>,
    pub(crate) column: Aligned<T>,
    /// The spectra of a block's kernels, one after the other.
    pub(crate) kernels: Aligned<T>,
    /// A row that has no place elsewhere.
    pub(crate) row: Vec<T>,
}

impl<T: ConvReal> Workspace<T> {
    pub(crate) fn new(fft: &TileTransform<T>) -> Self {
        Self {
            light: Aligned::zeros(fft.plane_len()),
            weighted: Aligned::zeros(fft.plane_len()),
            spectrum: Aligned::zeros(fft.spectrum_len()),
            sum: Aligned::zeros(fft.spectrum_len()),
            column: Aligned::zeros(fft.column_len()),
            kernels: Aligned::zeros(0),
            row: vec![T::zero(); fft.nx()],
        }
    }
}

/// Workspaces that threads take and give back, so that there are no more than threads.
#[derive(Debug)]
pub(crate) struct Pool<T>(Mutex<Vec<Workspace<T>>>);

impl<T: ConvReal> Pool<T> {
    pub(crate) fn new() -> Self {
        Self(Mutex::new(Vec::new()))
    }

    /// Lends a workspace to `work`.
    pub(crate) fn with<R>(&self, fft: &TileTransform<T>, work: impl FnOnce(&mut Workspace<T>) -> R) -> R {
        let taken = self.0.lock().ok().and_then(|mut pool| pool.pop());
        let mut workspace = taken.unwrap_or_else(|| Workspace::new(fft));
        let result = work(&mut workspace);
        if let Ok(mut pool) = self.0.lock() {
            pool.push(workspace);
        }
        result
    }
}
