//! The coordinates of the samples as checked `f64` values, their convex hull, and rows of pixels of
//! the frame.

use std::collections::HashMap;

use psf_types::maths::ConvexHull;
use psf_types::{FieldError, OutsidePolicy, PixelRegion, Position, SamplePositions};

use crate::error::CoeffFieldError;

/// Coordinates in pixels. Each is 0 or has a magnitude between `SMALLEST` and `LARGEST`.
pub(crate) type Point = [f64; 2];

/// Largest allowed magnitude of a coordinate. Products of four such coordinates, as in the test of
/// a circumcircle, do not overflow.
const LARGEST: f64 = 1e50;
/// Coordinates of smaller magnitude count as 0, so that products of four coordinates do not
/// underflow.
const SMALLEST: f64 = 1e-40;
/// Largest distance outside the samples at which a position still counts as covered, relative to
/// the samples' extent (or to one pixel, if that is more). This distance is well above the rounding
/// of coordinates, and a PSF does not change over it.
const COVERED: f64 = 1e-9;
/// The rounding error of coordinates after a few operations, relative to the largest coordinate.
const ROUNDING: f64 = 4.0 * f64::EPSILON;
/// Differences larger than this fraction of the samples' extent never count as rounding.
const MAX_SCATTER_OF_EXTENT: f64 = 1e-7;

/// The samples' coordinates and their length scales.
#[derive(Debug, Clone)]
pub(crate) struct Points {
    pub(crate) points: Vec<Point>,
    pub(crate) scale: Scale,
}

/// The extent of the samples, and the distances below which differences count as rounding.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scale {
    /// Positions up to this distance outside the samples still count as covered.
    pub(crate) covered: f64,
    /// Samples up to this distance from a line count as lying on it.
    pub(crate) rounding: f64,
    /// The larger side of the bounding box.
    pub(crate) extent: f64,
}

impl Points {
    pub(crate) fn new(positions: &SamplePositions) -> Result<Self, CoeffFieldError> {
        let mut points = Vec::with_capacity(positions.len());
        let mut seen = HashMap::with_capacity(positions.len());
        for (sample, &position) in positions.as_slice().iter().enumerate() {
            let point = representable(position).ok_or(CoeffFieldError::SampleRange {
                sample,
                position,
                limit: LARGEST,
            })?;
            if let Some(first) = seen.insert(point.map(f64::to_bits), sample) {
                return Err(CoeffFieldError::CoincidentSamples {
                    first,
                    second: sample,
                    position,
                });
            }
            points.push(point);
        }
        let scale = Scale::of(&points);
        Ok(Self { points, scale })
    }

    /// Selects some of the points and keeps the scale of all of them.
    pub(crate) fn subset(&self, samples: impl Iterator<Item = usize>) -> Self {
        Self {
            points: samples.map(|s| self.points[s]).collect(),
            scale: self.scale,
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.points.len()
    }
}

impl Scale {
    fn of(points: &[Point]) -> Self {
        let ((x0, x1), (y0, y1)) = (range(points, 0), range(points, 1));
        let extent = (x1 - x0).max(y1 - y0);
        let largest = x0.abs().max(x1.abs()).max(y0.abs()).max(y1.abs());
        let rounding = ROUNDING * largest;
        Self {
            covered: (COVERED * extent.max(1.0)).max(rounding),
            rounding: rounding.min(MAX_SCATTER_OF_EXTENT * extent),
            extent,
        }
    }
}

/// The smallest and the largest coordinate of points along an axis.
pub(crate) fn range(points: &[Point], axis: usize) -> (f64, f64) {
    let values = points.iter().map(|p| p[axis]);
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| {
        (a.min(v), b.max(v))
    })
}

/// Converts a requested position to a point.
pub(crate) fn query(position: Position) -> Result<Point, FieldError> {
    representable(position).ok_or_else(|| {
        external(
            position,
            CoeffFieldError::QueryRange {
                position,
                limit: LARGEST,
            },
        )
    })
}

pub(crate) fn external(position: Position, error: CoeffFieldError) -> FieldError {
    FieldError::External {
        position,
        source: Box::new(error),
    }
}

fn representable(position: Position) -> Option<Point> {
    let flush = |v: f64| if v.abs() < SMALLEST { 0.0 } else { v };
    let point = [flush(position.x()), flush(position.y())];
    point.iter().all(|v| v.abs() <= LARGEST).then_some(point)
}

/// Returns an error for an outside policy that this version does not know.
pub(crate) fn known(outside: OutsidePolicy) -> Result<OutsidePolicy, CoeffFieldError> {
    match outside {
        OutsidePolicy::Nearest | OutsidePolicy::Extend | OutsidePolicy::Error => Ok(outside),
        other => Err(CoeffFieldError::UnknownOutsidePolicy(other)),
    }
}

