//! Weights of a grid's lines along one axis.

use crate::axis::Axis;

/// The most lines that have a weight at a coordinate.
const LINES: usize = 4;
/// Pieces of a cell along which cubic weights are taken as linear: 1 / 25 of the error of one piece. Their number is odd, so that
/// a line that is left out lies in the middle of one, and leave-one-out errors have their part.
const PIECES: usize = 5;
/// The largest sum of the magnitudes of weights: of four evenly spaced lines it is 1.25, of the four at an edge 1.63. Beyond
/// it, lines are spaced so unevenly that a polynomial through them swings, and one of lower degree takes its place.
const LARGEST_SUM: f64 = 2.0;
/// A cell this many times as wide as its lines scatter is cut into pieces.
const WIDER_THAN_SCATTER: f64 = 1e3;

/// Weights of neighbouring lines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LineWeights {
    first: usize,
    weights: [f64; LINES],
}

/// The weights of a grid's lines at any coordinate, linear between knots: between the lines themselves, or at points on a
/// cubic between them.
#[derive(Debug, Clone)]
pub(crate) struct AxisWeights {
    knots: Axis,
    /// Between each knot and the next; one where there is one knot.
    pieces: Vec<Piece>,
}

#[derive(Debug, Clone, Copy)]
struct Piece {
    first: usize,
    low: [f64; LINES],
    high: [f64; LINES],
}

impl LineWeights {
    /// The lines with a weight, and their weights.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        let lines = self.weights.iter().enumerate().filter(|(_, w)| **w != 0.0);
        lines.map(|(i, &weight)| (self.first + i, weight))
    }
}

impl AxisWeights {
    /// Linear from line to line.
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
        }
    }

    /// On the cubic through the two lines on either side, or the four at an edge.
    pub(crate) fn cubic(lines: &Axis) -> Self {
        let cells = lines.lines.len() - 1;
        if cells == 0 {
            return Self::linear(lines);
        }
        let mut knots = Axis {
            lines: vec![lines.lines[0]],
            scatter: lines.scatter,
        };
        let mut pieces = Vec::with_capacity(cells * PIECES);
        for cell in 0..cells {
            let between = points_between(lines, cell);
            let stencil = Stencil::around(&lines.lines, cell, &between);
            let mut low = stencil.of_line(cell);
            let values = between.iter().map(|&v| stencil.weights(&lines.lines, v));
            for high in values.chain([stencil.of_line(cell + 1)]) {
                pieces.push(Piece {
                    first: stencil.first,
                    low,
                    high,
                });
                low = high;
            }
            knots.lines.extend(between);
            knots.lines.push(lines.lines[cell + 1]);
        }
        Self { knots, pieces }
    }

    /// Between which the weights are linear.
    pub(crate) fn knots(&self) -> &Axis {
        &self.knots
    }

    /// The weights at a coordinate; beyond the lines those of the last piece, linearly continued.
    pub(crate) fn at(&self, v: f64) -> LineWeights {
        let (piece, t) = self.knots.locate(v);
        let Piece { first, low, high } = &self.pieces[piece];
        LineWeights {
            first: *first,
            weights: std::array::from_fn(|i| (1.0 - t) * low[i] + t * high[i]),
        }
    }
}

fn unit(line: usize) -> [f64; LINES] {
    std::array::from_fn(|i| if i == line { 1.0 } else { 0.0 })
}

/// The ends of a cell's pieces but for the cell's own.
fn points_between(lines: &Axis, cell: usize) -> Vec<f64> {
    let (a, b) = (lines.lines[cell], lines.lines[cell + 1]);
    // A straight line passes through two lines alone.
    if lines.lines.len() == 2 || b - a <= WIDER_THAN_SCATTER * lines.scatter {
        return Vec::new();
    }
    let points: Vec<f64> = (1..PIECES)
        .map(|i| a + (b - a) * (i as f64 / PIECES as f64))
        .collect();
    let ascending = |v: &[f64]| v[0] < v[1];
    // Lines so close that there is nothing but rounding between them stay as they are.
    let is_apart = a < points[0] && points.windows(2).all(ascending) && points[PIECES - 2] < b;
    if is_apart { points } else { Vec::new() }
}

/// Neighbouring lines with the polynomial through their values.
#[derive(Debug, Clone, Copy)]
struct Stencil {
    first: usize,
    count: usize,
}

impl Stencil {
    /// The highest degree up to 3 whose weights are well behaved at these points of a cell.
    fn around(lines: &[f64], cell: usize, points: &[f64]) -> Self {
        (3..=LINES.min(lines.len()))
            .rev()
            .find_map(|count| {
                let from = (cell + 2).saturating_sub(count);
                let to = cell.min(lines.len() - count);
                let stencils = (from..=to).map(|first| Self { first, count });
                let judged = stencils.map(|stencil| (stencil.largest_sum(lines, points), stencil));
                let best = judged.reduce(|a, b| if b.0 < a.0 { b } else { a })?;
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

    /// Lagrange's polynomials.
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
    fn cubics_are_met_at_the_knots_of_uneven_lines() {
        let lines = [0.0, 1.0, 2.2, 3.5, 4.6, 5.8];
        let weights = AxisWeights::cubic(&axis(&lines));
        let cubic = |v: f64| 1.0 + v * (2.0 - v * (0.5 - 0.1 * v));
        let knots = &weights.knots().lines;
        assert_eq!(knots.len(), 5 * PIECES + 1);
        for &knot in knots {
            let error = value(&weights, &lines, knot, cubic) - cubic(knot);
            assert!(error.abs() < ROUNDING * 100.0, "{knot}: {error:e}");
        }
        // Between knots, and beyond the last, straight on.
        for (a, b) in [(0, 1), (5, 6)] {
            let middle = value(&weights, &lines, f64::midpoint(knots[a], knots[b]), cubic);
            assert!((middle - f64::midpoint(cubic(knots[a]), cubic(knots[b]))).abs() < ROUNDING * 100.0);
        }
        let before = knots[knots.len() - 2];
        let beyond = value(&weights, &lines, 5.8 + (5.8 - before), cubic);
        assert!((beyond - (2.0 * cubic(5.8) - cubic(before))).abs() < ROUNDING * 1e3);
    }

    #[test]
    fn lines_that_would_let_a_cubic_swing_are_left_out() {
        let lines = [0.0, 1.0, 1001.0, 1002.0];
        let weights = AxisWeights::cubic(&axis(&lines));
        for v in [200.0, 501.0, 900.0] {
            let sum: f64 = weights.at(v).iter().map(|(_, w)| w.abs()).sum();
            assert!(sum <= LARGEST_SUM, "{v}: {sum}");
        }
        assert_eq!(
            weights.at(501.0),
            LineWeights {
                first: 1,
                weights: [0.5, 0.5, 0.0, 0.0]
            }
        );
        // The narrow cells have nothing to fear of far lines.
        assert_eq!(weights.at(0.5).iter().count(), 4);
    }

    #[test]
    fn few_lines_and_lines_next_to_each_other_are_served() {
        assert_eq!(
            AxisWeights::cubic(&axis(&[3.0]))
                .at(9.0)
                .iter()
                .collect::<Vec<_>>(),
            [(0, 1.0)]
        );
        assert_eq!(AxisWeights::cubic(&axis(&[3.0, 5.0])).knots().lines, [3.0, 5.0]);
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
