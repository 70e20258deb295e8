//! A coefficient field on a regular grid, as in models of telescopes.

use std::borrow::Cow;

use ndarray::Array2;
use psf_types::{
    BilinearCells, CoefficientField, ErrorLimit, FieldError, PixelRegion, Position, WeightedNodes,
};

/// Coefficients that are bilinear in the cells of a square grid of nodes. The first node is at
/// pixel `(0, 0)`.
#[derive(Debug)]
pub(crate) struct GridField {
    /// Pixels from one node to the next.
    step: f64,
    /// The number of nodes along each side.
    side: usize,
    /// `[node, component]`, rows of nodes one after the other.
    values: Array2<f64>,
}

impl GridField {
    pub(crate) fn new(step: f64, side: usize, values: Array2<f64>) -> Self {
        assert_eq!(values.nrows(), side * side, "a value for each node");
        Self { step, side, values }
    }

    /// A coordinate in steps, clamped to the grid.
    fn place(&self, coordinate: f64) -> f64 {
        (coordinate / self.step).clamp(0.0, (self.side - 1) as f64)
    }

    /// The cell of a coordinate, and the position in the cell.
    fn cell(&self, coordinate: f64) -> (usize, f64) {
        let at = self.place(coordinate);
        let cell = (at as usize).min(self.side - 2);
        (cell, at - cell as f64)
    }

    fn weights(&self, column: usize, x: f64, (row, v): (usize, f64)) -> [(usize, f64); 4] {
        let u = self.place(x) - column as f64;
        let node = row * self.side + column;
        [
            (node, (1.0 - u) * (1.0 - v)),
            (node + 1, u * (1.0 - v)),
            (node + self.side, (1.0 - u) * v),
            (node + self.side + 1, u * v),
        ]
    }
}

impl CoefficientField for GridField {
    fn component_count(&self) -> usize {
        self.values.ncols()
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

    fn weighted_nodes(&self) -> Option<&dyn WeightedNodes> {
        Some(self)
    }

    fn bilinear_cells(&self, _: PixelRegion, _: ErrorLimit<'_>) -> BilinearCells {
        let lines: Vec<f64> = (0..self.side).map(|n| n as f64 * self.step).collect();
        BilinearCells::Lines {
            x: lines.clone(),
            y: lines,
            error: 0.0,
        }
    }
}

impl WeightedNodes for GridField {
    fn node_values(&self) -> Cow<'_, Array2<f64>> {
        Cow::Borrowed(&self.values)
    }

    fn weights_into(&self, p: Position, weights: &mut Vec<(usize, f64)>) -> Result<(), FieldError> {
        weights.clear();
        weights.extend(self.weights(self.cell(p.x()).0, p.x(), self.cell(p.y())));
        Ok(())
    }
}
