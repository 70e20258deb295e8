//! Samples on one line: linear interpolation along it.

use std::sync::Arc;

use psf_types::{FieldError, OutsidePolicy, Position};

use crate::geometry::{Point, Points, Row, Scale, along, dot, last_where, length, query, sub};
use crate::interpolation::{
    FieldWeights, OnRun, Visited, WeightList, admit, in_runs, pair, pixel_by_pixel, single,
};

/// Largest distance of collinear points from their line, relative to its length. Triangles between
/// such points would be slivers whose orientation depends on rounding errors.
const OFF_LINE: f64 = 1e-9;

/// Weights of one sample, of two samples, or of any number of samples on one line.
///
/// A position has the value at its foot, the nearest point of the line. This value is interpolated
/// linearly between the two samples around the foot. Beyond the ends, the value is constant
/// (nearest), or continues the straight line through the last two samples' values (extend). A
/// single sample's value applies everywhere. Under the policy error, only positions on the line and
/// between its ends are covered.
#[derive(Debug)]
pub(crate) struct LineWeights {
    points: Arc<Points>,
    /// The axis, 0 for x or 1 for y, along which the line is longer. The samples are ordered by
    /// their given coordinates along this axis, which takes no arithmetic and so no rounding.
    axis: usize,
    /// The samples, ordered along the axis.
    order: Vec<usize>,
    /// Unit vector along the line, or zero for one sample.
    direction: Point,
    outside: OutsidePolicy,
}

impl LineWeights {
    /// Returns the line through the points if they are collinear.
    pub(crate) fn detect(points: &Points, outside: OutsidePolicy) -> Option<Self> {
        let p = &points.points;
        let range = |axis: usize| {
            p.iter()
                .fold(f64::NEG_INFINITY, |m, q| m.max((q[axis] - p[0][axis]).abs()))
        };
        let axis = usize::from(range(1) > range(0));
        let mut order: Vec<usize> = (0..p.len()).collect();
        order.sort_by(|&a, &b| p[a][axis].total_cmp(&p[b][axis]));
        let (first, last) = (p[order[0]], p[order[order.len() - 1]]);
        let span = sub(last, first);
        let span_length = length(span);
        let direction = if span_length > 0.0 {
            span.map(|v| v / span_length)
        } else {
            [0.0; 2]
        };
        let off_line = p
            .iter()
            .map(|&q| dot(sub(q, first), normal(direction)).abs())
            .fold(0.0, f64::max);
        let narrowest = order
            .windows(2)
            .map(|w| p[w[1]][axis] - p[w[0]][axis])
            .fold(f64::INFINITY, f64::min);
        // Samples side by side across the line still need triangles.
        (off_line <= OFF_LINE * span_length && narrowest > 10.0 * off_line).then(|| Self {
            points: Arc::new(points.clone()),
            axis,
            order,
            direction,
            outside,
        })
    }

    /// Returns the line without one sample, or `None` if no sample is left.
    pub(crate) fn without(&self, sample: usize) -> Option<Self> {
        let order: Vec<usize> = self.order.iter().copied().filter(|&s| s != sample).collect();
        (!order.is_empty()).then(|| Self {
            points: Arc::clone(&self.points),
            axis: self.axis,
            order,
            direction: self.direction,
            outside: self.outside,
        })
    }

    /// Writes the weights at `p` and returns whether the samples cover it.
    pub(crate) fn weights(&self, p: Point, weights: &mut WeightList) -> bool {
        let at = |rank: usize| self.points.points[self.order[rank]];
        let last = self.order.len() - 1;
        let after = self
            .order
            .partition_point(|&sample| self.points.points[sample][self.axis] < p[self.axis]);
        if after <= last && at(after) == p {
            single(weights, self.order[after]);
            return true;
        }
        let Scale { covered, .. } = self.points.scale;
        if last == 0 {
            single(weights, self.order[0]);
            return length(sub(p, at(0))) <= covered;
        }
        let (off, foot) = self.foot(p);
        let (low, high) = (at(0)[self.axis], at(last)[self.axis]);
        // `foot` is measured along the axis. So along the line, the tolerance is larger than
        // `covered` by at most a factor of sqrt(2).
        let is_covered = off.abs() <= covered && low - covered <= foot && foot <= high + covered;
        let foot = if self.outside == OutsidePolicy::Extend {
            foot
        } else {
            foot.clamp(low, high)
        };
        let right = self.link(foot);
        let (a, b) = (at(right - 1)[self.axis], at(right)[self.axis]);
        pair(
            weights,
            self.order[right - 1],
            self.order[right],
            (foot - a) / (b - a),
        );
        is_covered
    }

    /// The signed distance of `p` from the line, and the coordinate of the foot of `p` along the
    /// axis.
    fn foot(&self, p: Point) -> (f64, f64) {
        let start = self.points.points[self.order[0]];
        let off = dot(sub(p, start), normal(self.direction));
        (off, along(p, -off, normal(self.direction))[self.axis])
    }

    /// The rank (index in `order`) of the second of the two samples around a foot. Beyond an end,
    /// these are the two samples at that end.
    fn link(&self, foot: f64) -> usize {
        self.order
            .partition_point(|&sample| self.points.points[sample][self.axis] <= foot)
            .clamp(1, self.order.len() - 1)
    }

