//! The PSFs of a simulator's layers.

use std::sync::OnceLock;

use conv_core::ConvReal;

use super::setup::Setup;
use super::sources::PartSources;
use crate::error::PsfieldError;
use crate::psf::{Psf, get_or_make};

/// A PSF with one basis, and a state for each of some layers. Most simulators have one part. The part also
/// holds what all regions of a frame share: the plans for stars and galaxies.
#[derive(Debug)]
pub(crate) struct Part<T: ConvReal> {
    pub(super) psf: Psf,
    sources: OnceLock<PartSources<T>>,
}

impl<T: ConvReal> Part<T> {
    pub(crate) fn new(psf: Psf) -> Self {
        Self {
            psf,
            sources: OnceLock::new(),
        }
    }

    /// A part for another PSF on the same basis, for scenes with stars or galaxies. Its local bases represent
    /// the PSFs of `represented`, or are those of this part.
    pub(crate) fn for_other(
        &self,
        psf: Psf,
        represented: Option<&Psf>,
        setup: &Setup,
    ) -> Result<Self, PsfieldError> {
        let sources = match represented {
            Some(represented) => self.sources(setup)?.representing(represented, setup)?,
            None => None,
        };
        let lent = sources.as_ref().or(self.sources.get());
        let sources = match lent {
            Some(lent) => lent.for_other_field(&psf)?,
            None => None,
        };
        Ok(Self {
            sources: sources.map_or_else(OnceLock::new, OnceLock::from),
            psf,
        })
    }

    /// The number of layers.
    pub(super) fn layer_count(&self) -> usize {
        self.psf.states().map_or(1, |states| states.values().len())
    }

    /// The plans for stars and galaxies, made when they are first needed.
    pub(super) fn sources(&self, setup: &Setup) -> Result<&PartSources<T>, PsfieldError> {
        get_or_make(&self.sources, || PartSources::new(&self.psf, setup))
    }

    /// Returns whether the plans for stars and galaxies exist.
    pub(super) fn has_sources(&self) -> bool {
        self.sources.get().is_some()
    }
}
