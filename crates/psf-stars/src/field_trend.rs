//! Smooth trends over the field.

use nalgebra::{DMatrix, DVector};
use psf_types::FrameShape;

/// The terms of a polynomial over the field, in coordinates that run from -1 to 1 over the frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct FieldTerms {
    degree: usize,
    frame: FrameShape,
}

impl FieldTerms {
    pub(crate) fn new(degree: usize, frame: FrameShape) -> Self {
        Self { degree, frame }
    }

    pub(crate) fn degree(self) -> usize {
        self.degree
    }

    pub(crate) fn frame(self) -> FrameShape {
        self.frame
    }

    pub(crate) fn count(self) -> usize {
        Self::count_of(self.degree)
    }

    pub(crate) fn count_of(degree: usize) -> usize {
        (degree + 1) * (degree + 2) / 2
    }

    /// Products of Legendre polynomials, `P_i(x) P_j(y)` with `i + j <= degree`: of one size over the field.
    pub(crate) fn at(self, x: f64, y: f64) -> Vec<f64> {
        let scaled = |v: f64, n: usize| (2.0 * v - (n - 1) as f64) / n as f64;
        let (px, py) = (
            legendre(scaled(x, self.frame.nx()), self.degree),
            legendre(scaled(y, self.frame.ny()), self.degree),
        );
        (0..=self.degree)
            .flat_map(|j| (0..=self.degree - j).map(move |i| (i, j)))
            .map(|(i, j)| px[i] * py[j])
            .collect()
    }
}

fn legendre(t: f64, degree: usize) -> Vec<f64> {
    let mut values = vec![1.0, t];
    for n in 1..degree {
        let n_real = n as f64;
        values.push(((2.0 * n_real + 1.0) * t * values[n] - n_real * values[n - 1]) / (n_real + 1.0));
    }
    values
}

/// Points `(x, y, value, weight)`; the weighted least-squares polynomial through them, if there are any.
pub(crate) fn trend(points: &[(f64, f64, f64, f64)], terms: FieldTerms) -> Option<Trend> {
    if points.is_empty() {
        return None;
    }
    let (mut rows, mut right) = (
        DMatrix::zeros(points.len(), terms.count()),
        DVector::zeros(points.len()),
    );
    for (k, &(x, y, value, weight)) in points.iter().enumerate() {
        let root = weight.sqrt();
        for (j, term) in terms.at(x, y).into_iter().enumerate() {
            rows[(k, j)] = root * term;
        }
        right[k] = root * value;
    }
    // Least squares by SVD: clustered points leave terms undetermined, which get the smallest values that do.
    let found = rows.svd(true, true).solve(&right, 1e-9).ok()?;
    Some(Trend {
        terms,
        coefficients: found.iter().copied().collect(),
    })
}

/// A polynomial over the field.
#[derive(Debug, Clone)]
pub(crate) struct Trend {
    terms: FieldTerms,
    coefficients: Vec<f64>,
}

impl Trend {
    pub(crate) fn at(&self, x: f64, y: f64) -> f64 {
        let terms = self.terms.at(x, y);
        terms.iter().zip(&self.coefficients).map(|(t, c)| t * c).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parabola_is_found_exactly() {
        let frame = FrameShape::new(100, 60).unwrap();
        let truth = |x: f64, y: f64| 2.0 + 0.01 * x - 0.02 * y + 1e-4 * x * y - 2e-4 * y * y;
        let points: Vec<_> = (0..30)
            .map(|k| (f64::from(k * 37 % 100), f64::from(k * 23 % 60)))
            .map(|(x, y)| (x, y, truth(x, y), 1.0 + x))
            .collect();
        let found = trend(&points, FieldTerms::new(2, frame)).unwrap();
        for (x, y) in [(0.0, 0.0), (99.0, 59.0), (50.0, 10.0)] {
            assert!((found.at(x, y) - truth(x, y)).abs() < 1e-10);
        }
        assert_eq!(
            FieldTerms::new(3, frame).at(1.0, 2.0).len(),
            FieldTerms::count_of(3)
        );
    }
}
