//! Inverse distance weighting with a local radius.

use std::num::NonZeroUsize;

use psf_types::{FieldError, Interpolation, OutsidePolicy, Position, SampleCoefficients, SamplePositions};

use crate::geometry::{Outside, Point, Points, query};
use crate::hull::Hull;
use crate::hull_leave_one_out::hull_leave_one_out;
use crate::leave_one_out::{LeaveOneOut, Unpredictable, prediction_error};
use crate::search_tree::SearchTree;
use crate::weight_list::single;
use crate::{CoeffFieldError, FieldInterpolation, FieldWeights, WeightList};

/// The square of the radius over the distance of the k-th neighbour.
const RADIUS_SQUARED: f64 = 2.0;

/// Inverse distance weights (Shepard's method) of the samples around a position.
///
/// With `d_i` the distance of sample `i` and `d_(k)` that of the `k`-th nearest sample,
///
/// ```text
/// w_i = u_i / sum_j u_j,   u_i = [max(R - d_i, 0) / (R d_i)]^p,   R = sqrt(2) d_(k)
/// ```
///
/// These are Franke and Little's weights (R. Franke & G. Nielson 1980, Int. J. Numer. Meth. Eng. 15, 1691; R. J. Renka 1988,
/// ACM Trans. Math. Softw. 14, 139), which fall to 0 at the radius, so that the field is continuous while samples enter and
/// leave. The radius grows with `d_(k)`, so at least `k` samples take part, and about `2 k` on an even sampling.
/// Among `k` samples or fewer `R` is infinite: `u_i = d_i^-p`.
///
/// Exact at the samples; no weight is negative. Linear fields are *not* reproduced: for `p > 1` every sample is a flat spot.
/// It serves rough or noisy samples; on smooth ones the other methods are better.
///
/// # Outside the samples
/// The formula needs no hull and tends to a mean of the nearest samples far away. Nearest: its value at the nearest point of
/// the convex hull. Extend: the formula itself, which is no linear continuation. Error: refuses (positions within 1e-9 of
/// the samples' extent, at least 1e-9 pixels, still count as inside).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InverseDistance {
    power: f64,
    neighbours: NonZeroUsize,
}

impl InverseDistance {
    /// The `k` that sets the radius when none is given: about 12 samples take part.
    pub const DEFAULT_NEIGHBOURS: usize = 6;

    /// Weights `d^-power` whose radius is set by the `neighbours`-th nearest sample.
    ///
    /// # Errors
    /// [`CoeffFieldError::Parameter`] unless `power` is finite and above 0 and `neighbours` at least 1.
    pub fn new(power: f64, neighbours: usize) -> Result<Self, CoeffFieldError> {
        if !(power.is_finite() && power > 0.0) {
            return Err(CoeffFieldError::Parameter {
                name: "the power of inverse distance weights",
                allowed: "finite and above 0",
                got: power,
            });
        }
        let neighbours = NonZeroUsize::new(neighbours).ok_or(CoeffFieldError::Parameter {
            name: "the number of neighbours of inverse distance weights",
            allowed: "at least 1",
            got: 0.0,
        })?;
        Ok(Self { power, neighbours })
    }

    /// The exponent.
    pub fn power(self) -> f64 {
        self.power
    }

    /// Which nearest sample sets the radius.
    pub fn neighbours(self) -> usize {
        self.neighbours.get()
    }

    fn weights_of(self, points: &Points) -> Result<InverseDistanceWeights, CoeffFieldError> {
        Ok(InverseDistanceWeights {
            tree: SearchTree::new(points)?,
            method: self,
        })
    }
}

impl Default for InverseDistance {
    fn default() -> Self {
        Self {
            power: Interpolation::DEFAULT_POWER,
            neighbours: NonZeroUsize::new(Self::DEFAULT_NEIGHBOURS).expect("not zero"),
        }
    }
}

impl FieldInterpolation for InverseDistance {
    fn prepare(
        &self,
        positions: &SamplePositions,
        outside: OutsidePolicy,
    ) -> Result<Box<dyn FieldWeights>, CoeffFieldError> {
        let points = Points::new(positions)?;
        Ok(Box::new(Bounded {
            weights: self.weights_of(&points)?,
            hull: Hull::new(&points),
            outside: Outside::try_from(outside)?,
        }))
    }

    fn leave_one_out(
        &self,
        samples: &SampleCoefficients,
        outside: OutsidePolicy,
    ) -> Result<LeaveOneOut, CoeffFieldError> {
        let points = Points::new(samples.positions())?;
        let formula = self.weights_of(&points)?;
        let mut weights = WeightList::new();
        let predict = |sample, at| {
            formula
                .weights(at, Some(sample), &mut weights)
                .ok_or(Unpredictable::NoOthers)?;
            Ok(prediction_error(samples, sample, samples.values(), &weights))
        };
        Ok(hull_leave_one_out(
            samples,
            &points,
            Outside::try_from(outside)?,
            predict,
        ))
    }
}

#[derive(Debug)]
struct InverseDistanceWeights {
    tree: SearchTree,
    method: InverseDistance,
}

#[derive(Debug)]
struct Bounded {
    weights: InverseDistanceWeights,
    hull: Hull,
    outside: Outside,
}

