//! PSF samples: stamps at positions.

use ndarray::{Array3, ArrayView2, ArrayView3, Axis};
use serde::{Deserialize, Serialize};

use crate::check::{self, Quantity};
use crate::{DataError, SamplePositions, StampGrid};

/// PSF stamps `[sample, y, x]` on one grid, each with the position it belongs to.
///
/// There is one stamp a position, every value is finite and every stamp holds positive, finite flux. Negative pixels are kept.
///
/// ```
/// use ndarray::Array3;
/// use psf_types::{Position, PsfSamples, SamplePositions, StampGrid};
/// let positions = SamplePositions::new(vec![Position::new(0.0, 0.0)?, Position::new(9.0, 0.0)?], None)?;
/// let samples = PsfSamples::new(Array3::from_elem((2, 5, 5), 0.04), positions, StampGrid::new(5, 5)?)?;
/// assert!((samples.flux(1) - 1.0).abs() < 1e-12);
/// # Ok::<(), psf_types::DataError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawPsfSamples", into = "RawPsfSamples")]
pub struct PsfSamples {
    stamps: Array3<f64>,
    positions: SamplePositions,
    grid: StampGrid,
}

#[derive(Serialize, Deserialize)]
struct RawPsfSamples {
    stamps: Array3<f64>,
    positions: SamplePositions,
    grid: StampGrid,
}

impl PsfSamples {
    /// Samples from a stack of stamps `[sample, y, x]`.
    ///
    /// # Errors
    /// [`DataError::CountMismatch`], [`DataError::StampShape`], [`DataError::NonFinite`] or
    /// [`DataError::NonPositiveFlux`].
    pub fn new(stamps: Array3<f64>, positions: SamplePositions, grid: StampGrid) -> Result<Self, DataError> {
        let (count, ny, nx) = stamps.dim();
        if count != positions.len() {
            return Err(DataError::CountMismatch {
                what: "stamps in the stack of samples, one for each position",
                expected: positions.len(),
                got: count,
            });
        }
        check::stamp_shape((ny, nx), grid)?;
        check::finite3(Quantity::SampleValue, stamps.view())?;
        for (sample, stamp) in stamps.axis_iter(Axis(0)).enumerate() {
            let flux = grid.flux_of_sum(stamp.sum());
            if !(flux > 0.0 && flux.is_finite()) {
                return Err(DataError::NonPositiveFlux { sample, flux });
            }
        }
        Ok(Self {
            stamps: check::row_major(stamps),
            positions,
            grid,
        })
    }

    /// The stamps `[sample, y, x]`, row-major.
    pub fn stamps(&self) -> ArrayView3<'_, f64> {
        self.stamps.view()
    }

    /// One stamp `[y, x]`.
    ///
    /// # Panics
    /// When there is no such sample.
    pub fn stamp(&self, sample: usize) -> ArrayView2<'_, f64> {
        self.stamps.index_axis(Axis(0), sample)
    }

    /// The fraction of the source's light that a sample holds.
    ///
    /// # Panics
    /// When there is no such sample.
    pub fn flux(&self, sample: usize) -> f64 {
        self.grid.flux_of_sum(self.stamp(sample).sum())
    }

    /// Where the samples lie.
    pub fn positions(&self) -> &SamplePositions {
        &self.positions
    }

    /// The pixel grid that all stamps share.
    pub fn grid(&self) -> StampGrid {
        self.grid
    }

    /// Number of samples, at least 1.
    #[allow(clippy::len_without_is_empty, reason = "never empty")]
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Every stamp divided by its flux, so that each holds unit flux.
    #[must_use]
    pub fn into_unit_flux(mut self) -> Self {
        for mut stamp in self.stamps.axis_iter_mut(Axis(0)) {
            let flux = self.grid.flux_of_sum(stamp.sum());
            stamp.mapv_inplace(|v| v / flux);
        }
        self
    }
}

impl TryFrom<RawPsfSamples> for PsfSamples {
    type Error = DataError;
    fn try_from(raw: RawPsfSamples) -> Result<Self, DataError> {
        Self::new(raw.stamps, raw.positions, raw.grid)
    }
}

impl From<PsfSamples> for RawPsfSamples {
    fn from(s: PsfSamples) -> Self {
        Self {
            stamps: s.stamps,
            positions: s.positions,
            grid: s.grid,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Position;
    use ndarray::Array3;

    fn two() -> SamplePositions {
        SamplePositions::new(vec![Position::of_pixel(0, 0), Position::of_pixel(1, 0)], None).unwrap()
    }

    #[test]
    fn each_invariant_is_checked() {
        let grid = StampGrid::new(3, 2).unwrap();
        let make = |stamps: Array3<f64>| PsfSamples::new(stamps, two(), grid);
        assert!(make(Array3::ones((2, 2, 3))).is_ok());
        assert!(matches!(
            make(Array3::ones((3, 2, 3))),
            Err(DataError::CountMismatch {
                expected: 2,
                got: 3,
                ..
            })
        ));
        assert!(matches!(
            make(Array3::ones((2, 3, 2))),
            Err(DataError::StampShape { .. })
        ));
        let mut stamps = Array3::ones((2, 2, 3));
        stamps[[1, 0, 2]] = f64::INFINITY;
        assert!(
            matches!(make(stamps.clone()), Err(DataError::NonFinite { index, .. }) if index == [1, 0, 2])
        );
        stamps.index_axis_mut(Axis(0), 1).fill(0.0);
        assert!(matches!(
            make(stamps),
            Err(DataError::NonPositiveFlux { sample: 1, .. })
        ));
    }

    #[test]
    fn unit_flux_counts_the_oversampling() {
        let grid = StampGrid::new(4, 4).unwrap().with_oversampling(2.0).unwrap();
        let samples = PsfSamples::new(Array3::from_elem((2, 4, 4), 3.0), two(), grid)
            .unwrap()
            .into_unit_flux();
        assert!((samples.flux(0) - 1.0).abs() < 1e-15);
        assert!((samples.stamp(0).sum() - 4.0).abs() < 1e-14);
    }
}
