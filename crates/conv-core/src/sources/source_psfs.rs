//! The PSFs of a plan's sources.

use std::sync::{Arc, OnceLock};

use psf_types::{Position, PsfModel, StampGrid};

use super::PsfVectors;
use crate::ConvError;
use crate::plan::psf_space::PsfSpace;
use crate::plan::{PlanOptions, check_layers};

/// The PSFs of sources, and those that the local bases represent.
#[derive(Debug, Clone)]
pub(crate) struct SourcePsfs {
    /// The model whose PSFs the sources have.
    pub(crate) model: PsfModel,
    shared: Arc<Shared>,
}

/// The parts that do not depend on the coefficient field of the sources' model.
#[derive(Debug)]
struct Shared {
    /// The models whose PSFs the local bases represent.
    models: Vec<PsfModel>,
    options: PlanOptions,
    /// The columns and rows of the frame to which stamps are truncated.
    size: Option<usize>,
    /// Made when the first source needs it.
    space: OnceLock<PsfSpace>,
}

impl SourcePsfs {
    /// The PSFs of the first of these models. Local bases represent those of all.
    pub(crate) fn new(
        models: &[PsfModel],
        options: PlanOptions,
        size: Option<usize>,
    ) -> Result<Self, ConvError> {
        check_layers(models)?;
        check_stamps(models[0].grid(), size)?;
        Ok(Self::on(models, options, size, OnceLock::new()))
    }

    fn on(models: &[PsfModel], options: PlanOptions, size: Option<usize>, space: OnceLock<PsfSpace>) -> Self {
        Self {
            model: models[0].clone(),
            shared: Arc::new(Shared {
                models: models.to_vec(),
                options,
                size,
                space,
            }),
        }
    }

    /// The PSFs of another model, with the same local bases.
    pub(crate) fn with_model(&self, model: &PsfModel) -> Self {
        Self {
            model: model.clone(),
            shared: Arc::clone(&self.shared),
        }
    }

    /// The PSFs of the first of other models, with local bases that represent those of all.
    pub(crate) fn for_other_models(&self, models: &[PsfModel]) -> Self {
        let Shared { options, size, .. } = *self.shared;
        let space = self.space().for_other_models(models, options.tolerance_on());
        Self::on(models, options, size, OnceLock::from(space))
    }

    pub(crate) fn models(&self) -> &[PsfModel] {
        &self.shared.models
    }

    pub(crate) fn options(&self) -> PlanOptions {
        self.shared.options
    }

    pub(crate) fn size(&self) -> Option<usize> {
        self.shared.size
    }

    pub(crate) fn space(&self) -> &PsfSpace {
        let shared = &self.shared;
        let make = || PsfSpace::new(&shared.models, shared.options.tolerance_on());
        shared.space.get_or_init(make)
    }

    /// The vectors of the PSFs of single sources.
    pub(crate) fn vectors(&self) -> PsfVectors<'_> {
        PsfVectors::new(&self.model, self.space())
    }

    /// An upper limit of the L2 norm of the PSF of a source of flux 1 on the pixels of the frame,
    /// for any sub-pixel position, and the size of the PSF's flux. Positions are in pixels of the frame.
    pub(crate) fn norm_and_flux(&self, position: Position) -> Result<(f64, f64), ConvError> {
        let mut vectors = self.vectors();
        let scale = vectors.set(position)?;
        let flux = (vectors.psf.dot(&self.space().fluxes) * scale).abs();
        Ok((
            OF_PHASES * vectors.norm() * scale / self.model.grid().oversampling(),
            flux,
        ))
    }
}

/// The L2 norm of a PSF over the frame's pixels depends on the sub-pixel position. It is at most
/// about this multiple of the norm over all pixels of the stamp, divided by the oversampling.
const OF_PHASES: f64 = 1.5;

/// Checks that sources can be drawn with stamps, which may be truncated to a size.
pub(crate) fn check_stamps(grid: StampGrid, size: Option<usize>) -> Result<(), ConvError> {
    if !grid.pixel_response_included() {
        return Err(ConvError::PixelResponse);
    }
    if size == Some(0) {
        return Err(ConvError::StampSize);
    }
    Ok(())
}
