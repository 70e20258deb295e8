//! Leading singular values and vectors of the samples, and what is known of the rest.

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use ndarray::{Array2, ArrayView2, Axis};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rayon::iter::{IndexedParallelIterator as _, IntoParallelIterator as _, ParallelIterator as _};

use crate::decomposition::{BasisError, ROWS, columns_of, decompose, product, project, subtract_projection};

/// The leading components of samples `[sample, pixel]`: all, or those that are computed.
#[derive(Debug)]
pub(crate) struct Components {
    /// The largest singular values, in descending order.
    pub(crate) values: Vec<f64>,
    /// Their singular vectors `[pixel, k]`.
    pub(crate) vectors: Mat<f64>,
    /// The coefficients `[sample, k]` of the samples.
    pub(crate) coefficients: Array2<f64>,
    /// The squared norm of each sample after these components are subtracted.
    pub(crate) unexplained: Vec<f64>,
    /// The singular values that are not computed.
    pub(crate) rest: Rest,
}

/// The singular values that are not computed. By default there are none.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Rest {
    /// Their number.
    pub(crate) count: usize,
    /// A bound of the largest.
    pub(crate) largest: f64,
    /// The sum of their squares.
    pub(crate) energy: f64,
    /// An estimate of their sum.
    pub(crate) sum: f64,
    /// The limits between which their sum lies.
    pub(crate) sum_limits: [f64; 2],
}

impl Components {
    /// Computes all components.
    pub(crate) fn all(rows: ArrayView2<'_, f64>) -> Result<Self, BasisError> {
        let (values, vectors) = decompose(columns_of(rows))?;
        Ok(Self {
            coefficients: project(rows, vectors.as_ref()),
            unexplained: vec![0.0; rows.nrows()],
            values,
            vectors,
            rest: Rest::default(),
        })
    }

    /// The squared norm of each sample after its first `count` components are subtracted.
    pub(crate) fn left_after(&self, count: usize) -> impl Iterator<Item = f64> {
        let rows = self.coefficients.outer_iter().zip(&self.unexplained);
        rows.map(move |(row, unexplained)| unexplained + row.iter().skip(count).map(|a| a * a).sum::<f64>())
    }
}

/// Vectors that are added to the space at a time. Singular values may be equal in groups of this
/// size. More vectors at a time need more vectors in all.
const BLOCK: usize = 8;
/// Dimensions of the space when its components are computed for the first time. Each time the
/// dimensions are doubled, up to half of the smaller side of the matrix. Beyond that, the whole
/// decomposition is about as fast.
const FIRST: usize = 256;
/// The smaller side of matrices of which leading components are computed without the rest.
const LARGE: usize = 1024;
/// A component is exact if its residual is at most this multiple of the largest singular value. Its
/// singular value is then exact to rounding, because its error is of the order of the squared
/// residual. Its stamp may contain this multiple, divided by the relative distance to the closest
/// singular value, of other components.
const EXACT: f64 = 1e-12;
/// Width of the limits of an estimated sum, in standard deviations. A normal variable leaves them
/// once in 2 million cases.
const DEVIATIONS: f64 = 5.0;
/// Relative error of the quadrature that estimates a sum, without the scatter of the random start.
const QUADRATURE: f64 = 0.01;

/// Returns whether matrices of this shape are so large that their leading components are computed
/// without the rest.
pub(crate) fn is_large(rows: ArrayView2<'_, f64>) -> bool {
    rows.nrows().min(rows.ncols()) >= LARGE
}

/// A space that contains the leading singular vectors of a matrix `X` ever more accurately: the
/// block Krylov space of `X^T X` for random vectors (Golub and Van Loan, Matrix Computations,
/// section 10.3; Musco and Musco 2015, arXiv:1504.05477).
///
/// All its vectors are kept and are orthogonal to rounding. The singular values of `X` within the
/// space are lower bounds of those of `X`.
#[derive(Debug)]
pub(crate) struct Krylov<'a> {
    matrix: MatRef<'a, f64>,
    rows: ArrayView2<'a, f64>,
    /// Orthonormal vectors `[pixel, k]`.
    space: Mat<f64>,
    /// Their images `X v`, `[sample, k]`.
    images: Mat<f64>,
    /// `X^T X v` of the last of them, with which the space grows.
    next: Mat<f64>,
}

impl<'a> Krylov<'a> {
    /// A space without vectors, for samples `[sample, pixel]`.
    pub(crate) fn new(rows: ArrayView2<'a, f64>) -> Self {
        Self {
            matrix: columns_of(rows),
            rows,
            space: Mat::zeros(rows.ncols(), 0),
            images: Mat::zeros(rows.nrows(), 0),
            next: Mat::new(),
        }
    }

