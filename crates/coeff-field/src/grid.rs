//! Samples on a regular grid, and the weights of grid lines along one axis.

use std::collections::HashMap;
use std::ops::Range;

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

/// The largest number of lines with a nonzero weight at a coordinate.
const LINES: usize = 4;
/// A cell is cut into this number of pieces. Between their ends, cubic weights are replaced by
/// linear ones. The error of this replacement is 1/25 of the error with one piece. The number is
/// odd, so that a line that leave-one-out omits lies in the middle of a piece. Leave-one-out errors
/// then include the error of the replacement.
const PIECES: usize = 5;
/// The largest allowed sum of the weights' magnitudes. Four evenly spaced lines reach 1.25, at an
/// edge 1.63. A sum above the limit means that the spacing is too uneven: a polynomial through the
/// lines would oscillate, and one of lower degree replaces it.
const LARGEST_SUM: f64 = 2.0;
/// A cell is cut into pieces only if it is wider than this multiple of the scatter of its lines.
const MIN_WIDTH_OVER_SCATTER: f64 = 1e3;

/// Weights of neighbouring lines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct NeighbouringLines {
    first: usize,
    weights: [f64; LINES],
}

/// The weights of a grid's lines at any coordinate. Weights are linear between knots. The knots are
/// the lines and, for cubics, also points inside each cell.
#[derive(Debug, Clone)]
pub(crate) struct AxisWeights {
    pub(crate) knots: Axis,
    /// One piece between each knot and the next, or a single one if there is one knot.
    pieces: Vec<Piece>,
    /// The cells with knots inside, in ascending order.
    cut: Vec<CutCell>,
}

/// A cell in which the weights are those of a cubic at [`PIECES`] - 1 knots.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CutCell {
    /// The coordinates of the cell's own lines.
    pub(crate) sides: (f64, f64),
    /// The index of the first knot inside the cell.
    inside: usize,
    /// The first line with a weight.
    pub(crate) first: usize,
    /// The second derivatives of the lines' weights at both sides, multiplied by the square of a
    /// piece's length. Between the sides, they are linear.
    pub(crate) second_derivatives: [[f64; LINES]; 2],
}

#[derive(Debug, Clone, Copy)]
struct Piece {
    first: usize,
    low: [f64; LINES],
    high: [f64; LINES],
}

impl NeighbouringLines {
    /// The lines with nonzero weight, and their weights.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        let lines = self.weights.iter().enumerate().filter(|(_, w)| **w != 0.0);
        lines.map(|(i, &weight)| (self.first + i, weight))
    }
}

impl AxisWeights {
    /// Weights that are linear from line to line.
    pub(crate) fn linear(lines: &Axis) -> Self {
        let cells = lines.lines.len().saturating_sub(1).max(1);
        Self {
            knots: lines.clone(),
            pieces: (0..cells)
                .map(|first| Piece {
                    first,
                    low: unit(0),
                    high: unit(1),
                })
                .collect(),
            cut: Vec::new(),
        }
    }

    /// Weights that equal, at the knots, the weights of a cubic interpolation. The cubic passes
    /// through the two lines on either side of a cell, or, in a cell at an edge, through the four
    /// outermost lines.
    pub(crate) fn cubic(lines: &Axis) -> Self {
        let cells = lines.lines.len() - 1;
        if cells == 0 {
            return Self::linear(lines);
        }
        let mut knots = Axis {
            lines: vec![lines.lines[0]],
            scatter: lines.scatter,
        };
        let (mut pieces, mut cut) = (Vec::with_capacity(cells * PIECES), Vec::new());
        for cell in 0..cells {
            let between = points_between(lines, cell);
            let stencil = Stencil::around(&lines.lines, cell, &between);
            let mut low = stencil.of_line(cell);
            let inside = knots.lines.len();
            let values = between.iter().map(|&v| stencil.weights(&lines.lines, v));
            for high in values.chain([stencil.of_line(cell + 1)]) {
                pieces.push(Piece {
                    first: stencil.first,
                    low,
                    high,
                });
                low = high;
            }
            if !between.is_empty() {
                cut.push(CutCell {
                    sides: (lines.lines[cell], lines.lines[cell + 1]),
                    inside,
                    first: stencil.first,
                    second_derivatives: second_derivatives(&pieces[pieces.len() - PIECES..]),
                });
            }
            knots.lines.extend(between);
            knots.lines.push(lines.lines[cell + 1]);
        }
        Self { knots, pieces, cut }
    }

