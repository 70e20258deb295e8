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

pub(crate) fn finite2<T: Real>(quantity: Quantity, values: ArrayView2<'_, T>) -> Result<(), DataError> {
    // Without indices this is as fast as memory; nearly always it is enough.
    if values
        .as_slice()
        .is_some_and(|values| values.iter().all(|v| v.is_finite()))
    {
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
