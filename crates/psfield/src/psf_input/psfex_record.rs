//! A PSFEx model as a basis and polynomial coefficient fields.

use std::f64::consts::PI;

use ndarray::Array3;
use psf_basis::{PixelNoise, RankSelection};
use psf_io::{PsfexAxis, PsfexModel};
use psf_types::{
    Interpolation, Normalisation, OutsidePolicy, Position, PsfModelRecord, PsfSamples, SamplePositions,
};

use crate::{FitOptions, PsfieldError, fit};

/// A PSFEx model as a basis and polynomial coefficient fields: the same PSFs to rounding, nothing is fitted anew.
///
/// The planes' polynomial of degree d is evaluated at (d+1) x (d+1) nodes, Chebyshev's extrema over `POLZERO +- POLSCAL / 2`,
/// which determine it; their full basis and an interpolating polynomial of degree d give it back. Outside the nodes the
/// polynomial goes on ([`OutsidePolicy::Extend`]), as in PSFEx's own tools. PSFEx's planes need not have unit flux; the
/// record says that every PSF is scaled to it ([`Normalisation::Unit`]).
///
/// # Errors
/// [`PsfieldError::DarkNode`] when the PSF has no positive flux somewhere in the area it was fitted to.
pub fn record_of_psfex(model: &PsfexModel) -> Result<PsfModelRecord, PsfieldError> {
    let degree = model.degree();
    let nodes = nodes(model)?;
    let mut stamps = Array3::zeros((nodes.len(), model.grid().ny(), model.grid().nx()));
    for (mut stamp, &position) in stamps.outer_iter_mut().zip(&nodes) {
        let psf = model.psf_at(position)?;
        let flux = psf.flux();
        if !(flux > 0.0 && flux.is_finite()) {
            return Err(PsfieldError::DarkNode { position, flux });
        }
        stamp.assign(&psf.values());
    }
    let samples = PsfSamples::new(stamps, SamplePositions::new(nodes, None)?, model.grid())?;
    let options = FitOptions {
        rank: RankSelection::Full,
        noise: PixelNoise::Known(0.0),
        interpolation: Interpolation::Polynomial { degree },
        outside: OutsidePolicy::Extend,
        normalisation: Normalisation::Keep,
        ..FitOptions::default()
    };
    let fitted = fit(samples, &options)?;
    let kept = fitted.record();
    Ok(PsfModelRecord::new(
        kept.basis().clone(),
        kept.coefficients().clone(),
        kept.interpolation(),
        kept.outside(),
        Normalisation::Unit,
    )?)
}

/// The nodes, x fastest; one, anywhere, where the PSF is the same everywhere.
fn nodes(model: &PsfexModel) -> Result<Vec<Position>, PsfieldError> {
    let Some(polynomial) = model.polynomial() else {
        return Ok(vec![Position::of_pixel(0, 0)]);
    };
    let along = |axis: &PsfexAxis| extrema(polynomial.degree(), axis.zero(), 0.5 * axis.scale());
    let (x, y) = (along(polynomial.x()), along(polynomial.y()));
    y.iter()
        .flat_map(|&y| x.iter().map(move |&x| Ok(Position::new(x, y)?)))
        .collect()
}

/// Where Chebyshev's polynomial of this degree has its extrema, the ends included, over `centre +- half`.
pub(crate) fn extrema(degree: usize, centre: f64, half: f64) -> Vec<f64> {
    if degree == 0 {
        return vec![centre];
    }
    (0..=degree)
        .map(|i| centre - half * (PI * i as f64 / degree as f64).cos())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model_of;
    use psf_io::PsfexPolynomial;

    /// Rounding, relative to the peak, also two scales away from the nodes, where high powers amplify it.
    const ROUNDING: f64 = 1e-12;

    fn model(degree: usize, scale: f64) -> PsfexModel {
        let axis = |name, zero| PsfexAxis::new(name, zero, scale).unwrap();
        let polynomial =
            PsfexPolynomial::new(axis("X_IMAGE", 700.0), axis("Y_IMAGE", 1500.25), degree).unwrap();
        let planes = Array3::from_shape_fn((PsfexPolynomial::term_count(degree), 9, 8), |(t, y, x)| {
            let r2 = (x as f64 - 4.0).powi(2) + (y as f64 - 4.0).powi(2);
            let wave = (t as f64 + 1.0 + 0.7 * x as f64 * (y as f64 + 0.3 * t as f64)).sin();
            (-0.2 * r2).exp() * if t == 0 { 1.0 } else { 0.2 * wave }
        });
        PsfexModel::new(planes, 0.7, Some(polynomial)).unwrap()
    }

    fn largest_error(psfex: &PsfexModel, record: PsfModelRecord, positions: &[(f64, f64)]) -> f64 {
        let record = PsfModelRecord::new(
            record.basis().clone(),
            record.coefficients().clone(),
            record.interpolation(),
            record.outside(),
            Normalisation::Keep,
        );
        let model = model_of(record.unwrap()).unwrap();
        let errors = positions.iter().map(|&(x, y)| {
            let position = Position::new(x, y).unwrap();
            let (found, truth) = (model.psf_at(position).unwrap(), psfex.psf_at(position).unwrap());
            let peak = truth.values().iter().fold(0.0f64, |m, v| m.max(v.abs()));
            let differences = found.values().to_owned() - truth.values();
            differences.iter().fold(0.0f64, |m, v| m.max(v.abs())) / peak
        });
        errors.fold(0.0, f64::max)
    }

    #[test]
    fn every_degree_is_carried_over_exactly_inside_and_outside() {
        let positions = [
            (700.0, 1500.25),
            (213.7, 2400.1),
            (1890.0, 3.0),
            (-300.0, 5000.0),
            (0.0, 0.0),
        ];
        for degree in 0..=4 {
            for scale in [2000.0, -2000.0] {
                let psfex = model(degree, scale);
                let record = record_of_psfex(&psfex).unwrap();
                assert_eq!(record.coefficients().positions().len(), (degree + 1).pow(2));
                assert_eq!(record.basis().rank() + 1, PsfexPolynomial::term_count(degree));
                assert_eq!(record.basis().grid(), psfex.grid());
                let error = largest_error(&psfex, record, &positions);
                assert!(error <= ROUNDING, "degree {degree}: {error:e}");
            }
        }
        // Another polynomial is another model: the comparison can fail.
        let error = largest_error(
            &model(2, 1990.0),
            record_of_psfex(&model(2, 2000.0)).unwrap(),
            &positions,
        );
        assert!(error > 1e-4, "{error:e}");
    }

    #[test]
    fn a_constant_model_is_the_same_everywhere() {
        let constant = PsfexModel::new(Array3::from_elem((1, 3, 5), 0.2), 1.5, None).unwrap();
        let record = record_of_psfex(&constant).unwrap();
        assert_eq!(
            (record.basis().rank(), record.normalisation()),
            (0, Normalisation::Unit)
        );
        assert!(largest_error(&constant, record, &[(0.0, 0.0), (1e4, -3e3)]) <= ROUNDING);
    }

    #[test]
    fn a_model_without_light_is_refused() {
        let psfex = model(1, 2000.0);
        let dark = psfex.planes().mapv(|v| -v);
        let dark = PsfexModel::new(dark, 0.7, psfex.polynomial().cloned()).unwrap();
        assert!(matches!(
            record_of_psfex(&dark),
            Err(PsfieldError::DarkNode { .. })
        ));
    }
}
