//! The weights of a coefficient field's nodes over a region.
//!
//! At each pixel, a field's coefficients are `sum_n w_n v_n`. Node `n` has the values `v_n`
//! ([`CoefficientField::node_values`]) and, at this pixel, the weight `w_n`.

use std::ops::Range;

use psf_types::{CoefficientField, PixelRegion};

/// Cells: rectangles of pixels in which the nodes' weights are bilinear. A region is divided into
/// bands of rows, and each band is divided into cells at some columns.
#[derive(Debug, Default)]
pub struct RegionCells {
    pub(crate) bands: Vec<Band>,
    cells: Vec<Cell>,
    /// The nodes that have a weight anywhere in the region, ascending.
    pub(crate) nodes: Vec<usize>,
    /// `(index into nodes, weight)`.
    weights: Vec<(usize, f64)>,
}

/// Neighbouring rows of a region that are divided at the same columns.
#[derive(Debug, Clone)]
pub(crate) struct Band {
    /// The rows, counted from the region's first row.
    pub(crate) rows: Range<usize>,
    cells: Range<usize>,
}

/// A rectangle of pixels: neighbouring columns of a band.
#[derive(Debug, Clone)]
pub(crate) struct Cell {
    /// First column, counted from the region's first column.
    pub(crate) column: usize,
    pub(crate) length: usize,
    /// The ranges of the list `weights` that belong to the corners, in the order of [`Corners`].
    /// `None` if the field has no value in the cell.
    corners: Option<[Range<usize>; CORNERS]>,
}

/// The weights at a cell's corners: first and last pixel of its first row, then of its last row.
pub(crate) type Corners<'a> = [&'a [(usize, f64)]; CORNERS];

pub(crate) const CORNERS: usize = 4;

/// A stretch of one row, as the field returns it.
struct Run {
    column: usize,
    length: usize,
    ends: Option<[Range<usize>; 2]>,
}

impl RegionCells {
    /// The cells of a field in a region. Together they cover all rows of the region.
    pub fn new(field: &dyn CoefficientField, region: PixelRegion) -> Self {
        let ny = region.shape().ny();
        let mut starts = vec![0];
        if let Some([_, ys]) = field.grid_lines() {
            let rows = ys.iter().map(|line| line.ceil() - region.y0() as f64);
            starts.extend(
                rows.filter(|&row| row > 0.0 && row < ny as f64)
                    .map(|row| row as usize),
            );
            // A field should return ascending lines. The sort is for a field that does not.
            starts.sort_unstable();
            starts.dedup();
        } else {
            starts.extend(1..ny);
        }
        starts.push(ny);
        let mut all = Self::default();
        for band in starts.windows(2) {
            all.add_band(field, region, band[0]..band[1]);
        }
        all.number_nodes();
        all
    }

    /// The cells of a few rows of a region, which include the first and the last row. Each of these
    /// rows is a band of its own. The other rows have no cells.
    pub(crate) fn sampled(field: &dyn CoefficientField, region: PixelRegion) -> Self {
        let ny = region.shape().ny();
        let count = SAMPLED_ROWS.min(ny);
        let mut all = Self::default();
        for i in 0..count {
            let row = i * (ny - 1) / (count - 1).max(1);
            all.add_band(field, region, row..row + 1);
        }
        all.number_nodes();
        all
    }

    /// Adds the rows between two neighbouring grid lines of the field. They become one band if the
    /// first and the last row are divided at the same columns. Otherwise each row becomes a band.
    fn add_band(&mut self, field: &dyn CoefficientField, region: PixelRegion, rows: Range<usize>) {
        let nx = region.shape().nx();
        let runs_of =
            |all: &mut Self, row: usize| all.runs(field, (region.x0(), region.y0() + row as i64), nx);
        let first = runs_of(self, rows.start);
        if rows.len() == 1 {
            self.push_band(rows, &first, &first);
            return;
        }
        let last = runs_of(self, rows.end - 1);
        let alike = |(a, b): (&Run, &Run)| {
            a.column == b.column && a.length == b.length && a.ends.is_some() == b.ends.is_some()
        };
        if first.len() == last.len() && first.iter().zip(&last).all(alike) {
            self.push_band(rows, &first, &last);
            return;
        }
        let (low, high) = (rows.start, rows.end - 1);
        self.push_band(low..low + 1, &first, &first);
        for row in low + 1..high {
            let runs = runs_of(self, row);
            self.push_band(row..row + 1, &runs, &runs);
        }
        self.push_band(high..high + 1, &last, &last);
    }

    fn push_band(&mut self, rows: Range<usize>, first: &[Run], last: &[Run]) {
        let start = self.cells.len();
        self.cells.extend(first.iter().zip(last).map(|(first, last)| {
            let ends = first.ends.clone().zip(last.ends.clone());
            Cell {
                column: first.column,
                length: first.length,
                corners: ends.map(|([a, b], [c, d])| [a, b, c, d]),
            }
        }));
        self.bands.push(Band {
            rows,
            cells: start..self.cells.len(),
        });
    }

    /// Returns the runs of a row and stores their weights.
    fn runs(&mut self, field: &dyn CoefficientField, (x, y): (i64, i64), length: usize) -> Vec<Run> {
        let mut runs = Vec::new();
        let mut column = 0;
        while column < length {
            let outcome = field.weights_along_row((x + column as i64, y), length - column, &mut |run| {
                // A run may extend beyond the row. Such a run is cut, and its pixels have no value.
                let pixels = run.length.min(length - column);
                let finite = |end: &[(usize, f64)]| end.iter().all(|(_, w)| w.is_finite());
                let ends = if finite(run.first) && finite(run.last) && pixels == run.length {
                    let first = self.push(run.first);
                    let last = if run.length == 1 {
                        first.clone()
                    } else {
                        self.push(run.last)
                    };
                    Some([first, last])
                } else {
                    None
                };
                if pixels > 0 {
                    runs.push(Run {
                        column,
                        length: pixels,
                        ends,
                    });
                }
                column += pixels;
            });
            if outcome.is_err() || column < length {
                // This pixel has no PSF. That is an error of the execution if the pixel is lit.
                runs.push(Run {
                    column,
                    length: 1,
                    ends: None,
                });
                column += 1;
            }
        }
        runs
    }

