//! Where the samples lie.

use std::collections::HashMap;

use serde::{Deserialize, Serialize};

use crate::{DataError, FrameShape, Position};

/// The distinct positions of the samples, in order, and the field they cover if it is known.
///
/// At least one position; no two are equal; all lie on the field where one is given.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawSamplePositions", into = "RawSamplePositions")]
pub struct SamplePositions {
    positions: Vec<Position>,
    field: Option<FrameShape>,
}

#[derive(Serialize, Deserialize)]
struct RawSamplePositions {
    positions: Vec<Position>,
    field: Option<FrameShape>,
}

impl SamplePositions {
    /// Positions of samples on a field of the given shape.
    ///
    /// # Errors
    /// [`DataError::NoSamples`], [`DataError::DuplicatePosition`] or [`DataError::OutsideField`].
    pub fn new(positions: Vec<Position>, field: Option<FrameShape>) -> Result<Self, DataError> {
        if positions.is_empty() {
            return Err(DataError::NoSamples);
        }
        if let Some(field) = field
            && let Some(sample) = positions.iter().position(|&p| !field.contains(p))
        {
            return Err(DataError::OutsideField {
                sample,
                position: positions[sample],
                field,
            });
        }
        // Adding 0.0 turns -0.0 into 0.0, so that equal coordinates have equal bits.
        let bits = |p: Position| ((p.x() + 0.0).to_bits(), (p.y() + 0.0).to_bits());
        let mut seen = HashMap::with_capacity(positions.len());
        for (second, &position) in positions.iter().enumerate() {
            if let Some(first) = seen.insert(bits(position), second) {
                return Err(DataError::DuplicatePosition {
                    first,
                    second,
                    position,
                });
            }
        }
        Ok(Self { positions, field })
    }

    /// The positions, in sample order.
    pub fn as_slice(&self) -> &[Position] {
        &self.positions
    }

    /// Number of samples, at least 1.
    #[allow(clippy::len_without_is_empty, reason = "never empty")]
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// The shape of the field, if it is known.
    pub fn field(&self) -> Option<FrameShape> {
        self.field
    }
}

impl TryFrom<RawSamplePositions> for SamplePositions {
    type Error = DataError;
    fn try_from(raw: RawSamplePositions) -> Result<Self, DataError> {
        Self::new(raw.positions, raw.field)
    }
}

impl From<SamplePositions> for RawSamplePositions {
    fn from(p: SamplePositions) -> Self {
        Self {
            positions: p.positions,
            field: p.field,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, y: f64) -> Position {
        Position::new(x, y).unwrap()
    }

    #[test]
    fn duplicates_are_named_also_across_the_two_zeros() {
        let error = SamplePositions::new(vec![at(0.0, 1.0), at(2.0, 2.0), at(-0.0, 1.0)], None).unwrap_err();
        assert!(
            matches!(
                error,
                DataError::DuplicatePosition {
                    first: 0,
                    second: 2,
                    ..
                }
            ),
            "{error}"
        );
        assert!(SamplePositions::new(vec![at(1.0, 1.0), at(1.0 + 1e-9, 1.0)], None).is_ok());
    }

    #[test]
    fn positions_off_the_field_are_named() {
        let field = FrameShape::new(10, 10).unwrap();
        let error = SamplePositions::new(vec![at(0.0, 0.0), at(9.6, 0.0)], Some(field)).unwrap_err();
        assert!(
            matches!(error, DataError::OutsideField { sample: 1, .. }),
            "{error}"
        );
    }
}
