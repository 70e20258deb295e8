//! A PSF that a Python function draws.

use std::sync::{Mutex, PoisonError};

use ndarray::ArrayViewMut2;
use numpy::PyReadonlyArray2;
use psfield::psf_types::{FrameShape, Position, Progress, PsfSource, SourceError, StampGrid};
use pyo3::prelude::*;

use crate::interruptible::Watch;

/// `f(x, y)` gives the stamp `[y, x]` of the PSF at a position, in doubles. It is never called twice at a time.
pub(crate) struct FunctionSource<'a> {
    pub(crate) function: &'a Py<PyAny>,
    pub(crate) grid: StampGrid,
    pub(crate) field: FrameShape,
    pub(crate) watch: &'a Watch,
    /// Held while the function runs. It is taken without the interpreter, lest one thread waits for it while it keeps the interpreter from
    /// another.
    turn: Mutex<()>,
}

impl<'a> FunctionSource<'a> {
    pub(crate) fn new(function: &'a Py<PyAny>, grid: StampGrid, field: FrameShape, watch: &'a Watch) -> Self {
        Self {
            function,
            grid,
            field,
            watch,
            turn: Mutex::new(()),
        }
    }
}

impl PsfSource for FunctionSource<'_> {
    fn grid(&self) -> StampGrid {
        self.grid
    }

    fn field(&self) -> FrameShape {
        self.field
    }

    fn draw_into(&self, position: Position, mut stamp: ArrayViewMut2<'_, f64>) -> Result<(), SourceError> {
        let failed =
            |source: Box<dyn std::error::Error + Send + Sync>| SourceError::External { position, source };
        let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        if self.watch.cancelled() {
            return Err(failed("sampling was stopped".into()));
        }
        Python::attach(|py| {
            let drawn = self
                .function
                .call1(py, (position.x(), position.y()))
                .map_err(|e| failed(e.into()))?;
            let drawn: PyReadonlyArray2<'_, f64> = drawn.extract(py).map_err(|e: PyErr| failed(e.into()))?;
            let values = drawn.as_array();
            if values.dim() != stamp.dim() {
                let (got, expected) = (values.dim(), stamp.dim());
                return Err(failed(
                    format!("its stamp has the shape {got:?}, others have {expected:?}").into(),
                ));
            }
            stamp.assign(&values);
            Ok(())
        })
    }
}
