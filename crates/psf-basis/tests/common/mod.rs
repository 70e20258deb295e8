//! Samples with known content.

use ndarray::{Array2, Array3};
use psf_types::{Position, PsfSamples, SamplePositions, StampGrid};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

pub(crate) fn normal(rows: usize, columns: usize, seed: u64) -> Array2<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    Array2::from_shape_simple_fn((rows, columns), || StandardNormal.sample(&mut rng))
}

/// Orthonormal rows, by Gram-Schmidt, each with zero sum.
pub(crate) fn orthonormal_rows(count: usize, length: usize, seed: u64) -> Array2<f64> {
    let mut rows = normal(count, length, seed);
    for k in 0..count {
        for _ in 0..2 {
            let mean = rows.row(k).sum() / length as f64;
            rows.row_mut(k).mapv_inplace(|v| v - mean);
            for j in 0..k {
                let overlap = rows.row(k).dot(&rows.row(j));
                let other = rows.row(j).to_owned();
                rows.row_mut(k).scaled_add(-overlap, &other);
            }
        }
        let norm = rows.row(k).dot(&rows.row(k)).sqrt();
        rows.row_mut(k).mapv_inplace(|v| v / norm);
    }
    rows
}

pub(crate) fn samples(stack: Array3<f64>) -> PsfSamples {
    let (count, ny, nx) = stack.dim();
    let positions = (0..count).map(|j| Position::of_pixel(j as i64, 0)).collect();
    PsfSamples::new(
        stack,
        SamplePositions::new(positions, None).unwrap(),
        StampGrid::new(nx, ny).unwrap(),
    )
    .unwrap()
}
