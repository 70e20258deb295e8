//! The singular value decomposition for fits and noise estimates, orthonormal bases made from any
//! stamps, and the crate's errors.

use faer::diag::Diag;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltRegularization, cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::matmul::matmul;
use faer::linalg::svd::{ComputeSvdVectors, SvdParams, svd, svd_scratch};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, Mat, MatRef, Par, Spec};
use ndarray::{Array2, Array3, ArrayView2, Axis, CowArray, Ix2};
use psf_types::{DataError, PsfBasis, StampGrid};
use rayon::iter::{IndexedParallelIterator as _, ParallelIterator as _};
use thiserror::Error;

/// Errors of basis methods and rank selection.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum BasisError {
    /// There is not enough memory for the singular value decomposition.
    #[error("not enough memory: the singular value decomposition needs {bytes} bytes more")]
    Memory {
        /// The bytes that could not be allocated.
        bytes: usize,
    },
    /// The singular value decomposition did not converge.
    #[error("the singular value decomposition of a matrix of {samples} x {pixels} values did not converge")]
    NoConvergence {
        /// Rows of the matrix. In a fit: number of training stamps.
        samples: usize,
        /// Columns of the matrix. In a fit: pixels per stamp.
        pixels: usize,
    },
    /// The requested rank exceeds the number of components.
    #[error("rank {asked} was asked for, but these samples span only {available} components")]
    RankTooHigh {
        /// The requested rank.
        asked: usize,
        /// The number of components above rounding.
        available: usize,
    },
    /// Without a mean stamp at least one component is needed.
    #[error("the rank is 0, but there is no mean stamp: use mean centring or at least one component")]
    RankZero,
    /// A noise level that is not a finite number of at least 0.
    #[error("the pixel noise must be finite and at least 0, got {got}")]
    BadNoise {
        /// The given value.
        got: f64,
    },
    /// Training stamps whose shape differs from the shape of the samples.
    #[error("training stamps have the shape {got:?} [y, x], but the samples have {expected:?}")]
    TrainingShape {
        /// Shape of the samples' stamps.
        expected: (usize, usize),
        /// Shape of the training stamps.
        got: (usize, usize),
    },
    /// A weight that is not finite and at least 0, or a sample whose weights are all 0.
    #[error("the weights of sample {sample} (0-based) must be finite, at least 0, and not all 0, got {got}")]
    BadWeight {
        /// Index of the sample.
        sample: usize,
        /// The weight, or the sum of all weights.
        got: f64,
    },
    /// Weights whose shape differs from the shape of the samples.
    #[error("weights have the shape {got:?} [sample, y, x], but the samples have {expected:?}")]
    WeightShape {
        /// Shape of the samples.
        expected: (usize, usize, usize),
        /// Shape of the weights.
        got: (usize, usize, usize),
    },
    /// Given stamps that are not orthogonal, or parts that do not match each other.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A given stamp that is zero everywhere.
    #[error("the given basis stamp {index} (0-based) is zero everywhere")]
    ZeroStamp {
        /// Its index.
        index: usize,
    },
    /// An error of a basis method in another crate.
    #[error("the basis method failed")]
    External(#[source] Box<dyn std::error::Error + Send + Sync>),
}

/// faer splits its work by this number, not by the number of threads. So the result does not depend
/// on the number of threads.
const SPLIT: usize = 8;

/// Rows of a matrix that are processed at a time.
pub(crate) const ROWS: usize = 256;

/// Below this work (samples x pixels x the smaller of the two), splitting costs more than it saves.
/// If other work occupies the threads, splitting costs many times more.
const MIN_WORK_TO_SPLIT: usize = 1 << 22;

/// Singular values below this multiple of `f64::EPSILON` times the samples' Frobenius norm count as
/// zero.
pub(crate) const ROUNDING_UNITS: f64 = 16.0;

/// Allowed relative difference between the sum of the squared singular values and the sum of the
/// samples' squared pixels. Both are equal except for rounding.
const SQUARES_AGREE: f64 = 1e-10;

/// Singular values, and singular vectors `[pixel, k]`.
type Decomposition = (Vec<f64>, Mat<f64>);

