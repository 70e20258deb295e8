//! Leave-one-out for interpolators whose samples' hull only decides what is outside.

use psf_types::SampleCoefficients;

use crate::geometry::{Outside, Point, Points};
use crate::hull::Hull;
use crate::leave_one_out::{LeaveOneOut, LeftOut, Unpredictable, judge};

/// Applies the outside policy to each sample's position as the others see it, and `predict`s the error of that sample by
/// the method's value at the point that the policy names.
pub(crate) fn hull_leave_one_out(
    samples: &SampleCoefficients,
    points: &Points,
    outside: Outside,
    mut predict: impl FnMut(usize, Point) -> Result<f64, Unpredictable>,
) -> LeaveOneOut {
    let hull = Hull::new(points);
    let positions = samples.positions().as_slice();
    let outcomes = positions.iter().enumerate().map(|(sample, &position)| {
        let p = points.points[sample];
        if points.len() == 1 {
            return LeftOut::Unpredictable {
                reason: Unpredictable::NoOthers,
            };
        }
        // Only a corner leaves the hull of the others.
        let (covered, at) = if hull.is_corner(sample) {
            let others = points.subset((0..points.len()).filter(|&s| s != sample));
            let hull = Hull::new(&others);
            match hull.admit(p, position, outside) {
                Ok(at) => (hull.covers(p), at),
                Err(_) => (false, p),
            }
        } else {
            (true, p)
        };
        match predict(sample, at) {
            Ok(error) => judge(outside, covered, error),
            Err(reason) => LeftOut::Unpredictable { reason },
        }
    });
    LeaveOneOut::new(outcomes.collect())
}
