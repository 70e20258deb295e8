//! Orthonormal basis stamps, and the samples' coefficients in the basis.

use ndarray::{ArcArray, Array2, Array3, ArrayView2, ArrayView3, Axis, Ix3};
use serde::{Deserialize, Serialize};

use crate::frame::{DataError, Quantity, read_through_new};
use crate::image::row_major;
use crate::sample_positions::SamplePositions;
use crate::stamp::StampGrid;

/// Orthonormal stamps `B_k` `[component, y, x]`, and the mean stamp `B_0` if the basis is
/// mean-centred.
///
/// The PSF at position `x` and offset `u` is `h(u; x) = B_0(u) + sum_k a_k(x) B_k(u)`, before any
/// scaling to unit flux. The inner products of the components form the unit
/// matrix within [`PsfBasis::ORTHONORMALITY_TOLERANCE`]. Every value is finite.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawPsfBasis")]
pub struct PsfBasis {
    mean: Option<Array2<f64>>,
    /// Clones of a basis share the components.
    components: ArcArray<f64, Ix3>,
    grid: StampGrid,
}

read_through_new!(RawPsfBasis => PsfBasis { mean: Option<Array2<f64>>, components: Array3<f64>, grid: StampGrid });

impl PsfBasis {
    /// The largest allowed difference of an inner product from 0 or 1. This tolerance accepts bases
    /// that other software stored in single precision. It rejects stamps that were never made
    /// orthonormal. psfield's own bases are orthonormal to 1e-12.
    pub const ORTHONORMALITY_TOLERANCE: f64 = 1e-5;

    /// A basis from its mean stamp (if mean-centred) and orthonormal components
    /// `[component, y, x]`.
    ///
    /// # Errors
    /// [`DataError::EmptyBasis`], [`DataError::StampShape`], [`DataError::NonFinite`] or
    /// [`DataError::NotOrthonormal`].
    pub fn new(
        mean: Option<Array2<f64>>,
        components: Array3<f64>,
        grid: StampGrid,
    ) -> Result<Self, DataError> {
        let (count, ny, nx) = components.dim();
        if mean.is_none() && count == 0 {
            return Err(DataError::EmptyBasis);
        }
        grid.check_dim((ny, nx))?;
        DataError::check_finite(Quantity::BasisValue, components.view())?;
        if let Some(mean) = &mean {
            grid.check_dim(mean.dim())?;
            DataError::check_finite(Quantity::MeanValue, mean.view())?;
        }
        let components = row_major(components);
        check_orthonormal(components.view())?;
        Ok(Self {
            mean: mean.map(row_major),
            components: components.into_shared(),
            grid,
        })
    }

    /// The mean stamp `[y, x]` of a mean-centred basis.
    pub fn mean(&self) -> Option<ArrayView2<'_, f64>> {
        self.mean.as_ref().map(|mean| mean.view())
    }

    /// The components `[component, y, x]`, row-major.
    pub fn components(&self) -> ArrayView3<'_, f64> {
        self.components.view()
    }

    /// The pixel grid of every stamp.
    pub fn grid(&self) -> StampGrid {
        self.grid
    }

    /// The number of components `K`, without the mean.
    pub fn rank(&self) -> usize {
        self.components.dim().0
    }
}

fn check_orthonormal(components: ArrayView3<'_, f64>) -> Result<(), DataError> {
    let (count, ny, nx) = components.dim();
    let flat = components.to_shape((count, ny * nx)).expect("row-major");
    let gram = flat.dot(&flat.t());
    for ((first, second), &product) in gram.indexed_iter() {
        let expected = f64::from(u8::from(first == second));
        if (product - expected).abs() > PsfBasis::ORTHONORMALITY_TOLERANCE {
            return Err(DataError::NotOrthonormal {
                first,
                second,
                product,
                expected,
                tolerance: PsfBasis::ORTHONORMALITY_TOLERANCE,
            });
        }
    }
    Ok(())
}

/// The coefficients `a_k` of every sample, `[sample, component]`, and the samples' positions. Every
/// value is finite.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawSampleCoefficients")]
pub struct SampleCoefficients {
    values: Array2<f64>,
    positions: SamplePositions,
}

read_through_new!(RawSampleCoefficients => SampleCoefficients { values: Array2<f64>, positions: SamplePositions });

impl SampleCoefficients {
    /// Coefficients `[sample, component]` at the samples' positions.
    ///
    /// # Errors
    /// [`DataError::CountMismatch`] or [`DataError::NonFinite`].
    pub fn new(values: Array2<f64>, positions: SamplePositions) -> Result<Self, DataError> {
        let what = "rows of coefficients, one for each sample";
        DataError::check_count(what, positions.len(), values.nrows())?;
        DataError::check_finite(Quantity::Coefficient, values.view())?;
        Ok(Self {
            values: row_major(values),
            positions,
        })
    }

    /// The coefficients `[sample, component]`, row-major.
    pub fn values(&self) -> ArrayView2<'_, f64> {
        self.values.view()
    }

    /// The positions of the samples.
    pub fn positions(&self) -> &SamplePositions {
        &self.positions
    }

    /// The number of components.
    pub fn component_count(&self) -> usize {
        self.values.ncols()
    }

    /// The coefficients of the samples in one state.
    ///
    /// # Panics
    /// When there is no such state.
    #[must_use]
    pub fn of_state(&self, state: usize) -> Self {
        let samples = self.positions.samples_of_state(state);
        Self {
            values: self.values.select(Axis(0), &samples),
            positions: self.positions.of_state(state),
        }
    }
}
