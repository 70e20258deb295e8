//! Derivatives with respect to flux and position.

use psf_types::PointSource;

/// The derivatives of a number with respect to the flux and the position of a source.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PointGradient {
    /// With respect to the flux.
    pub flux: f64,
    /// With respect to the position along x, in pixels.
    pub x: f64,
    /// With respect to the position along y, in pixels.
    pub y: f64,
}

impl PointGradient {
    /// The derivatives for a source of a flux from those with respect to flux, x and y for a source of flux 1.
    pub(crate) fn for_flux(flux: f64, [of_flux, x, y]: [f64; 3]) -> Self {
        Self {
            flux: of_flux,
            x: flux * x,
            y: flux * y,
        }
    }
}

/// Sources with a flux of 1. A source without flux is not drawn, but has a derivative with respect to its flux.
pub(crate) fn with_unit_flux(sources: &[PointSource]) -> Vec<PointSource> {
    let unit = |source: &PointSource| PointSource::new(source.position(), 1.0);
    sources
        .iter()
        .map(|source| unit(source).expect("1 is finite"))
        .collect()
}
