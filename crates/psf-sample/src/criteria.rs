//! Criteria that decide whether a cell of the mesh is fine enough, and measures of the difference
//! between two PSFs.

use ndarray::ArrayView2;

use crate::sampling::SampleError;

/// Decides whether a cell between samples is fine enough. The trait is object-safe, and other
/// crates may implement it.
///
/// A cell is a rectangle whose four corners are samples. It is halved along each axis along which
/// the measured variation exceeds the threshold.
pub trait RefinementCriterion: std::fmt::Debug + Send + Sync {
    /// The largest variation at which a cell is fine enough. It must be finite and above 0.
    fn threshold(&self) -> f64;

    /// Returns the points of a cell whose PSFs the criterion needs.
    fn probes(&self) -> CellProbes;

    /// Measures the variation of the PSF in a cell. The result must depend only on the stamps.
    fn assess(&self, cell: &CellStamps<'_>) -> CellVariation;
}

/// The points of a cell whose PSFs a criterion needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CellProbes {
    /// The four corners, which are samples anyway.
    Corners,
    /// The corners, the middles of the four edges and the cell's centre. When the cell is halved,
    /// each of these points that is a corner of a half becomes a sample.
    CornersAndMidpoints,
}

/// The variation of the PSF in a cell, in the criterion's measure. Both numbers are 0 or above.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CellVariation {
    /// Variation along x. If it exceeds the threshold, the cell is halved by a vertical line.
    pub along_x: f64,
    /// Variation along y. If it exceeds the threshold, the cell is halved by a horizontal line.
    pub along_y: f64,
}

impl CellVariation {
    /// The larger of the two variations.
    pub fn largest(self) -> f64 {
        self.along_x.max(self.along_y)
    }
}

/// The PSFs of a cell on the 3 x 3 grid of its corners, edge midpoints and centre.
#[derive(Debug)]
pub struct CellStamps<'a> {
    pub(crate) stamps: [[Option<ArrayView2<'a, f64>>; 3]; 3],
}

impl CellStamps<'_> {
    /// The PSF at `column` and `row`: 0 for the lower end of the axis, 1 for the middle, 2 for the
    /// upper end.
    ///
    /// # Panics
    /// When an index exceeds 2, or for a midpoint that [`RefinementCriterion::probes`] does not
    /// include.
    pub fn at(&self, column: usize, row: usize) -> ArrayView2<'_, f64> {
        self.stamps[row][column]
            .as_ref()
            .expect("the criterion includes the midpoints in its probes")
            .view()
    }
}

/// A relative difference of two stamps `a` and `b` on the same grid. It does not change when the
/// stamps are exchanged, and is 0 for equal stamps.
///
/// ```
/// use ndarray::array;
/// use psf_sample::DifferenceMeasure;
/// let (a, b) = (array![[0.6, 0.4]], array![[0.5, 0.5]]);
/// assert!((DifferenceMeasure::L1.between(a.view(), b.view()) - 0.2).abs() < 1e-15);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum DifferenceMeasure {
    /// `sum |a - b| / (sum |a| + sum |b|) * 2`: at most 2, reached by PSFs that do not overlap.
    L1,
    /// `||a - b||_2 / (||a||_2 + ||b||_2) * 2`: sqrt(2) for PSFs of equal norm that do not overlap.
    #[default]
    L2,
}

impl DifferenceMeasure {
    /// The difference of two stamps.
    ///
    /// # Panics
    /// When their shapes differ.
    pub fn between(self, a: ArrayView2<'_, f64>, b: ArrayView2<'_, f64>) -> f64 {
        self.of_pairs(a.iter().copied(), b.iter().copied(), a.dim() == b.dim())
    }

    /// The difference of `(a + b) / 2` and `c`.
    ///
    /// # Panics
    /// When the shapes differ.
    pub fn of_mean(self, [a, b]: [ArrayView2<'_, f64>; 2], c: ArrayView2<'_, f64>) -> f64 {
        let mean = a.iter().zip(b.iter()).map(|(a, b)| 0.5 * (a + b));
        self.of_pairs(mean, c.iter().copied(), a.dim() == b.dim() && b.dim() == c.dim())
    }

    fn of_pairs(self, a: impl Iterator<Item = f64>, b: impl Iterator<Item = f64>, same_shape: bool) -> f64 {
        assert!(same_shape, "the stamps must have equal shapes");
        let norm = |v: f64| if self == Self::L1 { v.abs() } else { v * v };
        let (mut d, mut na, mut nb) = (0.0, 0.0, 0.0);
        for (a, b) in a.zip(b) {
            d += norm(a - b);
            na += norm(a);
            nb += norm(b);
        }
        if self == Self::L2 {
            (d, na, nb) = (d.sqrt(), na.sqrt(), nb.sqrt());
        }
        // The difference of two stamps of zeros is 0. A drawn stamp always has flux.
        if d == 0.0 { 0.0 } else { 2.0 * d / (na + nb) }
    }
}

/// Requires that neighbouring samples differ by at most a threshold. Neighbours are the two ends of
/// an edge of a cell. Where a small cell meets a large cell, the edges of both count.
///
/// The criterion does not examine points between two samples. It therefore misses a variation that
/// starts and ends with equal PSFs within one cell of the starting grid. A PSF that varies linearly
/// is sampled densely, although interpolation would be exact.
/// [`InterpolationError`](crate::InterpolationError) examines points between samples, and usually
/// needs far fewer samples for the same error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NeighbourDifference {
    threshold: f64,
    measure: DifferenceMeasure,
}

