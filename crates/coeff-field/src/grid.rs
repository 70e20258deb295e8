//! Samples on a regular grid.

use std::collections::HashMap;

use psf_types::{OutsidePolicy, Position, SamplePositions};

use crate::error::CoeffFieldError;
use crate::geometry::Points;

/// A regular grid: a list of x, a list of y, and one sample at every combination of the two (every
/// node). The samples may be in any order.
///
/// The spacing may vary (a rectilinear grid). One row, one column or a single sample is a grid too.
/// Coordinates that differ by at most 1e-9 of the samples' extent belong to one column or row. The
/// coordinate of a column or row is the mean over its samples.
///
/// ```
/// use coeff_field::RegularGrid;
/// use psf_types::{Position, SamplePositions};
/// let nodes = [(0, 0), (0, 5), (9, 5), (2, 0), (9, 0), (2, 5)].map(|(x, y)| Position::of_pixel(x, y));
/// let grid = RegularGrid::detect(&SamplePositions::new(nodes.to_vec(), None)?)?;
/// assert_eq!((grid.xs(), grid.ys()), (&[0.0, 2.0, 9.0][..], &[0.0, 5.0][..]));
/// assert_eq!(grid.sample(2, 1), 2);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct RegularGrid {
    pub(crate) x: Axis,
    pub(crate) y: Axis,
    /// Index of the sample at each node, row by row.
    samples: Vec<usize>,
    /// Largest distance outside the grid at which a position still counts as covered.
    pub(crate) covered: f64,
}

/// Two coordinates belong to one line (a column or a row) if they differ by at most this fraction
/// of the samples' extent.
const SAME_LINE: f64 = 1e-9;

impl RegularGrid {
    /// Finds the columns and rows of samples.
    ///
    /// # Errors
    /// [`CoeffFieldError::NotRegular`] with the first node that has no sample.
    /// [`CoeffFieldError::SharedNode`] with the first node that has two.
    /// [`CoeffFieldError::SampleRange`] for coordinates above 1e50 pixels in magnitude.
    /// [`CoeffFieldError::CoincidentSamples`] for samples that differ only in coordinates of
    /// magnitudes below 1e-40 pixels, which count as 0.
    pub fn detect(positions: &SamplePositions) -> Result<Self, CoeffFieldError> {
        let points = Points::new(positions)?;
        let tolerance = SAME_LINE * points.scale.extent;
        let (x, columns) = Axis::new(points.points.iter().map(|p| p[0]).collect(), tolerance);
        let (y, rows) = Axis::new(points.points.iter().map(|p| p[1]).collect(), tolerance);
        let width = x.lines.len();
        let mut nodes = HashMap::with_capacity(points.len());
        for (sample, (&column, &row)) in columns.iter().zip(&rows).enumerate() {
            if let Some(first) = nodes.insert(row * width + column, sample) {
                return Err(CoeffFieldError::SharedNode {
                    first,
                    second: sample,
                    column,
                    row,
                    position: positions.as_slice()[sample],
                });
            }
        }
        // No node has two samples. If there are more nodes than samples, a node without a sample is
        // among the first points.len() + 1 nodes, so the search ends soon.
        let mut samples = Vec::with_capacity(points.len());
        for node in 0..width * y.lines.len() {
            let (column, row) = (node % width, node / width);
            let sample = nodes.get(&node).ok_or_else(|| CoeffFieldError::NotRegular {
                samples: points.len(),
                columns: width,
                rows: y.lines.len(),
                column,
                row,
                position: Position::new(x.lines[column], y.lines[row])
                    .expect("samples have finite coordinates"),
            })?;
            samples.push(*sample);
        }
        Ok(Self {
            x,
            y,
            samples,
            covered: points.scale.covered,
        })
    }

    /// The x coordinates of the columns, ascending.
    pub fn xs(&self) -> &[f64] {
        &self.x.lines
    }

