//! A basis of any stamps.

use ndarray::{Array2, Array3, ArrayView2};
use psf_types::{DataError, PsfBasis, StampGrid};

use crate::BasisError;
use crate::svd::{ROUNDING_UNITS, decompose, fix_signs};

/// The PSFs `mean + sum_k a_jk C_k` of any stamps `C` `[stamp, y, x]`, with coefficients `a` `[node, stamp]`, on an orthonormal basis: the
/// basis and the coefficients `[node, component]` in it.
///
/// The components are the singular vectors of the sums at the nodes, in the order of their share in them, found without making the
/// sums; those that are rounding of the whole are left out. For stamps that were a basis until something linear was done to them.
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
/// [`BasisError::Data`] when the parts do not fit each other, are not finite or nothing is left of them;
/// [`BasisError::NoConvergence`].
pub fn orthonormal(
    mean: Option<Array2<f64>>,
    stamps: Array3<f64>,
    coefficients: ArrayView2<'_, f64>,
    grid: StampGrid,
) -> Result<(PsfBasis, Array2<f64>), BasisError> {
    let (count, ny, nx) = stamps.dim();
    let nodes = coefficients.nrows();
    if coefficients.ncols() != count {
        return Err(DataError::CountMismatch {
            what: "coefficients, one for each stamp",
            expected: count,
            got: coefficients.ncols(),
        }
        .into());
    }
    if count == 0 || nodes == 0 {
        let basis = PsfBasis::new(mean, Array3::zeros((0, ny, nx)), grid)?;
        return Ok((basis, Array2::zeros((nodes, 0))));
    }
    let stamps = stamps
        .as_standard_layout()
        .into_owned()
        .into_shape_with_order((count, ny * nx))
        .expect("row-major");
    // a = U S V^T: the sums at the nodes have the singular vectors of S V^T C.
    let (shares, turned) = decompose(coefficients.as_standard_layout().view())?;
    let weights = Array2::from_shape_fn((shares.len(), count), |(i, k)| shares[i] * turned[(k, i)]);
    let weighted = weights.dot(&stamps);
    let (values, vectors) = decompose(weighted.as_standard_layout().view())?;
    let of_mean = mean
        .as_ref()
        .map_or(0.0, |m| nodes as f64 * m.iter().map(|v| v * v).sum::<f64>());
    let whole = (of_mean + values.iter().map(|s| s * s).sum::<f64>()).sqrt();
    let rounding = ROUNDING_UNITS * f64::EPSILON * whole;
    let rank = values.iter().take_while(|&&s| s > rounding).count();
    let mut components = Array2::from_shape_fn((rank, ny * nx), |(k, u)| vectors[(u, k)]);
    let mut coefficients = coefficients.dot(&stamps.dot(&components.t()));
    fix_signs(&mut components, &mut coefficients);
    let components = components
        .into_shape_with_order((rank, ny, nx))
        .expect("row-major");
    Ok((PsfBasis::new(mean, components, grid)?, coefficients))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sums of a few values of order 1.
    const ROUNDING: f64 = 1e-13;

    #[test]
    fn the_sums_stay_and_what_vanishes_is_dropped() {
        let grid = StampGrid::new(6, 5).unwrap();
        let value = |a: usize, b: usize| ((a * 31 + b * 17) as f64 * 0.7).sin();
        let mut stamps = Array3::from_shape_fn((4, 5, 6), |(k, y, x)| value(k + 1, 6 * y + x));
        // One without light, and one that is the sum of two others.
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
    fn nothing_is_no_basis_and_parts_must_fit() {
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
}