impl InverseDistanceWeights {
    /// The formula without one sample; none when no sample is left.
    fn weights(&self, p: Point, skip: Option<usize>, weights: &mut WeightList) -> Option<()> {
        let k = self.method.neighbours;
        let others = self.tree.len() - usize::from(skip.is_some());
        weights.clear();
        // With few samples nothing is cut off.
        let radius = if others <= k.get() {
            weights.extend(
                (0..self.tree.len())
                    .filter(|&sample| Some(sample) != skip)
                    .map(|sample| (sample, self.tree.square(p, sample))),
            );
            f64::INFINITY
        } else {
            let square = RADIUS_SQUARED * self.tree.square_of_kth(p, k, skip)?;
            self.tree
                .within(p, square, skip, |sample, square| weights.push((sample, square)));
            square.sqrt()
        };
        let nearest = weights
            .iter()
            .copied()
            .reduce(|a, b| if b.1 < a.1 { b } else { a })?;
        if nearest.1 == 0.0 {
            single(weights, nearest.0);
            return Some(());
        }
        // Relative to the nearest sample's, whose u is the largest, nothing overflows and the sum is at least 1.
        let d_nearest = nearest.1.sqrt();
        let scale = d_nearest / (1.0 - d_nearest / radius);
        weights.retain_mut(|(_, weight)| {
            let d = weight.sqrt();
            let u = (1.0 - d / radius).max(0.0) / d * scale;
            *weight = if self.method.power == 2.0 {
                u * u
            } else {
                u.powf(self.method.power)
            };
            *weight > 0.0
        });
        let sum: f64 = weights.iter().map(|(_, weight)| weight).sum();
        for (_, weight) in weights {
            *weight /= sum;
        }
        Some(())
    }
}

impl FieldWeights for Bounded {
    fn sample_count(&self) -> usize {
        self.weights.tree.len()
    }

    fn weights_into(&self, position: Position, weights: &mut WeightList) -> Result<(), FieldError> {
        let p = self.hull.admit(query(position)?, position, self.outside)?;
        self.weights
            .weights(p, None, weights)
            .expect("there is at least one sample");
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn formula(points: &[Point], power: f64, k: usize, p: Point) -> WeightList {
        let positions = points
            .iter()
            .map(|p| Position::new(p[0], p[1]).unwrap())
            .collect();
        let points = Points::new(&SamplePositions::new(positions, None).unwrap()).unwrap();
        let method = InverseDistance::new(power, k).unwrap();
        let mut weights = WeightList::new();
        method
            .weights_of(&points)
            .unwrap()
            .weights(p, None, &mut weights)
            .unwrap();
        weights.sort_unstable_by_key(|&(sample, _)| sample);
        weights
    }

    #[test]
    fn the_formula_holds_with_and_without_a_radius() {
        // d = 1, 2, 4: plain Shepard gives d^-2 = 1, 1/4, 1/16.
        let points = [[1.0, 0.0], [0.0, 2.0], [-4.0, 0.0]];
        let plain = formula(&points, 2.0, 3, [0.0, 0.0]);
        for ((_, w), expected) in plain.iter().zip([16.0, 4.0, 1.0]) {
            assert!((w - expected / 21.0).abs() < 1e-15);
        }
        // k = 2: R = 2 sqrt 2 and the third takes no part.
        let r = 8.0_f64.sqrt();
        let u = [(r - 1.0) / r, (r - 2.0) / (2.0 * r)].map(|v| v.powi(3));
        let cut = formula(&points, 3.0, 2, [0.0, 0.0]);
        assert_eq!(cut.len(), 2);
        for ((_, w), expected) in cut.iter().zip(u) {
            assert!((w - expected / (u[0] + u[1])).abs() < 1e-15);
        }
    }

    #[test]
    fn samples_all_at_one_distance_share_evenly() {
        let circle: Vec<Point> = (0..40)
            .map(|i| {
                let (s, c) = (f64::from(i) * std::f64::consts::TAU / 40.0).sin_cos();
                [c, s]
            })
            .collect();
        let weights = formula(&circle, 2.0, 6, [0.0, 0.0]);
        assert_eq!(weights.len(), 40);
        assert!(weights.iter().all(|(_, w)| (w - 0.025).abs() < 1e-12));
    }

    #[test]
    fn extreme_powers_and_distances_stay_finite() {
        let points = [[0.0, 0.0], [1e-9, 0.0], [1e7, 0.0], [0.0, 1e7], [1e7, 1e7]];
        for power in [1e-3, 1.0, 30.0, 1e4] {
            for p in [[1e-30, 0.0], [5e-10, 0.0], [5e6, 5e6], [-1e40, 3.0]] {
                for k in [1, 2, 6] {
                    let weights = formula(&points, power, k, p);
                    let sum: f64 = weights.iter().map(|(_, w)| w).sum();
                    assert!((sum - 1.0).abs() < 1e-12, "{power} {p:?} {k}: {weights:?}");
                }
            }
        }
    }

    #[test]
    fn bad_parameters_are_refused() {
        for power in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(
                InverseDistance::new(power, 6),
                Err(CoeffFieldError::Parameter { .. })
            ));
        }
        assert!(InverseDistance::new(2.0, 0).is_err());
    }
}
