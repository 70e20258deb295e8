//! Bilinear and bicubic interpolation on a regular grid. Weights are products of the weights along
//! the two axes of the grid.

use std::cell::LazyCell;

use ndarray::{ArrayView1, ArrayView2};
use psf_types::{
    BilinearCells, ErrorLimit, FieldError, OutsidePolicy, PixelRegion, Position, SampleCoefficients,
    SamplePositions,
};

use crate::axis_weights::{AxisWeights, Bend, CutCell, NeighbouringLines};
use crate::error::CoeffFieldError;
use crate::field::interpolated;
use crate::geometry::{Point, Row, covered_until, known, pixel_ranges, query};
use crate::grid::{Axis, RegularGrid};
use crate::interpolation::{
    FieldInterpolation, FieldWeights, Interpolated, OnRun, Outcomes, Unpredictable, Visited, WeightList,
    add_weight, admit, in_runs, outcomes_of, prediction_error,
};

/// Bilinear interpolation inside the cells of a [`RegularGrid`](crate::RegularGrid).
///
/// In a cell with corners `(x_0, y_0)` and `(x_1, y_1)`, with `t = (x - x_0) / (x_1 - x_0)` and `s`
/// likewise in y, `v = (1-s)(1-t) v_00 + (1-s) t v_10 + s (1-t) v_01 + s t v_11`. The field is
/// continuous and reproduces `1, x, y, xy`. For cells of `h_x` by `h_y` the error is at most
/// `(h_x^2 |v_xx| + h_y^2 |v_yy|) / 8`.
///
/// # Outside the grid
/// * Nearest: coordinates are clamped to the grid.
/// * Extend: the formula of the nearest cell continues, linear in each coordinate. Across a single
///   row or column the slope is unknown, and the values are constant.
/// * Error: returns an error. Positions outside the grid still count as inside up to a distance of
///   1e-9 times the samples' extent (or of 1e-9 pixels, if that is more). A grid of a single row
///   covers only positions on that row.
///
/// # Leave-one-out
/// Without one sample the grid is no longer regular. But the other samples of this sample's row
/// still form a line, and so do the other samples of its column. Each line predicts the sample
/// linearly from the two neighbours on that line. The prediction is the mean of the two. For a
/// sample on an edge of the grid, only the line along the edge is used. At a corner both lines
/// extrapolate, and their mean counts as [`LeftOut::Extrapolated`](crate::LeftOut::Extrapolated).
///
/// ```
/// use coeff_field::{Bilinear, FieldInterpolation};
/// use psf_types::{CoefficientField, OutsidePolicy, Position, SampleCoefficients, SamplePositions};
/// let corners = [(0, 0), (4, 0), (0, 4), (4, 4)].map(|(x, y)| Position::of_pixel(x, y));
/// let positions = SamplePositions::new(corners.to_vec(), None)?;
/// let samples = SampleCoefficients::new(ndarray::array![[0.0], [0.0], [0.0], [16.0]], positions)?;
/// let field = Bilinear.interpolate(&samples, OutsidePolicy::Extend)?;
/// let mut value = [0.0];
/// field.evaluate_into(Position::of_pixel(1, 6), &mut value)?;
/// assert_eq!(value, [6.0]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Bilinear;

impl FieldInterpolation for Bilinear {
    fn interpolate(&self, samples: &SampleCoefficients, outside: OutsidePolicy) -> Interpolated {
        let weights = GridWeights::prepare(samples.positions(), AxisWeights::linear, outside)?;
        interpolated(samples, weights)
    }

    fn leave_one_out(&self, samples: &SampleCoefficients, outside: OutsidePolicy) -> Outcomes {
        grid_leave_one_out(samples, AxisWeights::linear, outside)
    }
}

