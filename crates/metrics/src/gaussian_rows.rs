//! A Gaussian on the pixels of a cutout, and sums over the pixels under it.

use std::ops::Range;

use nalgebra::SMatrix;

/// Beyond this distance in sigmas, a Gaussian is below the smallest numbers of double precision.
pub(crate) const LARGEST_REACH: f64 = 37.0;
/// Pixels are left out if all their terms together are below this fraction of a sum.
const NEGLIGIBLE: f64 = 1e-15;
/// The values of a row come from a recurrence that starts afresh after this many pixels. It loses
/// half a rounding error times the square of their number.
const BLOCK: usize = 32;
const LANES: usize = 4;

/// The exponents `(j, k)` of the monomials `u^j v^k` of degree 2 and below.
pub(crate) const MONOMIALS: [(usize, usize); 6] = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)];

/// A Gaussian of height 1:
///
/// ```text
/// g(x, y) = exp(-(u^2 + v^2) / 2)      u = lxx dx + lyx dy      v = lyy dy
/// ```
///
/// with `dx = x - x0` and `dy = y - y0`. `L` is the Cholesky factor of the inverse covariance.
#[derive(Debug, Clone, Copy)]
pub(crate) struct UnitGaussian {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) lxx: f64,
    pub(crate) lyx: f64,
    pub(crate) lyy: f64,
}

/// The distance in sigmas beyond which a Gaussian can be left out: the sum of `pixels` terms, each
/// at most `largest` times the Gaussian, is there negligible next to `sum`.
pub(crate) fn reach(largest: f64, pixels: usize, sum: f64) -> f64 {
    let ratio = largest * (pixels as f64 / NEGLIGIBLE) / sum;
    (2.0 * ratio.max(1.0).ln()).sqrt().min(LARGEST_REACH)
}

/// The pixels of one row that a Gaussian reaches.
#[derive(Debug)]
pub(crate) struct GaussianRow {
    v: f64,
    columns: Range<usize>,
    u: Vec<f64>,
    values: Vec<f64>,
}

impl GaussianRow {
    /// Memory for rows of this many pixels.
    pub(crate) fn new(columns: usize) -> Self {
        Self {
            v: 0.0,
            columns: 0..0,
            u: vec![0.0; columns],
            values: vec![0.0; columns],
        }
    }

    /// Evaluates the Gaussian on a row, up to a distance of `reach` sigmas.
    pub(crate) fn evaluate(&mut self, gaussian: UnitGaussian, row: usize, reach: f64) {
        let UnitGaussian { x, y, lxx, lyx, lyy } = gaussian;
        let dy = row as f64 - y;
        let (v, shift) = (lyy * dy, lyx * dy);
        self.v = v;
        self.columns = 0..0;
        if v.abs() > reach {
            return;
        }
        let half = (reach * reach - v * v).sqrt();
        // The whole row if the Gaussian is not finite. `max` and `min` ignore NaN.
        let first = (x + (-half - shift) / lxx).ceil().max(0.0);
        let last = (x + (half - shift) / lxx).floor().min(self.u.len() as f64 - 1.0);
        if last < first {
            return;
        }
        self.columns = first as usize..last as usize + 1;
        for (column, u) in self.columns.clone().zip(&mut self.u) {
            *u = lxx * (column as f64 - x) + shift;
        }
        // g(x + 1) / g(x) = exp(-lxx (u + lxx / 2)) falls by the same factor at every pixel.
        let ratio_of_ratios = (-lxx * lxx).exp();
        let n = self.columns.len();
        for (values, u) in self.values[..n].chunks_mut(BLOCK).zip(self.u.chunks(BLOCK)) {
            let u = u[0];
            let mut g = (-0.5 * (u * u + v * v)).exp();
            let mut ratio = (-lxx * (u + 0.5 * lxx)).exp();
            for value in values {
                *value = g;
                g *= ratio;
                ratio *= ratio_of_ratios;
            }
        }
    }

    /// `v` on this row.
    pub(crate) fn v(&self) -> f64 {
        self.v
    }

    /// `u` on the columns that the Gaussian reaches.
    pub(crate) fn u(&self) -> &[f64] {
        &self.u[..self.columns.len()]
    }

    /// The columns that the Gaussian reaches.
    pub(crate) fn columns(&self) -> Range<usize> {
        self.columns.clone()
    }

    /// The Gaussian on these columns.
    pub(crate) fn values(&self) -> &[f64] {
        &self.values[..self.columns.len()]
    }
}

/// Sums over pixels of `q u^j v^k` for `j + k <= 4`, where `q` is a product of the Gaussian with
/// other values.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct MonomialSums([[f64; 5]; 5]);

