//! The wings of a PSF: its faint light far from the source.

use std::sync::Arc;

use ndarray::{ArcArray, Array2, Array3, ArrayView2, ArrayView3, Ix3};
use serde::{Deserialize, Serialize};

use crate::basis::SampleCoefficients;
use crate::coefficient_field::{CoefficientField, FieldError};
use crate::frame::{DataError, Position, Quantity, read_through_new};
use crate::image::row_major;
use crate::stamp::StampGrid;

/// The wings of a stored model: `h_w(u; x) = sum_k b_k(x) W_k(u)`. They are added to the core, which is the
/// model's own PSF, so the whole PSF is the sum of both.
///
/// The stamps `W_k` are large and few. They are stored in single precision, and vary slowly over the field.
/// Where the core is bright, they are 0. Their coefficients `b_k` are known where those of the core are, and
/// are interpolated in the same way.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawWingsRecord")]
pub struct WingsRecord {
    /// `[mode, y, x]`. Clones share them.
    stamps: ArcArray<f32, Ix3>,
    coefficients: SampleCoefficients,
    grid: StampGrid,
}

read_through_new!(RawWingsRecord => WingsRecord { stamps: Array3<f32>, coefficients: SampleCoefficients, grid: StampGrid });

impl WingsRecord {
    /// Wings from their stamps `[mode, y, x]` and the coefficients `[sample, mode]`.
    ///
    /// # Errors
    /// [`DataError::CountMismatch`], [`DataError::StampShape`], [`DataError::NonFinite`] or
    /// [`DataError::EmptyBasis`].
    pub fn new(
        stamps: Array3<f32>,
        coefficients: SampleCoefficients,
        grid: StampGrid,
    ) -> Result<Self, DataError> {
        let (count, ny, nx) = stamps.dim();
        if count == 0 {
            return Err(DataError::EmptyBasis);
        }
        let what = "coefficients, one for each stamp of the wings";
        DataError::check_count(what, count, coefficients.component_count())?;
        grid.check_dim((ny, nx))?;
        DataError::check_finite(Quantity::BasisValue, stamps.view())?;
        Ok(Self {
            stamps: row_major(stamps).into_shared(),
            coefficients,
            grid,
        })
    }

    /// These wings with other coefficients.
    ///
    /// # Errors
    /// [`DataError::CountMismatch`].
    pub fn with_coefficients(&self, coefficients: SampleCoefficients) -> Result<Self, DataError> {
        let what = "coefficients, one for each stamp of the wings";
        DataError::check_count(what, self.mode_count(), coefficients.component_count())?;
        Ok(Self {
            coefficients,
            ..self.clone()
        })
    }

    /// The stamps `[mode, y, x]`, row-major.
    pub fn stamps(&self) -> ArrayView3<'_, f32> {
        self.stamps.view()
    }

    /// The number of stamps.
    pub fn mode_count(&self) -> usize {
        self.stamps.dim().0
    }

    /// The flux of each stamp.
    pub fn stamp_fluxes(&self) -> Vec<f64> {
        stamp_fluxes(self.stamps(), self.grid)
    }

    /// The coefficients of the samples.
    pub fn coefficients(&self) -> &SampleCoefficients {
        &self.coefficients
    }

    /// The pixel grid of the stamps.
    pub fn grid(&self) -> StampGrid {
        self.grid
    }

    /// The wings of a model whose coefficients are those of a field.
    ///
    /// # Errors
    /// [`DataError::CountMismatch`].
    pub fn with_field(&self, field: Arc<dyn CoefficientField>) -> Result<Wings, DataError> {
        let what = "coefficients, one for each stamp of the wings";
        DataError::check_count(what, self.mode_count(), field.component_count())?;
        Ok(Wings {
            stamps: self.stamps.clone(),
            grid: self.grid,
            field,
        })
    }
}

/// The wings of a [`PsfModel`](crate::PsfModel), at any position: see [`WingsRecord`].
#[derive(Debug, Clone)]
pub struct Wings {
    stamps: ArcArray<f32, Ix3>,
    grid: StampGrid,
    field: Arc<dyn CoefficientField>,
}

impl Wings {
    /// The L2 norm of wings is at most this part of that of the core.
    pub const LARGEST_NORM: f64 = 0.02;

    /// The stamps `[mode, y, x]`, row-major.
    pub fn stamps(&self) -> ArrayView3<'_, f32> {
        self.stamps.view()
    }

    /// The number of stamps.
    pub fn mode_count(&self) -> usize {
        self.stamps.dim().0
    }

    /// The pixel grid of the stamps.
    pub fn grid(&self) -> StampGrid {
        self.grid
    }

    /// The flux of each stamp.
    pub fn stamp_fluxes(&self) -> Vec<f64> {
        stamp_fluxes(self.stamps(), self.grid)
    }

    /// The fields of the coefficients.
    pub fn field(&self) -> &Arc<dyn CoefficientField> {
        &self.field
    }

    /// Returns whether these wings have the stamps of others.
    pub fn has_stamps_of(&self, other: &Self) -> bool {
        self.grid == other.grid
            && (self.stamps.as_ptr() == other.stamps.as_ptr() || self.stamps == other.stamps)
    }

    /// Returns the wings at a position, `[y, x]`, in double precision.
    ///
    /// # Errors
    /// [`FieldError`] if the field has no value there.
    pub fn at(&self, position: Position) -> Result<Array2<f64>, FieldError> {
        let mut coefficients = vec![0.0; self.mode_count()];
        self.field.evaluate_into(position, &mut coefficients)?;
        let mut values = Array2::zeros(self.grid.dim());
        for (&b, stamp) in coefficients.iter().zip(self.stamps.outer_iter()) {
            values.zip_mut_with(&stamp, |sum, &v| *sum += b * f64::from(v));
        }
        Ok(values)
    }
}

/// The fluxes of stamps, summed in double precision.
fn stamp_fluxes(stamps: ArrayView3<'_, f32>, grid: StampGrid) -> Vec<f64> {
    let sum = |stamp: ArrayView2<'_, f32>| stamp.iter().map(|&v| f64::from(v)).sum();
    stamps
        .outer_iter()
        .map(|stamp| grid.flux_of_sum(sum(stamp)))
        .collect()
}
