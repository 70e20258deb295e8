//! The settings of a simulator, and the shapes of its scenes and images.

use conv_core::{ConvReal, InstructionSet, PlanOptions};
use psf_types::{FrameShape, PsfModel};

use super::flux::check_flux;
use super::geometry::Geometry;
use crate::error::PsfieldError;
use crate::evaluate::check_frame_on_field;
use crate::psf::{Psf, StampChange};
use crate::simulate_options::{Device, ScenePixels, SimulateOptions};

/// Frame pixels by which padded stamps may extend beyond the reach of the PSF ([`Psf::reach`]).
const STAMP_MARGIN: usize = 8;

/// The start of the error message for a region with a method that makes no plan
/// ([`PsfieldError::needs_plan`]).
pub(super) const REGION: &str = "a region of the frame can be computed";

/// Settings that suit each other, and the geometry that follows from them.
#[derive(Debug, Clone)]
pub(crate) struct Setup {
    pub(crate) options: SimulateOptions,
    pub(super) geometry: Geometry,
}

impl Setup {
    /// Checks settings for scenes of `shape` `(ny, nx)` through a PSF.
    pub(crate) fn new(
        psf: &Psf,
        (ny, nx): (usize, usize),
        options: SimulateOptions,
    ) -> Result<Self, PsfieldError> {
        options.plan_options()?;
        InstructionSet::asked()?;
        let geometry = Geometry::new(FrameShape::new(nx, ny)?, &options)?;
        let is_planned = options.method.has_plan();
        if !is_planned && !geometry.is_whole() {
            return Err(PsfieldError::needs_plan(REGION));
        }
        if !is_planned && options.device == Device::Gpu {
            const ON_GPU: &str =
                "only the methods auto and lowrank run on a GPU: choose one of them, or the device cpu";
            return Err(PsfieldError::of_setting("device", ON_GPU));
        }
        if options.stamp_size == Some(0) {
            const NO_STAMP: &str = "the stamp size must be at least 1 pixel";
            return Err(PsfieldError::of_setting("stamp_size", NO_STAMP));
        }
        check_frame_on_field(geometry.frame.shape(), psf.positions().field())?;
        Ok(Self { options, geometry })
    }

    /// The side of a PSF's stamps, in pixels of the frame. None: their own size.
    pub(super) fn stamp_size(&self, psf: &Psf) -> Option<usize> {
        // Farther out, padded stamps hold only zeros, which would cost time and change nothing.
        let widest = 2 * (psf.reach(None) + STAMP_MARGIN);
        self.options.stamp_size.map(|size| size.min(widest))
    }

    /// The options of a plan for some models of `psf`, with the limit of memory for these models. None for
    /// methods without a plan.
    ///
    /// # Errors
    /// The error of [`check_flux`].
    pub(super) fn plan_options<T: ConvReal>(
        &self,
        psf: &Psf,
        models: &[PsfModel],
    ) -> Result<Option<PlanOptions>, PsfieldError> {
        let Some(options) = self.options.plan_options()? else {
            return Ok(None);
        };
        check_flux(psf, models, &options)?;
        let frame = self.geometry.fine(self.geometry.frame)?.shape();
        let memory = || PlanOptions::memory_for::<T>(frame, &models[0]);
        let bytes = self.options.memory.unwrap_or_else(memory);
        let options = options.with_memory(bytes);
        let has_wings = models.iter().any(|model| model.wings().is_some());
        Ok(Some(if has_wings {
            options.beside_wings()
        } else {
            options
        }))
    }

    /// The PSF on the pixels of a scene's image, for its convolution.
    pub(crate) fn on_scene_pixels(&self, psf: &Psf) -> Result<Psf, PsfieldError> {
        let psf = self.with_scene_sampling(psf)?;
        match self.options.scene_pixels {
            ScenePixels::Point => Ok(psf),
            ScenePixels::Integrated => psf.without_scene_pixel(),
        }
    }

    /// The PSF at the sampling of a scene's image.
    fn with_scene_sampling(&self, psf: &Psf) -> Result<Psf, PsfieldError> {
        let size = self.stamp_size(psf);
        match self.options.oversample {
            1 => psf.native(size),
            finer => psf.for_finer_scene(finer, size, self.options.anchor),
        }
    }

    /// The changes of stamps by [`on_scene_pixels`](Self::on_scene_pixels), one after the other.
    pub(super) fn stamp_changes(&self, psf: &Psf) -> Result<Vec<StampChange>, PsfieldError> {
        let (options, size) = (&self.options, self.stamp_size(psf));
        let first = match options.oversample {
            1 => psf.native_change(size)?,
            finer => Some(psf.finer_change(finer, size)?),
        };
        let mut changes = Vec::from_iter(first);
        if options.scene_pixels == ScenePixels::Integrated {
            changes.push(self.with_scene_sampling(psf)?.scene_pixel_change()?);
        }
        Ok(changes)
    }
}
