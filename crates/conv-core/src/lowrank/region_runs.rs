//! The weights of the nodes over a region.

use std::ops::Range;

use psf_types::{CoefficientField, PixelRegion};

/// Runs of pixels along which the nodes' weights are linear, row by row.
#[derive(Debug, Default)]
pub(crate) struct RegionRuns {
    /// Where each row's runs start, and the end of the last.
    row_starts: Vec<usize>,
    runs: Vec<Run>,
    /// The nodes that have a weight anywhere in the region, ascending.
    nodes: Vec<usize>,
    /// `(index into nodes, weight)`.
    weights: Vec<(usize, f64)>,
}

/// Neighbouring pixels of a row.
#[derive(Debug, Clone)]
pub(crate) struct Run {
    /// First column, counted from the region's.
    pub(crate) column: usize,
    pub(crate) length: usize,
    /// The weights at the first and the last pixel; none where the field has no value.
    ends: Option<[Range<usize>; 2]>,
}

impl RegionRuns {
    pub(crate) fn new(field: &dyn CoefficientField, region: PixelRegion) -> Self {
        Self::of_rows(field, region, 0..region.shape().ny())
    }

    /// A few rows of a region, the first and the last among them, as if they were all.
    pub(crate) fn sampled(field: &dyn CoefficientField, region: PixelRegion) -> Self {
        let ny = region.shape().ny();
        let count = SAMPLED_ROWS.min(ny);
        let rows = (0..count).map(|i| i * (ny - 1) / (count - 1).max(1));
        Self::of_rows(field, region, rows)
    }

    fn of_rows(field: &dyn CoefficientField, region: PixelRegion, rows: impl Iterator<Item = usize>) -> Self {
        let mut all = Self::default();
        let nx = region.shape().nx();
        for row in rows {
            all.row_starts.push(all.runs.len());
            all.add_row(field, (region.x0(), region.y0() + row as i64), nx);
        }
        all.row_starts.push(all.runs.len());
        all.number_nodes();
        all
    }

    fn add_row(&mut self, field: &dyn CoefficientField, (x, y): (i64, i64), length: usize) {
        let mut column = 0;
        while column < length {
            let outcome = field.weights_along_row((x + column as i64, y), length - column, &mut |run| {
                // Whatever a field says, a row is covered once.
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
                    self.runs.push(Run {
                        column,
                        length: pixels,
                        ends,
                    });
                }
                column += pixels;
            });
            if outcome.is_err() || column < length {
                // Nobody may ever ask for this pixel; if it holds light, that is the time to complain.
                self.runs.push(Run {
                    column,
                    length: 1,
                    ends: None,
                });
                column += 1;
            }
        }
    }

    fn push(&mut self, weights: &[(usize, f64)]) -> Range<usize> {
        let start = self.weights.len();
        self.weights.extend_from_slice(weights);
        start..self.weights.len()
    }

    fn number_nodes(&mut self) {
        let mut nodes: Vec<usize> = Vec::new();
        let mut last = usize::MAX;
        for &(node, _) in &self.weights {
            if node != last {
                nodes.push(node);
                last = node;
            }
            if nodes.len() > 1 << 12 {
                nodes.sort_unstable();
                nodes.dedup();
            }
        }
        nodes.sort_unstable();
        nodes.dedup();
        for (node, _) in &mut self.weights {
            *node = nodes.binary_search(node).expect("every node is listed");
        }
        self.nodes = nodes;
    }

    pub(crate) fn nodes(&self) -> &[usize] {
        &self.nodes
    }

    pub(crate) fn row_count(&self) -> usize {
        self.row_starts.len() - 1
    }

    pub(crate) fn row(&self, row: usize) -> &[Run] {
        &self.runs[self.row_starts[row]..self.row_starts[row + 1]]
    }

    pub(crate) fn runs(&self) -> &[Run] {
        &self.runs
    }

    /// The weights of [`nodes`](Self::nodes) at the first and the last pixel of a run, where the field has values.
    pub(crate) fn ends(&self, run: &Run) -> Option<[&[(usize, f64)]; 2]> {
        let [first, last] = run.ends.as_ref()?;
        Some([&self.weights[first.clone()], &self.weights[last.clone()]])
    }

    /// Whether runs hold next to nothing but single pixels, so that a region takes much memory.
    pub(crate) fn are_short(&self) -> bool {
        let pixels: usize = self.runs.iter().map(|run| run.length).sum();
        self.runs.len() * SHORT_RUN > pixels
    }

    /// Whether the weights of every end add up to 1.
    pub(crate) fn is_partition_of_unity(&self) -> bool {
        let sums_to_one = |ends: [&[(usize, f64)]; 2]| {
            ends.iter()
                .all(|end| (end.iter().map(|(_, w)| w).sum::<f64>() - 1.0).abs() <= ROUNDING_OF_WEIGHTS)
        };
        self.runs.iter().filter_map(|run| self.ends(run)).all(sums_to_one)
    }
}

/// Rows that stand for a region.
const SAMPLED_ROWS: usize = 5;
/// Runs shorter than this on average are not worth their bookkeeping.
const SHORT_RUN: usize = 4;
/// Weights of an interpolator add up to 1 up to this.
const ROUNDING_OF_WEIGHTS: f64 = 1e-12;
