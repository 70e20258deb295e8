//! Pixels and the sources that they belong to.

use crate::neighbours::Neighbours;
use crate::selection::Candidate;

/// A source's pixels, as far as neighbours are concerned, in FWHM from its centre.
const OWN_FWHM: f64 = 1.5;
/// Neighbours with less than this part of a star's flux do not mask its pixels.
const HARMLESS: f64 = 0.01;

/// Which pixels belong to which source.
#[derive(Debug)]
pub(crate) struct Ownership {
    neighbours: Neighbours,
    fluxes: Vec<f64>,
    radius: f64,
}

impl Ownership {
    pub(crate) fn new(candidates: &[Candidate], fwhm_px: f64) -> Self {
        Self {
            neighbours: Neighbours::new(candidates.iter().map(|c| (c.x, c.y))),
            fluxes: candidates.iter().map(|c| c.flux).collect(),
            radius: OWN_FWHM * fwhm_px,
        }
    }

    /// Whether a pixel is free of the light of sources other than `source`, which has this flux.
    pub(crate) fn allows(&self, source: usize, flux: f64, x: f64, y: f64) -> bool {
        !self
            .neighbours
            .within(x, y, self.radius)
            .any(|(j, _)| j != source && self.fluxes[j] > HARMLESS * flux)
    }
}
