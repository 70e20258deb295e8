//! Bilinear interpolation on a regular grid.

use psf_types::{FieldError, OutsidePolicy, Position, RowRun, SampleCoefficients, SamplePositions};

use crate::geometry::{Outside, Point, query};
use crate::leave_one_out::{LeaveOneOut, LeftOut, Unpredictable, prediction_error};
use crate::regular_grid::Axis;
use crate::row::{Row, last_where};
use crate::weight_list::add_weight;
use crate::{CoeffFieldError, FieldInterpolation, FieldWeights, RegularGrid, WeightList};

/// Bilinear interpolation inside the cells of a [`RegularGrid`].
///
/// In a cell with corners `(x_0, y_0)` and `(x_1, y_1)`, with `t = (x - x_0) / (x_1 - x_0)` and `s` likewise in y,
/// `v = (1-s)(1-t) v_00 + (1-s) t v_10 + s (1-t) v_01 + s t v_11`. Reproduces `1, x, y, xy`; continuous; the error is at
/// most `(h_x^2 |v_xx| + h_y^2 |v_yy|) / 8` for cells of `h_x` by `h_y`.
///
/// # Outside the grid
/// * Nearest: coordinates are clamped to the grid.
/// * Extend: the formula of the nearest cell goes on, linear in each coordinate. Across a single row or column, which has no
///   slope, the values are constant.
/// * Error: refuses. Positions within 1e-9 of the samples' extent (at least 1e-9 pixels) still count as inside, so that a
///   single row covers that row alone.
///
/// # Leave-one-out
/// Without a sample the grid is no longer regular. Its row without its column, and its column without its row, still have
/// cells that predict it: linearly between its two neighbours in the row, and between those in the column. The
/// prediction is the mean of the two; on an edge of the grid, that along the edge; at a corner both
/// extrapolate: their mean counts as [`LeftOut::Extrapolated`].
///
/// ```
/// use coeff_field::{Bilinear, InterpolatedField};
/// use psf_types::{CoefficientField, OutsidePolicy, Position, SampleCoefficients, SamplePositions};
/// let corners = [(0, 0), (4, 0), (0, 4), (4, 4)].map(|(x, y)| Position::of_pixel(x, y));
/// let positions = SamplePositions::new(corners.to_vec(), None)?;
/// let samples = SampleCoefficients::new(ndarray::array![[0.0], [0.0], [0.0], [16.0]], positions)?;
/// let field = InterpolatedField::new(&samples, &Bilinear, OutsidePolicy::Extend)?;
/// let mut value = [0.0];
/// field.evaluate_into(Position::of_pixel(1, 6), &mut value)?;
/// assert_eq!(value, [6.0]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Bilinear;

impl FieldInterpolation for Bilinear {
    fn prepare(
        &self,
        positions: &SamplePositions,
        outside: OutsidePolicy,
    ) -> Result<Box<dyn FieldWeights>, CoeffFieldError> {
        Ok(Box::new(BilinearWeights {
            grid: RegularGrid::detect(positions)?,
            outside: Outside::try_from(outside)?,
        }))
    }

    fn leave_one_out(
        &self,
        samples: &SampleCoefficients,
        outside: OutsidePolicy,
    ) -> Result<LeaveOneOut, CoeffFieldError> {
        let grid = RegularGrid::detect(samples.positions())?;
        let outside = Outside::try_from(outside)?;
        let (columns, rows) = (grid.xs().len(), grid.ys().len());
        let mut outcomes: Vec<LeftOut> = Vec::new();
        outcomes.resize_with(columns * rows, || LeftOut::Unpredictable {
            reason: Unpredictable::NoOthers,
        });
        for row in 0..rows {
            for column in 0..columns {
                let sample = grid.sample(column, row);
                outcomes[sample] = leave_out(&grid, samples, column, row, outside);
            }
        }
        Ok(LeaveOneOut::new(outcomes))
    }
}

#[derive(Debug)]
struct BilinearWeights {
    grid: RegularGrid,
    outside: Outside,
}

