//! PSF models as they are stored.

use std::sync::Arc;

use ndarray::s;
use serde::{Deserialize, Serialize};

use crate::psf_model::check_components;
use crate::{
    CoefficientField, DataError, Interpolation, Normalisation, OutsidePolicy, PsfBasis, PsfModel,
    SampleCoefficients,
};

/// What a `psf-model` file holds: a basis, the samples' coefficients and how to interpolate them.
///
/// Plain data; `coeff-field` turns coefficients and interpolation into a [`CoefficientField`], which with the basis makes
/// a [`PsfModel`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawPsfModelRecord", into = "RawPsfModelRecord")]
pub struct PsfModelRecord {
    basis: PsfBasis,
    coefficients: SampleCoefficients,
    interpolation: Interpolation,
    outside: OutsidePolicy,
    normalisation: Normalisation,
}

#[derive(Serialize, Deserialize)]
struct RawPsfModelRecord {
    basis: PsfBasis,
    coefficients: SampleCoefficients,
    interpolation: Interpolation,
    outside: OutsidePolicy,
    normalisation: Normalisation,
}

impl PsfModelRecord {
    /// A model from its parts.
    ///
    /// # Errors
    /// [`DataError::CountMismatch`] when there is not one coefficient a component.
    pub fn new(
        basis: PsfBasis,
        coefficients: SampleCoefficients,
        interpolation: Interpolation,
        outside: OutsidePolicy,
        normalisation: Normalisation,
    ) -> Result<Self, DataError> {
        check_components(basis.rank(), coefficients.component_count())?;
        Ok(Self {
            basis,
            coefficients,
            interpolation,
            outside,
            normalisation,
        })
    }

    /// The basis.
    pub fn basis(&self) -> &PsfBasis {
        &self.basis
    }

    /// The samples' coefficients.
    pub fn coefficients(&self) -> &SampleCoefficients {
        &self.coefficients
    }

    /// How the coefficients are carried over the field.
    pub fn interpolation(&self) -> Interpolation {
        self.interpolation
    }

    /// What happens outside the samples.
    pub fn outside(&self) -> OutsidePolicy {
        self.outside
    }

    /// Whether PSFs are scaled to unit flux.
    pub fn normalisation(&self) -> Normalisation {
        self.normalisation
    }

    /// The record with its first components alone, at most `rank` of them.
    ///
    /// # Errors
    /// [`DataError::EmptyBasis`] for rank 0 of a basis without a mean.
    pub fn truncated(&self, rank: usize) -> Result<Self, DataError> {
        let rank = rank.min(self.basis.rank());
        let basis = PsfBasis::new(
            self.basis.mean().map(|mean| mean.to_owned()),
            self.basis.components().slice(s![..rank, .., ..]).to_owned(),
            self.basis.grid(),
        )?;
        let values = self.coefficients.values().slice(s![.., ..rank]).to_owned();
        let coefficients = SampleCoefficients::new(values, self.coefficients.positions().clone())?;
        Self::new(
            basis,
            coefficients,
            self.interpolation,
            self.outside,
            self.normalisation,
        )
    }

    /// The model with its coefficient field; `field` is the caller's interpolation of [`Self::coefficients`].
    ///
    /// # Errors
    /// As [`PsfModel::new`].
    pub fn into_model(self, field: Arc<dyn CoefficientField>) -> Result<PsfModel, DataError> {
        let shape = self.coefficients.positions().field();
        let model = PsfModel::new(&self.basis, field, self.normalisation, shape)?;
        Ok(model.without_needless_scaling(self.coefficients.values()))
    }
}

impl TryFrom<RawPsfModelRecord> for PsfModelRecord {
    type Error = DataError;
    fn try_from(raw: RawPsfModelRecord) -> Result<Self, DataError> {
        Self::new(
            raw.basis,
            raw.coefficients,
            raw.interpolation,
            raw.outside,
            raw.normalisation,
        )
    }
}

impl From<PsfModelRecord> for RawPsfModelRecord {
    fn from(m: PsfModelRecord) -> Self {
        Self {
            basis: m.basis,
            coefficients: m.coefficients,
            interpolation: m.interpolation,
            outside: m.outside,
            normalisation: m.normalisation,
        }
    }
}

#[cfg(test)]
mod tests {
    use ndarray::{Array2, Array3};

    use super::*;
    use crate::{Position, SamplePositions, StampGrid};

    #[test]
    fn truncation_keeps_the_first_components() {
        // One lit pixel each, so that they are orthonormal.
        let components = Array3::from_shape_fn((3, 2, 2), |(k, y, x)| f64::from(u8::from(2 * y + x == k)));
        let values = Array2::from_shape_fn((2, 3), |(sample, k)| (10 * sample + k) as f64);
        let positions = [(0, 0), (5, 0)].map(|(x, y)| Position::of_pixel(x, y));
        let positions = SamplePositions::new(positions.to_vec(), None).unwrap();
        let record = PsfModelRecord::new(
            PsfBasis::new(None, components, StampGrid::new(2, 2).unwrap()).unwrap(),
            SampleCoefficients::new(values, positions).unwrap(),
            Interpolation::Nearest,
            OutsidePolicy::Error,
            Normalisation::Keep,
        )
        .unwrap();
        let one = record.truncated(1).unwrap();
        assert_eq!(one.basis().rank(), 1);
        assert_eq!(
            one.basis().components(),
            record.basis().components().slice(s![..1, .., ..])
        );
        assert_eq!(
            one.coefficients().values(),
            record.coefficients().values().slice(s![.., ..1])
        );
        assert_eq!(one.outside(), OutsidePolicy::Error);
        assert_eq!(record.truncated(99).unwrap(), record);
        assert!(matches!(record.truncated(0), Err(DataError::EmptyBasis)));
    }
}