/// Returns samples `[sample, pixel]` in row-major order as a matrix `[pixel, sample]`.
pub(crate) fn columns_of(rows: ArrayView2<'_, f64>) -> MatRef<'_, f64> {
    let (samples, pixels) = rows.dim();
    let values = rows.to_slice().expect("row-major");
    MatRef::from_column_major_slice(values, pixels, samples)
}

/// Computes the singular value decomposition of a matrix `[pixel, sample]`. Returns the singular
/// values in descending order and the singular vectors `[pixel, k]`.
///
/// For some matrices with repeated rows, faer loses singular values without an error. The sum of
/// the squared singular values is then too small. In this case, or without convergence, the
/// decomposition is repeated after a QR decomposition, and if that also fails, without divide and
/// conquer.
pub(crate) fn decompose(matrix: MatRef<'_, f64>) -> Result<Decomposition, BasisError> {
    let usual: SvdParams = *Spec::<SvdParams, f64>::default();
    let qr_first = SvdParams {
        qr_ratio_threshold: 0.0,
        ..usual
    };
    let undivided = SvdParams {
        recursion_threshold: usize::MAX,
        ..qr_first
    };
    // A pairwise sum. In a plain sum of millions of squares, small ones round to nothing.
    let whole = matrix.squared_norm_l2();
    for params in [usual, qr_first, undivided] {
        let Some((values, vectors)) = decompose_by(matrix, params)? else {
            continue;
        };
        let held: f64 = values.iter().map(|s| s * s).sum();
        if (held - whole).abs() <= SQUARES_AGREE * whole {
            return Ok(descending(values, vectors));
        }
    }
    Err(BasisError::NoConvergence {
        samples: matrix.ncols(),
        pixels: matrix.nrows(),
    })
}

/// Computes the decomposition with these parameters of faer. Returns `None` if it does not
/// converge.
fn decompose_by(matrix: MatRef<'_, f64>, params: SvdParams) -> Result<Option<Decomposition>, BasisError> {
    let (pixels, samples) = matrix.shape();
    let size = samples.min(pixels);
    let work = samples.saturating_mul(pixels).saturating_mul(size);
    let par = if work < MIN_WORK_TO_SPLIT {
        Par::Seq
    } else {
        Par::rayon(SPLIT)
    };
    let scratch = svd_scratch::<f64>(
        pixels,
        samples,
        ComputeSvdVectors::Thin,
        ComputeSvdVectors::No,
        par,
        params.into(),
    );
    let bytes = scratch.unaligned_bytes_required();
    let mut memory = MemBuffer::try_new(scratch).map_err(|_| BasisError::Memory { bytes })?;
    let mut values = Diag::<f64>::zeros(size);
    let mut vectors = Mat::<f64>::zeros(pixels, size);
    let converged = svd(
        matrix,
        values.as_mut(),
        Some(vectors.as_mut()),
        None,
        par,
        MemStack::new(&mut memory),
        params.into(),
    )
    .is_ok();
    Ok(converged.then(|| (values.column_vector().iter().copied().collect(), vectors)))
}

/// Sorts the values in descending order, and the vectors with them. faer promises that order but
/// breaks it if samples repeat: the second singular value may follow hundreds of zeros.
fn descending(values: Vec<f64>, vectors: Mat<f64>) -> (Vec<f64>, Mat<f64>) {
    if values.is_sorted_by(|a, b| a >= b) {
        return (values, vectors);
    }
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[b].total_cmp(&values[a]));
    let sorted = Mat::from_fn(vectors.nrows(), order.len(), |u, k| vectors[(u, order[k])]);
    (order.iter().map(|&k| values[k]).collect(), sorted)
}

/// The product of two matrices. Each thread computes some of its rows at a time. faer's own
/// splitting is slower for narrow matrices, many times so if other work occupies the threads.
pub(crate) fn product(left: MatRef<'_, f64>, right: MatRef<'_, f64>) -> Mat<f64> {
    let mut product = Mat::zeros(left.nrows(), right.ncols());
    let parts = product.par_row_chunks_mut(ROWS).zip(left.par_row_chunks(ROWS));
    parts.for_each(|(into, left)| matmul(into, Accum::Replace, left, right, 1.0, Par::Seq));
    product
}