    /// The weights at a coordinate. Beyond the lines, the outermost piece continues linearly.
    pub(crate) fn at(&self, v: f64) -> NeighbouringLines {
        let (piece, t) = self.knots.locate(v);
        let Piece { first, low, high } = &self.pieces[piece];
        NeighbouringLines {
            first: *first,
            weights: std::array::from_fn(|i| (1.0 - t) * low[i] + t * high[i]),
        }
    }

    /// Some of the knots between two coordinates, and the largest error of values that are linear
    /// from one to the next of these knots. The error is at most `error`. `bends` returns how values
    /// bend in a cell, for one or more lines along the axis.
    pub(crate) fn knots_between(
        &self,
        (low, high): (f64, f64),
        error: f64,
        bends: impl Fn(&CutCell) -> Vec<Bend>,
    ) -> (Vec<f64>, f64) {
        let (mut kept, mut achieved) = (Vec::new(), 0.0_f64);
        let mut next = self.knots.lines.partition_point(|&knot| knot <= low);
        let end = self.knots.lines.partition_point(|&knot| knot < high);
        let from = self.cut.partition_point(|cell| cell.sides.1 <= low);
        let cells = self.cut[from..].iter().take_while(|cell| cell.sides.0 < high);
        for cell in cells.filter(|_| error > 0.0) {
            let bends = bends(cell);
            let error_of = |inside: &[usize]| bends.iter().map(|bend| bend.error(inside)).fold(0.0, f64::max);
            let rated = DIVISIONS.iter().map(|&inside| (inside, error_of(inside)));
            let Some((inside, of_cell)) = rated.into_iter().find(|(_, of_cell)| *of_cell <= error) else {
                continue;
            };
            achieved = achieved.max(of_cell);
            let (first, last) = (cell.inside, cell.inside + PIECES - 1);
            kept.extend(next..first);
            kept.extend(
                inside
                    .iter()
                    .map(|knot| cell.inside + knot - 1)
                    .filter(|&knot| knot >= next),
            );
            next = next.max(last);
        }
        kept.extend(next..end);
        kept.retain(|&knot| knot < end);
        (
            kept.into_iter().map(|knot| self.knots.lines[knot]).collect(),
            achieved,
        )
    }

    /// The lines with a weight between two coordinates, and the largest sum of their weights'
    /// magnitudes.
    pub(crate) fn lines_between(&self, (low, high): (f64, f64)) -> (Range<usize>, f64) {
        let inside = self.knots_between((low, high), 0.0, |_| Vec::new()).0;
        let (mut lines, mut largest) = (Vec::new(), 0.0_f64);
        for v in inside.into_iter().chain([low, high]) {
            let weights = self.at(v);
            largest = largest.max(weights.iter().map(|(_, weight)| weight.abs()).sum());
            lines.extend(weights.iter().map(|(line, _)| line));
        }
        lines.sort_unstable();
        (lines[0]..lines[lines.len() - 1] + 1, largest)
    }
}

/// The inner knots at which a cell can be divided, the fewest first. Knot `k` is `k` pieces after the
/// cell's first side.
const DIVISIONS: [&[usize]; 3] = [&[], &[2], &[2, 3]];

/// The second derivatives `a` and `b` of values at the two sides of a cell, multiplied by the square of
/// a piece's length: the scalar products `a a`, `a b` and `b b`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bend(pub(crate) [f64; 3]);