pub(crate) fn sub(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

/// Returns `a + s d`.
pub(crate) fn along(a: Point, s: f64, d: Point) -> Point {
    [a[0] + s * d[0], a[1] + s * d[1]]
}

pub(crate) fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// Twice the area of the triangle (0, a, b). It is positive when b lies to the left of a.
pub(crate) fn cross(a: Point, b: Point) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

pub(crate) fn length(a: Point) -> f64 {
    a[0].hypot(a[1])
}

/// The parameter, from 0 to 1, of the point on the segment a b that is nearest to p.
pub(crate) fn foot_on_segment(a: Point, b: Point, p: Point) -> f64 {
    let ab = sub(b, a);
    (dot(sub(p, a), ab) / dot(ab, ab)).clamp(0.0, 1.0)
}

/// If the rounding error of coordinates is below this fraction of the hull's width and of its
/// height, the error changes weights by no more than the rounding in their computation.
const PRECISE: f64 = 1e-13;

/// The convex hull of the samples, for interpolators without a triangulation.
#[derive(Debug, Clone)]
pub(crate) struct Hull {
    outline: ConvexHull,
    /// The samples at the corners, ascending.
    corner_samples: Vec<usize>,
    scale: Scale,
    /// The shorter side of the bounding box.
    narrower: f64,
    pub(crate) outside: OutsidePolicy,
}

/// A part of the plane: the hull itself, or a region outside the hull. For all positions in such a
/// region, the nearest points of the hull lie on the same edge, or are the same corner. Each part
/// is convex, and in it the nearest point of the hull is linear in the position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum HullPiece {
    /// The hull itself.
    Inside,
    /// The positions nearest to the edge that starts at this corner.
    Edge(usize),
    /// The positions nearest to this corner.
    Corner(usize),
}

impl Hull {
    /// The hull of some points. Returns an error for a policy that this version does not know.
    pub(crate) fn new(points: &Points, outside: OutsidePolicy) -> Result<Self, CoeffFieldError> {
        let hull = ConvexHull::new(&points.points);
        let mut corner_samples = hull.indices().to_vec();
        corner_samples.sort_unstable();
        let [x, y] = [0, 1].map(|axis| range(hull.corners(), axis));
        Ok(Self {
            corner_samples,
            scale: points.scale,
            narrower: (x.1 - x.0).min(y.1 - y.0),
            outline: hull,
            outside: known(outside)?,
        })
    }

    /// Returns whether a sample is a corner, so that removing it shrinks the hull.
    pub(crate) fn is_corner(&self, sample: usize) -> bool {
        self.corner_samples.binary_search(&sample).is_ok()
    }

    /// Returns whether `p` lies in the hull, or so little outside that it counts as covered.
    pub(crate) fn covers(&self, p: Point) -> bool {
        length(sub(self.piece(p).1, p)) <= self.scale.covered
    }

    /// Returns the point at which the weights for `position` are computed under the policy. Inside
    /// the hull it is the position itself.
    pub(crate) fn admit(&self, position: Position) -> Result<Point, FieldError> {
        let p = query(position)?;
        let place = self.place(p);
        let distance = length(sub(place, p));
        // By rounding, a sample on an edge may lie slightly outside the hull. It must keep its
        // exact value.
        if distance <= self.scale.rounding {
            Ok(p)
        } else if self.outside == OutsidePolicy::Nearest || distance <= self.scale.covered {
            Ok(place)
        } else {
            Err(FieldError::OutsideSamples { position })
        }
    }

    /// The point at which weights for `p` are computed under the policies nearest and extend. `p`
    /// counts as covered under the policy error.
    pub(crate) fn place(&self, p: Point) -> Point {
        match self.outside {
            OutsidePolicy::Extend => p,
            _ => self.piece(p).1,
        }
    }

    /// Returns whether the rounding of points on the hull is too small, relative to the hull's
    /// width and height, to affect a linear function.
    pub(crate) fn is_precise(&self) -> bool {
        self.scale.rounding <= PRECISE * self.narrower
    }

    /// Returns the piece that contains `p`, and the point of the hull nearest to `p`.
    pub(crate) fn piece(&self, p: Point) -> (HullPiece, Point) {
        if self.contains(p) {
            return (HullPiece::Inside, p);
        }
        let c = self.outline.corners();
        let mut best = (f64::INFINITY, (HullPiece::Corner(0), c[0]));
        // The two edges of a hull with two corners are one segment, so the first is enough.
        let edges = if c.len() == 2 { 1 } else { c.len() };
        for (i, &a) in c[..edges].iter().enumerate() {
            let end = (i + 1) % c.len();
            let b = c[end];
            let found = if c.len() == 1 {
                (HullPiece::Corner(0), a)
            } else {
                match foot_on_segment(a, b, p) {
                    0.0 => (HullPiece::Corner(i), a),
                    1.0 => (HullPiece::Corner(end), b),
                    s => (HullPiece::Edge(i), along(a, s, sub(b, a))),
                }
            };
            let distance = length(sub(found.1, p));
            if distance < best.0 {
                best = (distance, found);
            }
        }
        best.1
    }