/// Bicubic interpolation of a [`RegularGrid`](crate::RegularGrid), from four columns and four rows
/// around a position, in bilinear pieces.
///
/// In each coordinate the knots are the lines of the grid and the fifths of each cell. At the
/// knots, the weights are those of Lagrange's polynomial through the two lines on either side (at
/// an edge, through the four lines next to it). Between knots, weights are linear. So values are
/// exact at the samples and continuous. The error is at most
///
/// ```text
/// h^2 |v_xx| / 200 + 3 h^4 |v_xxxx| / 128
/// ```
///
/// in each coordinate, for evenly spaced lines at a distance `h` and away from the edges. In the
/// cells at an edge, the last term is `h^4 |v_xxxx| / 24`. On a smooth field, where the first term
/// is the larger one, the error is 1/25 of the error of [`Bilinear`](crate::Bilinear).
///
/// Weights may be negative. For evenly spaced lines their magnitudes sum to at most 1.25 in each
/// coordinate, 1.63 at an edge. In the middle of a cell, the variance of independent noise in the
/// samples is multiplied by 0.63 for each coordinate. With bilinear interpolation this factor is
/// 0.5.
///
/// If a coordinate has only three lines, the polynomial is a parabola. With two lines it is a
/// straight line. Where uneven spacing would make the weights' magnitudes sum to more than 2, fewer
/// lines are used.
///
/// # Outside the grid
/// The policies have the effects described in [`Bilinear`](crate::Bilinear). Under extend, the
/// field continues linearly with the slope of the last fifth of a cell.
///
/// # Leave-one-out
/// The row and the column of a sample predict it, with the rules of [`Bilinear`](crate::Bilinear)
/// but with cubics. Without the sample, the cell around it is twice as wide. So both terms of the
/// error above are overestimated. For evenly spaced lines and away from the edges, the factors are
/// 4 and 7.
///
/// ```
/// use coeff_field::{Bicubic, FieldInterpolation};
/// use ndarray::Array2;
/// use psf_types::{CoefficientField, OutsidePolicy, Position, SampleCoefficients, SamplePositions};
/// let positions: Vec<Position> = (0..25).map(|i| Position::of_pixel(i % 5 * 10, i / 5 * 10)).collect();
/// let values = Array2::from_shape_fn((25, 1), |(i, _)| positions[i].x().powi(3) * positions[i].y());
/// let samples = SampleCoefficients::new(values, SamplePositions::new(positions, None)?)?;
/// let field = Bicubic.interpolate(&samples, OutsidePolicy::Nearest)?;
/// let mut value = [0.0];
/// // Both coordinates are at fifths of a cell, where the cubics are exact.
/// field.evaluate_into(Position::of_pixel(12, 16), &mut value)?;
/// assert!((value[0] - 12_f64.powi(3) * 16.0).abs() < 1e-8);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Bicubic;

impl FieldInterpolation for Bicubic {
    fn interpolate(&self, samples: &SampleCoefficients, outside: OutsidePolicy) -> Interpolated {
        let weights = GridWeights::prepare(samples.positions(), AxisWeights::cubic, outside)?;
        interpolated(samples, weights)
    }

    fn leave_one_out(&self, samples: &SampleCoefficients, outside: OutsidePolicy) -> Outcomes {
        grid_leave_one_out(samples, AxisWeights::cubic, outside)
    }
}

/// Makes the weights between the lines of an axis.
type AlongAxis = fn(&Axis) -> AxisWeights;

/// The weights `w_n(x, y) = w_column(x) w_row(y)`.
#[derive(Debug)]
struct GridWeights {
    grid: RegularGrid,
    x: AxisWeights,
    y: AxisWeights,
    outside: OutsidePolicy,
}

impl GridWeights {
    fn prepare(
        positions: &SamplePositions,
        along: AlongAxis,
        outside: OutsidePolicy,
    ) -> Result<Self, CoeffFieldError> {
        let grid = RegularGrid::detect(positions)?;
        Ok(Self {
            x: along(&grid.x),
            y: along(&grid.y),
            grid,
            outside: known(outside)?,
        })
    }

    /// Returns the point at which the weights for `p` are computed, or `None` if the policy rejects
    /// `p`. The point is `p` itself (extend) or the nearest point of the grid.
    fn admit(&self, p: Point) -> Option<Point> {
        if self.outside == OutsidePolicy::Extend {
            return Some(p);
        }
        let clamped = [self.grid.x.clamp(p[0]), self.grid.y.clamp(p[1])];
        let is_covered = || (clamped[0] - p[0]).hypot(clamped[1] - p[1]) <= self.grid.covered;
        (self.outside == OutsidePolicy::Nearest || is_covered()).then_some(clamped)
    }

    fn product(&self, in_x: &NeighbouringLines, in_y: &NeighbouringLines, weights: &mut WeightList) {
        weights.clear();
        for (row, in_y) in in_y.iter() {
            for (column, in_x) in in_x.iter() {
                weights.push((self.grid.sample(column, row), in_x * in_y));
            }
        }
    }
}

