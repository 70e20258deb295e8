//! Legendre polynomials of scaled coordinates.

use crate::geometry::Point;

/// The samples' bounding box, as a map to [-1, 1].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scaling {
    centre: Point,
    half: Point,
}

impl Scaling {
    pub(crate) fn new(points: &[Point]) -> Self {
        let range = |axis: usize| {
            points
                .iter()
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), p| {
                    (a.min(p[axis]), b.max(p[axis]))
                })
        };
        let ranges = [range(0), range(1)];
        Self {
            centre: ranges.map(|(a, b)| f64::midpoint(a, b)),
            // Without a range all samples scale to 0, where every odd term vanishes.
            half: ranges.map(|(a, b)| if a < b { 0.5 * (b - a) } else { 1.0 }),
        }
    }

    /// The terms at a point, by total degree, each total degree by falling power of x.
    pub(crate) fn terms(&self, degree: usize, p: Point) -> Vec<f64> {
        let mut terms = Vec::with_capacity((degree + 1) * (degree + 2) / 2);
        let scaled = [0, 1].map(|axis| (p[axis] - self.centre[axis]) / self.half[axis]);
        let [x, y] = scaled.map(|v| legendre(degree, v));
        for total in 0..=degree {
            for j in 0..=total {
                terms.push(x[total - j] * y[j]);
            }
        }
        terms
    }
}

/// `sqrt(2n + 1) P_n(v)` for n = 0 to `degree`, by Bonnet's recurrence `(n+1) P_{n+1} = (2n+1) v P_n - n P_{n-1}`.
fn legendre(degree: usize, v: f64) -> Vec<f64> {
    let mut p = vec![1.0, v];
    for n in 1..degree {
        let k = n as f64;
        p.push(((2.0 * k + 1.0) * v * p[n] - k * p[n - 1]) / (k + 1.0));
    }
    for (n, value) in p.iter_mut().enumerate() {
        *value *= (2.0 * n as f64 + 1.0).sqrt();
    }
    p
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn legendre_values() {
        let p = legendre(4, 0.5);
        let expected = [1.0, 0.5, -0.125, -0.4375, -0.289_062_5];
        for (n, (got, value)) in p.iter().zip(expected).enumerate() {
            assert!((got - value * (2.0 * n as f64 + 1.0).sqrt()).abs() < 1e-15, "{n}");
        }
    }

    #[test]
    fn terms_come_by_total_degree() {
        let scaling = Scaling::new(&[[1e7, 3.0], [1e7 + 4.0, 3.0]]);
        // x' = 0.5; all y agree, so that y' = 0.
        let terms = scaling.terms(2, [1e7 + 3.0, 3.0]);
        let s = [1.0, 3.0_f64.sqrt(), 5.0_f64.sqrt()];
        let expected = [1.0, 0.5 * s[1], 0.0, -0.125 * s[2], 0.0, -0.5 * s[2]];
        for (got, expected) in terms.iter().zip(expected) {
            assert!((got - expected).abs() < 1e-15, "{terms:?}");
        }
    }
}