    /// The y coordinates of the rows, ascending.
    pub fn ys(&self) -> &[f64] {
        &self.y.lines
    }

    /// Returns the index of the sample at a node.
    ///
    /// # Panics
    /// When the column or the row does not exist.
    pub fn sample(&self, column: usize, row: usize) -> usize {
        assert!(
            column < self.x.lines.len(),
            "column {column} (0-based) does not exist: the number of columns is {}",
            self.x.lines.len()
        );
        self.samples[row * self.x.lines.len() + column]
    }
}

/// The lines of a grid along one axis: its columns (x) or its rows (y).
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Axis {
    /// Coordinates of the lines, ascending.
    pub(crate) lines: Vec<f64>,
    /// The largest distance of a sample from its line.
    pub(crate) scatter: f64,
}

/// Samples that scatter about their line by less than this fraction of a cell change weights only
/// by rounding.
const NEGLIGIBLE_SCATTER: f64 = 1e-13;

impl Axis {
    /// Returns the lines, and the index of each coordinate's line.
    pub(crate) fn new(coordinates: Vec<f64>, tolerance: f64) -> (Self, Vec<usize>) {
        let mut order: Vec<usize> = (0..coordinates.len()).collect();
        order.sort_by(|&a, &b| coordinates[a].total_cmp(&coordinates[b]));
        let mut axis = Self {
            lines: Vec::new(),
            scatter: 0.0,
        };
        let mut line_of = vec![0; coordinates.len()];
        for group in order.chunk_by(|&a, &b| coordinates[b] - coordinates[a] <= tolerance) {
            let (first, last) = (coordinates[group[0]], coordinates[group[group.len() - 1]]);
            let line = if first == last {
                first
            } else {
                // A mean of differences preserves the digits of large coordinates.
                let mean = group.iter().map(|&i| coordinates[i] - first).sum::<f64>() / group.len() as f64;
                first + mean
            };
            for &i in group {
                line_of[i] = axis.lines.len();
            }
            axis.scatter = axis.scatter.max(line - first).max(last - line);
            axis.lines.push(line);
        }
        (axis, line_of)
    }

    /// Returns the cell around a coordinate (the index of its lower line) and the fraction `t` of
    /// the upper line: `v = (1 - t) lower + t upper`. Both are 0 if there is only one line.
    pub(crate) fn locate(&self, v: f64) -> (usize, f64) {
        let last = self.lines.len() - 1;
        if last == 0 {
            return (0, 0.0);
        }
        let cell = self.cell(v);
        let (a, b) = (self.lines[cell], self.lines[cell + 1]);
        // A sample that lies slightly off its line still gets its own value.
        if (v - a).abs() <= self.scatter {
            (cell, 0.0)
        } else if (v - b).abs() <= self.scatter {
            (cell, 1.0)
        } else {
            (cell, (v - a) / (b - a))
        }
    }

    /// The cell around a coordinate, or the nearest one. There must be at least two lines.
    fn cell(&self, v: f64) -> usize {
        let last = self.lines.len() - 1;
        self.lines.partition_point(|&line| line <= v).clamp(1, last) - 1
    }

    /// Returns the upper bound, excluded, of a range of integers that starts at the integer `v`.
    /// Over this range the fraction of [`Self::locate`] is linear. If the bound is not above `v`,
    /// the range contains only `v`. With `clamped`, coordinates beyond the lines are first moved to
    /// the nearest line.
    pub(crate) fn linear_until(&self, v: f64, clamped: bool) -> f64 {
        let (last, low) = (self.lines.len() - 1, self.lines[0]);
        if last == 0 {
            return f64::INFINITY;
        }
        if clamped && v < low {
            return low;
        }
        if clamped && v > self.lines[last] {
            return f64::INFINITY;
        }
        let cell = self.cell(v);
        let (a, b) = (self.lines[cell], self.lines[cell + 1]);
        let mut until = match (cell + 1 == last, clamped) {
            (false, _) => b,
            (true, true) => b.floor() + 1.0,
            (true, false) => f64::INFINITY,
        };
        if self.scatter > NEGLIGIBLE_SCATTER * (b - a) {
            let is_moved = |v: f64, line: f64| (v - line).abs() <= self.scatter;
            if is_moved(v, a) || is_moved(v, b) {
                return v;
            }
            for line in [a, b] {
                if v < line {
                    until = until.min((line - self.scatter).ceil());
                    // Corrects for rounding of the bound.
                    while until > v && is_moved(until - 1.0, line) {
                        until -= 1.0;
                    }
                }
            }
        }
        until
    }

