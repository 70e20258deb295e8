//! Functions that are linear in the weights of a field's nodes.

use ndarray::{ArrayView2, Axis};

/// Functions that are linear in the weights of the nodes.
#[derive(Debug)]
pub(crate) struct NodeFunctions {
    pub(crate) width: usize,
    /// The functions of each node, then those that belong to no node, `[node, function]`.
    values: Vec<f64>,
}

impl NodeFunctions {
    /// The functions are the columns of arrays with one row for each node, and one more.
    pub(crate) fn new(columns: &[ArrayView2<'_, f64>]) -> Self {
        let rows = ndarray::concatenate(Axis(1), columns).expect("equally many rows");
        Self {
            width: rows.ncols(),
            values: rows.iter().copied().collect(),
        }
    }

    /// Writes the functions for some weights of the nodes.
    #[inline(always)]
    pub(crate) fn at(&self, end: &[(usize, f64)], values: &mut [f64]) {
        values.copy_from_slice(&self.values[self.values.len() - self.width..]);
        for &(node, weight) in end {
            let row = &self.values[node * self.width..(node + 1) * self.width];
            for (value, of_node) in values.iter_mut().zip(row) {
                *value += weight * of_node;
            }
        }
    }
}

/// The sum of the magnitudes of weights, with 1 for the offset.
pub(crate) fn sum_of_magnitudes(end: &[(usize, f64)]) -> f64 {
    end.iter().map(|(_, w)| w.abs()).sum::<f64>() + 1.0
}