    /// The piece or the end of the line that contains the foot of `p`.
    fn piece(&self, p: Point) -> Piece {
        let last = self.order.len() - 1;
        if last == 0 {
            return Piece::End(0);
        }
        let (_, foot) = self.foot(p);
        let at = |rank: usize| self.points.points[self.order[rank]][self.axis];
        if self.outside != OutsidePolicy::Extend && foot <= at(0) {
            Piece::End(0)
        } else if self.outside != OutsidePolicy::Extend && foot >= at(last) {
            Piece::End(last)
        } else {
            Piece::Link(self.link(foot))
        }
    }

    /// The columns of a row that meet a sample exactly. Such a column has the sample's value, even
    /// if the sample lies slightly off the line.
    fn hits(&self, row: Row) -> Vec<usize> {
        let points = self.order.iter().map(|&sample| self.points.points[sample]);
        let in_row = points.filter(|p| p[1] == row.y());
        let mut hits: Vec<usize> = in_row.filter_map(|p| row.column_at(p[0])).collect();
        hits.sort_unstable();
        hits
    }
}

/// A part of the line with weights that are linear in the position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Piece {
    /// Beyond the sample of this rank.
    End(usize),
    /// Between the sample of this rank and the one before it, or beyond them under the policy
    /// extend.
    Link(usize),
}

fn normal(direction: Point) -> Point {
    [-direction[1], direction[0]]
}

impl FieldWeights for LineWeights {
    fn sample_count(&self) -> usize {
        self.points.len()
    }

    fn weights_into(&self, position: Position, weights: &mut WeightList) -> Result<(), FieldError> {
        admit(self.weights(query(position)?, weights), self.outside, position)
    }

    /// A pixel that meets a sample exactly is a run of its own. The other pixels of a run have their
    /// feet on the same piece of the line: between two neighbouring samples, or beyond an end. Under
    /// the policy extend, the part beyond an end belongs to the last piece there. Under the policy
    /// error, every pixel is a run of its own.
    fn weights_along_row(&self, start: (i64, i64), length: usize, visit: OnRun<'_>) -> Visited {
        let row = Row::new(start, length);
        if self.outside == OutsidePolicy::Error {
            // Only the line itself is covered.
            return pixel_by_pixel(self, row, visit);
        }
        let hits = self.hits(row);
        let mut hits = hits.iter().copied().peekable();
        let weights_into = |column, weights: &mut WeightList| {
            self.weights(row.point(column), weights);
            Ok(())
        };
        let end_of = |column| {
            if hits.next_if_eq(&column).is_some() {
                return column + 1;
            }
            let here = self.piece(row.point(column));
            let before = hits.peek().copied().unwrap_or(length);
            1 + last_where(column, before, |column| self.piece(row.point(column)) == here)
        };
        in_runs(row, weights_into, end_of, visit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::points_of;

    fn line(points: &[Point], outside: OutsidePolicy) -> Option<LineWeights> {
        LineWeights::detect(&points_of(points), outside)
    }

    #[test]
    fn a_slanted_line_is_found_in_any_order_and_interpolated() {
        let line = line(&[[6.0, 3.0], [0.0, 0.0], [2.0, 1.0]], OutsidePolicy::Extend).unwrap();
        let mut w = Vec::new();
        // (4, 2) on the line is the foot of (3, 4).
        assert!(line.weights([4.0, 2.0], &mut w));
        assert_eq!(w, [(2, 0.5), (0, 0.5)]);
        assert!(!line.weights([3.0, 4.0], &mut w));
        assert!((w[0].1 - 0.5).abs() < 1e-15 && w[0].0 == 2);
        assert!(!line.weights([-2.0, -1.0], &mut w));
        assert_eq!(w, [(1, 2.0), (2, -1.0)]);
        assert!(line.weights([2.0, 1.0], &mut w));
        assert_eq!(w, [(2, 1.0)]);
    }

    #[test]
    fn triangles_are_no_line_but_rounded_lines_are() {
        assert!(line(&[[0.0, 0.0], [4.0, 0.0], [2.0, 1e-3]], OutsidePolicy::Nearest).is_none());
        assert!(line(&[[0.0, 0.0], [4.0, 0.0], [2.0, 1e-12]], OutsidePolicy::Nearest).is_some());
        // Two samples side by side across the line.
        assert!(
            line(
                &[[0.0, 0.0], [4.0, 0.0], [2.0, 0.0], [2.0, 1e-12]],
                OutsidePolicy::Nearest
            )
            .is_none()
        );
        assert!(line(&[[3.0, 3.0]], OutsidePolicy::Error).is_some());
    }

    #[test]
    fn only_the_segment_is_covered() {
        let line = line(&[[0.0, 0.0], [0.0, 10.0]], OutsidePolicy::Error).unwrap();
        let at = |x, y| line.weights_into(Position::new(x, y).unwrap(), &mut Vec::new());
        assert!(at(1e-12, 10.0 + 1e-12).is_ok());
        assert!(matches!(at(0.1, 5.0), Err(FieldError::OutsideSamples { .. })));
        assert!(matches!(at(0.0, 10.1), Err(FieldError::OutsideSamples { .. })));
    }
}