    /// Returns whether weights are linear from line to line within rounding.
    pub(crate) fn scatter_is_harmless(&self) -> bool {
        let cells = self.lines.windows(2).map(|line| line[1] - line[0]);
        self.scatter <= NEGLIGIBLE_SCATTER * cells.fold(f64::INFINITY, f64::min)
    }

    /// Returns the coordinate at which the weights for `v` are computed: `v` itself under the
    /// policy extend, otherwise `v` clamped to the range of the lines.
    pub(crate) fn place(&self, v: f64, outside: OutsidePolicy) -> f64 {
        if outside == OutsidePolicy::Extend {
            v
        } else {
            self.clamp(v)
        }
    }

    /// Clamps `v` to the range of the lines.
    pub(crate) fn clamp(&self, v: f64) -> f64 {
        v.clamp(self.lines[0], self.lines[self.lines.len() - 1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn positions(points: &[(f64, f64)]) -> SamplePositions {
        let positions = points.iter().map(|&(x, y)| Position::new(x, y).unwrap());
        SamplePositions::new(positions.collect(), None).unwrap()
    }

    #[test]
    fn the_missing_node_is_named() {
        let mut points: Vec<(f64, f64)> = (0..12)
            .map(|i| (f64::from(i % 4) * 10.0, f64::from(i / 4)))
            .collect();
        points.remove(6);
        let error = RegularGrid::detect(&positions(&points)).unwrap_err();
        match error {
            CoeffFieldError::NotRegular {
                samples: 11,
                columns: 4,
                rows: 3,
                column: 2,
                row: 1,
                position,
            } => assert_eq!((position.x(), position.y()), (20.0, 1.0)),
            other => panic!("{other}"),
        }
    }

    #[test]
    fn rounded_coordinates_make_one_line() {
        let noise = |i: i32| f64::from(i * 7 % 3 - 1) * 1e-13;
        let points: Vec<(f64, f64)> = (0..25)
            .map(|i| (f64::from(i % 5) + noise(i), f64::from(i / 5) - noise(i + 1)))
            .collect();
        let grid = RegularGrid::detect(&positions(&points)).unwrap();
        assert_eq!((grid.xs().len(), grid.ys().len()), (5, 5));
        assert!(grid.x.scatter > 0.0 && grid.x.scatter < 1e-12);
        assert_eq!(grid.sample(3, 2), 13);
    }

    #[test]
    fn two_samples_at_one_node_are_named() {
        let points = [(0.0, 0.0), (10.0, 0.0), (0.0, 10.0), (10.0, 10.0), (1e-9, 0.0)];
        assert!(matches!(
            RegularGrid::detect(&positions(&points)),
            Err(CoeffFieldError::SharedNode {
                first: 0,
                second: 4,
                column: 0,
                row: 0,
                ..
            })
        ));
    }

    #[test]
    fn rows_columns_and_points_are_grids() {
        for points in [
            &[(3.0, 1.0)][..],
            &[(0.0, 5.0), (9.0, 5.0), (4.0, 5.0)],
            &[(1.0, 2.0), (1.0, 0.0)],
        ] {
            assert!(RegularGrid::detect(&positions(points)).is_ok());
        }
        assert!(RegularGrid::detect(&positions(&[(0.0, 0.0), (1.0, 1.0)])).is_err());
    }
}
