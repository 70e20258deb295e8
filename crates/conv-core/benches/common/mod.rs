//! A model as models of telescopes are: samples on a regular grid, bilinear between them.

use std::borrow::Cow;
use std::sync::Arc;

use ndarray::{Array2, Array3};
use psf_types::{
    CoefficientField, FieldError, Normalisation, Position, PsfBasis, PsfModel, RowRun, StampGrid,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Pixels along each side of a stamp.
pub(crate) const STAMP: usize = 64;
/// Components of the model.
pub(crate) const RANK: usize = 30;
/// Samples along each side of the field.
pub(crate) const SAMPLES: usize = 17;

/// Coefficients that are bilinear in the cells of a square grid over a square frame.
#[derive(Debug)]
pub(crate) struct Grid {
    /// Pixels from one sample to the next.
    step: f64,
    values: Array2<f64>,
}

impl Grid {
    pub(crate) fn over(frame: usize) -> Self {
        let place = |n: usize| n as f64 / (SAMPLES - 1) as f64;
        let values = Array2::from_shape_fn((SAMPLES * SAMPLES, RANK), |(node, k)| {
            let (u, v) = (place(node % SAMPLES), place(node / SAMPLES));
            let wave = 1.0 + 0.3 * k as f64;
            0.05 / wave * (wave * (3.0 * u + 2.0 * v) + k as f64).sin()
        });
        Self {
            step: (frame - 1) as f64 / (SAMPLES - 1) as f64,
            values,
        }
    }

    /// The cell of a coordinate, held within the grid, and the place in it.
    fn cell(&self, coordinate: f64) -> (usize, f64) {
        let at = (coordinate / self.step).clamp(0.0, (SAMPLES - 1) as f64);
        let cell = (at as usize).min(SAMPLES - 2);
        (cell, at - cell as f64)
    }

    fn weights(&self, column: usize, x: f64, (row, v): (usize, f64)) -> [(usize, f64); 4] {
        let u = (x / self.step).clamp(0.0, (SAMPLES - 1) as f64) - column as f64;
        let node = row * SAMPLES + column;
        [
            (node, (1.0 - u) * (1.0 - v)),
            (node + 1, u * (1.0 - v)),
            (node + SAMPLES, (1.0 - u) * v),
            (node + SAMPLES + 1, u * v),
        ]
    }
}

impl CoefficientField for Grid {
    fn component_count(&self) -> usize {
        RANK
    }

    fn evaluate_into(&self, p: Position, coefficients: &mut [f64]) -> Result<(), FieldError> {
        coefficients.fill(0.0);
        for (node, weight) in self.weights(self.cell(p.x()).0, p.x(), self.cell(p.y())) {
            for (sum, value) in coefficients.iter_mut().zip(self.values.row(node)) {
                *sum += weight * value;
            }
        }
        Ok(())
    }

    fn node_values(&self) -> Cow<'_, Array2<f64>> {
        Cow::Borrowed(&self.values)
    }

    fn grid_lines(&self) -> Option<[Vec<f64>; 2]> {
        let lines: Vec<f64> = (0..SAMPLES).map(|n| n as f64 * self.step).collect();
        Some([lines.clone(), lines])
    }

    fn weights_along_row(
        &self,
        (x, y): (i64, i64),
        length: usize,
        visit: &mut dyn FnMut(RowRun<'_>),
    ) -> Result<(), FieldError> {
        let row = self.cell(y as f64);
        let end = x + length as i64;
        let mut first = x;
        while first < end {
            let column = self.cell(first as f64).0;
            let next = if column + 2 < SAMPLES {
                (((column + 1) as f64 * self.step).ceil() as i64).clamp(first + 1, end)
            } else {
                end
            };
            visit(RowRun {
                length: (next - first) as usize,
                first: &self.weights(column, first as f64, row),
                last: &self.weights(column, (next - 1) as f64, row),
            });
            first = next;
        }
        Ok(())
    }
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
    PsfModel::new(&basis, Arc::new(Grid::over(frame)), Normalisation::Keep, None).expect("a valid model")
}
