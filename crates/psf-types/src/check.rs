//! Checks that several constructors share.

use ndarray::{Array, ArrayView2, ArrayView3, Dimension};

pub(crate) use crate::error::Quantity;
use crate::{DataError, Real, StampGrid};

pub(crate) fn stamp_shape(got: (usize, usize), grid: StampGrid) -> Result<(), DataError> {
    if got == grid.dim() {
        Ok(())
    } else {
        Err(DataError::StampShape {
            expected: grid.dim(),
            got,
        })
    }
}

/// Values that are looked at between two questions whether one of them is not finite: enough that the loop over them has no way out
/// and fills vectors, few enough that they stay in the first cache.
const AT_ONCE: usize = 1024;

/// Whether all values are finite, at the speed of memory.
fn all_finite<T: Real>(values: &[T]) -> bool {
    values
        .chunks(AT_ONCE)
        .all(|some| some.iter().fold(true, |finite, v| finite & v.is_finite()))
}

pub(crate) fn finite2<T: Real>(quantity: Quantity, values: ArrayView2<'_, T>) -> Result<(), DataError> {
    // Without indices this is as fast as memory; nearly always it is enough.
    let finite = match values.as_slice() {
        Some(values) => all_finite(values),
        None => values
            .outer_iter()
            .all(|row| row.to_slice().is_some_and(all_finite)),
    };
    if finite {
        return Ok(());
    }
    match values.indexed_iter().find(|(_, v)| !v.is_finite()) {
        None => Ok(()),
        Some(((i, j), v)) => Err(DataError::NonFinite {
            quantity,
            index: vec![i, j],
            value: v.as_f64(),
        }),
    }
}

pub(crate) fn finite3(quantity: Quantity, values: ArrayView3<'_, f64>) -> Result<(), DataError> {
    match values.indexed_iter().find(|(_, v)| !v.is_finite()) {
        None => Ok(()),
        Some(((i, j, k), &value)) => Err(DataError::NonFinite {
            quantity,
            index: vec![i, j, k],
            value,
        }),
    }
}

/// Row-major without a copy where the array already is.
pub(crate) fn row_major<T: Clone, D: Dimension>(array: Array<T, D>) -> Array<T, D> {
    if array.is_standard_layout() {
        array
    } else {
        array.as_standard_layout().into_owned()
    }
}
