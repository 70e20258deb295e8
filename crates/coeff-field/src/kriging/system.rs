//! The equations of universal kriging for samples at some positions.
//!
//! Values at the samples are `y = P b + f + noise`: a polynomial trend with the terms `P`, a random
//! field `f` with the covariance `K`, and noise of the variance `l`. Reflections `H` (Householder) turn
//! `P` into `[R; 0]`. So only the last rows of `H y` are free of the trend. Their covariance is `C + l`,
//! with the last block `C` of `H K H^T`, which is positive definite for all kernels.

use std::borrow::Borrow;

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltRegularization, cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Accum, Mat, MatRef, Par, Spec};
use nalgebra::DMatrix;
use ndarray::{Array2, ArrayView2};
use psf_types::KrigingParameters;
use psf_types::maths::term_count;

use super::field::{Functions, Solution};
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
#[derive(Debug)]
pub(super) struct Covariances {
    functions: Functions,
    reflections: Vec<Vec<f64>>,
    /// `R`, upper triangular.
    upper: Mat<f64>,
    /// `H K H^T`.
    reflected: Mat<f64>,
    /// `H D H^T` for samples of uneven noise, with its relative variances on the diagonal of `D`. None if all
    /// samples have the same noise.
    noise: Option<Mat<f64>>,
    /// The mean of the diagonal of `C`.
    variance: f64,
}

impl Covariances {
    /// The covariances at scaled points. `None` if the samples do not determine the trend and one value
    /// more.
    pub(super) fn new(points: &[Point], parameters: &KrigingParameters) -> Option<Self> {
        let count = points.len();
        let functions = Functions::new(points, parameters);
        let terms = term_count(functions.degree);
        if count <= terms {
            return None;
        }
        let rows: Vec<Vec<f64>> = points.iter().map(|&p| functions.of_trend(p)).collect();
        let columns = (0..terms).map(|j| rows.iter().map(|row| row[j]).collect());
        let (reflections, upper) = reflections_of(columns.collect())?;
        let mut reflected = Mat::zeros(count, count);
        for j in 0..count {
            for i in j..count {
                let value = functions.covariance.between(points[i], points[j]);
                reflected[(i, j)] = value;
                reflected[(j, i)] = value;
            }
        }
        let reflected = reflected_twice(&reflections, reflected);
        let diagonal = (terms..count).map(|i| reflected[(i, i)]).sum::<f64>();
        // Without any variance about the trend, any scale of the nugget will do.
        let variance = diagonal / (count - terms) as f64;
        Some(Self {
            functions,
            reflections,
            upper,
            noise: None,
            variance: if variance > 0.0 { variance } else { 1.0 },
            reflected,
        })
    }

    /// The covariances of samples whose noise has these relative variances. `None` if there is not one for
    /// each sample.
    pub(super) fn with_noise(self, relative: &[f64]) -> Option<Self> {
        let count = self.functions.points.len();
        if relative.len() != count {
            return None;
        }
        let noise = Mat::from_fn(count, count, |i, j| if i == j { relative[i] } else { 0.0 });
        Some(Self {
            noise: Some(reflected_twice(&self.reflections, noise)),
            ..self
        })
    }

    /// An element of `H D H^T`.
    fn noise(&self, i: usize, j: usize) -> f64 {
        match &self.noise {
            Some(noise) => noise[(i, j)],
            None => f64::from(u8::from(i == j)),
        }
    }

    /// The number of values that are free of the trend.
    fn free(&self) -> usize {
        self.functions.points.len() - self.reflections.len()
    }
}

/// The equations with their solution's triangular factor. They own the covariances, or borrow them.
#[derive(Debug)]
pub(super) struct Equations<C> {
    covariances: C,
    /// Cholesky's factor of `C + l`, lower triangular.
    lower: Mat<f64>,
    /// `l`.
    nugget: f64,
}

