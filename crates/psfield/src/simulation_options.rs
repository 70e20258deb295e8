//! How scenes lie on the frame.

use psf_types::Anchor;

use crate::PsfieldError;

/// What a [`Simulation`](crate::Simulation) is made for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SimulationOptions {
    stamp_size: Option<usize>,
    oversample: usize,
    anchor: Anchor,
}

impl SimulationOptions {
    /// The finest scenes: so many pixels along each side of a frame pixel.
    pub const MAX_OVERSAMPLE: usize = 64;

    /// Cuts or pads the stamps of images, and cuts those of stars, to so many frame pixels along each side, centred at
    /// `size / 2`.
    #[must_use]
    pub fn with_stamp_size(self, stamp_size: Option<usize>) -> Self {
        Self { stamp_size, ..self }
    }

    /// For scenes that are finer than the frame: so many pixels along each side of a frame pixel. Everything in a scene (pixels, sources,
    /// frame) is in its own pixels; frame pixel `i` has its centre at `oversample i + (oversample - 1) / 2`.
    ///
    /// # Errors
    /// [`PsfieldError::Oversample`] for 0 or more than [`MAX_OVERSAMPLE`](Self::MAX_OVERSAMPLE).
    pub fn with_oversample(self, oversample: usize) -> Result<Self, PsfieldError> {
        if (1..=Self::MAX_OVERSAMPLE).contains(&oversample) {
            Ok(Self { oversample, ..self })
        } else {
            Err(PsfieldError::Oversample {
                got: oversample,
                most: Self::MAX_OVERSAMPLE,
            })
        }
    }

    /// For an anchoring. It matters where scenes are finer than the frame.
    #[must_use]
    pub fn with_anchor(self, anchor: Anchor) -> Self {
        Self { anchor, ..self }
    }

    /// Frame pixels along each side of the stamps, where cut or padded.
    pub fn stamp_size(&self) -> Option<usize> {
        self.stamp_size
    }

    /// Scene pixels along each side of a frame pixel.
    pub fn oversample(&self) -> usize {
        self.oversample
    }

    /// The anchoring.
    pub fn anchor(&self) -> Anchor {
        self.anchor
    }
}

impl Default for SimulationOptions {
    fn default() -> Self {
        Self {
            stamp_size: None,
            oversample: 1,
            anchor: Anchor::default(),
        }
    }
}