impl BilinearWeights {
    /// The nearest point of the grid where that is where to evaluate, if the policy admits the position.
    fn admit(&self, p: Point) -> Option<Point> {
        if self.outside == Outside::Extend {
            return Some(p);
        }
        let clamped = [self.grid.x().clamp(p[0]), self.grid.y().clamp(p[1])];
        let is_covered = || (clamped[0] - p[0]).hypot(clamped[1] - p[1]) <= self.grid.covered();
        (self.outside == Outside::Nearest || is_covered()).then_some(clamped)
    }

    /// Weights from the cell in x and y and the parts of its upper lines.
    fn weights_in(&self, (column, t): (usize, f64), (row, s): (usize, f64), weights: &mut WeightList) {
        weights.clear();
        for (row, in_y) in [(row, 1.0 - s), (row + 1, s)] {
            for (column, in_x) in [(column, 1.0 - t), (column + 1, t)] {
                if in_x != 0.0 && in_y != 0.0 {
                    weights.push((self.grid.sample(column, row), in_x * in_y));
                }
            }
        }
    }
}

impl FieldWeights for BilinearWeights {
    fn sample_count(&self) -> usize {
        self.grid.xs().len() * self.grid.ys().len()
    }

    fn grid_lines(&self) -> Option<[Vec<f64>; 2]> {
        Some([self.grid.xs().to_vec(), self.grid.ys().to_vec()])
    }

    fn weights_into(&self, position: Position, weights: &mut WeightList) -> Result<(), FieldError> {
        let [x, y] = self
            .admit(query(position)?)
            .ok_or(FieldError::OutsideSamples { position })?;
        self.weights_in(self.grid.x().locate(x), self.grid.y().locate(y), weights);
        Ok(())
    }

