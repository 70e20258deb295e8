//! Coefficients of the samples.

use ndarray::{Array2, ArrayView2};
use serde::{Deserialize, Serialize};

use crate::check::{self, Quantity};
use crate::{DataError, SamplePositions};

/// The coefficients `a_k` of every sample, `[sample, component]`, with the samples' positions; every value is finite.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawSampleCoefficients", into = "RawSampleCoefficients")]
pub struct SampleCoefficients {
    values: Array2<f64>,
    positions: SamplePositions,
}

#[derive(Serialize, Deserialize)]
struct RawSampleCoefficients {
    values: Array2<f64>,
    positions: SamplePositions,
}

impl SampleCoefficients {
    /// Coefficients `[sample, component]` at positions.
    ///
    /// # Errors
    /// [`DataError::CountMismatch`] or [`DataError::NonFinite`].
    pub fn new(values: Array2<f64>, positions: SamplePositions) -> Result<Self, DataError> {
        if values.nrows() != positions.len() {
            return Err(DataError::CountMismatch {
                what: "rows of coefficients, one for each sample",
                expected: positions.len(),
                got: values.nrows(),
            });
        }
        check::finite2(Quantity::Coefficient, values.view())?;
        Ok(Self {
            values: check::row_major(values),
            positions,
        })
    }

    /// The coefficients `[sample, component]`, row-major.
    pub fn values(&self) -> ArrayView2<'_, f64> {
        self.values.view()
    }

    /// Where the samples lie.
    pub fn positions(&self) -> &SamplePositions {
        &self.positions
    }

    /// The number of components.
    pub fn component_count(&self) -> usize {
        self.values.ncols()
    }
}

impl TryFrom<RawSampleCoefficients> for SampleCoefficients {
    type Error = DataError;
    fn try_from(raw: RawSampleCoefficients) -> Result<Self, DataError> {
        Self::new(raw.values, raw.positions)
    }
}

impl From<SampleCoefficients> for RawSampleCoefficients {
    fn from(c: SampleCoefficients) -> Self {
        Self {
            values: c.values,
            positions: c.positions,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Position;

    #[test]
    fn rows_and_values_are_checked() {
        let one = SamplePositions::new(vec![Position::of_pixel(0, 0)], None).unwrap();
        assert!(SampleCoefficients::new(Array2::zeros((1, 0)), one.clone()).is_ok());
        assert!(matches!(
            SampleCoefficients::new(Array2::zeros((2, 1)), one.clone()),
            Err(DataError::CountMismatch {
                expected: 1,
                got: 2,
                ..
            })
        ));
        assert!(matches!(
            SampleCoefficients::new(Array2::from_elem((1, 1), f64::NAN), one),
            Err(DataError::NonFinite { .. })
        ));
    }
}
