//! The long-exposure transfer function of the atmosphere.

use crate::error::require;
use crate::{OpticsError, SeeingParams};

/// `FWHM = 0.975864 lambda / r0` of the Kolmogorov long-exposure PSF without a telescope.
const KOLMOGOROV_FWHM: f64 = 0.975_864;
/// `2 (24/5 Gamma(6/5))^(5/6)` (Fried 1966).
const STRUCTURE: f64 = 6.883_877_182_293_81;
const GAMMA_5_6: f64 = 1.128_787_029_908_125_7;
const GAMMA_11_6: f64 = 0.940_655_858_256_771_4;
const GAMMA_1_6: f64 = 5.566_316_001_780_236;

/// The transfer function `exp(-D(b) / 2)` of the seeing at a baseline `b` in metres. `D` is the
/// phase structure function, `r0` Fried's parameter and `L0` the outer scale:
///
/// * Kolmogorov: `D = 6.8839 (b / r0)^(5/3)`.
/// * von Karman: `D = C (L0 / r0)^(5/3) [Gamma(5/6) / 2^(1/6) - z^(5/6) K_{5/6}(z)]`, `z = 2 pi b /
///   L0`, `C = 2^(1/6) Gamma(11/6) / pi^(8/3) (24/5 Gamma(6/5))^(5/6)` (Tokovinin 2002, PASP 114,
///   1156).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Seeing {
    r0_m: f64,
    outer_scale_m: Option<f64>,
}

impl Seeing {
    pub(crate) fn new(params: &SeeingParams, wavelength_m: f64) -> Result<Self, OpticsError> {
        let positive = |key, allowed, value: f64| require(key, allowed, value, value > 0.0);
        let at_nm = params.at_wavelength_nm;
        let at_m = 1e-9 * positive("seeing.at_wavelength_nm", "a number of nm above 0", at_nm)?;
        let r0_there = match (params.r0_m, params.fwhm_arcsec) {
            (Some(r0), None) => positive("seeing.r0_m", "a number of metres above 0", r0)?,
            (None, Some(fwhm)) => {
                let fwhm = positive("seeing.fwhm_arcsec", "a number of arcsec above 0", fwhm)?;
                KOLMOGOROV_FWHM * at_m / crate::arcsec_to_rad(fwhm)
            }
            (r0, fwhm) => {
                let given = usize::from(r0.is_some()) + usize::from(fwhm.is_some());
                return Err(OpticsError::Unusable(format!(
                    "exactly one of seeing.r0_m and seeing.fwhm_arcsec must be given, got {given}"
                )));
            }
        };
        if let Some(scale) = params.outer_scale_m {
            positive("seeing.outer_scale_m", "a number of metres above 0", scale)?;
        }
        Ok(Self {
            r0_m: r0_there * (wavelength_m / at_m).powf(1.2),
            outer_scale_m: params.outer_scale_m,
        })
    }

    /// The transfer function at the baseline `b_m` in metres: wavelength times spatial frequency.
    pub(crate) fn transfer(&self, b_m: f64) -> f64 {
        (-0.5 * self.structure(b_m)).exp()
    }

    fn structure(&self, b_m: f64) -> f64 {
        let Some(scale) = self.outer_scale_m else {
            return STRUCTURE * (b_m / self.r0_m).powf(5.0 / 3.0);
        };
        let z = std::f64::consts::TAU * b_m / scale;
        let c = 2f64.powf(1.0 / 6.0) * GAMMA_11_6 / std::f64::consts::PI.powf(8.0 / 3.0) * STRUCTURE / 2.0;
        c * (scale / self.r0_m).powf(5.0 / 3.0) * bessel_deficit(z)
    }
}

/// `Gamma(5/6) / 2^(1/6) - z^(5/6) K_{5/6}(z)`: 0 at z = 0, without cancellation at small z.
fn bessel_deficit(z: f64) -> f64 {
    let nu: f64 = 5.0 / 6.0;
    let limit = GAMMA_5_6 / 2f64.powf(1.0 / 6.0);
    if z < 2.0 {
        // K_nu = pi / (2 sin(nu pi)) (I_-nu - I_nu), sin(5 pi / 6) = 1/2. The first term of I_-nu
        // cancels `limit` and is left out.
        let q = z * z / 4.0;
        let (mut sum, mut minus, mut plus) = (
            0.0,
            2f64.powf(nu) / GAMMA_1_6,
            (z * z / 2.0).powf(nu) / GAMMA_11_6,
        );
        for k in 0..40 {
            let k = f64::from(k);
            sum += plus;
            plus *= q / ((k + 1.0) * (k + 1.0 + nu));
            minus *= q / ((k + 1.0) * (k + 1.0 - nu));
            sum -= minus;
        }
        std::f64::consts::PI * sum
    } else {
        // K_nu(z) = integral over t > 0 of exp(-z cosh t) cosh(nu t). The trapezoid rule converges
        // exponentially for it.
        let step = 0.05;
        let k: f64 = (1..120)
            .map(|i| f64::from(i) * step)
            .map(|t| (-z * t.cosh()).exp() * (nu * t).cosh())
            .sum::<f64>()
            + 0.5 * (-z).exp();
        limit - z.powf(nu) * k * step
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seeing(r0_m: f64, outer_scale_m: Option<f64>) -> Seeing {
        Seeing { r0_m, outer_scale_m }
    }

    #[test]
    fn the_two_forms_of_the_bessel_function_meet() {
        let limit = GAMMA_5_6 / 2f64.powf(1.0 / 6.0);
        let below = bessel_deficit(2.0 - 1e-12);
        let above = bessel_deficit(2.0);
        assert!((below - above).abs() < 1e-11, "{below} {above}");
        assert!((bessel_deficit(60.0) - limit).abs() < 1e-15);
        assert_eq!(bessel_deficit(0.0), 0.0);
    }

    #[test]
    fn a_large_outer_scale_is_kolmogorov() {
        // The first correction is proportional to (b / L0)^(1/3), which is small only for huge
        // scales.
        let ratio = seeing(0.1, Some(1e12)).structure(0.3) / seeing(0.1, None).structure(0.3);
        assert!((ratio - 1.0).abs() < 1e-3, "{ratio}");
        let outer = seeing(0.1, Some(20.0));
        assert!(outer.structure(1.0) < seeing(0.1, None).structure(1.0));
    }

    #[test]
    fn the_structure_function_saturates_at_twice_the_phase_variance() {
        // The variance is the integral over the plane of 0.0229 r0^(-5/3) (k^2 + L0^-2)^(-11/6)
        // (Noll 1976). The constant 0.0229 has three digits.
        let (r0, scale) = (0.2f64, 25.0f64);
        let variance = 0.5 * seeing(r0, Some(scale)).structure(1e4);
        let integral = 0.0229 * std::f64::consts::TAU * 0.6 * (scale / r0).powf(5.0 / 3.0);
        assert!((variance / integral - 1.0).abs() < 1e-3);
    }
}
