//! The cells between the pixels of an interpolated stamp.

use ndarray::Array2;
use psf_types::maths::gauss_legendre;

use crate::stamp_interpolator::{Kernel, MOST_TAPS};

/// The nodes and weights of a cell.
const RULE: [(f64, f64); 8] = gauss_legendre();

/// A cell of the interpolated stamp, and the coefficients that contribute to it.
pub(super) struct Cell {
    kernel: Kernel,
    pub(super) first: [f64; 2],
    coefficients: [[f64; MOST_TAPS]; MOST_TAPS],
}

impl Cell {
    pub(super) fn new(kernel: Kernel, coefficients: &Array2<f64>, [x, y]: [usize; 2]) -> Self {
        let mut own = [[0.0; MOST_TAPS]; MOST_TAPS];
        for (j, row) in own.iter_mut().enumerate().take(kernel.tap_count()) {
            for (i, value) in row.iter_mut().enumerate().take(kernel.tap_count()) {
                *value = coefficients[[y + j, x + i]];
            }
        }
        Self {
            kernel,
            first: [x as f64, y as f64],
            coefficients: own,
        }
    }

    /// The weights of the coefficients along an axis. The functions of the cell continue beyond it.
    pub(super) fn kernel_weights(&self, axis: usize, at: f64) -> [f64; MOST_TAPS] {
        self.kernel.weights(at - self.first[axis])
    }

    /// The coefficients along the row `y`.
    pub(super) fn line(&self, y: f64) -> [f64; MOST_TAPS] {
        let mut line = [0.0; MOST_TAPS];
        for (weight, row) in self.kernel_weights(1, y).iter().zip(&self.coefficients) {
            for (sum, c) in line.iter_mut().zip(row) {
                *sum += weight * c;
            }
        }
        line
    }

    /// The stamp's value at a point, per pixel of the frame.
    pub(super) fn at(&self, [x, y]: [f64; 2]) -> f64 {
        product(&self.kernel_weights(0, x), &self.line(y))
    }
}

pub(super) fn product(a: &[f64; MOST_TAPS], b: &[f64; MOST_TAPS]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The integrals of the nodes' Lagrange polynomials on a block of `length` cells times the kernels of
/// the coefficients, `[node, coefficient]`.
pub(super) fn integrals(kernel: Kernel, length: usize, rule: &[(f64, f64)]) -> Array2<f64> {
    let taps = kernel.tap_count();
    let mut integrals = Array2::zeros((rule.len(), length + taps - 1));
    for cell in 0..length {
        for (at, weight) in RULE {
            let weights = kernel.weights(at);
            let place = (cell as f64 + at) / length as f64;
            for (k, (node, _)) in rule.iter().enumerate() {
                let others = rule.iter().enumerate().filter(|&(j, _)| j != k);
                let polynomial: f64 = others
                    .map(|(_, (other, _))| (place - other) / (node - other))
                    .product();
                for (tap, kernel) in weights.iter().enumerate().take(taps) {
                    integrals[[k, cell + tap]] += weight * polynomial * kernel;
                }
            }
        }
    }
    integrals
}