impl<C: Borrow<Covariances>> Equations<C> {
    /// The equations with a nugget, relative to the mean variance about the trend. `None` if the
    /// covariance is not positive definite.
    pub(super) fn new(covariances: C, nugget: f64) -> Option<Self> {
        let all = covariances.borrow();
        let (count, first) = (all.free(), all.reflections.len());
        let mut least = LEAST_NUGGET * count as f64;
        for _ in 0..MOST_TRIES {
            let nugget = nugget.max(least) * all.variance;
            let mut lower = all.reflected.submatrix(first, first, count, count).to_owned();
            match &all.noise {
                None => (0..count).for_each(|i| lower[(i, i)] += nugget),
                Some(noise) => lower += noise.submatrix(first, first, count, count) * faer::Scale(nugget),
            }
            let mut memory =
                MemBuffer::new(cholesky_in_place_scratch::<f64>(count, Par::Seq, Spec::default()));
            let stack = MemStack::new(&mut memory);
            let regularization = LltRegularization::default();
            let made = cholesky_in_place(lower.as_mut(), regularization, Par::Seq, stack, Spec::default());
            if made.is_ok() && (0..count).all(|i| lower[(i, i)].is_finite()) {
                return Some(Self {
                    covariances,
                    lower,
                    nugget,
                });
            }
            least *= LARGER;
        }
        None
    }

    /// The nugget, relative to the mean variance about the trend.
    pub(super) fn nugget(&self) -> f64 {
        self.nugget / self.covariances.borrow().variance
    }

    /// The nugget in units of the kernel.
    pub(super) fn nugget_in_kernel(&self) -> f64 {
        self.nugget
    }

    /// An element of the covariances with noise, `H (K + l D) H^T`.
    fn element(&self, i: usize, j: usize) -> f64 {
        let all = self.covariances.borrow();
        all.reflected[(i, j)] + self.nugget * all.noise(i, j)
    }

    /// The field through values `[sample, column]`.
    pub(super) fn solve(&self, values: ArrayView2<'_, f64>) -> Solution {
        let all = self.covariances.borrow();
        let terms = all.reflections.len();
        let mut known = Mat::from_fn(values.nrows(), values.ncols(), |i, j| values[(i, j)]);
        reflect_columns(all.reflections.iter(), &mut known);
        let (mut trend, mut free) = known.as_mut().split_at_row_mut(terms);
        solve_lower_triangular_in_place(self.lower.as_ref(), free.as_mut(), Par::Seq);
        solve_upper_triangular_in_place(self.lower.transpose(), free.as_mut(), Par::Seq);
        // R b = first rows of H (y - (K + l D) dual).
        let first_rows = Mat::from_fn(terms, all.free(), |i, j| self.element(i, terms + j));
        let (to, free) = (trend.as_mut(), free.as_ref());
        matmul(to, Accum::Add, first_rows.as_ref(), free, -1.0, Par::Seq);
        solve_upper_triangular_in_place(all.upper.as_ref(), trend.as_mut(), Par::Seq);
        let in_array = |matrix: MatRef<'_, f64>| Array2::from_shape_fn(matrix.shape(), |at| matrix[at]);
        let found = in_array(trend.as_ref());
        trend.fill(0.0);
        reflect_columns(all.reflections.iter().rev(), &mut known);
        Solution {
            duals: in_array(known.as_ref()),
            trend: found,
        }
    }

    /// For each sample, the inverse of the variance with which the other samples predict it (O.
    /// Dubrule 1983, Mathematical Geology 15, 687). The error of the prediction is the sample's dual
    /// divided by it.
    pub(super) fn precisions(&self) -> Vec<f64> {
        let all = self.covariances.borrow();
        let (terms, count) = (all.reflections.len(), all.functions.points.len());
        // The last rows of H, then L^-1 times them.
        let mut rows = Mat::identity(count, count);
        reflect_columns(all.reflections.iter(), &mut rows);
        let mut rows = rows.subrows_mut(terms, all.free());
        solve_lower_triangular_in_place(self.lower.as_ref(), rows.as_mut(), Par::Seq);
        rows.col_iter().map(|column| column.squared_norm_l2()).collect()
    }

    /// The variance of the prediction at a scaled point, without noise, in units of the kernel.
    pub(super) fn variance(&self, at: Point) -> f64 {
        self.predictions(vec![at]).variance(0)
    }