impl Bend {
    /// A bound of the error's norm, if values are linear between the sides of the cell and some of its
    /// inner knots, or between any coordinates in between.
    ///
    /// Values are linear between knots. At knot `k`, their slope changes by the second derivative of the
    /// cubic at that knot, times the length of a piece. From `s` to `e`, a straight line is off at `t` by
    /// the sum of these changes times Green's function `(min(t, k) - s) (e - max(t, k)) / (e - s)`. This
    /// function is smaller on every part of `s` to `e`.
    fn error(self, inside: &[usize]) -> f64 {
        let Self([aa, ab, bb]) = self;
        let size_at = |knot: usize| {
            let part = knot as f64 / PIECES as f64;
            let square = (1.0 - part).powi(2) * aa + 2.0 * part * (1.0 - part) * ab + part * part * bb;
            square.max(0.0).sqrt()
        };
        let (mut largest, mut start) = (0.0_f64, 0);
        for &end in inside.iter().chain([&PIECES]) {
            for t in start + 1..end {
                let of_knot = |knot: usize| {
                    let green = ((t.min(knot) - start) * (end - t.max(knot))) as f64 / (end - start) as f64;
                    green * size_at(knot)
                };
                largest = largest.max((start + 1..end).map(of_knot).sum());
            }
            start = end;
        }
        largest
    }
}

/// The second derivatives of a cell's cubic weights at its two sides, from the weights at its first
/// and at its last four knots.
fn second_derivatives(pieces: &[Piece]) -> [[f64; LINES]; 2] {
    let at_side = |knots: [&[f64; LINES]; 4]| {
        std::array::from_fn(|i| {
            let [a, b, c, d] = knots.map(|weights| weights[i]);
            2.0 * a - 5.0 * b + 4.0 * c - d
        })
    };
    let last = pieces.len() - 1;
    [
        at_side([&pieces[0].low, &pieces[0].high, &pieces[1].high, &pieces[2].high]),
        at_side([
            &pieces[last].high,
            &pieces[last].low,
            &pieces[last - 1].low,
            &pieces[last - 2].low,
        ]),
    ]
}

fn unit(line: usize) -> [f64; LINES] {
    std::array::from_fn(|i| if i == line { 1.0 } else { 0.0 })
}

/// The knots inside a cell, without the cell's own ends.
fn points_between(lines: &Axis, cell: usize) -> Vec<f64> {
    let (a, b) = (lines.lines[cell], lines.lines[cell + 1]);
    // The polynomial through only two lines is straight, so it needs no pieces.
    if lines.lines.len() == 2 || b - a <= MIN_WIDTH_OVER_SCATTER * lines.scatter {
        return Vec::new();
    }
    let points: Vec<f64> = (1..PIECES)
        .map(|i| a + (b - a) * (i as f64 / PIECES as f64))
        .collect();
    let ascending = |v: &[f64]| v[0] < v[1];
    // A cell is not cut if it is so narrow that rounding makes two of its knots equal.
    let is_apart = a < points[0] && points.windows(2).all(ascending) && points[PIECES - 2] < b;
    if is_apart { points } else { Vec::new() }
}

/// Neighbouring lines. Their weights evaluate the polynomial that passes through the values at
/// these lines.
#[derive(Debug, Clone, Copy)]
struct Stencil {
    first: usize,
    count: usize,
}

impl Stencil {
    /// Returns a stencil of the highest degree, up to 3, whose weights' magnitudes sum to at most
    /// [`LARGEST_SUM`] at these points of a cell. Among stencils of that degree, it has the
    /// smallest sum.
    fn around(lines: &[f64], cell: usize, points: &[f64]) -> Self {
        (3..=LINES.min(lines.len()))
            .rev()
            .find_map(|count| {
                let from = (cell + 2).saturating_sub(count);
                let to = cell.min(lines.len() - count);
                let stencils = (from..=to).map(|first| Self { first, count });
                let rated = stencils.map(|stencil| (stencil.largest_sum(lines, points), stencil));
                let best = rated.reduce(|a, b| if b.0 < a.0 { b } else { a })?;
                (best.0 <= LARGEST_SUM).then_some(best.1)
            })
            .unwrap_or(Self {
                first: cell,
                count: 2,
            })
    }

    fn largest_sum(self, lines: &[f64], points: &[f64]) -> f64 {
        let sums = points
            .iter()
            .map(|&v| self.weights(lines, v).iter().map(|w| w.abs()).sum::<f64>());
        sums.fold(0.0, f64::max)
    }

