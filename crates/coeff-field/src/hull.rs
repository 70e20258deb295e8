//! The convex hull of the samples, for interpolators without a triangulation.

use psf_types::{FieldError, Position};

use crate::geometry::{Outside, Point, Points, Scale, along, cross, foot_on_segment, length, sub};

/// Rounding of coordinates below this part of the hull's width and height changes no weight by more than their own rounding.
const PRECISE: f64 = 1e-13;

/// Corners of the convex hull, counter-clockwise; one or two for samples on a point or a line.
#[derive(Debug, Clone)]
pub(crate) struct Hull {
    corners: Vec<Point>,
    /// The samples at the corners, ascending.
    corner_samples: Vec<usize>,
    scale: Scale,
    /// The shorter side of the bounding box.
    narrower: f64,
}

/// A part of the plane whose positions have their nearest point of the hull on the same feature of it. Each is convex, and
/// the nearest point is linear in the position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum HullPiece {
    /// The hull itself.
    Inside,
    /// Beside the edge that starts at this corner.
    Edge(usize),
    /// Around this corner.
    Corner(usize),
}

impl Hull {
    /// Andrew's monotone chain (A. M. Andrew 1979, Inf. Process. Lett. 9, 216).
    pub(crate) fn new(points: &Points) -> Self {
        let p = &points.points;
        let mut order: Vec<usize> = (0..p.len()).collect();
        order.sort_by(|&a, &b| p[a][0].total_cmp(&p[b][0]).then(p[a][1].total_cmp(&p[b][1])));
        let mut chain: Vec<usize> = Vec::new();
        let grow = |chain: &mut Vec<usize>, base: usize, sample: usize| {
            while chain.len() >= base + 2 {
                let (a, b) = (p[chain[chain.len() - 2]], p[chain[chain.len() - 1]]);
                if cross(sub(b, a), sub(p[sample], b)) > 0.0 {
                    break;
                }
                chain.pop();
            }
            chain.push(sample);
        };
        for &sample in &order {
            grow(&mut chain, 0, sample);
        }
        let base = chain.len() - 1;
        for &sample in order.iter().rev().skip(1) {
            grow(&mut chain, base, sample);
        }
        if chain.len() > 1 {
            chain.pop();
        }
        let corners: Vec<Point> = chain.iter().map(|&sample| p[sample]).collect();
        let range = |axis: usize| {
            let of = |fold: fn(f64, f64) -> f64| corners.iter().map(|c| c[axis]).reduce(fold);
            of(f64::max)
                .zip(of(f64::min))
                .map_or(0.0, |(high, low)| high - low)
        };
        let narrower = range(0).min(range(1));
        chain.sort_unstable();
        Self {
            corners,
            corner_samples: chain,
            scale: points.scale,
            narrower,
        }
    }

    /// Whether a sample is a corner, so that the hull shrinks without it.
    pub(crate) fn is_corner(&self, sample: usize) -> bool {
        self.corner_samples.binary_search(&sample).is_ok()
    }

    /// Whether `p` lies in the hull or so little outside that it counts as covered.
    pub(crate) fn covers(&self, p: Point) -> bool {
        self.contains(p) || length(sub(self.nearest(p), p)) <= self.scale.covered
    }

    /// Where to evaluate for `position` under a policy: the point itself where the hull holds it.
    pub(crate) fn admit(&self, p: Point, position: Position, outside: Outside) -> Result<Point, FieldError> {
        if outside == Outside::Extend || self.contains(p) {
            return Ok(p);
        }
        let nearest = self.nearest(p);
        let distance = length(sub(nearest, p));
        // A sample on the hull whose corner was rounded away must be met exactly.
        if distance <= self.scale.rounding {
            Ok(p)
        } else if outside == Outside::Nearest || distance <= self.scale.covered {
            Ok(nearest)
        } else {
            Err(FieldError::OutsideSamples { position })
        }
    }

    /// Whether the nearest points of the hull are rounded by so little of its width and height that no linear function shows
    /// it.
    pub(crate) fn is_precise(&self) -> bool {
        self.scale.rounding <= PRECISE * self.narrower
    }

    /// The piece that holds `p`, and the point of the hull that is nearest to `p`.
    pub(crate) fn piece(&self, p: Point) -> (HullPiece, Point) {
        if self.contains(p) {
            (HullPiece::Inside, p)
        } else {
            self.nearest_with_piece(p)
        }
    }

    /// Whether `p` lies in the closed hull, found by bisection over the fan of the first corner.
    pub(crate) fn contains(&self, p: Point) -> bool {
        let c = &self.corners;
        if c.len() < 3 {
            return c.contains(&p);
        }
        let left_of = |a: Point, b: Point| cross(sub(b, a), sub(p, a)) >= 0.0;
        let (mut low, mut high) = (1, c.len() - 1);
        if !left_of(c[0], c[low]) || !left_of(c[high], c[0]) {
            return false;
        }
        while high - low > 1 {
            let middle = usize::midpoint(low, high);
            if left_of(c[0], c[middle]) {
                low = middle;
            } else {
                high = middle;
            }
        }
        left_of(c[low], c[high])
    }

    /// The point of the boundary that is nearest to `p`.
    fn nearest(&self, p: Point) -> Point {
        self.nearest_with_piece(p).1
    }

    fn nearest_with_piece(&self, p: Point) -> (HullPiece, Point) {
        let c = &self.corners;
        let mut best = (f64::INFINITY, (HullPiece::Corner(0), c[0]));
        // The way back along a line is the same edge.
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use psf_types::SamplePositions;

    fn hull(points: &[Point]) -> Hull {
        let positions = points
            .iter()
            .map(|p| Position::new(p[0], p[1]).unwrap())
            .collect();
        Hull::new(&Points::new(&SamplePositions::new(positions, None).unwrap()).unwrap())
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
        assert_eq!(hull.corners, [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]);
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
        assert_eq!(hull.nearest([1.0, 5.0]), [1.0, 2.0]);
        assert_eq!(hull.nearest([3.0, 4.0]), [2.0, 2.0]);
    }

    #[test]
    fn points_and_lines_have_hulls_too() {
        let one = hull(&[[3.0, 4.0]]);
        assert!(one.contains([3.0, 4.0]) && !one.covers([3.0, 5.0]));
        assert_eq!(one.nearest([9.0, 9.0]), [3.0, 4.0]);
        let two = hull(&[[0.0, 0.0], [4.0, 4.0], [1.0, 1.0]]);
        assert!(two.covers([2.0, 2.0]) && !two.covers([2.0, 2.1]));
        assert_eq!(two.nearest([0.0, 4.0]), [2.0, 2.0]);
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
        assert_eq!(hull.corners.len(), 100);
        for i in 0..1000 {
            let (s, c) = (f64::from(i) * 0.1).sin_cos();
            // The polygon's inradius is 5 cos(pi/100) = 4.9975.
            assert!(hull.contains([4.997 * c, 4.997 * s]));
            assert!(!hull.contains([5.001 * c, 5.001 * s]));
        }
    }
}
