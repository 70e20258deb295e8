//! Neighbouring samples resemble each other.

use crate::{CellProbes, CellStamps, CellVariation, DifferenceMeasure, RefinementCriterion, SampleError};

/// Neighbouring samples differ by less than a threshold. Neighbours are the ends of every edge of the mesh: the next sample
/// to the left, right, above and below (where a small cell meets a large one, along both the small and the large edge).
///
/// What lies between two samples is not looked at: a PSF that comes back to the same shape within one cell of the starting
/// grid goes unseen, and a PSF that varies linearly is sampled densely although interpolation would be exact.
/// [`InterpolationError`](crate::InterpolationError) looks there, and mostly needs far fewer samples for the same error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NeighbourDifference {
    threshold: f64,
    measure: DifferenceMeasure,
}

impl NeighbourDifference {
    /// The default threshold, 1 %.
    pub const DEFAULT_THRESHOLD: f64 = 0.01;

    /// A criterion with this threshold on this measure.
    ///
    /// # Errors
    /// [`SampleError::Setting`] unless the threshold is finite and above 0.
    pub fn new(threshold: f64, measure: DifferenceMeasure) -> Result<Self, SampleError> {
        crate::adaptive_sampling::check_threshold(threshold)?;
        Ok(Self { threshold, measure })
    }

    /// The measure of the difference.
    pub fn measure(&self) -> DifferenceMeasure {
        self.measure
    }
}

impl Default for NeighbourDifference {
    fn default() -> Self {
        Self {
            threshold: Self::DEFAULT_THRESHOLD,
            measure: DifferenceMeasure::default(),
        }
    }
}

impl RefinementCriterion for NeighbourDifference {
    fn threshold(&self) -> f64 {
        self.threshold
    }

    fn probes(&self) -> CellProbes {
        CellProbes::Corners
    }

    fn assess(&self, cell: &CellStamps<'_>) -> CellVariation {
        let between =
            |a: (usize, usize), b: (usize, usize)| self.measure.between(cell.at(a.0, a.1), cell.at(b.0, b.1));
        CellVariation {
            along_x: between((0, 0), (2, 0)).max(between((0, 2), (2, 2))),
            along_y: between((0, 0), (0, 2)).max(between((2, 0), (2, 2))),
        }
    }
}
