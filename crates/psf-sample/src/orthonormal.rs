//! An orthonormal basis of the stamps drawn so far.

use ndarray::{Array1, Array2, ArrayView1, ArrayView2};

/// A stamp adds to the basis if more than this part of its norm lies outside.
const INDEPENDENT: f64 = 1e-13;

/// An orthonormal basis that grows with each stamp. So stamps of any size become coefficients, at most
/// as many as there are stamps, with equal differences and norms.
#[derive(Debug, Default)]
pub(crate) struct OrthonormalBasis {
    vectors: Vec<Array1<f64>>,
    shape: (usize, usize),
}

impl OrthonormalBasis {
    /// The number of vectors.
    pub(crate) fn len(&self) -> usize {
        self.vectors.len()
    }

    /// Adds a stamp, and returns its coefficients. Gram-Schmidt's method is applied twice, which makes
    /// vectors orthogonal up to rounding (L. Giraud, J. Langou, M. Rozloznik and J. van den Eshof 2005,
    /// Numerische Mathematik 101, 87).
    pub(crate) fn add(&mut self, stamp: ArrayView2<'_, f64>) -> Vec<f64> {
        self.shape = stamp.dim();
        let mut rest: Array1<f64> = stamp.iter().copied().collect();
        let whole = norm(rest.view());
        let mut coefficients = vec![0.0; self.vectors.len()];
        for _ in 0..2 {
            for (coefficient, vector) in coefficients.iter_mut().zip(&self.vectors) {
                let along = vector.dot(&rest);
                rest.scaled_add(-along, vector);
                *coefficient += along;
            }
        }
        let length = norm(rest.view());
        if length > INDEPENDENT * whole {
            rest /= length;
            self.vectors.push(rest);
            coefficients.push(length);
        }
        coefficients
    }

    /// The stamp with these coefficients.
    pub(crate) fn stamp(&self, coefficients: &[f64]) -> Array2<f64> {
        let mut sum = Array1::zeros(self.shape.0 * self.shape.1);
        for (coefficient, vector) in coefficients.iter().zip(&self.vectors) {
            sum.scaled_add(*coefficient, vector);
        }
        sum.into_shape_with_order(self.shape)
            .expect("one value for each pixel")
    }
}

fn norm(values: ArrayView1<'_, f64>) -> f64 {
    values.dot(&values).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of a few hundred operations.
    const ROUNDING: f64 = 1e-14;

    #[test]
    fn coefficients_give_the_stamps_back() {
        let mut basis = OrthonormalBasis::default();
        let stamps: Vec<Array2<f64>> = (0..6)
            .map(|k| {
                let width = 2.0 + 1e-5 * f64::from(k % 5);
                Array2::from_shape_fn((7, 9), |(y, x)| {
                    (-((y as f64 - 3.0).powi(2) + (x as f64 - 4.0).powi(2)) / width).exp()
                })
            })
            .collect();
        let found: Vec<Vec<f64>> = stamps.iter().map(|stamp| basis.add(stamp.view())).collect();
        assert!(basis.len() < 6, "the last stamp is the first one again");
        for (stamp, coefficients) in stamps.iter().zip(&found) {
            let difference = &basis.stamp(coefficients) - stamp;
            assert!(difference.iter().all(|v| v.abs() < ROUNDING));
        }
        for (i, a) in basis.vectors.iter().enumerate() {
            for (j, b) in basis.vectors.iter().enumerate() {
                let expected = if i == j { 1.0 } else { 0.0 };
                assert!((a.dot(b) - expected).abs() < ROUNDING, "{i} {j}");
            }
        }
    }
}
