//! Interpolation by the nearest sample, and by inverse distances.

use std::num::NonZeroUsize;

use psf_types::{
    FieldError, Interpolation, OutsidePolicy, Position, RowRun, SampleCoefficients, SamplePositions,
};

use crate::error::CoeffFieldError;
use crate::field::interpolated;
use crate::geometry::{Hull, HullPiece, Point, Points, Row, last_where};
use crate::interpolation::{
    FieldInterpolation, FieldWeights, Interpolated, OnRun, Outcomes, Unpredictable, Visited, WeightList,
    hull_leave_one_out, prediction_error, single,
};
use crate::lattice::Lattice;
use crate::search_tree::SearchTree;

/// The value of the nearest sample, or of the first one among samples at equal distance.
///
/// Piecewise constant, with jumps along the edges of the Voronoi cells.
///
/// # Outside the samples
/// * Nearest: moves the position to the nearest point of the convex hull, and returns the value of
///   the sample nearest to that point.
/// * Extend: the value of the sample nearest to the position itself.
/// * Error: returns an error. Positions outside the hull still count as inside up to a distance of
///   1e-9 times the samples' extent (or of 1e-9 pixels, if that is more).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Nearest;

impl FieldInterpolation for Nearest {
    fn interpolate(&self, samples: &SampleCoefficients, outside: OutsidePolicy) -> Interpolated {
        interpolated(samples, NearestWeights::prepare(samples.positions(), outside)?)
    }

    fn leave_one_out(&self, samples: &SampleCoefficients, outside: OutsidePolicy) -> Outcomes {
        let points = Points::new(samples.positions())?;
        let tree = SearchTree::new(&points)?;
        let predict = |sample, at| {
            let other = tree.nearest(at, Some(sample)).ok_or(Unpredictable::NoOthers)?;
            Ok(prediction_error(
                samples,
                sample,
                samples.values(),
                &vec![(other, 1.0)],
            ))
        };
        hull_leave_one_out(samples, &points, outside, predict)
    }
}

#[derive(Debug)]
struct NearestWeights {
    tree: SearchTree,
    hull: Hull,
}

impl NearestWeights {
    /// Prepares the weights for samples at `positions`.
    fn prepare(positions: &SamplePositions, outside: OutsidePolicy) -> Result<Self, CoeffFieldError> {
        let points = Points::new(positions)?;
        Ok(Self {
            tree: SearchTree::new(&points)?,
            hull: Hull::new(&points, outside)?,
        })
    }

    /// Returns the part of the plane that contains `p`, and the sample whose value applies at `p`.
    /// Returns `None` where rounding could select another sample, or outside the hull under the
    /// policy error. Within a part, the nearest point of the hull is linear in the position.
    ///
    /// If two positions have the same part and sample, both also apply at every position between
    /// them, because the parts and the samples' Voronoi cells are convex.
    fn clearly(&self, p: Point) -> Option<(HullPiece, usize)> {
        let (piece, at) = match self.hull.outside {
            OutsidePolicy::Extend => (HullPiece::Inside, p),
            OutsidePolicy::Nearest => self.hull.piece(p),
            _ => self.hull.contains(p).then_some((HullPiece::Inside, p))?,
        };
        Some((piece, self.tree.clearly_nearest(at)?))
    }
}

impl FieldWeights for NearestWeights {
    fn sample_count(&self) -> usize {
        self.tree.len()
    }

    fn weights_into(&self, position: Position, weights: &mut WeightList) -> Result<(), FieldError> {
        let p = self.hull.admit(position)?;
        single(
            weights,
            self.tree.nearest(p, None).expect("there is at least one sample"),
        );
        Ok(())
    }

    /// Visits one run for each Voronoi cell that the row crosses, and single pixels close to the
    /// cells' edges.
    fn weights_along_row(&self, start: (i64, i64), length: usize, visit: OnRun<'_>) -> Visited {
        let row = Row::new(start, length);
        if self.tree.len() == 1 && self.hull.outside != OutsidePolicy::Error && length > 0 {
            let everywhere = [(0, 1.0)];
            visit(RowRun {
                length,
                first: &everywhere,
                last: &everywhere,
            });
            return Ok(());
        }
        let mut weights = WeightList::new();
        let mut column = 0;
        while column < length {
            let last = if let Some((piece, sample)) = self.clearly(row.point(column)) {
                single(&mut weights, sample);
                let is_alike = |column| self.clearly(row.point(column)) == Some((piece, sample));
                last_where(column, length, is_alike)
            } else {
                self.weights_into(row.position(column), &mut weights)?;
                column
            };
            visit(RowRun {
                length: last + 1 - column,
                first: &weights,
                last: &weights,
            });
            column = last + 1;
        }
        Ok(())
    }
}

