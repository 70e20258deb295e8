//! A table of a field whose coefficients take long to evaluate.

use std::convert::Infallible;

use ndarray::{Array2, ArrayView1, ArrayView2, ArrayViewMut2, Axis};
use psf_types::{
    BilinearCells, CoefficientField, ErrorLimit, FieldError, FieldTable, FrameShape, PixelRegion, Position,
    TableLimits, WeightedNodes,
};
use rayon::prelude::*;

use super::allowed_errors::CellError;
use super::checked_cells::{Measure, evaluate_each};

/// A table of a field in a region, and the limit of its errors.
///
/// Small patches with larger errors, and patches where the field lacks values, hold no polynomial: there
/// the field itself is evaluated.
#[derive(Debug)]
pub(crate) struct SmoothTable {
    table: FieldTable,
    /// The limit of errors with which the table was made.
    pub(crate) limit: CellError,
}

/// The number of patches along each axis that are checked at least.
const FEWEST: f64 = 8.0;
/// Undivided patches have at least this size in pixels.
const SMALLEST: f64 = 16.0;
/// The largest number of divisions. Along a kink, more of them would not make the field smoother.
const MOST_DIVISIONS: u32 = 3;
/// Values fill at most about this memory.
const MOST_BYTES: usize = 1 << 28;

impl SmoothTable {
    /// Tabulates a field. `scale` is that of [`psf_types::BilinearCells::Unknown`].
    pub(crate) fn new(
        field: &dyn CoefficientField,
        region: PixelRegion,
        (scale, measure): (f64, Measure<'_>),
    ) -> Self {
        let shape = region.shape();
        let counts = [shape.nx(), shape.ny()].map(|pixels| {
            let side = (pixels as f64 - 1.0).max(1.0);
            let wanted = (side / scale.max(1.0)).ceil().max(FEWEST);
            wanted.min((side / SMALLEST).ceil()) as usize
        });
        let limits = TableLimits {
            counts: counts.map(|count| count.min(FieldTable::MOST_PATCHES)),
            most_divisions: MOST_DIVISIONS,
            smallest: SMALLEST,
            most_values: MOST_BYTES / size_of::<f64>(),
        };
        let corners = [
            region.position(0, 0),
            region.position(shape.nx() - 1, shape.ny() - 1),
        ];
        let mut evaluate = |at: &[Position], values: ArrayViewMut2<'_, f64>| {
            evaluate_each(field, at, values);
            Ok::<(), Infallible>(())
        };
        let fits_at = |difference: ArrayView1<'_, f64>| {
            let difference = difference.as_slice().expect("row-major");
            (measure.of_size)(difference) <= 1.0 && (measure.of_all)(difference) <= 1.0
        };
        let mut fits = |differences: ArrayView2<'_, f64>| {
            let patches = differences
                .axis_chunks_iter(Axis(0), FieldTable::CHECKS)
                .into_par_iter();
            patches.map(|checks| checks.outer_iter().all(fits_at)).collect()
        };
        let width = field.component_count();
        let Ok(table) = FieldTable::new(corners, width, limits, &mut evaluate, &mut fits);
        Self {
            table,
            limit: measure.limit,
        }
    }
}

/// A field with its table, if there is one that is good enough.
#[derive(Debug)]
pub(crate) struct Tabulated<'a> {
    pub(crate) field: &'a dyn CoefficientField,
    pub(crate) table: Option<&'a SmoothTable>,
}

impl CoefficientField for Tabulated<'_> {
    fn component_count(&self) -> usize {
        self.field.component_count()
    }

    fn evaluate_into(&self, position: Position, coefficients: &mut [f64]) -> Result<(), FieldError> {
        match self.table {
            Some(table) if table.table.write(position, coefficients) => Ok(()),
            _ => self.field.evaluate_into(position, coefficients),
        }
    }

    fn evaluate_each_into(&self, positions: &[Position], mut values: ArrayViewMut2<'_, f64>) {
        let Some(table) = self.table else {
            return self.field.evaluate_each_into(positions, values);
        };
        let mut found = vec![0.0; self.component_count()];
        let mut others = Vec::new();
        for (i, (&position, mut row)) in positions.iter().zip(values.outer_iter_mut()).enumerate() {
            if table.table.write(position, &mut found) {
                row.assign(&ArrayView1::from(&found));
            } else {
                others.push(i);
            }
        }
        let at: Vec<Position> = others.iter().map(|&i| positions[i]).collect();
        let mut of_field = Array2::zeros((at.len(), found.len()));
        self.field.evaluate_each_into(&at, of_field.view_mut());
        for (&i, row) in others.iter().zip(of_field.outer_iter()) {
            values.row_mut(i).assign(&row);
        }
    }

    fn some_coefficients(&self, frame: Option<FrameShape>) -> Array2<f64> {
        self.field.some_coefficients(frame)
    }

    fn weighted_nodes(&self) -> Option<&dyn WeightedNodes> {
        self.field.weighted_nodes()
    }

    fn bilinear_cells(&self, region: PixelRegion, error: ErrorLimit<'_>) -> BilinearCells {
        self.field.bilinear_cells(region, error)
    }
}