    fn of_line(self, line: usize) -> [f64; LINES] {
        unit(line - self.first)
    }

    /// The values of Lagrange's polynomials at a coordinate.
    fn weights(self, lines: &[f64], v: f64) -> [f64; LINES] {
        let own = &lines[self.first..self.first + self.count];
        std::array::from_fn(|i| {
            if i >= self.count {
                return 0.0;
            }
            let others = own.iter().enumerate().filter(|(other, _)| *other != i);
            others.map(|(_, &x)| (v - x) / (own[i] - x)).product()
        })
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

    /// Rounding of sums of four terms.
    const ROUNDING: f64 = 1e-13;

    fn axis(lines: &[f64]) -> Axis {
        Axis {
            lines: lines.to_vec(),
            scatter: 0.0,
        }
    }

    fn value(weights: &AxisWeights, lines: &[f64], v: f64, f: impl Fn(f64) -> f64) -> f64 {
        weights.at(v).iter().map(|(line, w)| w * f(lines[line])).sum()
    }

    #[test]
    fn cubics_are_exact_at_the_knots_of_uneven_lines() {
        let lines = [0.0, 1.0, 2.2, 3.5, 4.6, 5.8];
        let weights = AxisWeights::cubic(&axis(&lines));
        let cubic = |v: f64| 1.0 + v * (2.0 - v * (0.5 - 0.1 * v));
        let knots = &weights.knots.lines;
        assert_eq!(knots.len(), 5 * PIECES + 1);
        for &knot in knots {
            let error = value(&weights, &lines, knot, cubic) - cubic(knot);
            assert!(error.abs() < ROUNDING * 100.0, "{knot}: {error:e}");
        }
        // Values between knots, and beyond the last one, lie on straight lines.
        for (a, b) in [(0, 1), (5, 6)] {
            let middle = value(&weights, &lines, f64::midpoint(knots[a], knots[b]), cubic);
            assert!((middle - f64::midpoint(cubic(knots[a]), cubic(knots[b]))).abs() < ROUNDING * 100.0);
        }
        let before = knots[knots.len() - 2];
        let beyond = value(&weights, &lines, 5.8 + (5.8 - before), cubic);
        assert!((beyond - (2.0 * cubic(5.8) - cubic(before))).abs() < ROUNDING * 1e3);
    }

    #[test]
    fn fewer_lines_are_used_where_a_cubic_would_oscillate() {
        let lines = [0.0, 1.0, 1001.0, 1002.0];
        let weights = AxisWeights::cubic(&axis(&lines));
        for v in [200.0, 501.0, 900.0] {
            let sum: f64 = weights.at(v).iter().map(|(_, w)| w.abs()).sum();
            assert!(sum <= LARGEST_SUM, "{v}: {sum}");
        }
        assert_eq!(
            weights.at(501.0),
            NeighbouringLines {
                first: 1,
                weights: [0.5, 0.5, 0.0, 0.0]
            }
        );
        // A narrow cell still uses all four lines, since distant lines have small weights there.
        assert_eq!(weights.at(0.5).iter().count(), 4);
    }

    #[test]
    fn cubics_work_with_few_or_very_close_lines() {
        assert_eq!(
            AxisWeights::cubic(&axis(&[3.0]))
                .at(9.0)
                .iter()
                .collect::<Vec<_>>(),
            [(0, 1.0)]
        );
        assert_eq!(AxisWeights::cubic(&axis(&[3.0, 5.0])).knots.lines, [3.0, 5.0]);
        let parabola = AxisWeights::cubic(&axis(&[0.0, 4.0, 8.0]));
        assert!((value(&parabola, &[0.0, 4.0, 8.0], 4.8, |v| v * v) - 23.04).abs() < ROUNDING * 100.0);
        let close = [1.0, 1.0 + f64::EPSILON, 2.0];
        let weights = AxisWeights::cubic(&axis(&close));
        for v in [1.0, close[1], 1.5, 2.0] {
            assert!(
                (value(&weights, &close, v, |_| 1.0) - 1.0).abs() < ROUNDING,
                "{v}"
            );
        }
    }
}
