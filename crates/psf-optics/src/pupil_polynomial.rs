//! Polynomials of the pupil coordinates in powers of x and y.

/// `sum_{a + b <= degree} c_ab x^a y^b` over the pupil.
///
/// A wavefront is summed in this form once for each PSF and then evaluated row by row, with its gradient, by Horner's
/// rule: cheaper than a sum over maps of many Zernike polynomials, and without their memory.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PupilPolynomial {
    degree: usize,
    /// `c_ab` at `b * (degree + 1) + a`.
    coefficients: Vec<f64>,
}

/// A [`PupilPolynomial`] at one y: coefficients of ascending powers of x.
#[derive(Debug, Default)]
pub(crate) struct PupilRowPolynomial {
    value: Vec<f64>,
    dy: Vec<f64>,
}

/// Values and gradient along a row.
#[derive(Debug, Default)]
pub(crate) struct PupilRowValues {
    pub(crate) value: Vec<f64>,
    pub(crate) dx: Vec<f64>,
    pub(crate) dy: Vec<f64>,
}

impl PupilPolynomial {
    pub(crate) fn zero(degree: usize) -> Self {
        Self {
            degree,
            coefficients: vec![0.0; (degree + 1) * (degree + 1)],
        }
    }

    pub(crate) fn degree(&self) -> usize {
        self.degree
    }

    pub(crate) fn is_finite(&self) -> bool {
        self.coefficients.iter().all(|c| c.is_finite())
    }

    pub(crate) fn coefficient_mut(&mut self, a: usize, b: usize) -> &mut f64 {
        &mut self.coefficients[b * (self.degree + 1) + a]
    }

    /// Adds `factor * other`, whose degree must not be higher.
    pub(crate) fn add_scaled(&mut self, other: &Self, factor: f64) {
        for b in 0..=other.degree {
            for a in 0..=other.degree - b {
                *self.coefficient_mut(a, b) += factor * other.coefficients[b * (other.degree + 1) + a];
            }
        }
    }

    /// Reduces the polynomial and its derivative in y to one y.
    pub(crate) fn at_y(&self, y: f64, row: &mut PupilRowPolynomial) {
        let d = self.degree;
        row.value.clear();
        row.dy.clear();
        for a in 0..=d {
            let (mut value, mut slope) = (0.0, 0.0);
            for b in (0..=d - a).rev() {
                slope = slope * y + value;
                value = value * y + self.coefficients[b * (d + 1) + a];
            }
            row.value.push(value);
            row.dy.push(slope);
        }
    }

    #[cfg(test)]
    pub(crate) fn evaluate(&self, x: f64, y: f64) -> f64 {
        let (mut row, mut values) = (PupilRowPolynomial::default(), PupilRowValues::default());
        self.at_y(y, &mut row);
        row.evaluate(&[x], &mut values);
        values.value[0]
    }
}

impl PupilRowPolynomial {
    /// Values and gradient at every `x`.
    pub(crate) fn evaluate(&self, x: &[f64], values: &mut PupilRowValues) {
        for v in [&mut values.value, &mut values.dx, &mut values.dy] {
            v.clear();
            v.resize(x.len(), 0.0);
        }
        for (&c, &c_dy) in self.value.iter().zip(&self.dy).rev() {
            let columns = values
                .value
                .iter_mut()
                .zip(&mut values.dx)
                .zip(&mut values.dy)
                .zip(x);
            for (((value, dx), dy), &x) in columns {
                *dx = *dx * x + *value;
                *value = *value * x + c;
                *dy = *dy * x + c_dy;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_and_gradient_of_a_cubic() {
        // 1 + 2x - 3xy + 0.5 x y^2 + 4 y^3
        let mut p = PupilPolynomial::zero(3);
        for (a, b, c) in [(0, 0, 1.0), (1, 0, 2.0), (1, 1, -3.0), (1, 2, 0.5), (0, 3, 4.0)] {
            *p.coefficient_mut(a, b) = c;
        }
        let (mut row, mut values) = (PupilRowPolynomial::default(), PupilRowValues::default());
        let y = -0.4;
        p.at_y(y, &mut row);
        let xs = [0.7, -1.2];
        row.evaluate(&xs, &mut values);
        for (i, x) in xs.into_iter().enumerate() {
            let expected = 1.0 + 2.0 * x - 3.0 * x * y + 0.5 * x * y * y + 4.0 * y * y * y;
            assert!((values.value[i] - expected).abs() < 1e-14);
            assert!((values.dx[i] - (2.0 - 3.0 * y + 0.5 * y * y)).abs() < 1e-14);
            assert!((values.dy[i] - (-3.0 * x + x * y + 12.0 * y * y)).abs() < 1e-14);
        }
    }
}
