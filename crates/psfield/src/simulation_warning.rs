//! What a user should know of a simulation that nothing in it can check.

use std::fmt;

use crate::scene_sources::RESOLVED_PX;
use crate::{PsfInput, PsfieldError, SceneParts, SimulationOptions};

/// What a user should know of a simulation that nothing in it can check. Its text says what to do, where something can be done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SimulationWarning {
    /// An image is convolved with stamps interpolated from others.
    InterpolatedStamps,
    /// Stars are drawn between the pixels of stamps that are too coarse for it.
    StarsBetweenPixels,
    /// Galaxies are blurred by the pixels on which they are drawn.
    SmallGalaxies {
        /// How many.
        count: usize,
    },
}

impl SimulationWarning {
    /// What there is to say of a PSF for scenes of a kind; of their sources see [`SceneSources::warnings`](crate::SceneSources::warnings).
    ///
    /// # Errors
    /// [`PsfieldError::Data`] for a stamp size of 0.
    pub fn of_psf(
        psf: &PsfInput,
        parts: SceneParts,
        options: SimulationOptions,
    ) -> Result<Option<Self>, PsfieldError> {
        let picked = !parts.image || options.oversample() > 1 || psf.native_is_exact(options.stamp_size())?;
        Ok((!picked).then_some(Self::InterpolatedStamps))
    }
}

impl fmt::Display for SimulationWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::InterpolatedStamps => f.write_str(
                "the PSF stamps are not sampled at the centres of the image's pixels, or lack the pixel response: they are \
                 interpolated",
            ),
            Self::StarsBetweenPixels => f.write_str(
                "stars lie between pixels, and the PSF stamps are not oversampled (or less than twice): they are interpolated, which is wrong by \
                 percents where the PSF is under-sampled; the spot check does not see that",
            ),
            Self::SmallGalaxies { count } => write!(
                f,
                "{count} galaxies have a half-light radius below {RESOLVED_PX} pixels of the scene, whose own size then blurs them (by \
                 percents): --oversample S draws them on finer pixels"
            ),
        }
    }
}
