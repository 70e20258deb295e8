//! Piecewise cubic interpolation on a regular grid.

use psf_types::{OutsidePolicy, SampleCoefficients, SamplePositions};

use crate::axis_weights::AxisWeights;
use crate::grid_leave_one_out::grid_leave_one_out;
use crate::grid_weights::GridWeights;
use crate::leave_one_out::LeaveOneOut;
use crate::{CoeffFieldError, FieldInterpolation, FieldWeights};

/// Cubics through four columns and four rows of a [`RegularGrid`](crate::RegularGrid), made of pieces that are bilinear.
///
/// In each coordinate the weights are those of Lagrange's polynomial through the two lines on either side (at an edge, through
/// the four lines next to it), at the fifths of each cell; between these points, and the lines themselves, weights are
/// linear. So values are exact at the samples and continuous, runs of pixels along which weights are linear are as long as
/// a fifth of a cell, and the error is at most
///
/// ```text
/// h^2 |v_xx| / 200 + 3 h^4 |v_xxxx| / 128
/// ```
///
/// in each coordinate, for evenly spaced lines a distance `h` apart and away from the edges (in the cells at an edge, 5 h^4 / 128):
/// where the field is smooth, 1/25 of what [`Bilinear`](crate::Bilinear) leaves. Weights may be negative; their
/// magnitudes add up to at most 1.25 in each coordinate, 1.63 at an edge. Noise of independent samples keeps 0.63 of its variance
/// in the middle of a cell along a coordinate, where bilinear interpolation keeps 0.5.
///
/// With three lines in a coordinate the polynomial is a parabola, with two a straight line. Where lines are spaced so unevenly that
/// the magnitudes of the weights would add up to more than 2, fewer lines are used.
///
/// # Outside the grid
/// As [`Bilinear`](crate::Bilinear): clamped, continued linearly with the slope of the last fifth of a cell, or refused.
///
/// # Leave-one-out
/// The mean of the predictions along the sample's row without its column and its column without its row, as
/// [`Bilinear`](crate::Bilinear), each by cubics. Since the cell around it is twice as wide, both parts of the error above are foretold
/// too large, 4 and 7 fold in the middle of even lines.
///
/// ```
/// use coeff_field::{Bicubic, InterpolatedField};
/// use ndarray::Array2;
/// use psf_types::{CoefficientField, OutsidePolicy, Position, SampleCoefficients, SamplePositions};
/// let positions: Vec<Position> = (0..25).map(|i| Position::of_pixel(i % 5 * 10, i / 5 * 10)).collect();
/// let values = Array2::from_shape_fn((25, 1), |(i, _)| positions[i].x().powi(3) * positions[i].y());
/// let samples = SampleCoefficients::new(values, SamplePositions::new(positions, None)?)?;
/// let field = InterpolatedField::new(&samples, &Bicubic, OutsidePolicy::Nearest)?;
/// let mut value = [0.0];
/// // A fifth of a cell behind a column.
/// field.evaluate_into(Position::of_pixel(12, 16), &mut value)?;
/// assert!((value[0] - 12_f64.powi(3) * 16.0).abs() < 1e-8);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Bicubic;

impl FieldInterpolation for Bicubic {
    fn prepare(
        &self,
        positions: &SamplePositions,
        outside: OutsidePolicy,
    ) -> Result<Box<dyn FieldWeights>, CoeffFieldError> {
        let weights = GridWeights::new(positions, AxisWeights::cubic, outside)?;
        Ok(Box::new(weights))
    }

    fn leave_one_out(
        &self,
        samples: &SampleCoefficients,
        outside: OutsidePolicy,
    ) -> Result<LeaveOneOut, CoeffFieldError> {
        grid_leave_one_out(samples, AxisWeights::cubic, outside)
    }
}
