//! Interpolation between the samples is good.

use crate::{CellProbes, CellStamps, CellVariation, DifferenceMeasure, RefinementCriterion, SampleError};

/// Linear interpolation between the samples is wrong by less than a threshold at points that are no samples:
///
/// * at the middle of each edge, against the mean of the edge's ends;
/// * at the centre of the cell, against the mean of **either** pair of opposite corners, whichever is worse: a Delaunay
///   triangulation may draw either diagonal. Bilinear interpolation, the mean of both, is never worse than the worse one.
///
/// For a PSF that varies quadratically within a cell, the worst point of a triangle with a right angle is the middle of its
/// longest side, so these points bound the error in the cell. Where cells of different size meet, a triangulation may join
/// other samples; its error there is of the same order, not strictly bounded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InterpolationError {
    threshold: f64,
    measure: DifferenceMeasure,
}

impl InterpolationError {
    /// A criterion with this threshold on this measure of (interpolated, true).
    ///
    /// # Errors
    /// [`SampleError::Setting`] unless the threshold is finite and above 0.
    pub fn new(threshold: f64, measure: DifferenceMeasure) -> Result<Self, SampleError> {
        crate::adaptive_sampling::check_threshold(threshold)?;
        Ok(Self { threshold, measure })
    }

    /// The measure of the error.
    pub fn measure(&self) -> DifferenceMeasure {
        self.measure
    }
}

impl RefinementCriterion for InterpolationError {
    fn threshold(&self) -> f64 {
        self.threshold
    }

    fn probes(&self) -> CellProbes {
        CellProbes::CornersAndMidpoints
    }

    fn assess(&self, cell: &CellStamps<'_>) -> CellVariation {
        let error = |a: (usize, usize), b: (usize, usize), middle: (usize, usize)| {
            let ends = [cell.at(a.0, a.1), cell.at(b.0, b.1)];
            self.measure.of_mean(ends, cell.at(middle.0, middle.1))
        };
        let x = error((0, 0), (2, 0), (1, 0)).max(error((0, 2), (2, 2), (1, 2)));
        let y = error((0, 0), (0, 2), (0, 1)).max(error((2, 0), (2, 2), (2, 1)));
        let centre = error((0, 0), (2, 2), (1, 1)).max(error((2, 0), (0, 2), (1, 1)));
        // Halving an axis takes three quarters of a quadratic error along it and half of the twist (the rest of the centre's
        // error). Where halving one axis is enough, that one bears the centre's error, else both do.
        let twist = (centre - x - y).max(0.0);
        let enough = |of: f64, other: f64| {
            of.max(centre) > self.threshold
                && (of / 4.0).max(other).max(centre - 0.75 * of - 0.5 * twist) <= self.threshold
        };
        let (x_alone, y_alone) = (enough(x, y), enough(y, x));
        CellVariation {
            along_x: if y_alone && (!x_alone || y > x) {
                x
            } else {
                x.max(centre)
            },
            along_y: if x_alone && (!y_alone || x >= y) {
                y
            } else {
                y.max(centre)
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, array};

    /// The variation of a cell whose stamps are `f` at the 3 x 3 points.
    fn assess(f: impl Fn(f64, f64) -> f64) -> CellVariation {
        let all: Vec<Array2<f64>> = (0..9)
            .map(|i| array![[1.0, f(f64::from(i % 3) / 2.0, f64::from(i / 3) / 2.0)]])
            .collect();
        let stamps = [0, 1, 2].map(|row| [0, 1, 2].map(|column| Some(all[3 * row + column].view())));
        InterpolationError::new(0.1, DifferenceMeasure::L1)
            .unwrap()
            .assess(&CellStamps { stamps })
    }

    #[test]
    fn linear_variation_is_no_error() {
        assert!(assess(|x, y| 0.2 + 0.3 * x + 0.5 * y).largest() < 1e-15);
    }

    #[test]
    fn errors_are_charged_to_the_axis_that_causes_them() {
        let v = assess(|x, _| x * x);
        assert!(v.along_x > 0.1 && v.along_y == 0.0, "{v:?}");
        let v = assess(|x, y| 0.1 * x * x + y * y);
        assert!(v.along_y > v.along_x && v.along_x < 0.05, "{v:?}");
        let v = assess(|x, y| x * y);
        assert!(
            v.along_x == v.along_y && v.along_x > 0.1,
            "a twist shows at the centre alone: {v:?}"
        );
    }
}