    /// Enlarges the space and computes the leading components in it. Returns `None` if the space
    /// would be too large.
    pub(crate) fn enlarged(&mut self) -> Result<Option<Components>, BasisError> {
        let (size, from) = ((2 * self.space.ncols()).max(FIRST), self.space.ncols());
        if size > self.rows.nrows().min(self.rows.ncols()) / 2 {
            return Ok(None);
        }
        self.space.resize_with(self.rows.ncols(), size, |_, _| 0.0);
        self.images.resize_with(self.rows.nrows(), size, |_, _| 0.0);
        for first in (from..size).step_by(BLOCK) {
            let next = match first {
                0 => {
                    let mut random = ChaCha8Rng::seed_from_u64(1);
                    Mat::from_fn(self.rows.ncols(), BLOCK, |_, _| {
                        StandardNormal.sample(&mut random)
                    })
                }
                _ => std::mem::replace(&mut self.next, Mat::new()),
            };
            let Some(next) = orthonormal_to(self.space.subcols(0, first), next)? else {
                return Ok(None);
            };
            let images = self.images.subcols_mut(first, BLOCK);
            self.next = multiply_twice(self.matrix, next.as_ref(), images);
            self.space.subcols_mut(first, BLOCK).copy_from(next);
        }
        self.components().map(Some)
    }

    /// The components of `X` within the space that are exact, from the first on.
    fn components(&self) -> Result<Components, BasisError> {
        let (values, turned) = decompose(self.images.transpose())?;
        let residuals = self.residuals(&turned);
        let count = residuals.iter().take_while(|&&r| r <= EXACT * values[0]).count();
        let vectors = product(self.space.as_ref(), turned.subcols(0, count));
        let coefficients = project(self.rows, vectors.as_ref());
        let unexplained = unexplained(self.rows, coefficients.view(), &vectors);
        let energy = unexplained.iter().sum();
        Ok(Components {
            rest: self.rest(&values, &turned, count, residuals.get(count).copied(), energy),
            values: values[..count].to_vec(),
            vectors,
            coefficients,
            unexplained,
        })
    }

    /// Describes the singular values after the first `count`. `values` and `turned` are the singular
    /// values and vectors within the space, `residual` belongs to the first value that is left, and
    /// `energy` is the sum of the squares of the values that are left.
    fn rest(
        &self,
        values: &[f64],
        turned: &Mat<f64>,
        count: usize,
        residual: Option<f64>,
        energy: f64,
    ) -> Rest {
        let left = self.rows.nrows().min(self.rows.ncols()) - count;
        // At least one of the values left is as large as their root mean square. So a large value
        // that the space misses is noticed.
        let root_mean_square = (energy / left as f64).sqrt();
        let next = residual.map_or(0.0, |residual| values[count] + residual);

        // For a random unit vector v, the mean of |<v, v_i>|^2 is 1 / pixels. So the first vectors
        // of the space sample the sum over all singular values (Gauss quadrature of a block
        // Krylov space: Golub and Meurant 2010, Matrices, Moments and Quadrature, chapter 6).
        let sampled = |k: usize| {
            let squares: f64 = (0..BLOCK).map(|i| turned[(i, k)] * turned[(i, k)]).sum();
            squares * self.rows.ncols() as f64 / BLOCK as f64 * values[k]
        };
        let most = left as f64 * root_mean_square;
        let least = values[count..].iter().sum::<f64>().min(most);
        let sum = (count..values.len()).map(sampled).sum::<f64>().clamp(least, most);
        let error = DEVIATIONS * (2.0 * energy / BLOCK as f64).sqrt() + QUADRATURE * sum;
        Rest {
            count: left,
            largest: next.max(root_mean_square),
            energy,
            sum,
            sum_limits: [(sum - error).max(least), (sum + error).min(most)],
        }
    }

    /// For each vector `v = V t` of the space `V`, the norm of the part of `X^T u`,
    /// `u = X v / |X v|`, that lies outside the space. It is 0 for a singular vector of `X`.
    fn residuals(&self, turned: &Mat<f64>) -> Vec<f64> {
        let mut left = product(self.images.as_ref(), turned.as_ref());
        for column in left.col_iter_mut() {
            let norm = column.norm_l2();
            if norm > 0.0 {
                column.iter_mut().for_each(|v| *v /= norm);
            }
        }
        let mut outside = product(self.matrix, left.as_ref());
        subtract_projection(&mut outside, self.space.as_ref());
        outside.col_iter().map(|column| column.norm_l2()).collect()
    }
}