/// Subtracts from the columns of a matrix their projection on a space of orthonormal vectors.
pub(crate) fn subtract_projection(matrix: &mut Mat<f64>, space: MatRef<'_, f64>) {
    *matrix -= product(space, product(space.transpose(), matrix.as_ref()).as_ref());
}

/// The first `count` columns of a matrix `[pixel, k]`, as `[k, pixel]`.
pub(crate) fn rows_of_columns(matrix: MatRef<'_, f64>, count: usize) -> Array2<f64> {
    Array2::from_shape_fn((count, matrix.nrows()), |(k, u)| matrix[(u, k)])
}

/// The coefficients `[sample, k]` of samples `[sample, pixel]`.
pub(crate) fn project(rows: ArrayView2<'_, f64>, vectors: MatRef<'_, f64>) -> Array2<f64> {
    let coefficients = product(columns_of(rows).transpose(), vectors);
    Array2::from_shape_fn((rows.nrows(), vectors.ncols()), |(j, k)| coefficients[(j, k)])
}

/// Counts the values above a level in a descending list.
pub(crate) fn count_above(values: &[f64], level: f64) -> usize {
    values.iter().take_while(|&&s| s > level).count()
}

/// Makes the value of largest magnitude in each component positive.
pub(crate) fn fix_signs(components: &mut Array2<f64>, coefficients: &mut Array2<f64>) {
    for (mut component, mut column) in components
        .outer_iter_mut()
        .zip(coefficients.axis_iter_mut(Axis(1)))
    {
        let peak = component
            .iter()
            .copied()
            .fold(0.0f64, |m, v| if v.abs() > m.abs() { v } else { m });
        if peak < 0.0 {
            component.mapv_inplace(|v| -v);
            column.mapv_inplace(|v| -v);
        }
    }
}

/// Converts the PSFs `mean + sum_k a_jk C_k` of any stamps `C` `[stamp, y, x]`, with coefficients
/// `a` `[node, stamp]`, to an orthonormal basis. There is one PSF for each node, such as a sample.
/// Returns the basis and the coefficients `[node, component]` in it.
///
/// The components are the singular vectors of the sums at the nodes, in descending order of their
/// singular values. They are found without forming the sums. Components whose singular values
/// are rounding errors are omitted. Use this function after a linear operation on the stamps of a basis, such
/// as resampling.
///
/// ```
/// use ndarray::{Array3, array};
/// use psf_types::StampGrid;
/// let stamps = Array3::from_shape_vec((2, 1, 2), vec![3.0, 0.0, 1.0, 1.0])?;
/// let (basis, coefficients) = psf_basis::orthonormal(None, stamps, array![[1.0, 2.0]].view(), StampGrid::new(2, 1)?)?;
/// // 1 (3, 0) + 2 (1, 1) = (5, 2)
/// assert_eq!(basis.rank(), 1);
/// assert!((coefficients[[0, 0]] * basis.components()[[0, 0, 0]] - 5.0).abs() < 1e-14);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`BasisError::Data`] when the parts do not match each other, the mean is not finite, or neither
/// a mean nor components remain. [`BasisError::NoConvergence`] when the decomposition fails, for
/// example for stamps that are not finite. [`BasisError::Memory`] when memory is too small for it.
pub fn orthonormal(
    mean: Option<Array2<f64>>,
    stamps: Array3<f64>,
    coefficients: ArrayView2<'_, f64>,
    grid: StampGrid,
) -> Result<(PsfBasis, Array2<f64>), BasisError> {
    let (count, ny, nx) = stamps.dim();
    let nodes = coefficients.nrows();
    DataError::check_count("coefficients, one for each stamp", count, coefficients.ncols())?;
    if count == 0 || nodes == 0 {
        let basis = PsfBasis::new(mean, Array3::zeros((0, ny, nx)), grid)?;
        return Ok((basis, Array2::zeros((nodes, 0))));
    }
    let stamps = flat(&stamps);
    // a = U S V^T: the sums at the nodes have the singular vectors of S V^T C.
    let (shares, turned) = decompose(columns_of(coefficients.as_standard_layout().view()))?;
    let weights = Array2::from_shape_fn((shares.len(), count), |(i, k)| shares[i] * turned[(k, i)]);
    let weighted = weights.dot(&stamps);
    let (values, vectors) = decompose(columns_of(weighted.as_standard_layout().view()))?;
    let of_mean = mean
        .as_ref()
        .map_or(0.0, |m| nodes as f64 * m.iter().map(|v| v * v).sum::<f64>());
    let whole = (of_mean + values.iter().map(|s| s * s).sum::<f64>()).sqrt();
    let rounding = ROUNDING_UNITS * f64::EPSILON * whole;
    let rank = count_above(&values, rounding);
    let mut components = rows_of_columns(vectors.as_ref(), rank);
    let mut coefficients = coefficients.dot(&stamps.dot(&components.t()));
    fix_signs(&mut components, &mut coefficients);
    Ok((
        PsfBasis::new(mean, stamps_of(components, grid), grid)?,
        coefficients,
    ))
}

