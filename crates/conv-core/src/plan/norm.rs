//! Norms, products and sums of vectors.

use ndarray::{Array1, ArrayView1};

pub(crate) fn norm(v: ArrayView1<'_, f64>) -> f64 {
    v.dot(&v).sqrt()
}

/// The scalar product, in sums that vectorise.
#[inline(always)]
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    const LANES: usize = 8;
    let mut sums = [0.0; LANES];
    let (a, b) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest: f64 = a.remainder().iter().zip(b.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in a.zip(b) {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum += a * b;
        }
    }
    sums.iter().sum::<f64>() + rest
}

/// Adds a multiple of a vector to another.
#[inline(always)]
pub(crate) fn add_scaled(to: &mut [f64], factor: f64, vector: &[f64]) {
    for (value, of_vector) in to.iter_mut().zip(vector) {
        *value += factor * of_vector;
    }
}

/// The values of a vector, for loops inside `vectorized!`.
pub(crate) fn values(vector: &Array1<f64>) -> &[f64] {
    vector.as_slice().expect("vectors are contiguous")
}
