//! Samples with known content.

use ndarray::{Array2, Array3, Axis};
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

/// A matrix of `count` samples with exactly these singular values once the mean is taken out, on a bright mean stamp.
pub(crate) fn with_singular_values(values: &[f64], count: usize, side: usize, noise: f64) -> PsfSamples {
    let pixels = side * side;
    let stamps = orthonormal_rows(values.len(), pixels, 1);
    let coefficients = orthonormal_rows(values.len(), count, 2);
    let mut stack = normal(count, pixels, 3) * noise;
    for (k, &value) in values.iter().enumerate() {
        for j in 0..count {
            stack
                .row_mut(j)
                .scaled_add(value * coefficients[[k, j]], &stamps.row(k));
        }
    }
    stack += &ndarray::Array1::from_elem(pixels, 2.0).insert_axis(Axis(0));
    samples(stack.into_shape_with_order((count, side, side)).unwrap())
}
