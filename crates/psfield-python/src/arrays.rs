//! Arrays of NumPy, borrowed.

use ndarray::{Dimension, Ix2};
use numpy::{Element, PyArray, PyArrayMethods, PyReadonlyArray, PyReadwriteArray};
use pyo3::prelude::*;

use crate::error::invalid;
use crate::simulators::Images;

/// The images of a scene, borrowed from NumPy.
pub(crate) struct Borrowed<'py, T: Element>(Vec<(Option<String>, PyReadonlyArray<'py, T, Ix2>)>);

impl<'py, T: Element> Borrowed<'py, T> {
    pub(crate) fn new(images: &[(Option<String>, Bound<'py, PyAny>)]) -> PyResult<Self> {
        let borrowed =
            |(spectrum, image): &(Option<String>, _)| Ok((spectrum.clone(), readonly(image, "scene")?));
        images.iter().map(borrowed).collect::<PyResult<_>>().map(Self)
    }

    pub(crate) fn views(&self) -> Images<'_, T> {
        let views = self
            .0
            .iter()
            .map(|(spectrum, image)| (spectrum.clone(), image.as_array()));
        views.collect()
    }
}

/// Borrows a NumPy array for reading. The Python code has already converted the array to the plan's
/// precision.
pub(crate) fn readonly<'py, T: Element, D: Dimension>(
    array: &Bound<'py, PyAny>,
    name: &str,
) -> PyResult<PyReadonlyArray<'py, T, D>> {
    let array = array.cast::<PyArray<T, D>>()?;
    array.try_readonly().map_err(|_| {
        invalid(format!(
            "{name}: another call is writing its image to this array: wait until it returns"
        ))
    })
}

/// Borrows a NumPy array for writing.
pub(crate) fn writable<'py, T: Element, D: Dimension>(
    array: &Bound<'py, PyAny>,
) -> PyResult<PyReadwriteArray<'py, T, D>> {
    let array = array.cast::<PyArray<T, D>>()?;
    array
        .try_readwrite()
        .map_err(|_| invalid("out: another call reads or writes this array: give each call its own array"))
}
