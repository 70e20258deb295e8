//! Norms of vectors.

use ndarray::{ArrayView1, aview1};

pub(crate) fn norm(v: ArrayView1<'_, f64>) -> f64 {
    v.dot(&v).sqrt()
}

/// The squared norm. It takes less time than a plain sum, because several values are added at a
/// time.
pub(crate) fn norm_squared(v: &[f64]) -> f64 {
    aview1(v).dot(&aview1(v))
}
