//! A search for the samples around a position.

use std::num::NonZeroUsize;

use kiddo::{ImmutableKdTree, SquaredEuclidean};

use crate::error::CoeffFieldError;
use crate::geometry::{Point, Points, dot, sub};

/// A k-d tree whose results do not depend on how it was built. The distances in results are
/// computed here, not by the tree. Of samples at equal distance, the one with the lowest index is
/// chosen.
#[derive(Debug)]
pub(crate) struct SearchTree {
    tree: ImmutableKdTree<f64, 2>,
    points: Vec<Point>,
}

/// The tree may round its own distances differently. Searches are wider by this factor.
const ROUNDING: f64 = 1.0 + 1e-12;
/// Relative tolerance of a comparison of squared distances, well above the rounding of the
/// distances and of the coordinates.
const DISTANCE_ROUNDING: f64 = 64.0 * f64::EPSILON;

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

    /// The sample nearest to `p` other than `skip`, or the first of several at equal distance.
    /// `None` if no sample is left.
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

    /// The sample nearest to `p`, or `None` where another one is equally near within rounding.
    ///
    /// If two positions give the same sample, it is also the nearest one at all positions between
    /// them, because Voronoi cells are convex.
    pub(crate) fn clearly_nearest(&self, p: Point) -> Option<usize> {
        let two = const { NonZeroUsize::new(2).expect("2 is not 0") };
        let mut found = self.closest(p, two);
        let a = found.next()?;
        let Some(b) = found.next() else {
            return Some(a.1);
        };
        let (near, far) = if a.0 <= b.0 { (a, b) } else { (b, a) };
        let doubt = DISTANCE_ROUNDING * (far.0 + (p[0].abs() + p[1].abs()) * far.0.sqrt());
        (far.0 - near.0 > doubt).then_some(near.1)
    }

    /// The squared distance of the `k`-th nearest sample other than `skip`, or of the farthest one
    /// if there are fewer. `None` if no sample is left.
    pub(crate) fn square_of_kth(&self, p: Point, k: NonZeroUsize, skip: Option<usize>) -> Option<f64> {
        let wanted = k.saturating_add(usize::from(skip.is_some()));
        let others = self
            .closest(p, wanted)
            .filter(|&(_, sample)| Some(sample) != skip);
        others.take(k.get()).map(|(square, _)| square).reduce(f64::max)
    }

    /// The squared distances and indices of the `count` samples nearest to `p`, or of all if there
    /// are fewer.
    fn closest(&self, p: Point, count: NonZeroUsize) -> impl Iterator<Item = (f64, usize)> {
        let query = self.tree.query(&p);
        let found = query.nearest_n::<SquaredEuclidean<f64>>(count).execute();
        let samples = found.into_iter().map(|item| item.item as usize);
        samples.map(move |sample| (self.square(p, sample), sample))
    }

    /// Visits every sample other than `skip` whose squared distance from `p` is at most about
    /// `square`.
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
