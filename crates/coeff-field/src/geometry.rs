//! Points in double precision, checked once, and the few vector operations in use.

use std::collections::HashMap;

use psf_types::{FieldError, OutsidePolicy, Position, SamplePositions};

use crate::CoeffFieldError;

/// Coordinates in pixels; each is 0 or has a magnitude between `SMALLEST` and `LARGEST`.
pub(crate) type Point = [f64; 2];

/// Products of four coordinates, as in the test of a circumcircle, must not overflow ...
const LARGEST: f64 = 1e50;
/// ... nor underflow; what is smaller counts as 0.
const SMALLEST: f64 = 1e-40;
/// How far outside the samples a position may lie and still count as covered, relative to the samples' extent (or to
/// one pixel, if that is more): well above the rounding of coordinates, far below any change of a PSF.
const COVERED: f64 = 1e-9;
/// The rounding of coordinates that were computed in a few operations, relative to the largest of them ...
const ROUNDING: f64 = 4.0 * f64::EPSILON;
/// ... but samples that differ by a good part of their extent differ on purpose.
const MEANT: f64 = 1e-7;

/// The samples' coordinates and the lengths that go with them.
#[derive(Debug, Clone)]
pub(crate) struct Points {
    pub(crate) points: Vec<Point>,
    pub(crate) scale: Scale,
}

/// Lengths that tell apart what is different from what is only rounded differently.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scale {
    /// Positions this far outside the samples still count as covered.
    pub(crate) covered: f64,
    /// Samples this close to a line are on it but for rounding.
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

    /// Some of the points, judged by the lengths of all of them.
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
        let range = |axis: usize| {
            let values = points.iter().map(|p| p[axis]);
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| {
                (a.min(v), b.max(v))
            })
        };
        let ((x0, x1), (y0, y1)) = (range(0), range(1));
        let extent = (x1 - x0).max(y1 - y0);
        let largest = x0.abs().max(x1.abs()).max(y0.abs()).max(y1.abs());
        let rounding = ROUNDING * largest;
        Self {
            covered: (COVERED * extent.max(1.0)).max(rounding),
            rounding: rounding.min(MEANT * extent),
            extent,
        }
    }
}

/// A position asked for, as a point.
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

/// The outside policies of this version.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Outside {
    Nearest,
    Extend,
    Error,
}

impl TryFrom<OutsidePolicy> for Outside {
    type Error = CoeffFieldError;
    fn try_from(policy: OutsidePolicy) -> Result<Self, CoeffFieldError> {
        match policy {
            OutsidePolicy::Nearest => Ok(Self::Nearest),
            OutsidePolicy::Extend => Ok(Self::Extend),
            OutsidePolicy::Error => Ok(Self::Error),
            other => Err(CoeffFieldError::UnknownOutsidePolicy(other)),
        }
    }
}

pub(crate) fn sub(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

/// `a + s d`.
pub(crate) fn along(a: Point, s: f64, d: Point) -> Point {
    [a[0] + s * d[0], a[1] + s * d[1]]
}

pub(crate) fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// Twice the area of the triangle (0, a, b), positive when b lies to the left of a.
pub(crate) fn cross(a: Point, b: Point) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

pub(crate) fn length(a: Point) -> f64 {
    a[0].hypot(a[1])
}

/// The parameter in [0, 1] of the point of the segment a b that is nearest to p.
pub(crate) fn foot_on_segment(a: Point, b: Point, p: Point) -> f64 {
    let ab = sub(b, a);
    (dot(sub(p, a), ab) / dot(ab, ab)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, y: f64) -> Position {
        Position::new(x, y).unwrap()
    }

    #[test]
    fn coordinates_that_geometry_cannot_carry_are_refused() {
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
    fn lengths_follow_the_samples() {
        let points =
            Points::new(&SamplePositions::new(vec![at(1e4, 0.0), at(0.0, 5e3)], None).unwrap()).unwrap();
        assert_eq!(points.scale.extent, 1e4);
        assert!((points.scale.covered - 1e-5).abs() < 1e-12);
        assert!(points.scale.rounding > 1e-12 && points.scale.rounding < 1e-11);
    }
}
