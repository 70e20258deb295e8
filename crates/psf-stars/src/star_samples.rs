//! What the stars of a frame give.

use psf_types::PsfSamples;

use crate::{Background, CoverageMap, RegistrationReport, Rejection, Saturation, Source};

/// PSF samples from the stars of a frame, and all that is known of how they came about.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct StarSamples {
    /// The samples, of unit flux, in the order of their sources.
    pub samples: PsfSamples,
    /// Every source found, the most significant first; none is left out, each rejected one carries its reasons.
    pub sources: Vec<Source>,
    /// Where the samples cover the field.
    pub coverage: CoverageMap,
    /// The frame's background.
    pub background: Background,
    /// The most frequent FWHM of the stars in pixels.
    pub fwhm_px: f64,
    /// The saturation level in force.
    pub saturation: Saturation,
    /// How the stars were registered.
    pub registration: RegistrationReport,
}

impl StarSamples {
    /// How many sources were rejected for each reason; a source may have several.
    pub fn rejection_counts(&self) -> Vec<(Rejection, usize)> {
        rejection_counts(&self.sources)
    }
}

pub(crate) fn rejection_counts(sources: &[Source]) -> Vec<(Rejection, usize)> {
    Rejection::ALL
        .into_iter()
        .map(|reason| {
            (
                reason,
                sources.iter().filter(|s| s.rejected.contains(reason)).count(),
            )
        })
        .filter(|(_, count)| *count > 0)
        .collect()
}
