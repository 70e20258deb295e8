//! How a PSF changes with its position.

use ndarray::Array1;
use psf_types::{FieldError, Position};

/// The step along an axis, in frame pixels, over which a difference stands for the derivative of a PSF. Its
/// error, relative to the derivative, is about the step divided by the size of the field's features.
const STEP: f64 = 1.0 / 131_072.0;

/// A vector at a position, and its derivatives with respect to x and y. Where the vector has a kink they are
/// one-sided.
pub(crate) fn with_slopes(
    position: Position,
    mut vector: impl FnMut(Position) -> Result<Array1<f64>, FieldError>,
) -> Result<[Array1<f64>; 3], FieldError> {
    let here = vector(position)?;
    let mut slope = |x: f64, y: f64| {
        let mut difference = |step: f64| {
            let moved = Position::new(position.x() + step * x, position.y() + step * y);
            // Beyond the range of numbers, nothing changes.
            let there = moved.map_or_else(|_| Ok(here.clone()), &mut vector)?;
            Ok((there - &here) / step)
        };
        // The field may end here.
        difference(STEP).or_else(|_: FieldError| difference(-STEP))
    };
    let [along_x, along_y] = [slope(1.0, 0.0)?, slope(0.0, 1.0)?];
    Ok([here, along_x, along_y])
}