    /// Returns whether `p` lies in the closed hull.
    pub(crate) fn contains(&self, p: Point) -> bool {
        self.outline.contains(p)
    }
}

/// The smallest and the largest coordinate of a region's pixels along both axes.
pub(crate) fn pixel_ranges(region: PixelRegion) -> [(f64, f64); 2] {
    let (x, y, shape) = (region.x0(), region.y0(), region.shape());
    [(x, shape.nx()), (y, shape.ny())].map(|(first, count)| (first as f64, (first + count as i64 - 1) as f64))
}

/// Neighbouring pixels in a row of the frame. Columns are counted from the first of these pixels.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Row {
    x: i64,
    y: i64,
    pub(crate) length: usize,
}

impl Row {
    pub(crate) fn new((x, y): (i64, i64), length: usize) -> Self {
        Self { x, y, length }
    }

    pub(crate) fn y(self) -> f64 {
        self.y as f64
    }

    pub(crate) fn x(self, column: usize) -> f64 {
        (self.x + column as i64) as f64
    }

    pub(crate) fn position(self, column: usize) -> Position {
        Position::of_pixel(self.x + column as i64, self.y)
    }

    /// The point of a column. Integer coordinates are always in range, so this needs no check.
    pub(crate) fn point(self, column: usize) -> Point {
        [self.x(column), self.y()]
    }

    /// The first column after `column` whose x is not below `bound`, or the row's end.
    pub(crate) fn first_from(self, bound: f64, column: usize) -> usize {
        // A float to integer cast saturates.
        let ahead = (bound.ceil() - self.x(column)) as usize;
        column.saturating_add(ahead.max(1)).min(self.length)
    }

    /// The column whose x coordinate is `x`, if there is one.
    pub(crate) fn column_at(self, x: f64) -> Option<usize> {
        let column = x - self.x(0);
        (column.fract() == 0.0 && (0.0..self.length as f64).contains(&column)).then_some(column as usize)
    }
}

/// Returns the end of the columns from `start` on that are covered, at most `end`. The covered area
/// is convex, so these columns have no gaps.
pub(crate) fn covered_until(start: usize, end: usize, is_covered: impl Fn(usize) -> bool) -> usize {
    if is_covered(end - 1) {
        end
    } else {
        1 + last_where(start, end, is_covered)
    }
}

/// Returns the last column in `start..end` for which `holds` is true. If `holds` is not true for
/// all columns before that one, returns some column for which it is true. `holds` must be true for
/// `start`. The search doubles its steps, then bisects.
pub(crate) fn last_where(start: usize, end: usize, mut holds: impl FnMut(usize) -> bool) -> usize {
    let (mut low, mut high, mut step) = (start, end, 1);
    while high - low > 1 {
        let tried = if step < high - low {
            low + step
        } else {
            usize::midpoint(low, high)
        };
        if holds(tried) {
            low = tried;
            step = step.saturating_mul(2);
        } else {
            // From here on the search bisects.
            (high, step) = (tried, usize::MAX);
        }
    }
    low
}

