//! A model as for a telescope: samples on a regular grid, with bilinear interpolation between them.

#[path = "../../tests/common/grid_field.rs"]
mod grid_field;

use std::sync::Arc;

use grid_field::GridField;
use ndarray::{Array2, Array3};
use psf_types::{Normalisation, PsfBasis, PsfModel, StampGrid};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Pixels along each side of a stamp.
pub(crate) const STAMP: usize = 64;
/// The number of components of the model.
pub(crate) const RANK: usize = 30;
/// The number of samples along each side of the field.
pub(crate) const SAMPLES: usize = 17;

/// Coefficients over a square frame.
fn grid_over(frame: usize) -> GridField {
    let place = |n: usize| n as f64 / (SAMPLES - 1) as f64;
    let values = Array2::from_shape_fn((SAMPLES * SAMPLES, RANK), |(node, k)| {
        let (u, v) = (place(node % SAMPLES), place(node / SAMPLES));
        let wave = 1.0 + 0.3 * k as f64;
        0.05 / wave * (wave * (3.0 * u + 2.0 * v) + k as f64).sin()
    });
    GridField::new((frame - 1) as f64 / (SAMPLES - 1) as f64, SAMPLES, values)
}

/// A Gaussian of unit flux and components without flux, over a square frame.
pub(crate) fn model(frame: usize) -> PsfModel {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut rows = Array2::from_shape_simple_fn((RANK, STAMP * STAMP), || rng.random_range(-1.0..1.0f64));
    for k in 0..RANK {
        let mean = rows.row(k).mean().unwrap_or_default();
        rows.row_mut(k).mapv_inplace(|v| v - mean);
        for j in 0..k {
            let overlap = rows.row(k).dot(&rows.row(j));
            let other = rows.row(j).to_owned();
            rows.row_mut(k).scaled_add(-overlap, &other);
        }
        let norm = rows.row(k).dot(&rows.row(k)).sqrt();
        rows.row_mut(k).mapv_inplace(|v| v / norm);
    }
    let components: Array3<f64> = rows
        .into_shape_with_order((RANK, STAMP, STAMP))
        .expect("row-major");
    let half = (STAMP / 2) as f64;
    let gauss = Array2::from_shape_fn((STAMP, STAMP), |(y, x)| {
        (-((y as f64 - half).powi(2) + (x as f64 - half).powi(2)) / 8.0).exp()
    });
    let mean = &gauss / gauss.sum();
    let grid = StampGrid::new(STAMP, STAMP).expect("a valid grid");
    let basis = PsfBasis::new(Some(mean), components, grid).expect("an orthonormal basis");
    PsfModel::new(&basis, Arc::new(grid_over(frame)), Normalisation::Keep, None).expect("a valid model")
}
