//! From the serialisable choice of an interpolation to the method.

use psf_types::{Interpolation, OutsidePolicy, SampleCoefficients, SamplePositions};

use crate::leave_one_out::LeaveOneOut;
use crate::{
    Bicubic, Bilinear, CoeffFieldError, Delaunay, FieldInterpolation, FieldWeights, InverseDistance,
    NaturalNeighbour, Nearest, Polynomial, RegularGrid,
};

/// What [`Interpolation::Auto`] stands for with samples at these positions; any other choice stands for itself.
///
/// Where the samples form a regular grid of at least 2 x 2, bicubic, or bilinear if it has but 2 x 2; nearest for a single
/// sample; else natural neighbour (which interpolates along the line where samples are collinear).
///
/// ```
/// use coeff_field::resolve;
/// use psf_types::{Interpolation, Position, SamplePositions};
/// let corners = [(0, 0), (4, 0), (0, 4), (4, 4)].map(|(x, y)| Position::of_pixel(x, y));
/// let grid = SamplePositions::new(corners.to_vec(), None)?;
/// assert_eq!(resolve(Interpolation::Auto, &grid), Interpolation::Bilinear);
/// let triangle = SamplePositions::new(corners[..3].to_vec(), None)?;
/// assert_eq!(resolve(Interpolation::Auto, &triangle), Interpolation::NaturalNeighbour);
/// # Ok::<(), psf_types::DataError>(())
/// ```
pub fn resolve(choice: Interpolation, positions: &SamplePositions) -> Interpolation {
    if choice != Interpolation::Auto {
        return choice;
    }
    if positions.len() == 1 {
        return Interpolation::Nearest;
    }
    match RegularGrid::detect(positions) {
        Ok(grid) if grid.xs().len() >= 2 && grid.ys().len() >= 2 => {
            if positions.len() == 4 {
                Interpolation::Bilinear
            } else {
                Interpolation::Bicubic
            }
        }
        _ => Interpolation::NaturalNeighbour,
    }
}

/// The method that a choice names; [`Auto`] decides when it sees the samples.
///
/// ```
/// use coeff_field::interpolation;
/// use psf_types::Interpolation;
/// let choice: Interpolation = "polynomial=3".parse()?;
/// println!("{:?}", interpolation(choice)?);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`CoeffFieldError::Parameter`] for a parameter out of range, [`CoeffFieldError::UnknownInterpolation`] for a choice
/// newer than this crate.
pub fn interpolation(choice: Interpolation) -> Result<Box<dyn FieldInterpolation>, CoeffFieldError> {
    Ok(match choice {
        Interpolation::Auto => Box::new(Auto),
        Interpolation::Delaunay => Box::new(Delaunay),
        Interpolation::NaturalNeighbour => Box::new(NaturalNeighbour),
        Interpolation::InverseDistance { power } => {
            Box::new(InverseDistance::new(power, InverseDistance::DEFAULT_NEIGHBOURS)?)
        }
        Interpolation::Bilinear => Box::new(Bilinear),
        Interpolation::Bicubic => Box::new(Bicubic),
        Interpolation::Polynomial { degree } => Box::new(Polynomial::new(degree)?),
        Interpolation::Nearest => Box::new(Nearest),
        other => return Err(CoeffFieldError::UnknownInterpolation(other)),
    })
}

/// The method that [`resolve`] names for the samples it is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Auto;

impl FieldInterpolation for Auto {
    fn prepare(
        &self,
        positions: &SamplePositions,
        outside: OutsidePolicy,
    ) -> Result<Box<dyn FieldWeights>, CoeffFieldError> {
        interpolation(resolve(Interpolation::Auto, positions))?.prepare(positions, outside)
    }

    /// Of the method chosen for all samples, which also predicts when one is left out.
    fn leave_one_out(
        &self,
        samples: &SampleCoefficients,
        outside: OutsidePolicy,
    ) -> Result<LeaveOneOut, CoeffFieldError> {
        interpolation(resolve(Interpolation::Auto, samples.positions()))?.leave_one_out(samples, outside)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use psf_types::Position;

    #[test]
    fn auto_suits_the_samples() {
        let choose = |points: &[(i64, i64)]| {
            let positions = points.iter().map(|&(x, y)| Position::of_pixel(x, y)).collect();
            resolve(
                Interpolation::Auto,
                &SamplePositions::new(positions, None).unwrap(),
            )
        };
        assert_eq!(choose(&[(1, 1)]), Interpolation::Nearest);
        assert_eq!(choose(&[(0, 0), (5, 0)]), Interpolation::NaturalNeighbour);
        assert_eq!(choose(&[(0, 0), (5, 5), (9, 9)]), Interpolation::NaturalNeighbour);
        assert_eq!(choose(&[(0, 0), (5, 0), (0, 1), (5, 1)]), Interpolation::Bilinear);
        let lines = [(0, 0), (5, 0), (9, 0), (0, 1), (5, 1), (9, 1)];
        assert_eq!(choose(&lines), Interpolation::Bicubic);
    }

    #[test]
    fn every_choice_has_its_method() {
        for (text, name) in [
            ("auto", "Auto"),
            ("delaunay", "Delaunay"),
            ("natural-neighbour", "NaturalNeighbour"),
            ("idw=3", "InverseDistance { power: 3.0, neighbours: 6 }"),
            ("bilinear", "Bilinear"),
            ("bicubic", "Bicubic"),
            ("polynomial=4", "Polynomial { degree: 4 }"),
            ("nearest", "Nearest"),
        ] {
            assert_eq!(
                format!("{:?}", interpolation(text.parse().unwrap()).unwrap()),
                name
            );
        }
        assert!(interpolation(Interpolation::InverseDistance { power: f64::NAN }).is_err());
        assert!(interpolation(Interpolation::Polynomial { degree: 99 }).is_err());
    }
}