    /// The predictions at scaled points.
    pub(super) fn predictions(&self, points: Vec<Point>) -> Predictions<'_> {
        let all = self.covariances.borrow();
        let (terms, free) = (all.reflections.len(), all.free());
        let of_trend: Vec<_> = points.iter().map(|&at| all.functions.of_trend(at)).collect();
        let mut weights = Mat::from_fn(terms, points.len(), |i, j| of_trend[j][i]);
        solve_lower_triangular_in_place(all.upper.transpose(), weights.as_mut(), Par::Seq);
        let of_samples: Vec<_> = points.iter().map(|&at| all.functions.of_samples(at)).collect();
        let mut known = Mat::from_fn(terms + free, points.len(), |i, j| of_samples[j][i]);
        reflect_columns(all.reflections.iter(), &mut known);
        let along = known.subrows(0, terms).to_owned();
        let mut explained = known.subrows(terms, free).to_owned();
        let across = Mat::from_fn(free, terms, |i, j| self.element(terms + i, j));
        let to = explained.as_mut();
        matmul(to, Accum::Add, across.as_ref(), weights.as_ref(), -1.0, Par::Seq);
        solve_lower_triangular_in_place(self.lower.as_ref(), explained.as_mut(), Par::Seq);
        let of_trend = Mat::from_fn(terms, terms, |i, j| self.element(i, j)) * &weights;
        Predictions {
            functions: &all.functions,
            points,
            weights,
            along,
            of_trend,
            explained,
        }
    }
}

/// Predictions at some points, with the covariances of their errors.
pub(super) struct Predictions<'a> {
    functions: &'a Functions,
    points: Vec<Point>,
    /// For each point the `w` with `R^T w = p`: these weights of the first rows of `H y` keep the trend.
    weights: Mat<f64>,
    /// The covariances of each point with the first rows of `H y`.
    along: Mat<f64>,
    /// `w` times the covariance of the first rows of `H y`, with their noise.
    of_trend: Mat<f64>,
    /// The part of each point's variance that the free values explain, as a vector.
    explained: Mat<f64>,
}

impl Predictions<'_> {
    /// The covariance of the errors of two predictions, without noise, in units of the kernel.
    pub(super) fn covariance(&self, a: usize, b: usize) -> f64 {
        let covariance = self.functions.covariance.between(self.points[a], self.points[b]);
        covariance + self.of_trend(a, b) - dot(&self.explained, a, &self.explained, b)
    }

    /// The variance of a prediction's error.
    pub(super) fn variance(&self, a: usize) -> f64 {
        let known = dot(&self.explained, a, &self.explained, a);
        let covariance = self.functions.covariance.between(self.points[a], self.points[a]);
        let trend = dot(&self.weights, a, &self.of_trend, a);
        // Rounding of the difference may be all that is left.
        let terms = covariance.abs() + 2.0 * dot(&self.weights, a, &self.along, a).abs() + trend + known;
        self.covariance(a, a).max(ROUNDING * terms)
    }

    fn of_trend(&self, a: usize, b: usize) -> f64 {
        let both = dot(&self.weights, a, &self.along, b) + dot(&self.weights, b, &self.along, a);
        dot(&self.weights, a, &self.of_trend, b) - both
    }
}

/// The scalar product of two columns.
fn dot(a: &Mat<f64>, i: usize, b: &Mat<f64>, j: usize) -> f64 {
    let products = a.col(i).iter().zip(b.col(j).iter()).map(|(a, b)| a * b);
    products.sum()
}

/// The reflections that make columns upper triangular, and the triangle. `None` if columns depend on each
/// other.
fn reflections_of(mut columns: Vec<Vec<f64>>) -> Option<(Vec<Vec<f64>>, Mat<f64>)> {
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
    Some((reflections, Mat::from_fn(count, count, |i, j| columns[j][i])))
}

fn norm(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// Applies reflections, one after the other, to each column of a matrix.
fn reflect_columns<'a>(reflections: impl Iterator<Item = &'a Vec<f64>> + Clone, matrix: &mut Mat<f64>) {
    for column in matrix.col_iter_mut() {
        let column = column.try_as_col_major_mut().expect("matrices are column-major");
        let column = column.as_slice_mut();
        reflections.clone().for_each(|v| reflect(v, column));
    }
}

/// `H M H^T` of a symmetric matrix: it is reflected from one side, and by symmetry from the other.
fn reflected_twice(reflections: &[Vec<f64>], mut matrix: Mat<f64>) -> Mat<f64> {
    for _ in 0..2 {
        reflect_columns(reflections.iter(), &mut matrix);
        matrix = matrix.transpose().to_owned();
    }
    matrix
}

/// `x - 2 v (v^T x)`.
fn reflect(v: &[f64], x: &mut [f64]) {
    let along: f64 = v.iter().zip(&*x).map(|(v, x)| v * x).sum();
    for (x, v) in x.iter_mut().zip(v) {
        *x -= 2.0 * along * v;
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
