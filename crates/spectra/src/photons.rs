//! The photons of a source that a bandpass lets pass, as a sum over wavelengths.

use crate::curve::Bandpass;
use crate::error::SpectraError;
use crate::spectrum::Spectrum;

/// A fraction of the detected photons, and the wavelength that stands for them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PhotonFraction {
    /// Wavelength in micrometres.
    pub wavelength_um: f64,
    /// The fraction of the photons. All fractions add up to 1.
    pub weight: f64,
}

/// The nodes on -1 to 1 and the weights of Gauss and Legendre's rule with four nodes, exact for
/// polynomials of degree 7 (Abramowitz and Stegun 1964, table 25.4).
const NODES: [(f64, f64); 4] = [
    (-0.861_136_311_594_052_6, 0.347_854_845_137_453_9),
    (-0.339_981_043_584_856_3, 0.652_145_154_862_546_1),
    (0.339_981_043_584_856_3, 0.652_145_154_862_546_1),
    (0.861_136_311_594_052_6, 0.347_854_845_137_453_9),
];
/// No piece of the integral is longer than the bandpass divided by this number, so that formulas
/// such as Planck's law are polynomials within rounding in each piece.
const PIECES: f64 = 64.0;
/// The part of the bandpass that a table of a spectrum may leave out at either end, relative to its
/// width. It allows for rounding of the wavelengths in files.
const SLACK: f64 = 1e-6;

/// The detected photons of a source: `int g(lambda) f_lambda lambda T d lambda`, divided by this
/// integral for `g = 1`, is the sum of `weight * g(wavelength)` over the returned list. The list is
/// in the order of wavelengths.
///
/// The rule of Gauss and Legendre is applied between the rows of the bandpass, of the spectrum and of
/// `knots`. It is exact where `g` is a cubic and the spectrum a table, and exact within rounding for
/// formulas. `knots` are wavelengths at which `g` has a kink.
///
/// # Errors
/// [`SpectraError::NoOverlap`] if no photons pass, [`SpectraError::Uncovered`] if a table covers only
/// a part of the bandpass.
pub fn photons(
    bandpass: &Bandpass,
    spectrum: &Spectrum,
    knots: &[f64],
) -> Result<Vec<PhotonFraction>, SpectraError> {
    let (first, last) = bandpass.range_um();
    let (low, high) = spectrum.range_um();
    if low >= last || high <= first {
        return Err(no_overlap(bandpass, spectrum));
    }
    let slack = SLACK * (last - first);
    if low > first + slack || high < last - slack {
        return Err(SpectraError::Uncovered {
            bandpass: (first, last),
            spectrum: (low, high),
        });
    }
    let rows = bandpass
        .throughput()
        .wavelengths_um()
        .iter()
        .chain(knots)
        .copied();
    let mut cuts: Vec<f64> = rows
        .chain(spectrum.rows_um())
        .filter(|w| (first..=last).contains(w))
        .collect();
    cuts.extend([first, last]);
    cuts.sort_by(f64::total_cmp);
    cuts.dedup();
    let longest = (last - first) / PIECES;
    let mut fractions = Vec::new();
    for pair in cuts.windows(2) {
        let pieces = ((pair[1] - pair[0]) / longest).ceil().max(1.0);
        let half = (pair[1] - pair[0]) / (2.0 * pieces);
        for piece in 0..pieces as usize {
            let middle = pair[0] + half * (2 * piece + 1) as f64;
            for (node, weight) in NODES {
                let wavelength_um = middle + half * node;
                let density =
                    bandpass.throughput().at(wavelength_um) * spectrum.photon_density(wavelength_um);
                let weight = half * weight * density;
                fractions.push(PhotonFraction {
                    wavelength_um,
                    weight,
                });
            }
        }
    }
    let total: f64 = fractions.iter().map(|f| f.weight).sum();
    if !(total > 0.0 && total.is_finite()) {
        return Err(no_overlap(bandpass, spectrum));
    }
    for fraction in &mut fractions {
        fraction.weight /= total;
    }
    fractions.retain(|fraction| fraction.weight > 0.0);
    Ok(fractions)
}

fn no_overlap(bandpass: &Bandpass, spectrum: &Spectrum) -> SpectraError {
    SpectraError::NoOverlap {
        bandpass: bandpass.range_um(),
        spectrum: spectrum.range_um(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::curve::Curve;
    use crate::spectrum::FluxDensity;

    /// Rounding of sums of some hundred terms.
    const ROUNDING: f64 = 1e-13;

    fn triangle() -> Bandpass {
        Bandpass::new(Curve::new(vec![0.4, 0.5, 0.7, 0.9], vec![0.0, 0.0, 1.0, 0.0]).unwrap())
    }

    fn mean(fractions: &[PhotonFraction], g: impl Fn(f64) -> f64) -> f64 {
        fractions.iter().map(|f| f.weight * g(f.wavelength_um)).sum()
    }

    #[test]
    fn polynomials_are_integrated_exactly() {
        // Photons per wavelength are constant: the weight is the triangle itself.
        let flat = Spectrum::power_law(-1.0).unwrap();
        let found = photons(&triangle(), &flat, &[0.6]).unwrap();
        assert!((mean(&found, |_| 1.0) - 1.0).abs() < ROUNDING);
        assert!((mean(&found, |w| w) - 0.7).abs() < ROUNDING);
        // The variance of a triangle of half width 0.2.
        assert!((mean(&found, |w| (w - 0.7).powi(2)) - 0.04 / 6.0).abs() < ROUNDING);
        // A kink of g at a knot.
        let kinked = mean(&found, |w| (w - 0.6).max(0.0));
        // int over 0.6 to 0.9 of (w - 0.6) T / 0.2: 0.7 - 0.6 plus int over 0.5 to 0.6 of (0.6 - w) T / 0.2.
        assert!((kinked - (0.1 + 0.1f64.powi(3) / 6.0 / 0.04)).abs() < ROUNDING);
    }

    #[test]
    fn formulas_equal_fine_tables() {
        let body = Spectrum::black_body(3000.0).unwrap();
        let wavelengths: Vec<f64> = (0..=40_000)
            .map(|i| 0.4 + 0.5 * f64::from(i) / 40_000.0)
            .collect();
        let densities = wavelengths.iter().map(|&w| body.photon_density(w)).collect();
        let table = Spectrum::table(Curve::new(wavelengths, densities).unwrap(), FluxDensity::Photons);
        let of = |spectrum| mean(&photons(&triangle(), spectrum, &[]).unwrap(), |w| w);
        // The table is linear between rows that are 1.25e-5 um apart.
        assert!((of(&body) - of(&table)).abs() < 1e-9);
    }

    #[test]
    fn spectra_outside_the_bandpass_are_refused() {
        let table = |from: f64, to: f64| {
            Spectrum::table(
                Curve::new(vec![from, to], vec![1.0, 1.0]).unwrap(),
                FluxDensity::Photons,
            )
        };
        let message = |spectrum: &Spectrum| photons(&triangle(), spectrum, &[]).unwrap_err().to_string();
        assert!(message(&table(1.0, 2.0)).contains("no light in the bandpass, which passes 0.5 to 0.9 um"));
        assert!(message(&table(0.6, 2.0)).contains("known only from 0.6 to 2 um"));
        assert!(photons(&triangle(), &table(0.5, 0.9), &[]).is_ok());
        let shifted = table(0.5, 0.9).with_redshift(1.0).unwrap();
        assert!(message(&shifted).contains("no light"));
    }
}
