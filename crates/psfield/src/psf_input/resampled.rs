//! The same PSF on other pixels.

use conv_core::{grid_with_pixel_response, native_grid, resample_samples};
use psf_basis::{Centring, RankSelection};
use psf_types::{
    Anchor, FrameShape, Normalisation, Position, PsfModelRecord, PsfSamples, SamplePositions, StampGrid,
};

use super::{PsfInput, check_stack, samples_of};
use crate::{FitOptions, PsfieldError, fit};

impl PsfInput {
    /// The same PSF with stamps at the frame's own pixels, centred on one, as images need them, the pixel response in them; `size` pixels
    /// wide and high, centred at `size / 2`, where given, else as large as the stamps. What is such already stays as it is.
    ///
    /// # Errors
    /// [`PsfieldError`] when `size` is 0, the resampled stamps hold no flux or would fill more memory than
    /// [`PsfieldError::TooLarge`] allows.
    pub fn native(self, size: Option<usize>) -> Result<Self, PsfieldError> {
        let target = self.native_target(size)?;
        if target == self.grid() {
            return Ok(self);
        }
        self.remade(|samples| Ok(resample_samples(samples, target)?), target)
    }

    /// Whether [`native`](Self::native) only picks pixels of the stamps, so that nothing is interpolated.
    ///
    /// # Errors
    /// [`PsfieldError::Data`] when `size` is 0.
    pub fn native_is_exact(&self, size: Option<usize>) -> Result<bool, PsfieldError> {
        let grid = self.grid();
        let picks = grid.whole_centre().is_some()
            && grid.oversampling().fract() == 0.0
            && grid.pixel_response_included();
        Ok(picks || self.native_target(size)? == grid)
    }

    fn native_target(&self, size: Option<usize>) -> Result<StampGrid, PsfieldError> {
        let base = match size {
            None => native_grid(grid_with_pixel_response(self.grid())?)?,
            Some(n) => StampGrid::new(n, n)?,
        };
        Ok(base
            .with_pixel_response_included(true)
            .with_interpolation(self.grid().interpolation()))
    }

    /// The same PSF with the response of a frame pixel in its stamps, at their own sampling; a response that is there already
    /// stays as it is.
    ///
    /// # Errors
    /// As [`native`](Self::native).
    pub fn with_pixel_response(self) -> Result<Self, PsfieldError> {
        let target = grid_with_pixel_response(self.grid())?;
        if target == self.grid() {
            return Ok(self);
        }
        self.remade(|samples| Ok(resample_samples(samples, target)?), target)
    }

    /// The same PSF for scenes whose pixels are `finer` times smaller than the frame's, with stamps for images at the scene's
    /// pixels: `size` frame pixels wide and high, where given.
    ///
    /// Frame pixel `i` has its centre at `finer i + (finer - 1) / 2` of the scene. The convolution of a scene with these stamps,
    /// taken at every `finer`-th pixel from `(finer - 1) / 2` (rounded down) on and times `finer^2`, is the frame's image: the response of
    /// the frame's pixel is in the stamps, so that it is sampled, not summed.
    pub(crate) fn for_finer_scene(
        self,
        finer: usize,
        size: Option<usize>,
        anchor: Anchor,
    ) -> Result<Self, PsfieldError> {
        let s = finer as f64;
        let own = grid_with_pixel_response(self.grid())?;
        let target = match size {
            None => native_grid(own.with_oversampling(own.oversampling() / s)?)?,
            Some(n) => StampGrid::new(n * finer, n * finer)?,
        };
        let target = target
            .with_pixel_response_included(true)
            .with_interpolation(own.interpolation());
        // An even number of scene pixels puts the centre of the frame's between two of them.
        let between = (s - 1.0) / 2.0 - ((finer - 1) / 2) as f64;
        let offset_of_field = if anchor == Anchor::Output {
            (s - 1.0) / 2.0 - between
        } else {
            (s - 1.0) / 2.0
        };
        let sampled = target
            .with_oversampling(s)?
            .with_centre(target.centre_x() - between, target.centre_y() - between)?;
        let remake = |samples: &PsfSamples| {
            let fine = resample_samples(samples, sampled)?;
            let positions = finer_positions(samples.positions(), finer, offset_of_field)?;
            // Fractions of the flux in a pixel of the scene.
            let stamps = fine.stamps().mapv(|v| v / (s * s));
            Ok(PsfSamples::new(stamps, positions, target)?)
        };
        self.remade(remake, target)
    }

    /// The PSF whose samples are remade, one by one and linearly in their values.
    ///
    /// Interpolation is linear in the samples, so a model of remade samples gives the PSFs that come of remaking its own, before the
    /// scaling to unit flux; that is done last, on the new stamps.
    fn remade(
        self,
        remake: impl FnOnce(&PsfSamples) -> Result<PsfSamples, PsfieldError>,
        target: StampGrid,
    ) -> Result<Self, PsfieldError> {
        let record = match self {
            Self::Samples(samples, options) => {
                check_stack(samples.len(), target)?;
                return Ok(Self::Samples(remake(&samples)?, options));
            }
            Self::Model(record) => record,
        };
        check_stack(record.coefficients().positions().len(), target)?;
        let options = FitOptions {
            rank: RankSelection::Full,
            centring: if record.basis().mean().is_some() {
                Centring::Mean
            } else {
                Centring::None
            },
            interpolation: record.interpolation(),
            outside: record.outside(),
            normalisation: Normalisation::Keep,
            ..FitOptions::default()
        };
        let fitted = fit(remake(&samples_of(&record)?)?, &options)?;
        let kept = fitted.record();
        Ok(Self::Model(PsfModelRecord::new(
            kept.basis().clone(),
            kept.coefficients().clone(),
            record.interpolation(),
            record.outside(),
            record.normalisation(),
        )?))
    }
}

/// Positions in pixels of the scene. All interpolators follow a change of scale.
fn finer_positions(
    positions: &SamplePositions,
    finer: usize,
    offset: f64,
) -> Result<SamplePositions, PsfieldError> {
    let s = finer as f64;
    let moved = positions
        .as_slice()
        .iter()
        .map(|p| Position::new(s * p.x() + offset, s * p.y() + offset))
        .collect::<Result<_, _>>()?;
    let field = positions
        .field()
        .map(|field| FrameShape::new(finer * field.nx(), finer * field.ny()))
        .transpose()?;
    Ok(SamplePositions::new(moved, field)?)
}
