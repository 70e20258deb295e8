//! The value of the nearest sample.

use psf_types::{FieldError, OutsidePolicy, Position, RowRun, SampleCoefficients, SamplePositions};

use crate::geometry::{Outside, Point, Points, query};
use crate::hull::{Hull, HullPiece};
use crate::hull_leave_one_out::hull_leave_one_out;
use crate::leave_one_out::{LeaveOneOut, Unpredictable, prediction_error};
use crate::row::{Row, last_where};
use crate::search_tree::SearchTree;
use crate::weight_list::single;
use crate::{CoeffFieldError, FieldInterpolation, FieldWeights, WeightList};

/// The value of the nearest sample; of several at the same distance, that of the first.
///
/// Piecewise constant, with jumps along the edges of the Voronoi cells.
///
/// # Outside the samples
/// Nearest: the sample nearest to the nearest point of the convex hull. Extend: the sample nearest to the position itself.
/// Error: refuses (positions within 1e-9 of the samples' extent, at least 1e-9 pixels, still count as inside).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Nearest;

impl FieldInterpolation for Nearest {
    fn prepare(
        &self,
        positions: &SamplePositions,
        outside: OutsidePolicy,
    ) -> Result<Box<dyn FieldWeights>, CoeffFieldError> {
        let points = Points::new(positions)?;
        Ok(Box::new(NearestWeights {
            tree: SearchTree::new(&points)?,
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
        Ok(hull_leave_one_out(
            samples,
            &points,
            Outside::try_from(outside)?,
            predict,
        ))
    }
}

#[derive(Debug)]
struct NearestWeights {
    tree: SearchTree,
    hull: Hull,
    outside: Outside,
}

impl NearestWeights {
    /// The sample whose value `p` takes, and the piece of the plane in which that is the nearest sample of a linear function
    /// of the position; none where rounding could decide for another one.
    ///
    /// Positions with the same result surround none with another: the pieces and the samples' Voronoi cells are convex.
    fn clearly(&self, p: Point) -> Option<(HullPiece, usize)> {
        let (piece, at) = match self.outside {
            Outside::Extend => (HullPiece::Inside, p),
            Outside::Nearest => self.hull.piece(p),
            Outside::Error => self.hull.contains(p).then_some((HullPiece::Inside, p))?,
        };
        Some((piece, self.tree.clearly_nearest(at)?))
    }
}

impl FieldWeights for NearestWeights {
    fn sample_count(&self) -> usize {
        self.tree.len()
    }

    fn weights_into(&self, position: Position, weights: &mut WeightList) -> Result<(), FieldError> {
        let p = self.hull.admit(query(position)?, position, self.outside)?;
        single(
            weights,
            self.tree.nearest(p, None).expect("there is at least one sample"),
        );
        Ok(())
    }

    /// A run for each Voronoi cell that the row crosses, and single pixels close to their edges.
    fn weights_along_row(
        &self,
        start: (i64, i64),
        length: usize,
        visit: &mut dyn FnMut(RowRun<'_>),
    ) -> Result<(), FieldError> {
        let row = Row::new(start, length);
        if self.tree.len() == 1 && self.outside != Outside::Error && length > 0 {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ties_go_to_the_first_sample() {
        let corners = [(4, 4), (0, 4), (4, 0), (0, 0)].map(|(x, y)| Position::of_pixel(x, y));
        let positions = SamplePositions::new(corners.to_vec(), None).unwrap();
        let nearest = Nearest.prepare(&positions, OutsidePolicy::Nearest).unwrap();
        let mut weights = WeightList::new();
        for (x, y, sample) in [(2, 2, 0), (2, 0, 2), (0, 2, 1), (1, 1, 3), (9, -9, 2)] {
            nearest
                .weights_into(Position::of_pixel(x, y), &mut weights)
                .unwrap();
            assert_eq!(weights, [(sample, 1.0)], "({x}, {y})");
        }
    }
}
