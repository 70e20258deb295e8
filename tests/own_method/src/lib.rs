//! An interpolation and a basis method, in a crate that depends on two stages alone.

use std::sync::Arc;

use coeff_field::ndarray::{Array2, Array3, Axis};
use coeff_field::psf_types::{
    CoefficientField, FieldError, OutsidePolicy, Position, PsfSamples, SampleCoefficients,
};
use coeff_field::{CoeffFieldError, FieldInterpolation};
use psf_basis::{BasisError, BasisFit, BasisMethod, GivenStamps};

/// The mean of the samples, with weights that fall with the distance.
#[derive(Debug)]
pub struct Smooth {
    /// The distance in pixels at which weights have fallen to a half.
    pub scale: f64,
}

#[derive(Debug)]
struct SmoothField {
    samples: SampleCoefficients,
    scale: f64,
}

impl FieldInterpolation for Smooth {
    fn interpolate(
        &self,
        samples: &SampleCoefficients,
        _: OutsidePolicy,
    ) -> Result<Arc<dyn CoefficientField>, CoeffFieldError> {
        Ok(Arc::new(SmoothField {
            samples: samples.clone(),
            scale: self.scale,
        }))
    }
}

impl CoefficientField for SmoothField {
    fn component_count(&self) -> usize {
        self.samples.component_count()
    }

    fn evaluate_into(&self, at: Position, coefficients: &mut [f64]) -> Result<(), FieldError> {
        coefficients.fill(0.0);
        let mut whole = 0.0;
        let positions = self.samples.positions().as_slice();
        for (position, values) in positions.iter().zip(self.samples.values().outer_iter()) {
            let weight = 1.0 / (1.0 + (position.distance(at) / self.scale).powi(2));
            whole += weight;
            for (a, value) in coefficients.iter_mut().zip(values) {
                *a += weight * value;
            }
        }
        coefficients.iter_mut().for_each(|a| *a /= whole);
        Ok(())
    }
}

/// The samples themselves are the basis.
#[derive(Debug)]
pub struct OwnSamples;

impl BasisMethod for OwnSamples {
    fn fit(&self, samples: &PsfSamples) -> Result<BasisFit, BasisError> {
        let stamps: Array3<f64> = samples.stamps().to_owned();
        let mean: Option<Array2<f64>> = stamps.mean_axis(Axis(0));
        GivenStamps::new(stamps, mean)?.fit(samples)
    }
}

#[cfg(test)]
mod tests {
    use coeff_field::psf_types::{FrameShape, SamplePositions, StampGrid};
    use coeff_field::{TableOptions, tabulate_field};

    use super::*;

    #[test]
    fn samples_are_fitted_interpolated_and_tabulated() {
        let stamps = Array3::from_shape_fn((9, 7, 7), |(j, y, x)| {
            let square = (x as f64 - 3.0).powi(2) + (y as f64 - 3.0).powi(2);
            (-square / (2.0 + 0.3 * j as f64)).exp()
        });
        let at = (0..9)
            .map(|j| Position::of_pixel(40 * (j % 3), 30 * (j / 3)))
            .collect();
        let frame = FrameShape::new(81, 61).unwrap();
        let positions = SamplePositions::new(at, Some(frame)).unwrap();
        let samples = PsfSamples::new(stamps, positions.clone(), StampGrid::new(7, 7).unwrap()).unwrap();
        let fit = OwnSamples.fit(&samples).unwrap();
        assert!(fit.max_error() < 1e-12);
        let field = Smooth { scale: 30.0 }
            .interpolate(fit.coefficients(), OutsidePolicy::Nearest)
            .unwrap();
        let size = |error: &[f64]| error.iter().map(|d| d * d).sum::<f64>().sqrt();
        let options = TableOptions {
            size: &size,
            limit: 1e-6,
            samples: &positions,
        };
        let (nodes, method) = tabulate_field(field.as_ref(), options).unwrap();
        let table = coeff_field::interpolation(method).unwrap();
        let table = table.interpolate(&nodes, OutsidePolicy::Nearest).unwrap();
        let (mut a, mut b) = (vec![0.0; fit.rank()], vec![0.0; fit.rank()]);
        let at = Position::new(33.3, 21.0).unwrap();
        field.evaluate_into(at, &mut a).unwrap();
        table.evaluate_into(at, &mut b).unwrap();
        let error: Vec<f64> = a.iter().zip(&b).map(|(a, b)| a - b).collect();
        assert!(size(&error) < 1e-6);
    }
}
