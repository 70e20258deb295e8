//! Turns PSFEx models and field-varying PSFs of ScopeSim into models that equal them to rounding.

use ndarray::{Array3, Axis};
use psf_basis::{PixelNoise, RankSelection};
use psf_io::{PsfexModel, ScopesimPsf};
use psf_types::{
    Interpolation, Normalisation, OutsidePolicy, PsfModelRecord, PsfSamples, SampleCoefficients,
    SamplePositions, StateKind,
};

use crate::error::{ErrorKind, PsfieldError};
use crate::fit::{FitOptions, fit};

/// Turns a PSFEx model into a basis and polynomial coefficient fields. They reproduce the PSFs of
/// the model to rounding, before the scaling to unit flux.
///
/// The model is evaluated at (d+1) x (d+1) nodes, where d is the total degree of its polynomial.
/// The nodes are Chebyshev's extrema over `POLZERO +- POLSCAL / 2`. All components of these PSFs
/// are kept, and their coefficients are polynomials of total degree d in x and y. The polynomials
/// also apply outside the nodes ([`OutsidePolicy::Extend`]), as in PSFEx's own tools. The PSFs of a
/// PSFEx model need not have unit flux. The record therefore requests a scaling to unit flux
/// ([`Normalisation::Unit`]).
///
/// # Errors
/// [`ErrorKind::Data`] when the PSF at a node does not have positive flux, and the errors of
/// [`fit()`].
pub fn record_of_psfex(model: &PsfexModel) -> Result<PsfModelRecord, PsfieldError> {
    let nodes = model.nodes()?;
    let mut stamps = Array3::zeros((nodes.len(), model.grid().ny(), model.grid().nx()));
    for (mut stamp, &position) in stamps.outer_iter_mut().zip(&nodes) {
        let psf = model.psf_at(position)?;
        let flux = psf.flux();
        if !(flux > 0.0 && flux.is_finite()) {
            let message = format!(
                "the PSF at {position} has flux {flux}: a model needs positive flux over the whole area to which it was fitted"
            );
            return Err(PsfieldError::new(ErrorKind::Data, message));
        }
        stamp.assign(&psf.values());
    }
    let samples = PsfSamples::new(stamps, SamplePositions::new(nodes, None)?, model.grid())?;
    let degree = model.degree();
    let record = full_basis(samples, Interpolation::Polynomial { degree })?;
    Ok(record
        .with_policies(OutsidePolicy::Extend, Normalisation::Unit)
        .with_circle_error(None))
}

/// Turns a field-varying PSF of ScopeSim into a basis of its layers. Each node of the file's map
/// has the coefficients of its layer, so that no stamp is stored twice, however fine the map is. At
/// every position the PSF of the nearest node applies, scaled to unit flux as in ScopeSim. Several
/// wavelengths are states.
pub(super) fn record_of_scopesim(psf: &ScopesimPsf) -> Result<PsfModelRecord, PsfieldError> {
    let layers = full_basis(psf.layers().clone(), Interpolation::Nearest)?;
    let of_layers = layers.coefficients().values();
    let wavelengths = psf.wavelengths_um();
    // The layers of each wavelength follow those of the one before.
    let count = of_layers.nrows() / wavelengths.len();
    let rows: Vec<usize> = (0..wavelengths.len())
        .flat_map(|state| psf.layer_of_node().iter().map(move |layer| state * count + layer))
        .collect();
    let of_nodes = of_layers.select(Axis(0), &rows);
    let nodes = match wavelengths {
        [_] => psf.nodes().clone(),
        several => {
            let (at, field) = (psf.nodes().as_slice(), psf.nodes().field());
            SamplePositions::in_every_state(at, field, StateKind::Wavelength, several)?
        }
    };
    let coefficients = SampleCoefficients::new(of_nodes, nodes)?;
    let record = layers.with_parts(layers.basis().clone(), coefficients)?;
    Ok(record.with_policies(OutsidePolicy::Nearest, Normalisation::Unit))
}

/// Fits a basis with all components to samples. The samples are not scaled.
fn full_basis(samples: PsfSamples, interpolation: Interpolation) -> Result<PsfModelRecord, PsfieldError> {
    let options = FitOptions {
        rank: RankSelection::Full,
        noise: PixelNoise::Known(0.0),
        interpolation,
        normalisation: Normalisation::Keep,
        ..FitOptions::default()
    };
    Ok(fit(samples, &options)?.record().clone())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::model_of;
    use psf_io::{PsfexAxis, PsfexPolynomial};
    use psf_types::Position;

    /// Rounding error, relative to the peak. High powers amplify it at positions two scales away
    /// from the nodes.
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
        // Proves that the comparison can fail: another scale gives another model.
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
    fn a_model_of_negative_flux_is_refused() {
        let psfex = model(1, 2000.0);
        let negative = psfex.planes().mapv(|v| -v);
        let negative = PsfexModel::new(negative, 0.7, psfex.polynomial().cloned()).unwrap();
        let error = record_of_psfex(&negative).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Data);
        assert!(error.to_string().contains("has flux -"), "{error}");
    }
}
