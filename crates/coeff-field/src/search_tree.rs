//! Nearest samples.

use std::num::NonZeroUsize;

use kiddo::{ImmutableKdTree, SquaredEuclidean};

use crate::CoeffFieldError;
use crate::geometry::{Point, Points, dot, sub};

/// A k-d tree whose answers do not depend on how it was built: distances are computed here, ties go to the lowest sample.
#[derive(Debug)]
pub(crate) struct SearchTree {
    tree: ImmutableKdTree<f64, 2>,
    points: Vec<Point>,
}

/// The tree's own distances may be rounded differently.
const ROUNDING: f64 = 1.0 + 1e-12;
/// Rounding of a squared distance, and of the position it is taken from, is well below this, relatively.
const DOUBT: f64 = 64.0 * f64::EPSILON;

impl SearchTree {
    pub(crate) fn new(points: &Points) -> Result<Self, CoeffFieldError> {
        let tree = ImmutableKdTree::new_from_slice(&points.points)
            .map_err(|error| CoeffFieldError::External(Box::new(error)))?;
        Ok(Self {
            tree,
            points: points.points.clone(),
        })
    }

    pub(crate) fn len(&self) -> usize {
        self.points.len()
    }

    /// The sample nearest to `p` apart from `skip`; of several at the same distance the first. None when none is left.
    pub(crate) fn nearest(&self, p: Point, skip: Option<usize>) -> Option<usize> {
        let largest = self.square_of_kth(p, NonZeroUsize::MIN, skip)?;
        let mut best = (f64::INFINITY, usize::MAX);
        self.within(p, largest, skip, |sample, square| {
            if (square, sample) < best {
                best = (square, sample);
            }
        });
        Some(best.1)
    }

    /// The sample nearest to `p`; none where another one is as near but for rounding.
    ///
    /// Where `p` and `q` have the same result, so have the positions between them: the difference of the squared distances of
    /// two samples is linear along the line, and the rounding allowed for convex.
    pub(crate) fn clearly_nearest(&self, p: Point) -> Option<usize> {
        let two = const { NonZeroUsize::new(2).expect("2 is not 0") };
        let found = self
            .tree
            .query(&p)
            .nearest_n::<SquaredEuclidean<f64>>(two)
            .execute();
        let mut found = found.iter().map(|item| {
            let sample = item.item as usize;
            (self.square(p, sample), sample)
        });
        let a = found.next()?;
        let Some(b) = found.next() else {
            return Some(a.1);
        };
        let (near, far) = if a.0 <= b.0 { (a, b) } else { (b, a) };
        let doubt = DOUBT * (far.0 + (p[0].abs() + p[1].abs()) * far.0.sqrt());
        (far.0 - near.0 > doubt).then_some(near.1)
    }

    /// The squared distance of the `k`-th nearest sample apart from `skip`; of the last one where there are fewer.
    pub(crate) fn square_of_kth(&self, p: Point, k: NonZeroUsize, skip: Option<usize>) -> Option<f64> {
        let wanted = k.saturating_add(usize::from(skip.is_some()));
        let found = self
            .tree
            .query(&p)
            .nearest_n::<SquaredEuclidean<f64>>(wanted)
            .execute();
        found
            .iter()
            .map(|item| item.item as usize)
            .filter(|&sample| Some(sample) != skip)
            .take(k.get())
            .map(|sample| self.square(p, sample))
            .reduce(f64::max)
    }

    /// Visits every sample whose squared distance from `p` is at most about `square`, apart from `skip`.
    pub(crate) fn within(
        &self,
        p: Point,
        square: f64,
        skip: Option<usize>,
        mut visit: impl FnMut(usize, f64),
    ) {
        let found = self
            .tree
            .query(&p)
            .within::<SquaredEuclidean<f64>>(square * ROUNDING)
            .execute();
        for sample in found.iter().map(|item| item.item as usize) {
            if Some(sample) != skip {
                visit(sample, self.square(p, sample));
            }
        }
    }

    pub(crate) fn square(&self, p: Point, sample: usize) -> f64 {
        let d = sub(self.points[sample], p);
        dot(d, d)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use psf_types::{Position, SamplePositions};

    fn check(points: &[Point], queries: &[Point]) {
        let positions = points
            .iter()
            .map(|p| Position::new(p[0], p[1]).unwrap())
            .collect();
        let tree =
            SearchTree::new(&Points::new(&SamplePositions::new(positions, None).unwrap()).unwrap()).unwrap();
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
        let one = Points::new(&SamplePositions::new(vec![Position::of_pixel(1, 2)], None).unwrap()).unwrap();
        let tree = SearchTree::new(&one).unwrap();
        assert_eq!(tree.nearest([9.0, 9.0], None), Some(0));
        assert_eq!(tree.nearest([9.0, 9.0], Some(0)), None);
    }
}