/// The squared ratio of the radius `R` to the distance `d_(k)` in the formula of
/// [`InverseDistance`].
const RADIUS_SQUARED: f64 = 2.0;

/// Inverse distance weights (Shepard's method) of the samples around a position.
///
/// `d_i` is the distance of sample `i`, and `d_(k)` the distance of the `k`-th nearest sample:
///
/// ```text
/// w_i = u_i / sum_j u_j,   u_i = [max(R - d_i, 0) / (R d_i)]^p,   R = sqrt(2) d_(k)
/// ```
///
/// These weights are by Franke and Little (R. Franke & G. Nielson 1980, Int. J. Numer. Meth. Eng.
/// 15, 1691, and R. J. Renka 1988, ACM Trans. Math. Softw. 14, 139). They fall to 0 at the radius
/// `R`, so the field stays continuous where samples enter or leave this radius. The radius grows
/// with `d_(k)`, so at least `k` samples take part, and about `2 k` on an even sampling. If there
/// are only `k` samples or fewer, `R` is infinite and `u_i = d_i^-p`.
///
/// The interpolator gives the values at the corners of a [tree of cells](crate#tree-of-cells).
///
/// The result is exact at the samples. Linear fields are *not*
/// reproduced: for `p > 1` the field is flat at every sample. The method suits rough or noisy
/// samples. For smooth samples the other methods are better.
///
/// # Outside the samples
/// The formula needs no hull. Far away its value tends to the mean of all samples.
///
/// * Nearest: the value at the nearest point of the convex hull.
/// * Extend: the formula itself, which is not a linear continuation.
/// * Error: returns an error. Positions outside the hull still count as inside up to a distance of
///   1e-9 times the samples' extent (or of 1e-9 pixels, if that is more).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InverseDistance {
    power: f64,
    neighbours: NonZeroUsize,
}

impl InverseDistance {
    /// The default `k` that sets the radius. On an even sampling, about 12 samples then take part.
    pub const DEFAULT_NEIGHBOURS: usize = 6;

    /// Weights `d^-power` with a radius set by the `neighbours`-th nearest sample.
    ///
    /// # Errors
    /// [`CoeffFieldError::Parameter`] unless `power` is finite and above 0 and `neighbours` is at
    /// least 1.
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

    /// The number `k`: the `k`-th nearest sample sets the radius.
    pub fn neighbours(self) -> usize {
        self.neighbours.get()
    }

