//! A field-varying PSF of ScopeSim as a model.

use ndarray::Axis;
use psf_basis::{PixelNoise, RankSelection};
use psf_io::ScopesimPsf;
use psf_types::{Interpolation, Normalisation, OutsidePolicy, PsfModelRecord, SampleCoefficients};

use crate::{FitOptions, PsfieldError, fit};

/// A basis of the layers, and at each node of the map the coefficients of its layer: no stamp is there twice, however fine the
/// map. The nearest node's PSF applies, scaled to unit flux as ScopeSim does.
pub(super) fn record_of_scopesim(psf: &ScopesimPsf) -> Result<PsfModelRecord, PsfieldError> {
    let options = FitOptions {
        rank: RankSelection::Full,
        noise: PixelNoise::Known(0.0),
        interpolation: Interpolation::Nearest,
        normalisation: Normalisation::Keep,
        ..FitOptions::default()
    };
    let fitted = fit(psf.layers().clone(), &options)?;
    let layers = fitted.record();
    let of_nodes = layers
        .coefficients()
        .values()
        .select(Axis(0), psf.layer_of_node());
    Ok(PsfModelRecord::new(
        layers.basis().clone(),
        SampleCoefficients::new(of_nodes, psf.nodes().clone())?,
        Interpolation::Nearest,
        OutsidePolicy::Nearest,
        Normalisation::Unit,
    )?)
}
