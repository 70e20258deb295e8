//! Stars of a frame, drawn and measured alike wherever they are compared.

use psf_stars::StarSamples;
use psf_types::{PointSource, Position};

use crate::PsfieldError;

/// The measuring window in FWHM, and at least so many pixels.
const WINDOW_FWHM: f64 = 4.0;
const LEAST_WINDOW: usize = 7;

/// Pixels along each side of the window in which a star is measured: an odd number.
pub(crate) fn measuring_window(fwhm_px: f64) -> usize {
    ((WINDOW_FWHM * fwhm_px).ceil() as usize | 1).max(LEAST_WINDOW)
}

/// Every source with light on the frame, whether it became a sample or not.
pub(crate) fn drawn_sources(stars: &StarSamples) -> Result<Vec<PointSource>, PsfieldError> {
    let field = stars.samples.positions().field();
    let mut sources = Vec::with_capacity(stars.sources.len());
    for source in &stars.sources {
        let position = Position::new(source.x, source.y)?;
        if source.flux > 0.0 && field.is_none_or(|field| field.contains(position)) {
            sources.push(PointSource::new(position, source.flux)?);
        }
    }
    Ok(sources)
}
