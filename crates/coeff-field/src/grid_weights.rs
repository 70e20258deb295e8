//! Weights of samples on a regular grid: products of weights along its two axes.

use psf_types::{FieldError, OutsidePolicy, Position, RowRun, SamplePositions};

use crate::axis::Axis;
use crate::axis_weights::{AxisWeights, LineWeights};
use crate::geometry::{Outside, Point, query};
use crate::row::{Row, last_where};
use crate::{CoeffFieldError, FieldWeights, RegularGrid, WeightList};

/// How values go on between the lines of an axis.
pub(crate) type AlongAxis = fn(&Axis) -> AxisWeights;

/// `w_n(x, y) = w_column(x) w_row(y)`.
#[derive(Debug)]
pub(crate) struct GridWeights {
    grid: RegularGrid,
    x: AxisWeights,
    y: AxisWeights,
    outside: Outside,
}

impl GridWeights {
    pub(crate) fn new(
        positions: &SamplePositions,
        along: AlongAxis,
        outside: OutsidePolicy,
    ) -> Result<Self, CoeffFieldError> {
        let grid = RegularGrid::detect(positions)?;
        Ok(Self {
            x: along(grid.x()),
            y: along(grid.y()),
            grid,
            outside: Outside::try_from(outside)?,
        })
    }

    /// The nearest point of the grid where that is where to evaluate, if the policy admits the position.
    fn admit(&self, p: Point) -> Option<Point> {
        if self.outside == Outside::Extend {
            return Some(p);
        }
        let clamped = [self.grid.x().clamp(p[0]), self.grid.y().clamp(p[1])];
        let is_covered = || (clamped[0] - p[0]).hypot(clamped[1] - p[1]) <= self.grid.covered();
        (self.outside == Outside::Nearest || is_covered()).then_some(clamped)
    }

    fn product(&self, in_x: &LineWeights, in_y: &LineWeights, weights: &mut WeightList) {
        weights.clear();
        for (row, in_y) in in_y.iter() {
            for (column, in_x) in in_x.iter() {
                weights.push((self.grid.sample(column, row), in_x * in_y));
            }
        }
    }
}

impl FieldWeights for GridWeights {
    fn sample_count(&self) -> usize {
        self.grid.xs().len() * self.grid.ys().len()
    }

    fn grid_lines(&self) -> Option<[Vec<f64>; 2]> {
        let axes = [self.x.knots(), self.y.knots()];
        // Near a line about which samples scatter, weights are those of the line itself.
        let is_exact = axes.iter().all(|axis| axis.scatter_is_harmless());
        is_exact.then(|| axes.map(|axis| axis.lines.clone()))
    }

    fn weights_into(&self, position: Position, weights: &mut WeightList) -> Result<(), FieldError> {
        let [x, y] = self
            .admit(query(position)?)
            .ok_or(FieldError::OutsideSamples { position })?;
        self.product(&self.x.at(x), &self.y.at(y), weights);
        Ok(())
    }

    /// A run for each piece that the row crosses, and one beside the grid on either side.
    fn weights_along_row(
        &self,
        start: (i64, i64),
        length: usize,
        visit: &mut dyn FnMut(RowRun<'_>),
    ) -> Result<(), FieldError> {
        let row = Row::new(start, length);
        let (mut first, mut last) = (WeightList::new(), WeightList::new());
        let is_clamped = self.outside != Outside::Extend;
        let is_admitted = |column| self.admit(row.point(column)).is_some();
        let in_x = |column| self.x.at(self.grid.x().place(row.x(column), self.outside));
        let in_y = self.y.at(self.grid.y().place(row.y(), self.outside));
        let mut column = 0;
        while column < length {
            if !is_admitted(column) {
                return Err(FieldError::OutsideSamples {
                    position: row.position(column),
                });
            }
            self.product(&in_x(column), &in_y, &mut first);
            let until = self.x.knots().linear_until(row.x(column), is_clamped);
            let mut end = row.first_from(until, column);
            if !is_admitted(end - 1) {
                // What is covered is convex.
                end = 1 + last_where(column, end, is_admitted);
            }
            if end == column + 1 {
                visit(RowRun::of_pixel(&first));
            } else {
                self.product(&in_x(end - 1), &in_y, &mut last);
                visit(RowRun {
                    length: end - column,
                    first: &first,
                    last: &last,
                });
            }
            column = end;
        }
        Ok(())
    }
}
