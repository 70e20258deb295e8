//! Bilinear interpolation on a regular grid.

use psf_types::{OutsidePolicy, SampleCoefficients, SamplePositions};

use crate::axis_weights::AxisWeights;
use crate::grid_leave_one_out::grid_leave_one_out;
use crate::grid_weights::GridWeights;
use crate::leave_one_out::LeaveOneOut;
use crate::{CoeffFieldError, FieldInterpolation, FieldWeights};

/// Bilinear interpolation inside the cells of a [`RegularGrid`](crate::RegularGrid).
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
/// extrapolate: their mean counts as [`LeftOut::Extrapolated`](crate::LeftOut::Extrapolated).
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
        let weights = GridWeights::new(positions, AxisWeights::linear, outside)?;
        Ok(Box::new(weights))
    }

    fn leave_one_out(
        &self,
        samples: &SampleCoefficients,
        outside: OutsidePolicy,
    ) -> Result<LeaveOneOut, CoeffFieldError> {
        grid_leave_one_out(samples, AxisWeights::linear, outside)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::leave_one_out::LeftOut;
    use ndarray::Array2;
    use psf_types::Position;

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