impl NeighbourDifference {
    /// A criterion with a threshold on the difference of neighbours.
    ///
    /// # Errors
    /// [`SampleError::Setting`] unless the threshold is finite and above 0.
    pub fn new(threshold: f64, measure: DifferenceMeasure) -> Result<Self, SampleError> {
        check_threshold(threshold)?;
        Ok(Self { threshold, measure })
    }

    /// The measure of the difference.
    pub fn measure(&self) -> DifferenceMeasure {
        self.measure
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

/// Requires that the error of linear interpolation between the samples is at most a threshold. Each
/// cell is checked at five points:
///
/// * at the middle of each edge, where the PSF is compared with the mean of the edge's two ends.
/// * at the centre of the cell, where the PSF is compared with the mean of two opposite corners.
///   The larger error of **both** diagonals counts, because a Delaunay triangulation may contain
///   either. Bilinear interpolation is the mean over both diagonals, so its error is not larger.
///
/// For a PSF that varies quadratically within a cell, the errors at these points bound the error
/// everywhere in the cell, whichever diagonal the triangulation contains. Where cells of different
/// size meet, a triangulation may join other samples. Its error there is of similar size, but not
/// strictly bounded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InterpolationError {
    threshold: f64,
    measure: DifferenceMeasure,
}

impl InterpolationError {
    /// The default threshold, 1 %.
    pub const DEFAULT_THRESHOLD: f64 = 0.01;

    /// A criterion with a threshold on the difference between the interpolated and the true PSF.
    ///
    /// # Errors
    /// [`SampleError::Setting`] unless the threshold is finite and above 0.
    pub fn new(threshold: f64, measure: DifferenceMeasure) -> Result<Self, SampleError> {
        check_threshold(threshold)?;
        Ok(Self { threshold, measure })
    }

    /// The measure of the error.
    pub fn measure(&self) -> DifferenceMeasure {
        self.measure
    }
}

impl Default for InterpolationError {
    fn default() -> Self {
        Self {
            threshold: Self::DEFAULT_THRESHOLD,
            measure: DifferenceMeasure::default(),
        }
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
        // Halving an axis removes three quarters of a quadratic error along it, and half of the
        // twist (the part of the error at the centre beyond `x + y`). If halving one axis is
        // enough, the error at the centre counts for this axis only, otherwise for both axes.
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

pub(crate) fn check_threshold(threshold: f64) -> Result<(), SampleError> {
    let (name, allowed) = ("the threshold of the criterion", "a finite number above 0");
    SampleError::check(threshold.is_finite() && threshold > 0.0, name, allowed, threshold)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, array};

    #[test]
    fn the_measures_give_values_computed_by_hand() {
        let (a, b) = (array![[3.0, 0.0], [0.0, 1.0]], array![[0.0, 4.0], [0.0, 1.0]]);
        let l1 = 2.0 * 7.0 / (4.0 + 5.0);
        let l2 = 2.0 * 5.0 / (10f64.sqrt() + 17f64.sqrt());
        for (measure, expected) in [(DifferenceMeasure::L1, l1), (DifferenceMeasure::L2, l2)] {
            assert!((measure.between(a.view(), b.view()) - expected).abs() < 1e-15);
            assert_eq!(
                measure.between(a.view(), b.view()),
                measure.between(b.view(), a.view())
            );
            assert_eq!(measure.between(a.view(), a.view()), 0.0);
            let scaled = measure.between((&a * 1e-3).view(), (&b * 1e-3).view());
            assert!((scaled - expected).abs() < 1e-14, "relative");
            let mean = (&a + &b) / 2.0;
            assert_eq!(measure.of_mean([a.view(), b.view()], mean.view()), 0.0);
        }
    }

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
    fn errors_count_for_the_axis_that_causes_them() {
        let v = assess(|x, _| x * x);
        assert!(v.along_x > 0.1 && v.along_y == 0.0, "{v:?}");
        let v = assess(|x, y| 0.1 * x * x + y * y);
        assert!(v.along_y > v.along_x && v.along_x < 0.05, "{v:?}");
        let v = assess(|x, y| x * y);
        assert!(
            v.along_x == v.along_y && v.along_x > 0.1,
            "a twist has an error only at the centre: {v:?}"
        );
    }
}