/// Rows `[stamp, pixel]` as stamps `[stamp, y, x]`.
pub(crate) fn stamps_of(rows: Array2<f64>, grid: StampGrid) -> Array3<f64> {
    let shape = (rows.nrows(), grid.ny(), grid.nx());
    rows.into_shape_with_order(shape).expect("row-major")
}

/// Stamps `[stamp, pixel]`, copied only if they are not in row-major order.
fn flat(stamps: &Array3<f64>) -> CowArray<'_, f64, Ix2> {
    let (count, ny, nx) = stamps.dim();
    stamps.to_shape((count, ny * nx)).expect("as many values")
}

/// Stamps count as dependent if the part of one at right angles to those before it is below this fraction
/// of it.
const DEPENDENT: f64 = 1e-5;

/// Converts PSFs to an orthonormal basis as [`orthonormal`] does, but faster, for stamps that are nearly
/// orthogonal, such as a basis after a small change. All components are kept, in their order, whatever
/// the coefficients are.
///
/// The first component is the first stamp scaled to norm 1, the next is the part of the second stamp at
/// right angles to it, and so on (two Cholesky decompositions of the stamps' scalar products: Yamamoto
/// et al. 2015, ETNA 44, 306). For stamps that are nearly dependent, the result is that of
/// [`orthonormal`].
///
/// ```
/// use ndarray::{Array3, array};
/// use psf_types::StampGrid;
/// let stamps = Array3::from_shape_vec((2, 1, 2), vec![3.0, 0.0, 1.0, 1.0])?;
/// let grid = StampGrid::new(2, 1)?;
/// let (basis, coefficients) = psf_basis::orthonormal_in_order(None, stamps, array![[1.0, 2.0]].view(), grid)?;
/// // 1 (3, 0) + 2 (1, 1) = (5, 2)
/// assert!((coefficients[[0, 0]] - 5.0).abs() < 1e-14 && (coefficients[[0, 1]] - 2.0).abs() < 1e-14);
/// assert!((basis.components()[[1, 0, 1]] - 1.0).abs() < 1e-14);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// The errors of [`orthonormal`].
pub fn orthonormal_in_order(
    mean: Option<Array2<f64>>,
    stamps: Array3<f64>,
    coefficients: ArrayView2<'_, f64>,
    grid: StampGrid,
) -> Result<(PsfBasis, Array2<f64>), BasisError> {
    let (count, ny, nx) = stamps.dim();
    DataError::check_count("coefficients, one for each stamp", count, coefficients.ncols())?;
    // `[pixel, stamp]`.
    let mut components = columns_of(flat(&stamps).view()).to_owned();
    let mut turned = coefficients.to_owned();
    for _ in 0..2 {
        let Some(lower) = triangle_of(components.as_ref()) else {
            return orthonormal(mean, stamps, coefficients, grid);
        };
        let chunks = components.par_row_chunks_mut(ROWS);
        chunks
            .for_each(|rows| solve_lower_triangular_in_place(lower.as_ref(), rows.transpose_mut(), Par::Seq));
        turned = turned.dot(&Array2::from_shape_fn((count, count), |(i, k)| lower[(i, k)]));
    }
    let components = Array3::from_shape_fn((count, ny, nx), |(k, y, x)| components[(y * nx + x, k)]);
    Ok((PsfBasis::new(mean, components, grid)?, turned))
}

