//! When a cell of the mesh is fine enough.

use ndarray::ArrayView2;

/// Decides whether a cell between samples is fine enough. Object-safe; may be implemented elsewhere.
///
/// A cell is a rectangle whose four corners are samples. It is split along an axis whose value exceeds the threshold.
pub trait RefinementCriterion: std::fmt::Debug + Send + Sync {
    /// The largest value that is fine, finite and above 0.
    fn threshold(&self) -> f64;

    /// Which PSFs of a cell the criterion looks at.
    fn probes(&self) -> CellProbes;

    /// Measures a cell. Must depend on the stamps alone.
    fn assess(&self, cell: &CellStamps<'_>) -> CellVariation;
}

/// Which PSFs of a cell are drawn for a criterion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CellProbes {
    /// The four corners, which are samples anyway.
    Corners,
    /// The corners, the middles of the four edges and the cell's centre. They become samples where the cell is split.
    CornersAndMidpoints,
}

/// How much the PSF varies in a cell, in the criterion's measure: numbers of 0 or above.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CellVariation {
    /// Along x: above the threshold, the cell is halved by a vertical line.
    pub along_x: f64,
    /// Along y: above the threshold, the cell is halved by a horizontal line.
    pub along_y: f64,
}

impl CellVariation {
    /// The larger of the two.
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
    /// The PSF at `column` and `row`: 0 for the lower end of the axis, 1 for the middle, 2 for the upper end.
    ///
    /// # Panics
    /// When an index exceeds 2, or for a midpoint that [`RefinementCriterion::probes`] did not ask for.
    pub fn at(&self, column: usize, row: usize) -> ArrayView2<'_, f64> {
        self.stamps[row][column]
            .as_ref()
            .expect("the criterion asks for its midpoints")
            .view()
    }
}