/// Points of samples at these coordinates.
#[cfg(test)]
pub(crate) fn points_of(points: &[Point]) -> Points {
    let positions = points.iter().map(|p| Position::new(p[0], p[1]).unwrap());
    Points::new(&SamplePositions::new(positions.collect(), None).unwrap()).unwrap()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, y: f64) -> Position {
        Position::new(x, y).unwrap()
    }

    #[test]
    fn too_large_and_coincident_coordinates_are_refused() {
        let far = SamplePositions::new(vec![at(0.0, 0.0), at(1e60, 0.0)], None).unwrap();
        assert!(matches!(
            Points::new(&far),
            Err(CoeffFieldError::SampleRange { sample: 1, .. })
        ));
        let same = SamplePositions::new(vec![at(1e-60, 0.0), at(1.0, 0.0), at(0.0, 1e-50)], None).unwrap();
        assert!(matches!(
            Points::new(&same),
            Err(CoeffFieldError::CoincidentSamples {
                first: 0,
                second: 2,
                ..
            })
        ));
        assert!(query(at(0.0, -1e51)).is_err());
        assert_eq!(query(at(-1e-300, 3.0)).unwrap(), [0.0, 3.0]);
    }

    #[test]
    fn length_scales_follow_the_samples() {
        let points =
            Points::new(&SamplePositions::new(vec![at(1e4, 0.0), at(0.0, 5e3)], None).unwrap()).unwrap();
        assert_eq!(points.scale.extent, 1e4);
        assert!((points.scale.covered - 1e-5).abs() < 1e-12);
        assert!(points.scale.rounding > 1e-12 && points.scale.rounding < 1e-11);
    }

    fn hull(points: &[Point]) -> Hull {
        Hull::new(&points_of(points), OutsidePolicy::Nearest).unwrap()
    }

    #[test]
    fn a_square_with_points_on_edges_and_inside() {
        let hull = hull(&[
            [0.0, 0.0],
            [2.0, 0.0],
            [1.0, 0.0],
            [1.0, 1.0],
            [2.0, 2.0],
            [0.0, 2.0],
            [0.0, 1.0],
        ]);
        assert_eq!(
            hull.outline.corners(),
            [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]
        );
        assert!(hull.is_corner(4) && !hull.is_corner(2) && !hull.is_corner(3));
        for p in [[0.0, 0.0], [2.0, 2.0], [1.0, 2.0], [2.0, 0.3], [0.1, 1.9]] {
            assert!(hull.contains(p), "{p:?}");
        }
        for p in [[-0.1, 1.0], [1.0, 2.1], [2.1, 2.1], [0.5, -1.0], [3.0, 0.0]] {
            assert!(!hull.contains(p) && !hull.covers(p), "{p:?}");
        }
        assert!(hull.covers([2.0 + 1e-12, 1.0]));
        for (p, piece) in [
            ([1.0, 5.0], HullPiece::Edge(2)),
            ([3.0, 4.0], HullPiece::Corner(2)),
            ([-1.0, -1.0], HullPiece::Corner(0)),
            ([-1.0, 1.0], HullPiece::Edge(3)),
            ([0.0, 1.0], HullPiece::Inside),
        ] {
            assert_eq!(hull.piece(p).0, piece, "{p:?}");
        }
        assert_eq!(hull.piece([1.0, 5.0]).1, [1.0, 2.0]);
        assert_eq!(hull.piece([3.0, 4.0]).1, [2.0, 2.0]);
    }

    #[test]
    fn points_and_lines_have_hulls_too() {
        let one = hull(&[[3.0, 4.0]]);
        assert!(one.contains([3.0, 4.0]) && !one.covers([3.0, 5.0]));
        assert_eq!(one.piece([9.0, 9.0]).1, [3.0, 4.0]);
        let two = hull(&[[0.0, 0.0], [4.0, 4.0], [1.0, 1.0]]);
        assert!(two.covers([2.0, 2.0]) && !two.covers([2.0, 2.1]));
        assert_eq!(two.piece([0.0, 4.0]).1, [2.0, 2.0]);
    }

    #[test]
    fn a_round_hull_agrees_with_the_circle() {
        let points: Vec<Point> = (0..100)
            .map(|i| {
                let (s, c) = (f64::from(i) * std::f64::consts::TAU / 100.0).sin_cos();
                [5.0 * c, 5.0 * s]
            })
            .collect();
        let hull = hull(&points);
        assert_eq!(hull.outline.corners().len(), 100);
        for i in 0..1000 {
            let (s, c) = (f64::from(i) * 0.1).sin_cos();
            // The polygon's inradius is 5 cos(pi/100) = 4.9975.
            assert!(hull.contains([4.997 * c, 4.997 * s]));
            assert!(!hull.contains([5.001 * c, 5.001 * s]));
        }
    }

    #[test]
    fn the_last_column_is_found_wherever_it_is_in_few_steps() {
        for start in [0, 3] {
            for length in [1, 2, 3, 10, 1000] {
                for last in start..start + length {
                    let mut asked = 0;
                    let found = last_where(start, start + length, |column| {
                        assert!(column > start && column < start + length);
                        asked += 1;
                        column <= last
                    });
                    assert_eq!(found, last, "{start} {length}");
                    assert!(asked <= 20, "{asked} of {length}");
                }
            }
        }
    }

    #[test]
    fn bounds_become_columns() {
        let row = Row::new((-5, 2), 10);
        for (bound, column, expected) in [
            (-2.5, 0, 3),
            (-2.0, 0, 3),
            (-1.999, 0, 4),
            (-7.0, 4, 5),
            (f64::INFINITY, 4, 10),
            (f64::NEG_INFINITY, 9, 10),
            (1e300, 9, 10),
        ] {
            assert_eq!(row.first_from(bound, column), expected, "{bound}");
        }
        assert_eq!(row.column_at(4.0), Some(9));
        for x in [5.0, -6.0, 0.5] {
            assert_eq!(row.column_at(x), None);
        }
    }
}