impl MonomialSums {
    /// Adds a row with `q = g * values`. `values` are those of the row's columns.
    pub(crate) fn add(&mut self, row: &GaussianRow, values: &[f64]) {
        let along_row = power_sums(row.u(), row.values(), values);
        let mut power = 1.0;
        for k in 0..5 {
            for (j, sum) in along_row.iter().enumerate().take(5 - k) {
                self.0[j][k] += sum * power;
            }
            power *= row.v;
        }
    }

    /// The sum of `q u^j v^k`.
    pub(crate) fn of(&self, (j, k): (usize, usize)) -> f64 {
        self.0[j][k]
    }

    /// The sums of `q` times the products of every two [`MONOMIALS`].
    pub(crate) fn products(&self) -> SMatrix<f64, 6, 6> {
        SMatrix::from_fn(|a, b| {
            let ((j, k), (l, m)) = (MONOMIALS[a], MONOMIALS[b]);
            self.0[j + l][k + m]
        })
    }
}

/// The sums of `a b u^j` for `j` from 0 to 4.
fn power_sums(u: &[f64], a: &[f64], b: &[f64]) -> [f64; 5] {
    let ((u, u_rest), (a, a_rest), (b, b_rest)) = (
        u.as_chunks::<LANES>(),
        a.as_chunks::<LANES>(),
        b.as_chunks::<LANES>(),
    );
    let mut sums = [[0.0; LANES]; 5];
    for ((u, a), b) in u.iter().zip(a).zip(b) {
        let mut term = [0.0; LANES];
        for lane in 0..LANES {
            term[lane] = a[lane] * b[lane];
        }
        for sum in &mut sums {
            for lane in 0..LANES {
                sum[lane] += term[lane];
                term[lane] *= u[lane];
            }
        }
    }
    for ((u, a), b) in u_rest.iter().zip(a_rest).zip(b_rest) {
        let mut term = a * b;
        for sum in &mut sums {
            sum[0] += term;
            term *= u;
        }
    }
    sums.map(|[a, b, c, d]| (a + b) + (c + d))
}

/// The sum of the products of two rows.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut sums = [0.0; LANES];
    for (a, b) in a.iter().zip(b) {
        for lane in 0..LANES {
            sums[lane] += a[lane] * b[lane];
        }
    }
    for (a, b) in a_rest.iter().zip(b_rest) {
        sums[0] += a * b;
    }
    let [a, b, c, d] = sums;
    (a + b) + (c + d)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of exponents up to 37^2 / 2, and of 32 steps of the recurrence.
    const RECURRENCE: f64 = 1e-12;

    #[test]
    fn rows_hold_the_gaussian_wherever_it_counts() {
        let shapes = [
            (0.3, 0.0, 0.3),
            (0.02, 0.01, 0.05),
            (5.0, -3.0, 2.0),
            (0.9, 0.7, 0.1),
            (40.0, 0.0, 40.0),
        ];
        for ((lxx, lyx, lyy), reach) in shapes.into_iter().zip([9.0, 3.0, 9.0, 37.0, 37.0]) {
            let gaussian = UnitGaussian {
                x: 70.3,
                y: 9.8,
                lxx,
                lyx,
                lyy,
            };
            let mut row = GaussianRow::new(150);
            let mut sums = MonomialSums::default();
            let mut expected = [0.0; 3];
            for i in 0..20 {
                row.evaluate(gaussian, i, reach);
                sums.add(&row, row.values());
                for column in 0..150 {
                    let (dx, dy) = (column as f64 - 70.3, i as f64 - 9.8);
                    let (u, v) = (lxx * dx + lyx * dy, lyy * dy);
                    let g = (-0.5 * (u * u + v * v)).exp();
                    let inside = row.columns().contains(&column);
                    assert_eq!(inside, u.hypot(v) <= reach, "{gaussian:?} {i} {column}");
                    if inside {
                        let value = row.values()[column - row.columns().start];
                        assert!((value / g - 1.0).abs() < RECURRENCE, "{gaussian:?} {i} {column}");
                        for (sum, factor) in expected.iter_mut().zip([1.0, u * u * v, u * v * v * v]) {
                            *sum += g * g * factor;
                        }
                    }
                }
            }
            for (monomial, expected) in [(0, 0), (2, 1), (1, 3)].into_iter().zip(expected) {
                assert!(
                    (sums.of(monomial) - expected).abs() <= RECURRENCE * expected.abs().max(sums.of((0, 0)))
                );
            }
        }
    }

    #[test]
    fn a_gaussian_that_is_not_finite_is_seen() {
        for lxx in [f64::NAN, f64::INFINITY, 0.0] {
            let gaussian = UnitGaussian {
                x: f64::NAN,
                y: 1.0,
                lxx,
                lyx: 0.0,
                lyy: 1.0,
            };
            let mut row = GaussianRow::new(5);
            row.evaluate(gaussian, 1, 9.0);
            assert!(row.columns() == (0..5) && row.values()[0].is_nan(), "{row:?}");
        }
    }
}