    /// Writes the weights by the formula, without the sample `skip`. Returns `None` if no sample is
    /// left.
    fn weights(
        self,
        tree: &SearchTree,
        p: Point,
        skip: Option<usize>,
        weights: &mut WeightList,
    ) -> Option<()> {
        let k = self.neighbours;
        let others = tree.len() - usize::from(skip.is_some());
        weights.clear();
        // If there are only k samples or fewer, the radius is infinite.
        let radius = if others <= k.get() {
            weights.extend(
                (0..tree.len())
                    .filter(|&sample| Some(sample) != skip)
                    .map(|sample| (sample, tree.square(p, sample))),
            );
            f64::INFINITY
        } else {
            let square = RADIUS_SQUARED * tree.square_of_kth(p, k, skip)?;
            tree.within(p, square, skip, |sample, square| weights.push((sample, square)));
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
        // Weights relative to the nearest sample, which has the largest u. So nothing overflows,
        // and the sum is at least 1.
        let d_nearest = nearest.1.sqrt();
        let scale = d_nearest / (1.0 - d_nearest / radius);
        weights.retain_mut(|(_, weight)| {
            let d = weight.sqrt();
            let u = (1.0 - d / radius).max(0.0) / d * scale;
            *weight = if self.power == 2.0 {
                u * u
            } else {
                u.powf(self.power)
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

impl Default for InverseDistance {
    fn default() -> Self {
        Self {
            power: Interpolation::DEFAULT_POWER,
            neighbours: NonZeroUsize::new(Self::DEFAULT_NEIGHBOURS).expect("not zero"),
        }
    }
}

impl FieldInterpolation for InverseDistance {
    fn interpolate(&self, samples: &SampleCoefficients, outside: OutsidePolicy) -> Interpolated {
        let points = Points::new(samples.positions())?;
        let (tree, hull) = (SearchTree::new(&points)?, Hull::new(&points, outside)?);
        let lattice = Lattice::new(samples.positions(), &points, outside, |p, weights| {
            self.weights(&tree, hull.place(p), None, weights)
                .expect("there is at least one sample");
        })?;
        interpolated(samples, lattice)
    }

    fn leave_one_out(&self, samples: &SampleCoefficients, outside: OutsidePolicy) -> Outcomes {
        let points = Points::new(samples.positions())?;
        let tree = SearchTree::new(&points)?;
        let mut weights = WeightList::new();
        let predict = |sample, at| {
            self.weights(&tree, at, Some(sample), &mut weights)
                .ok_or(Unpredictable::NoOthers)?;
            Ok(prediction_error(samples, sample, samples.values(), &weights))
        };
        hull_leave_one_out(samples, &points, outside, predict)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::points_of;

    #[test]
    fn ties_go_to_the_first_sample() {
        let corners = [(4, 4), (0, 4), (4, 0), (0, 0)].map(|(x, y)| Position::of_pixel(x, y));
        let positions = SamplePositions::new(corners.to_vec(), None).unwrap();
        let nearest = NearestWeights::prepare(&positions, OutsidePolicy::Nearest).unwrap();
        let mut weights = WeightList::new();
        for (x, y, sample) in [(2, 2, 0), (2, 0, 2), (0, 2, 1), (1, 1, 3), (9, -9, 2)] {
            nearest
                .weights_into(Position::of_pixel(x, y), &mut weights)
                .unwrap();
            assert_eq!(weights, [(sample, 1.0)], "({x}, {y})");
        }
    }

    fn formula(points: &[Point], power: f64, k: usize, p: Point) -> WeightList {
        let method = InverseDistance::new(power, k).unwrap();
        let mut weights = WeightList::new();
        let tree = SearchTree::new(&points_of(points)).unwrap();
        method.weights(&tree, p, None, &mut weights).unwrap();
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
        // k = 2: R = 2 sqrt 2, and the third sample has no weight.
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

    fn check(points: &[Point], queries: &[Point]) {
        let tree = SearchTree::new(&points_of(points)).unwrap();
        for &p in queries {
            let mut all: Vec<(f64, usize)> = (0..points.len()).map(|i| (tree.square(p, i), i)).collect();
            all.sort_by(|a, b| a.partial_cmp(b).unwrap());
            assert_eq!(tree.nearest(p, None), Some(all[0].1), "{p:?}");
            assert_eq!(tree.nearest(p, Some(all[0].1)), Some(all[1].1), "{p:?}");
            let is_clear = all[0].0 < all[1].0 * (1.0 - 1e-9);
            let expected = is_clear.then_some(all[0].1);
            if is_clear || all[0].0 == all[1].0 {
                assert_eq!(tree.clearly_nearest(p), expected, "{p:?}");
            }
            let k = NonZeroUsize::new(7).unwrap();
            let seventh = all[6.min(all.len() - 1)].0;
            assert_eq!(tree.square_of_kth(p, k, None), Some(seventh));
            let mut inside = Vec::new();
            tree.within(p, seventh, None, |sample, square| {
                if square <= seventh {
                    inside.push(sample);
                }
            });
            assert_eq!(inside.len(), all.iter().filter(|(s, _)| *s <= seventh).count());
        }
    }

    #[test]
    fn grids_with_many_ties_agree_with_a_linear_search() {
        let grid: Vec<Point> = (0..71 * 71)
            .map(|i| [f64::from(i % 71), f64::from(i / 71)])
            .collect();
        let queries: Vec<Point> = (0..400)
            .map(|i| [f64::from(i % 20) * 3.75 - 2.0, f64::from(i / 20) * 3.5])
            .collect();
        check(&grid, &queries);
    }

    #[test]
    fn rows_clusters_and_circles_agree_with_a_linear_search() {
        let queries = [
            [0.0, 0.0],
            [35.0, 0.0],
            [-1e7, 3.0],
            [1e-9, 1e-9],
            [17.0, 1e3],
            [1e30, 1e30],
        ];
        check(
            &(0..300).map(|i| [f64::from(i), 0.0]).collect::<Vec<_>>(),
            &queries,
        );
        check(
            &(0..300).map(|i| [5.0, f64::from(i) * 1e-9]).collect::<Vec<_>>(),
            &queries,
        );
        let circle = |i: i32| {
            let (s, c) = (f64::from(i) * 0.1).sin_cos();
            [1e7 + c, s]
        };
        check(&(0..60).map(circle).collect::<Vec<_>>(), &queries);
    }

    #[test]
    fn nothing_is_left_of_one_sample() {
        let tree = SearchTree::new(&points_of(&[[1.0, 2.0]])).unwrap();
        assert_eq!(tree.nearest([9.0, 9.0], None), Some(0));
        assert_eq!(tree.nearest([9.0, 9.0], Some(0)), None);
    }
}
