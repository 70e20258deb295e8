//! The equations of universal kriging for samples at some positions.
//!
//! Values at the samples are `y = P b + f + noise`: a polynomial trend with the terms `P`, a random
//! field `f` with the covariance `K`, and noise with the covariance `l D`. `D` is diagonal. With
//! `S = D^(-1/2)`, the values `S y` have noise of the covariance `l`. Reflections `H` (Householder)
//! turn `S P` into `[R; 0]`. So only the last rows of `H S y` are free of the trend. Their covariance
//! is `C + l`, with the last block `C` of `H S K S H`, which is positive definite for all kernels.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltRegularization, cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Accum, Mat, MatMut, Par, Spec};
use nalgebra::DMatrix;
use ndarray::{Array2, ArrayView2};
use psf_types::KrigingParameters;

use super::kernel::{Covariance, term_count, terms};
use crate::geometry::Point;

/// The nugget is at least this fraction of the sum of the variances about the trend. So the condition
/// number of the equations is at most 1e14. Closed forms of leave-one-out errors mean nothing near 1e16.
pub(super) const LEAST_NUGGET: f64 = 1e-14;
/// If rounding makes the covariance indefinite, the nugget grows by this factor, at most
/// [`MOST_TRIES`] times.
const LARGER: f64 = 10.0;
const MOST_TRIES: usize = 8;
/// The rounding of a variance, relative to its terms.
const ROUNDING: f64 = 1e-15;
/// The smallest part of the trend's terms that is not spanned by others.
const DEPENDENT: f64 = 1e-8;

/// The covariances of samples, without their noise.
#[derive(Debug, Clone)]
pub(super) struct Covariances {
    points: Vec<Point>,
    covariance: Covariance,
    trend: usize,
    /// `S`.
    scales: Vec<f64>,
    reflections: Vec<Vec<f64>>,
    /// `R`, upper triangular, row-major.
    upper: Vec<Vec<f64>>,
    /// `H S K S H`.
    reflected: Mat<f64>,
    /// The mean of the diagonal of `C`.
    variance: f64,
}

impl Covariances {
    /// The covariances at scaled points. `noise` holds the standard deviations of the samples' noise,
    /// relative to each other, or nothing if all are equal. `None` if the samples do not determine the
    /// trend and one value more.
    pub(super) fn new(points: &[Point], noise: &[f64], parameters: &KrigingParameters) -> Option<Self> {
        let count = points.len();
        let scales: Vec<f64> = match noise {
            [] => vec![1.0; count],
            noise => noise.iter().map(|sigma| sigma.recip()).collect(),
        };
        let covariance = Covariance::new(parameters);
        let trend = parameters.trend();
        if count <= term_count(trend) {
            return None;
        }
        let rows = points.iter().zip(&scales);
        let rows: Vec<Vec<f64>> = rows
            .map(|(&p, scale)| terms(trend, p).map(|term| term * scale).collect())
            .collect();
        let columns = (0..term_count(trend)).map(|j| rows.iter().map(|row| row[j]).collect());
        let [reflections, upper] = reflections_of(columns.collect())?;
        let mut reflected = Mat::zeros(count, count);
        for j in 0..count {
            for i in j..count {
                let value = scales[i] * scales[j] * covariance.between(points[i], points[j]);
                reflected[(i, j)] = value;
                reflected[(j, i)] = value;
            }
        }
        // From one side, and by symmetry from the other.
        for _ in 0..2 {
            for j in 0..count {
                let column = column_of(reflected.as_mut(), j);
                reflect_by(&reflections, column);
            }
            transpose(reflected.as_mut());
        }
        let first = reflections.len();
        let diagonal = (first..count).map(|i| reflected[(i, i)]).sum::<f64>();
        Some(Self {
            points: points.to_vec(),
            covariance,
            trend,
            scales,
            reflections,
            upper,
            variance: diagonal / (count - first) as f64,
            reflected,
        })
    }

    /// The number of values that are free of the trend.
    fn free(&self) -> usize {
        self.points.len() - self.reflections.len()
    }

    /// `H S y`, column by column.
    fn reflected_values(&self, values: ArrayView2<'_, f64>) -> Mat<f64> {
        let mut all = Mat::from_fn(values.nrows(), values.ncols(), |i, j| {
            self.scales[i] * values[(i, j)]
        });
        for j in 0..all.ncols() {
            let column = column_of(all.as_mut(), j);
            reflect_by(&self.reflections, column);
        }
        all
    }