/// The lower triangular matrix `L` with `L L^T = M^T M`. None if columns of the matrix `M` are nearly
/// dependent or not finite.
fn triangle_of(matrix: MatRef<'_, f64>) -> Option<Mat<f64>> {
    let count = matrix.ncols();
    let mut lower = Mat::zeros(count, count);
    matmul(
        lower.as_mut(),
        Accum::Replace,
        matrix.transpose(),
        matrix,
        1.0,
        Par::rayon(SPLIT),
    );
    let sizes: Vec<f64> = (0..count).map(|k| lower[(k, k)].sqrt()).collect();
    let mut memory = MemBuffer::new(cholesky_in_place_scratch::<f64>(count, Par::Seq, Spec::default()));
    let stack = MemStack::new(&mut memory);
    let regularization = LltRegularization::default();
    cholesky_in_place(lower.as_mut(), regularization, Par::Seq, stack, Spec::default()).ok()?;
    for k in 1..count {
        lower.col_mut(k).subrows_mut(0, k).fill(0.0);
    }
    let is_new = |(k, size)| lower[(k, k)].is_finite() && lower[(k, k)] > DEPENDENT * size;
    sizes.into_iter().enumerate().all(is_new).then_some(lower)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of sums of a few values of order 1.
    const ROUNDING: f64 = 1e-13;

    #[test]
    fn the_sums_are_kept_and_vanishing_components_are_omitted() {
        let grid = StampGrid::new(6, 5).unwrap();
        let value = |a: usize, b: usize| ((a * 31 + b * 17) as f64 * 0.7).sin();
        let mut stamps = Array3::from_shape_fn((4, 5, 6), |(k, y, x)| value(k + 1, 6 * y + x));
        // One stamp without light, and one that is the sum of two others.
        stamps.index_axis_mut(ndarray::Axis(0), 1).fill(0.0);
        let sum = &stamps.index_axis(ndarray::Axis(0), 0) + &stamps.index_axis(ndarray::Axis(0), 2);
        stamps.index_axis_mut(ndarray::Axis(0), 3).assign(&sum);
        let mean = Array2::from_shape_fn((5, 6), |(y, x)| value(9, 6 * y + x));
        for nodes in [1, 3, 50] {
            let a = Array2::from_shape_fn((nodes, 4), |(j, k)| value(j + 3, k + 40));
            let expected = a.dot(&stamps.to_shape((4, 30)).unwrap());
            let (basis, b) = orthonormal(Some(mean.clone()), stamps.clone(), a.view(), grid).unwrap();
            assert_eq!(basis.rank(), nodes.min(2));
            assert_eq!(basis.mean().unwrap(), mean);
            let flat = basis
                .components()
                .into_shape_with_order((basis.rank(), 30))
                .unwrap();
            for ((i, j), product) in flat.dot(&flat.t()).indexed_iter() {
                assert!((product - f64::from(u8::from(i == j))).abs() < ROUNDING);
            }
            for (got, wanted) in b.dot(&flat).iter().zip(&expected) {
                assert!((got - wanted).abs() < ROUNDING, "{nodes}: {got} against {wanted}");
            }
        }
    }

    #[test]
    fn a_changed_basis_keeps_its_order_and_its_sums() {
        let grid = StampGrid::new(6, 5).unwrap();
        let value = |a: usize, b: usize| ((a * 31 + b * 17) as f64 * 0.7).sin();
        let stamps = Array3::from_shape_fn((4, 5, 6), |(k, y, x)| {
            value(k + 1, 6 * y + x) * 0.1 + f64::from(u8::from(6 * y + x == 7 * k))
        });
        let a = Array2::from_shape_fn((9, 4), |(j, k)| value(j + 3, k + 40));
        let mut dependent = stamps.clone();
        let first = &stamps.index_axis(Axis(0), 0) * 2.0;
        dependent.index_axis_mut(Axis(0), 3).assign(&first);
        for (stamps, rank) in [(stamps, 4), (dependent, 3)] {
            let expected = a.dot(&stamps.to_shape((4, 30)).unwrap());
            let (basis, b) = orthonormal_in_order(None, stamps.clone(), a.view(), grid).unwrap();
            assert_eq!(basis.rank(), rank);
            let flat = basis.components().into_shape_with_order((rank, 30)).unwrap();
            for (got, wanted) in b.dot(&flat).iter().zip(&expected) {
                assert!((got - wanted).abs() < ROUNDING, "{got} against {wanted}");
            }
            // The first component is the first stamp.
            let along = (&basis.components().index_axis(Axis(0), 0) * &stamps.index_axis(Axis(0), 0)).sum();
            let norm = stamps
                .index_axis(Axis(0), 0)
                .iter()
                .map(|v| v * v)
                .sum::<f64>()
                .sqrt();
            assert!(rank == 3 || (along / norm - 1.0).abs() < ROUNDING);
        }
        let none = orthonormal_in_order(
            None,
            Array3::from_elem((1, 5, 6), f64::NAN),
            Array2::ones((1, 1)).view(),
            grid,
        );
        assert!(none.is_err());
    }

    #[test]
    fn zeros_give_no_basis_and_shapes_must_match() {
        let grid = StampGrid::new(3, 2).unwrap();
        let zeros = Array3::zeros((2, 2, 3));
        let a = Array2::ones((4, 2));
        let (basis, b) = orthonormal(Some(Array2::ones((2, 3))), zeros.clone(), a.view(), grid).unwrap();
        assert_eq!((basis.rank(), b.dim()), (0, (4, 0)));
        assert!(matches!(
            orthonormal(None, zeros.clone(), a.view(), grid),
            Err(BasisError::Data(DataError::EmptyBasis))
        ));
        assert!(matches!(
            orthonormal(None, zeros, Array2::ones((4, 3)).view(), grid),
            Err(BasisError::Data(DataError::CountMismatch { .. }))
        ));
    }

    /// A peak and a wide faint halo: each square of the halo is below the rounding of the peak's, but
    /// together they are 4e-10 of the sum, more than [`SQUARES_AGREE`].
    #[test]
    fn wide_faint_halos_are_decomposed() {
        const PIXELS: usize = 1 << 22;
        let rows = Array2::from_shape_fn((2, PIXELS), |(j, u)| match (j, u) {
            (0, 0) => 1.0,
            _ => 1e-8 * if j == 1 && u % 2 == 0 { -1.0 } else { 1.0 },
        });
        let (values, _) = decompose(columns_of(rows.view())).unwrap();
        let halo = 1e-8 * (PIXELS as f64).sqrt();
        assert!((values[1] / halo - 1.0).abs() < 1e-6, "{values:?}");
    }

    /// `decompose` accepts a result if the squares of its values add up. This test shows that its
    /// vectors are then orthonormal and match its values.
    #[test]
    fn repeated_rows_have_few_singular_values() {
        for (rows, columns) in [
            (300, 289),
            (440, 289),
            (500, 289),
            (289, 289),
            (289, 440),
            (200, 289),
        ] {
            for distinct in [1, 2, 3, 5, 9] {
                let matrix = Array2::from_shape_fn((rows, columns), |(j, u)| {
                    let width = 4.0 + 0.6 * (j % distinct) as f64;
                    (-((u as f64 - 140.0) / width).powi(2)).exp() / width
                });
                let (values, vectors) = decompose(columns_of(matrix.view())).unwrap();
                let top = values[0];
                assert!(values.is_sorted_by(|a, b| a >= b));
                assert!(values[distinct..].iter().all(|s| *s < 1e-13 * top));
                let gram = vectors.transpose() * &vectors;
                let image = project(matrix.view(), vectors.as_ref());
                for (k, column) in image.axis_iter(Axis(1)).enumerate() {
                    let norm = column.dot(&column).sqrt();
                    assert!(
                        (norm - values[k]).abs() < 1e-12 * top,
                        "{rows}, {columns}, {distinct}: {k}"
                    );
                    for i in 0..values.len() {
                        let off = gram[(i, k)] - f64::from(u8::from(i == k));
                        assert!(off.abs() < 1e-12, "{rows}, {columns}, {distinct}: {i}, {k}");
                    }
                }
            }
        }
    }
}
