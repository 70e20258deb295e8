//! The wavefront error over the field.

use std::f64::consts::TAU;

use crate::pupil_polynomial::PupilPolynomial;
use crate::{FieldCoordinates, FieldPolynomial, OpticsError, WavefrontParams, WavefrontUnit, Zernike};

/// Zernike terms with coefficients that are polynomials of the field, ready to be summed.
#[derive(Debug)]
pub(crate) struct Wavefront {
    modes: Vec<(PupilPolynomial, FieldPolynomial)>,
    degree: usize,
    radians_per_unit: f64,
}

impl Wavefront {
    pub(crate) fn new(params: &WavefrontParams, wavelength_nm: f64) -> Result<Self, OpticsError> {
        let mut modes = Vec::new();
        for (i, mode) in params.modes.iter().enumerate() {
            let key = format!("wavefront.modes[{i}]");
            let zernike = Zernike::from_noll(mode.noll).map_err(|_| {
                OpticsError::setting(format!("{key}.noll"), "an index from 1 to 231", mode.noll)
            })?;
            if params.modes[..i].iter().any(|m| m.noll == mode.noll) {
                return Err(OpticsError::Repeated {
                    key,
                    what: format!("noll = {}", mode.noll),
                });
            }
            let coefficient = FieldPolynomial::named(&key, mode.terms.clone())?;
            modes.push((zernike.to_cartesian(), coefficient));
        }
        Ok(Self {
            degree: modes.iter().map(|(p, _)| p.degree()).max().unwrap_or(0),
            modes,
            radians_per_unit: match params.unit {
                WavefrontUnit::Nm => TAU / wavelength_nm,
                WavefrontUnit::Waves => TAU,
            },
        })
    }

    /// The phase in radians over the pupil at a field position.
    pub(crate) fn phase(&self, at: FieldCoordinates) -> PupilPolynomial {
        let mut sum = PupilPolynomial::zero(self.degree);
        for (mode, coefficient) in &self.modes {
            sum.add_scaled(mode, coefficient.evaluate(at) * self.radians_per_unit);
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FieldTerm, ModeParams};
    use psf_types::{FrameShape, Position};

    #[test]
    fn terms_add_up_over_field_and_pupil() {
        let mode = |noll, terms: &[(u32, u32, f64)]| ModeParams {
            noll,
            terms: terms
                .iter()
                .map(|&(x, y, value)| FieldTerm { x, y, value })
                .collect(),
        };
        let params = WavefrontParams {
            unit: WavefrontUnit::Waves,
            modes: vec![mode(4, &[(0, 0, 0.1), (2, 0, 0.3)]), mode(9, &[(0, 1, -0.2)])],
        };
        let at = FieldCoordinates::of(
            Position::new(0.0, 75.0).unwrap(),
            FrameShape::new(101, 101).unwrap(),
        );
        let (x, y) = (0.4, -0.7);
        let z = |j| Zernike::from_noll(j).unwrap().evaluate(x, y);
        let phase = |unit, wavelength| {
            let params = WavefrontParams {
                unit,
                ..params.clone()
            };
            Wavefront::new(&params, wavelength)
                .unwrap()
                .phase(at)
                .evaluate(x, y)
        };
        let expected = TAU * (0.4 * z(4) - 0.1 * z(9));
        assert!((phase(WavefrontUnit::Waves, 500.0) - expected).abs() < 1e-14);
        assert!((phase(WavefrontUnit::Nm, 500.0) - expected / 500.0).abs() < 1e-16);
    }
}