    /// The equations with a nugget, relative to the mean variance about the trend. `None` if the
    /// covariance is not positive definite.
    pub(super) fn with_nugget(&self, nugget: f64) -> Option<Equations<'_>> {
        let (count, first) = (self.free(), self.reflections.len());
        let mut least = LEAST_NUGGET * count as f64;
        // Without any variance about the trend, any nugget will do.
        let variance = if self.variance > 0.0 { self.variance } else { 1.0 };
        for _ in 0..MOST_TRIES {
            let nugget = nugget.max(least) * variance;
            let mut lower = self.reflected.submatrix(first, first, count, count).to_owned();
            for i in 0..count {
                lower[(i, i)] += nugget;
            }
            let mut memory =
                MemBuffer::new(cholesky_in_place_scratch::<f64>(count, Par::Seq, Spec::default()));
            let stack = MemStack::new(&mut memory);
            let regularization = LltRegularization::default();
            let made = cholesky_in_place(lower.as_mut(), regularization, Par::Seq, stack, Spec::default());
            if made.is_ok() && (0..count).all(|i| lower[(i, i)].is_finite()) {
                return Some(Equations {
                    covariances: self,
                    lower,
                    nugget,
                });
            }
            least *= LARGER;
        }
        None
    }
}

/// The equations with their solution's triangular factor.
#[derive(Debug)]
pub(super) struct Equations<'a> {
    covariances: &'a Covariances,
    /// Cholesky's factor of `C + l`, lower triangular.
    lower: Mat<f64>,
    /// `l`.
    nugget: f64,
}

/// The field is `sum_i k(x, x_i) dual_i + sum_j p_j(x) trend_j`.
#[derive(Debug)]
pub(super) struct Solution {
    /// `[sample, column]`.
    pub(super) duals: Array2<f64>,
    /// `[term, column]`.
    pub(super) trend: Array2<f64>,
}

impl Equations<'_> {
    /// The nugget, relative to the mean variance about the trend.
    pub(super) fn nugget(&self) -> f64 {
        let variance = self.covariances.variance;
        self.nugget / if variance > 0.0 { variance } else { 1.0 }
    }

    /// The field through values `[sample, column]`.
    pub(super) fn solve(&self, values: ArrayView2<'_, f64>) -> Solution {
        let all = self.covariances;
        let (terms, count) = (all.reflections.len(), all.points.len());
        let mut known = all.reflected_values(values);
        let columns = known.ncols();
        let mut free = known.submatrix(terms, 0, all.free(), columns).to_owned();
        solve_lower_triangular_in_place(self.lower.as_ref(), free.as_mut(), Par::Seq);
        solve_upper_triangular_in_place(self.lower.transpose(), free.as_mut(), Par::Seq);
        // R b = first rows of H S (y - K dual).
        let mut along = Mat::zeros(terms, columns);
        let first_rows = all.reflected.submatrix(0, terms, terms, all.free());
        matmul(
            along.as_mut(),
            Accum::Replace,
            first_rows,
            free.as_ref(),
            1.0,
            Par::Seq,
        );
        let mut trend = Array2::zeros((terms, columns));
        for column in 0..columns {
            for i in (0..terms).rev() {
                let later = (i + 1..terms)
                    .map(|j| all.upper[i][j] * trend[(j, column)])
                    .sum::<f64>();
                trend[(i, column)] = (known[(i, column)] - along[(i, column)] - later) / all.upper[i][i];
            }
        }
        let mut duals = Array2::zeros((count, columns));
        for column in 0..columns {
            let rows = column_of(known.as_mut(), column);
            rows[..terms].fill(0.0);
            for (row, value) in rows[terms..].iter_mut().zip(free.col(column).iter()) {
                *row = *value;
            }
            for v in all.reflections.iter().rev() {
                reflect(v, rows);
            }
            for ((dual, row), scale) in duals.column_mut(column).iter_mut().zip(rows).zip(&all.scales) {
                *dual = scale * *row;
            }
        }
        Solution { duals, trend }
    }

    /// For each sample, the inverse of the variance with which the other samples predict it (O.
    /// Dubrule 1983, Mathematical Geology 15, 687). The error of the prediction is the sample's dual
    /// divided by it.
    pub(super) fn precisions(&self) -> Vec<f64> {
        let all = self.covariances;
        let (terms, count) = (all.reflections.len(), all.points.len());
        // The last rows of H, then L^-1 times them.
        let mut rows = Mat::zeros(all.free(), count);
        let mut unit = vec![0.0; count];
        for j in 0..count {
            unit.fill(0.0);
            unit[j] = 1.0;
            reflect_by(&all.reflections, &mut unit);
            for (to, value) in column_of(rows.as_mut(), j).iter_mut().zip(&unit[terms..]) {
                *to = *value;
            }
        }
        solve_lower_triangular_in_place(self.lower.as_ref(), rows.as_mut(), Par::Seq);
        let squares = rows.col_iter().map(|column| column.squared_norm_l2());
        squares
            .zip(&all.scales)
            .map(|(square, scale)| square * scale * scale)
            .collect()
    }

    /// The variance of the prediction at a scaled point, without noise, in units of the kernel.
    pub(super) fn variance(&self, at: Point) -> f64 {
        let all = self.covariances;
        let (terms_count, count) = (all.reflections.len(), all.points.len());
        let mut known: Vec<f64> = all
            .points
            .iter()
            .zip(&all.scales)
            .map(|(&p, scale)| scale * all.covariance.between(at, p))
            .collect();
        reflect_by(&all.reflections, &mut known);
        // R^T w = p: the first weights keep the trend.
        let mut weights: Vec<f64> = Vec::with_capacity(terms_count);
        for (j, term) in terms(all.trend, at).enumerate() {
            let before = (0..j).map(|i| all.upper[i][j] * weights[i]).sum::<f64>();
            weights.push((term - before) / all.upper[j][j]);
        }
        let mut free = Mat::zeros(count - terms_count, 1);
        let (mut of_trend, mut variance) = (0.0, all.covariance.between(at, at));
        for (i, wi) in weights.iter().enumerate() {
            variance -= 2.0 * wi * known[i];
            for (j, wj) in weights.iter().enumerate() {
                of_trend += wi * wj * all.reflected[(i, j)];
            }
            of_trend += self.nugget * wi * wi;
        }
        for i in 0..free.nrows() {
            let along = weights
                .iter()
                .enumerate()
                .map(|(j, w)| w * all.reflected[(j, terms_count + i)]);
            free[(i, 0)] = known[terms_count + i] - along.sum::<f64>();
        }
        solve_lower_triangular_in_place(self.lower.as_ref(), free.as_mut(), Par::Seq);
        let known = free.squared_norm_l2();
        // Rounding of the difference may be all that is left.
        let rounding = ROUNDING * (variance.abs() + of_trend.abs() + known);
        (variance + of_trend - known).max(rounding)
    }
}

