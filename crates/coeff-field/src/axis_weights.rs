//! The weights of a grid's lines along one axis.

use std::ops::Range;

use crate::grid::Axis;

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

/// A cell with knots inside. At its knots, the weights are those of a polynomial of degree 3 or
/// less.
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

    /// The knots between two coordinates.
    pub(crate) fn all_knots_between(&self, (low, high): (f64, f64)) -> Vec<f64> {
        let knots = self.knots.lines.iter().copied();
        knots.filter(|&knot| low < knot && knot < high).collect()
    }

    /// Some of the knots between two coordinates, and the largest error of values that are linear
    /// from one to the next of these knots. The error is at most `error`. With an error of 0, these
    /// are all knots. `bends` returns how values bend in a cell, for one or more lines along the
    /// axis.
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
        let inside = self.all_knots_between((low, high));
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

/// The inner knots at which a cell can be divided, the fewest first. Knot `k` is `k` pieces after
/// the cell's first side.
const DIVISIONS: [&[usize]; 3] = [&[], &[2], &[2, 3]];

/// The second derivatives `a` and `b` of values at the two sides of a cell, multiplied by the
/// square of a piece's length: the scalar products `a a`, `a b` and `b b`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bend(pub(crate) [f64; 3]);

impl Bend {
    /// A bound of the error's norm, if values are linear between the sides of the cell and some of
    /// its inner knots, or between any coordinates in between.
    ///
    /// Values are linear between knots. At knot `k`, their slope changes by the second derivative
    /// of the cubic at that knot, times the length of a piece. From `s` to `e`, a straight line is
    /// off at `t` by the sum of these changes times Green's function
    /// `(min(t, k) - s) (e - max(t, k)) / (e - s)`. This function is smaller on every part of `s` to
    /// `e`.
    fn error(self, inside: &[usize]) -> f64 {
        let Self([aa, ab, bb]) = self;
        let size_at = |knot: usize| {
            let part = knot as f64 / PIECES as f64;
            let square = (1.0 - part).powi(2) * aa + 2.0 * part * (1.0 - part) * ab + part * part * bb;
            // Not a number if the scalar products overflow.
            if square.is_nan() {
                f64::INFINITY
            } else {
                square.max(0.0).sqrt()
            }
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
    let points = inner_points(a, b);
    let ascending = |v: &[f64]| v[0] < v[1];
    // A cell is not cut if it is so narrow that rounding makes two of its knots equal.
    let is_apart = a < points[0] && points.windows(2).all(ascending) && points[PIECES - 2] < b;
    if is_apart { points.to_vec() } else { Vec::new() }
}

/// The points that divide an interval into [`PIECES`] equal pieces.
fn inner_points(a: f64, b: f64) -> [f64; PIECES - 1] {
    std::array::from_fn(|i| a + (b - a) * ((i + 1) as f64 / PIECES as f64))
}

/// The weights `l_s(v)` of states, such as wavelengths, at a value `v` between them: pairs of a state
/// and its weight. Their sum is 1. `states` are the values of the states, ascending.
///
/// The interpolation is cubic, through the two states on either side (at an end, through the four
/// outermost ones). With uneven distances at which a cubic would oscillate, and with fewer than four
/// states, the degree is lower. Beyond the first and the last state, the PSF stays that of this
/// state.
///
/// ```
/// use coeff_field::state_weights;
/// assert_eq!(state_weights(&[0.5, 0.75], 0.625), [(0, 0.5), (1, 0.5)]);
/// assert_eq!(state_weights(&[0.5, 0.75], 0.9), [(1, 1.0)]);
/// ```
///
/// # Panics
/// When there are no states.
pub fn state_weights(states: &[f64], v: f64) -> Vec<(usize, f64)> {
    let last = states.len() - 1;
    let above = states.partition_point(|&state| state <= v);
    if above == 0 || above > last {
        return vec![(above.min(last), 1.0)];
    }
    // The stencil is that of the whole interval, so that the weights are continuous.
    let points = inner_points(states[above - 1], states[above]);
    let stencil = Stencil::around(states, above - 1, &points);
    let weights = stencil.weights(states, v).into_iter().enumerate();
    let nonzero = weights.filter(|(_, w)| *w != 0.0);
    nonzero.map(|(i, w)| (stencil.first + i, w)).collect()
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