/// The second derivatives along one line of the grid, at both sides of a cell, multiplied by a
/// factor. `at(i)` returns the values where line `i` of the other axis crosses it.
fn bend<'a>(
    cell: &CutCell,
    (factor, error): (f64, ErrorLimit<'_>),
    at: impl Fn(usize) -> ArrayView1<'a, f64>,
) -> Bend {
    let [a, b] = cell.second_derivatives.map(|weights| {
        let mut sum = vec![0.0; at(cell.first).len()];
        for (i, &weight) in weights.iter().enumerate().filter(|(_, w)| **w != 0.0) {
            let values = at(cell.first + i);
            for (sum, value) in sum.iter_mut().zip(values) {
                *sum += factor * weight * value;
            }
        }
        sum
    });
    Bend([
        error.product(&a, &a),
        error.product(&a, &b),
        error.product(&b, &b),
    ])
}

impl FieldWeights for GridWeights {
    fn sample_count(&self) -> usize {
        self.grid.xs().len() * self.grid.ys().len()
    }

    /// The cells of bicubic interpolation are cells of the grid, undivided or divided into two,
    /// three or five parts, as the error requires.
    fn bilinear_cells(
        &self,
        values: ArrayView2<'_, f64>,
        region: PixelRegion,
        error: ErrorLimit<'_>,
    ) -> BilinearCells {
        // If samples scatter about their line, positions within the scatter have the weights of the
        // line itself. There the weights are not bilinear.
        if ![&self.x, &self.y]
            .iter()
            .all(|axis| axis.knots.scatter_is_harmless())
        {
            return BilinearCells::every_row(region);
        }
        let ranges = pixel_ranges(region);
        let [(x0, x1), (y0, y1)] = ranges;
        let corners = [[x0, y0], [x1, y0], [x0, y1], [x1, y1]];
        if corners.iter().any(|&p| self.admit(p).is_none()) {
            // Some pixels have no value.
            return BilinearCells::Bands(self.y.all_knots_between(ranges[1]));
        }
        let place = |axis: &Axis, (low, high)| {
            let place = |v| axis.place(v, self.outside);
            (place(low), place(high))
        };
        // Not needed if cells have no knots inside, or no error is allowed.
        let columns = LazyCell::new(|| self.x.lines_between(place(&self.grid.x, ranges[0])));
        let rows = LazyCell::new(|| self.y.lines_between(place(&self.grid.y, ranges[1])));
        // Let I be linear interpolation along x and J along y. Then
        // f - I J f = (f - I f) + I (f - J f), and I takes weighted means. So the errors along both
        // axes add up.
        let half = error.size / 2.0;
        let (x, error_x) = self.x.knots_between(ranges[0], half, |cell| {
            let (rows, sum_in_y) = &*rows;
            let bend = |row| {
                bend(cell, (*sum_in_y, error), |column| {
                    values.row(self.grid.sample(column, row))
                })
            };
            rows.clone().map(bend).collect()
        });
        let (y, error_y) = self.y.knots_between(ranges[1], half, |cell| {
            let (columns, sum_in_x) = &*columns;
            let bend = |column| {
                bend(cell, (*sum_in_x, error), |row| {
                    values.row(self.grid.sample(column, row))
                })
            };
            columns.clone().map(bend).collect()
        });
        let error = error_x + error_y;
        BilinearCells::Lines { x, y, error }
    }

    fn weights_into(&self, position: Position, weights: &mut WeightList) -> Result<(), FieldError> {
        let [x, y] = self
            .admit(query(position)?)
            .ok_or(FieldError::OutsideSamples { position })?;
        self.product(&self.x.at(x), &self.y.at(y), weights);
        Ok(())
    }

    /// Visits one run for each cell that the row crosses, or for each fifth of such a cell
    /// (bicubic). Under the policy nearest there is also one run outside the grid on either side.
    fn weights_along_row(&self, start: (i64, i64), length: usize, visit: OnRun<'_>) -> Visited {
        let row = Row::new(start, length);
        let is_clamped = self.outside != OutsidePolicy::Extend;
        let is_admitted = |column| self.admit(row.point(column)).is_some();
        let in_x = |column| self.x.at(self.grid.x.place(row.x(column), self.outside));
        let in_y = self.y.at(self.grid.y.place(row.y(), self.outside));
        let weights_into = |column, weights: &mut WeightList| {
            admit(is_admitted(column), self.outside, row.position(column))?;
            self.product(&in_x(column), &in_y, weights);
            Ok(())
        };
        let end_of = |column| {
            let until = self.x.knots.linear_until(row.x(column), is_clamped);
            covered_until(column, row.first_from(until, column), is_admitted)
        };
        in_runs(row, weights_into, end_of, visit)
    }
}