    /// A run for each cell that the row crosses, and one beside the grid on either side.
    fn weights_along_row(
        &self,
        start: (i64, i64),
        length: usize,
        visit: &mut dyn FnMut(RowRun<'_>),
    ) -> Result<(), FieldError> {
        let row = Row::new(start, length);
        let (mut first, mut last) = (WeightList::new(), WeightList::new());
        let is_clamped = self.outside != Outside::Extend;
        let mut column = 0;
        while column < length {
            let [x, y] = self
                .admit(row.point(column))
                .ok_or_else(|| FieldError::OutsideSamples {
                    position: row.position(column),
                })?;
            let in_y = self.grid.y().locate(y);
            self.weights_in(self.grid.x().locate(x), in_y, &mut first);
            let mut end = row.first_from(self.grid.x().linear_until(row.x(column), is_clamped), column);
            if self.admit(row.point(end - 1)).is_none() {
                // What is covered is convex.
                end = 1 + last_where(column, end, |column| self.admit(row.point(column)).is_some());
            }
            if end == column + 1 {
                visit(RowRun::of_pixel(&first));
            } else {
                let x = row.x(end - 1);
                let x = if is_clamped { self.grid.x().clamp(x) } else { x };
                self.weights_in(self.grid.x().locate(x), in_y, &mut last);
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

/// How the other nodes of a line predict one of them.
struct AlongLine {
    weights: WeightList,
    between: bool,
}

fn along_line(axis: &Axis, left_out: usize, outside: Outside) -> Option<AlongLine> {
    let v = axis.lines[left_out];
    let mut others = axis.clone();
    others.lines.remove(left_out);
    let numbers: Vec<usize> = (0..axis.lines.len()).filter(|&line| line != left_out).collect();
    if others.lines.is_empty() {
        return None;
    }
    let between = left_out > 0 && left_out + 1 < axis.lines.len();
    let (cell, t) = others.locate(if outside == Outside::Extend {
        v
    } else {
        others.clamp(v)
    });
    let mut weights = WeightList::new();
    add_weight(&mut weights, numbers[cell], 1.0 - t);
    if t != 0.0 {
        add_weight(&mut weights, numbers[cell + 1], t);
    }
    Some(AlongLine { weights, between })
}

fn leave_out(
    grid: &RegularGrid,
    samples: &SampleCoefficients,
    column: usize,
    row: usize,
    outside: Outside,
) -> LeftOut {
    let in_row = along_line(grid.x(), column, outside).map(|line| AlongLine {
        weights: to_samples(&line.weights, |c| grid.sample(c, row)),
        ..line
    });
    let in_column = along_line(grid.y(), row, outside).map(|line| AlongLine {
        weights: to_samples(&line.weights, |r| grid.sample(column, r)),
        ..line
    });
    let lines: Vec<AlongLine> = in_row.into_iter().chain(in_column).collect();
    let any_between = lines.iter().any(|line| line.between);
    let used: Vec<&AlongLine> = lines.iter().filter(|line| line.between || !any_between).collect();
    if used.is_empty() {
        return LeftOut::Unpredictable {
            reason: Unpredictable::NoOthers,
        };
    }
    if !any_between && outside == Outside::Error {
        return LeftOut::Unpredictable {
            reason: Unpredictable::OutsideSamples,
        };
    }
    let mut weights = WeightList::new();
    for line in &used {
        for &(sample, weight) in &line.weights {
            add_weight(&mut weights, sample, weight / used.len() as f64);
        }
    }
    let sample = grid.sample(column, row);
    let error = prediction_error(samples, sample, samples.values(), &weights);
    if any_between {
        LeftOut::Predicted { error }
    } else {
        LeftOut::Extrapolated { error }
    }
}

fn to_samples(weights: &WeightList, sample: impl Fn(usize) -> usize) -> WeightList {
    weights.iter().map(|&(line, w)| (sample(line), w)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    /// Rounding of sums of four terms.
    const ROUNDING: f64 = 1e-13;

    fn grid(xs: &[f64], ys: &[f64], f: impl Fn(f64, f64) -> f64) -> SampleCoefficients {
        let nodes: Vec<(f64, f64)> = ys.iter().flat_map(|&y| xs.iter().map(move |&x| (x, y))).collect();
        let values = Array2::from_shape_fn((nodes.len(), 1), |(i, _)| f(nodes[i].0, nodes[i].1));
        let positions = nodes.iter().map(|&(x, y)| Position::new(x, y).unwrap());
        SampleCoefficients::new(values, SamplePositions::new(positions.collect(), None).unwrap()).unwrap()
    }

    #[test]
    fn uneven_cells_reproduce_xy_inside_and_extended() {
        let f = |x: f64, y: f64| 3.0 - x + 2.0 * y + 0.5 * x * y;
        let samples = grid(&[0.0, 1.0, 5.0], &[-2.0, 3.0], f);
        let field = crate::InterpolatedField::new(&samples, &Bilinear, OutsidePolicy::Extend).unwrap();
        let mut value = [0.0];
        for (x, y) in [
            (0.5, 0.0),
            (1.0, 3.0),
            (4.9, -1.9),
            (5.0, 0.3),
            (-3.0, 9.0),
            (7.0, -4.0),
        ] {
            psf_types::CoefficientField::evaluate_into(&field, Position::new(x, y).unwrap(), &mut value)
                .unwrap();
            assert!((value[0] - f(x, y)).abs() < ROUNDING * 100.0, "({x}, {y})");
        }
    }

    #[test]
    fn left_out_samples_are_predicted_along_their_row_and_column() {
        let samples = grid(&[0.0, 1.0, 3.0], &[0.0, 1.0, 2.0], |x, y| x * x + 10.0 * y * y);
        let errors = Bilinear.leave_one_out(&samples, OutsidePolicy::Nearest).unwrap();
        let error = |sample: usize| match errors.outcomes()[sample] {
            LeftOut::Predicted { error } => (error, true),
            LeftOut::Extrapolated { error } => (error, false),
            ref other => panic!("{other:?}"),
        };
        // Centre, 11: the row gives 13, the column 21.
        assert!((error(4).0 - 6.0).abs() < ROUNDING && error(4).1);
        // Left edge: along the column 20 for 10.
        assert!((error(3).0 - 10.0).abs() < ROUNDING && error(3).1);
        // Corner: the neighbours hold 1 and 10.
        assert!((error(0).0 - 5.5).abs() < ROUNDING && !error(0).1);
        let strict = Bilinear.leave_one_out(&samples, OutsidePolicy::Error).unwrap();
        assert_eq!(strict.predicted().count(), 5);
        // Extended, the corner is predicted from two more nodes: -3 along the row, -20 along the column.
        let extended = Bilinear.leave_one_out(&samples, OutsidePolicy::Extend).unwrap();
        match extended.outcomes()[0] {
            LeftOut::Extrapolated { error } => assert!((error - 11.5).abs() < ROUNDING),
            ref other => panic!("{other:?}"),
        }
    }
}