    fn push(&mut self, weights: &[(usize, f64)]) -> Range<usize> {
        let start = self.weights.len();
        self.weights.extend_from_slice(weights);
        start..self.weights.len()
    }

    fn number_nodes(&mut self) {
        let mut nodes: Vec<usize> = Vec::new();
        let mut last = usize::MAX;
        let mut room = ROOM_FOR_NODES;
        for &(node, _) in &self.weights {
            if node != last {
                nodes.push(node);
                last = node;
            }
            if nodes.len() > room {
                nodes.sort_unstable();
                nodes.dedup();
                // The list may double before the next sort, so that few sorts are needed even in
                // regions with tens of thousands of nodes.
                room = ROOM_FOR_NODES.max(2 * nodes.len());
            }
        }
        nodes.sort_unstable();
        nodes.dedup();
        for (node, _) in &mut self.weights {
            *node = nodes.binary_search(node).expect("every node is listed");
        }
        self.nodes = nodes;
    }

    pub(crate) fn cells_of(&self, band: &Band) -> &[Cell] {
        &self.cells[band.cells.clone()]
    }

    /// The weights of [`nodes`](Self::nodes) at the corners of a cell. `None` if the field has no
    /// value in the cell.
    pub(crate) fn corners(&self, cell: &Cell) -> Option<Corners<'_>> {
        let corners = cell.corners.as_ref()?;
        Some(corners.each_ref().map(|range| &self.weights[range.clone()]))
    }

    /// The corners of all cells with values.
    pub(crate) fn all_corners(&self) -> impl Iterator<Item = Corners<'_>> {
        self.cells.iter().filter_map(|cell| self.corners(cell))
    }

    /// Returns whether runs have so few pixels that it takes less memory to store coefficients
    /// pixel by pixel.
    pub(crate) fn are_short(&self) -> bool {
        let (mut runs, mut pixels) = (0, 0);
        for band in &self.bands {
            runs += band.rows.len() * band.cells.len();
            let columns: usize = self.cells_of(band).iter().map(|cell| cell.length).sum();
            pixels += band.rows.len() * columns;
        }
        runs * SHORT_RUN > pixels
    }

    /// Returns whether the weights at every corner sum to 1.
    pub(crate) fn is_partition_of_unity(&self) -> bool {
        let sums_to_one = |corners: Corners<'_>| {
            corners
                .iter()
                .all(|corner| (corner.iter().map(|(_, w)| w).sum::<f64>() - 1.0).abs() <= ROUNDING_OF_WEIGHTS)
        };
        self.all_corners().all(sums_to_one)
    }
}

/// The list of nodes may hold repetitions up to this length, or up to twice the number of nodes if
/// that is more. This limits the memory of the list, not the number of nodes.
const ROOM_FOR_NODES: usize = 1 << 12;
/// The number of rows in [`RegionCells::sampled`].
const SAMPLED_ROWS: usize = 5;
/// If runs are shorter than this on average, coefficients are stored pixel by pixel.
const SHORT_RUN: usize = 4;
/// The largest rounding error of a sum of weights.
const ROUNDING_OF_WEIGHTS: f64 = 1e-12;

#[cfg(test)]
mod tests {
    use super::*;
    use psf_types::{FieldError, FrameShape, Position, RowRun};

    const SIDE: usize = 120;

    /// Every pixel is a node, numbered from the last pixel to the first. The weights of a pixel
    /// belong to its own node and to the node of the pixel before it, row by row.
    #[derive(Debug)]
    struct NodesOfPixels;

    impl NodesOfPixels {
        fn weights(x: usize, y: usize) -> [(usize, f64); 2] {
            let node = SIDE * SIDE - 1 - (y * SIDE + x);
            [(node, 0.75), ((node + 1) % (SIDE * SIDE), 0.25)]
        }
    }

    impl CoefficientField for NodesOfPixels {
        fn component_count(&self) -> usize {
            1
        }
        fn evaluate_into(&self, _: Position, _: &mut [f64]) -> Result<(), FieldError> {
            unreachable!("only weights are requested")
        }
        fn weights_along_row(
            &self,
            (x, y): (i64, i64),
            length: usize,
            visit: &mut dyn FnMut(RowRun<'_>),
        ) -> Result<(), FieldError> {
            for column in 0..length {
                visit(RowRun::of_pixel(&Self::weights(x as usize + column, y as usize)));
            }
            Ok(())
        }
    }

    #[test]
    fn more_nodes_than_there_is_room_for_keep_their_weights() {
        let region = PixelRegion::new(0, 0, FrameShape::new(SIDE, SIDE).unwrap());
        let cells = RegionCells::new(&NodesOfPixels, region);
        let all: Vec<usize> = (0..SIDE * SIDE).collect();
        assert!(all.len() > 2 * ROOM_FOR_NODES);
        assert_eq!(cells.nodes, all);
        for band in &cells.bands {
            for cell in cells.cells_of(band) {
                let expected = NodesOfPixels::weights(cell.column, band.rows.start);
                assert_eq!(cells.corners(cell).unwrap(), [&expected[..]; CORNERS]);
            }
        }
    }
}