/// The reflections that make columns upper triangular, and the triangle, row-major. `None` if columns
/// depend on each other.
fn reflections_of(mut columns: Vec<Vec<f64>>) -> Option<[Vec<Vec<f64>>; 2]> {
    let count = columns.len();
    let mut reflections: Vec<Vec<f64>> = Vec::with_capacity(count);
    for k in 0..count {
        let whole = norm(&columns[k]);
        let rest = norm(&columns[k][k..]);
        if rest.is_nan() || rest <= DEPENDENT * whole {
            return None;
        }
        let mut v = columns[k].clone();
        v[..k].fill(0.0);
        v[k] += rest.copysign(v[k]);
        let length = norm(&v);
        for v in &mut v {
            *v /= length;
        }
        for column in &mut columns[k..] {
            reflect(&v, column);
        }
        reflections.push(v);
    }
    let upper = (0..count).map(|i| columns.iter().map(|column| column[i]).collect());
    Some([reflections, upper.collect()])
}

fn norm(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>().sqrt()
}

fn reflect_by(reflections: &[Vec<f64>], x: &mut [f64]) {
    for v in reflections {
        reflect(v, x);
    }
}

/// `x - 2 v (v^T x)`.
fn reflect(v: &[f64], x: &mut [f64]) {
    let along: f64 = v.iter().zip(&*x).map(|(v, x)| v * x).sum();
    for (x, v) in x.iter_mut().zip(v) {
        *x -= 2.0 * along * v;
    }
}

fn column_of(matrix: MatMut<'_, f64>, column: usize) -> &mut [f64] {
    let column = matrix.col_mut(column).try_as_col_major_mut();
    column.expect("matrices are column-major").as_slice_mut()
}

fn transpose(mut matrix: MatMut<'_, f64>) {
    for j in 0..matrix.ncols() {
        for i in 0..j {
            let (a, b) = (matrix[(i, j)], matrix[(j, i)]);
            matrix[(i, j)] = b;
            matrix[(j, i)] = a;
        }
    }
}

/// Returns values `[sample, column]` with at most as many columns as samples, whose rows have the same
/// scalar products. Squared errors of linear predictions are then the same, too.
pub(super) fn compressed(values: ArrayView2<'_, f64>) -> Array2<f64> {
    let (rows, columns) = values.dim();
    if columns <= rows {
        return values.to_owned();
    }
    let upper = DMatrix::from_fn(columns, rows, |j, i| values[(i, j)]).qr().r();
    Array2::from_shape_fn((rows, rows), |(i, j)| upper[(j, i)])
}