/// Computes `X v`, which goes to `images`, and returns `X^T X v`, for the columns `v` of `vectors`.
/// `matrix` is `X^T`. Reads it from memory only once, because this takes most of the time.
fn multiply_twice(matrix: MatRef<'_, f64>, vectors: MatRef<'_, f64>, images: MatMut<'_, f64>) -> Mat<f64> {
    /// Rows of `X` that remain in the processor's cache between both products.
    const CACHED: usize = 32;
    let parts = matrix.par_col_chunks(ROWS).zip(images.par_row_chunks_mut(ROWS));
    let sums = parts.map(|(columns, mut images)| {
        let mut sum = Mat::zeros(vectors.nrows(), vectors.ncols());
        for first in (0..columns.ncols()).step_by(CACHED) {
            let columns = columns.subcols(first, CACHED.min(columns.ncols() - first));
            let mut images = images.as_mut().subrows_mut(first, columns.ncols());
            let rows = columns.transpose();
            matmul(images.as_mut(), Accum::Replace, rows, vectors, 1.0, Par::Seq);
            matmul(sum.as_mut(), Accum::Add, columns, images.as_ref(), 1.0, Par::Seq);
        }
        sum
    });
    // The parts and the order of their sum do not depend on the number of threads.
    let sums: Vec<Mat<f64>> = sums.collect();
    sums.iter()
        .fold(Mat::zeros(vectors.nrows(), vectors.ncols()), |sum, part| {
            sum + part
        })
}

/// Orthonormal vectors that are orthogonal to `space` and, with it, span the columns of `matrix`.
/// Where the columns lie in the space except for rounding, the directions are arbitrary. Returns
/// `None` if there are no such vectors to rounding.
fn orthonormal_to(space: MatRef<'_, f64>, mut matrix: Mat<f64>) -> Result<Option<Mat<f64>>, BasisError> {
    /// Enough even where only rounding is left of a column, of which most lies in the space again.
    const TIMES: usize = 8;
    for _ in 0..TIMES {
        subtract_projection(&mut matrix, space);
        let (values, vectors) = decompose(matrix.as_ref())?;
        matrix = vectors;
        // Little was subtracted from vectors of unit norm, so little of it is left.
        if values[values.len() - 1] > 0.5 && values[0] < 1.5 {
            return Ok(Some(matrix));
        }
    }
    Ok(None)
}

/// The squared norm of each sample after the components are subtracted.
fn unexplained(rows: ArrayView2<'_, f64>, coefficients: ArrayView2<'_, f64>, vectors: &Mat<f64>) -> Vec<f64> {
    let left = |(rows, coefficients): (ArrayView2<'_, f64>, ArrayView2<'_, f64>)| -> Vec<f64> {
        let mut left = columns_of(rows).to_owned();
        let coefficients = columns_of(coefficients);
        matmul(
            left.as_mut(),
            Accum::Add,
            vectors.as_ref(),
            coefficients,
            -1.0,
            Par::Seq,
        );
        left.col_iter().map(|column| column.squared_norm_l2()).collect()
    };
    let rows: Vec<_> = rows.axis_chunks_iter(Axis(0), ROWS).collect();
    let coefficients = coefficients.axis_chunks_iter(Axis(0), ROWS);
    let blocks: Vec<_> = rows.into_iter().zip(coefficients).collect();
    blocks.into_par_iter().flat_map_iter(left).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The values of a flat spectrum do not converge in a small space. Neither they nor a single
    /// strong value are taken for exact too early, and the limits of the rest hold.
    #[test]
    fn what_has_not_converged_is_not_returned_and_the_rest_is_within_its_limits() {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let mut rows = Array2::from_shape_simple_fn((1024, 1100), || StandardNormal.sample(&mut random));
        for (one_strong, exact) in [(false, 0), (true, 1)] {
            if one_strong {
                rows.row_mut(3).mapv_inplace(|v: f64| 100.0 * v);
            }
            let all = Components::all(rows.view()).unwrap();
            let mut space = Krylov::new(rows.view());
            let found = space.enlarged().unwrap().unwrap();
            assert_eq!(found.values.len(), exact);
            let rest = found.rest;
            let left = &all.values[exact..];
            assert_eq!(rest.count, left.len());
            assert!(rest.largest >= left[0] && rest.largest < 1.1 * left[0]);
            let energy: f64 = left.iter().map(|v| v * v).sum();
            assert!((rest.energy / energy - 1.0).abs() < 1e-12);
            let sum: f64 = left.iter().sum();
            assert!(rest.sum_limits[0] <= sum && sum <= rest.sum_limits[1]);
            assert!((rest.sum / sum - 1.0).abs() < 0.03, "{} against {sum}", rest.sum);
            for (a, b) in found.unexplained.iter().zip(all.left_after(exact)) {
                assert!((a / b - 1.0).abs() < 1e-9);
            }
            // The size after the next is beyond the limit.
            assert!(space.enlarged().unwrap().is_some() && space.enlarged().unwrap().is_none());
        }
    }
}