/// Predicts each sample from the other samples of its row, and also from those of its column. The
/// result is the mean of these two predictions. If the sample lies between other samples in only
/// one of the two lines, only that line is used.
fn grid_leave_one_out(samples: &SampleCoefficients, along: AlongAxis, outside: OutsidePolicy) -> Outcomes {
    let grid = RegularGrid::detect(samples.positions())?;
    let outside = known(outside)?;
    let in_rows = LeftOutLine::each(&grid.x, along, outside);
    let in_columns = LeftOutLine::each(&grid.y, along, outside);
    let mut nodes = vec![(0, 0); samples.positions().len()];
    for row in 0..in_columns.len() {
        for column in 0..in_rows.len() {
            nodes[grid.sample(column, row)] = (column, row);
        }
    }
    Ok(outcomes_of(samples, outside, |sample| {
        let (column, row) = nodes[sample];
        let (in_row, in_column) = (in_rows[column].as_ref(), in_columns[row].as_ref());
        let covered = in_row.into_iter().chain(in_column).any(|line| line.between);
        let is_used = |line: &&LeftOutLine| line.between || !covered;
        let in_row = in_row.filter(is_used);
        let in_row = in_row.map(|line| line.of_samples(|other| grid.sample(other, row)));
        let in_column = in_column.filter(is_used);
        let in_column = in_column.map(|line| line.of_samples(|other| grid.sample(column, other)));
        let lines: Vec<WeightList> = in_row.into_iter().chain(in_column).collect();
        if lines.is_empty() {
            return Err(Unpredictable::NoOthers);
        }
        let mut weights = WeightList::new();
        for &(other, weight) in lines.iter().flatten() {
            add_weight(&mut weights, other, weight / lines.len() as f64);
        }
        let error = prediction_error(samples, sample, samples.values(), &weights);
        Ok((covered, error))
    }))
}

/// The weights of an axis's other lines that predict the samples on one line.
struct LeftOutLine {
    weights: WeightList,
    /// True unless the line is the first or the last one.
    between: bool,
}

impl LeftOutLine {
    /// For each line of an axis, returns the weights that predict it from the other lines, or
    /// `None` if there are no others.
    fn each(axis: &Axis, along: AlongAxis, outside: OutsidePolicy) -> Vec<Option<Self>> {
        let without = |left_out: usize| {
            let mut others = axis.clone();
            let v = others.lines.remove(left_out);
            if others.lines.is_empty() {
                return None;
            }
            let number = |other: usize| other + usize::from(other >= left_out);
            let weights = along(&others).at(others.place(v, outside));
            Some(Self {
                weights: weights.iter().map(|(other, w)| (number(other), w)).collect(),
                between: left_out > 0 && left_out + 1 < axis.lines.len(),
            })
        };
        (0..axis.lines.len()).map(without).collect()
    }

    fn of_samples(&self, sample: impl Fn(usize) -> usize) -> WeightList {
        self.weights.iter().map(|&(line, w)| (sample(line), w)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::interpolation::LeftOut;
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
        let field = Bilinear.interpolate(&samples, OutsidePolicy::Extend).unwrap();
        let mut value = [0.0];
        for (x, y) in [
            (0.5, 0.0),
            (1.0, 3.0),
            (4.9, -1.9),
            (5.0, 0.3),
            (-3.0, 9.0),
            (7.0, -4.0),
        ] {
            field
                .evaluate_into(Position::new(x, y).unwrap(), &mut value)
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
        // Centre, value 11: the row predicts 13, the column 21.
        assert!((error(4).0 - 6.0).abs() < ROUNDING && error(4).1);
        // Left edge: the column predicts 20 instead of 10.
        assert!((error(3).0 - 10.0).abs() < ROUNDING && error(3).1);
        // Corner: the neighbours have the values 1 and 10.
        assert!((error(0).0 - 5.5).abs() < ROUNDING && !error(0).1);
        let strict = Bilinear.leave_one_out(&samples, OutsidePolicy::Error).unwrap();
        assert_eq!(strict.predicted().count(), 5);
        // Extended, the next two samples of the row predict -3, and those of the column -20.
        let extended = Bilinear.leave_one_out(&samples, OutsidePolicy::Extend).unwrap();
        match extended.outcomes()[0] {
            LeftOut::Extrapolated { error } => assert!((error - 11.5).abs() < ROUNDING),
            ref other => panic!("{other:?}"),
        }
    }
}
