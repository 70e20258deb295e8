//! A PSF as a user brings it: samples to be fitted, or a model.

mod file_options;
mod fit_choices;
mod open;
mod psfex_record;
mod scopesim_record;

use conv_core::{native_grid, resample_samples};
use ndarray::{Array3, s};
use psf_basis::{Centring, RankSelection};
use psf_types::{DataError, Normalisation, PsfModel, PsfModelRecord, PsfSamples, SamplePositions, StampGrid};

use crate::{FitOptions, PsfieldError, fit, model_of};

pub use file_options::PsfFileOptions;
pub use fit_choices::FitChoices;
pub use open::OpenedPsf;
pub(crate) use psfex_record::extrema;
pub use psfex_record::record_of_psfex;

/// A PSF as a user brings it.
#[derive(Debug, Clone)]
pub enum PsfInput {
    /// Samples, and how to fit them.
    Samples(PsfSamples, FitOptions),
    /// A model.
    Model(PsfModelRecord),
}

impl PsfInput {
    /// The pixel grid of the stamps.
    pub fn grid(&self) -> StampGrid {
        match self {
            Self::Samples(samples, _) => samples.grid(),
            Self::Model(record) => record.basis().grid(),
        }
    }

    /// Where the samples lie, or the nodes of the model.
    pub fn positions(&self) -> &SamplePositions {
        match self {
            Self::Samples(samples, _) => samples.positions(),
            Self::Model(record) => record.coefficients().positions(),
        }
    }

    /// The model, on the stamps' own grid.
    ///
    /// # Errors
    /// [`PsfieldError`] when the fit or the interpolator fails.
    pub fn into_model(self) -> Result<PsfModel, PsfieldError> {
        match self {
            Self::Samples(samples, options) => fit(samples, &options)?.into_model(),
            Self::Model(record) => model_of(record),
        }
    }

    /// The same PSF with stamps at the frame's own pixels, centred on one, as images need them; `size` pixels wide and high,
    /// centred at `size / 2`, where given, else as large as the stamps. What is such already stays as it is.
    ///
    /// Resampling is linear in the stamps and interpolation in the samples, so a model gives the PSFs that come of resampling
    /// its own, before the scaling to unit flux; that is done last, on the new stamps.
    ///
    /// # Errors
    /// [`PsfieldError`] when `size` is 0, the resampled stamps hold no flux or would fill more memory than
    /// [`PsfieldError::TooLarge`] allows.
    pub fn native(self, size: Option<usize>) -> Result<Self, PsfieldError> {
        let target = self.native_target(size)?;
        if target == self.grid() {
            return Ok(self);
        }
        Ok(match self {
            Self::Samples(samples, options) => {
                check_stack(samples.len(), target)?;
                Self::Samples(resample_samples(&samples, target)?, options)
            }
            Self::Model(record) => {
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
                let fitted = fit(resample_samples(&samples_of(&record)?, target)?, &options)?;
                let kept = fitted.record();
                Self::Model(PsfModelRecord::new(
                    kept.basis().clone(),
                    kept.coefficients().clone(),
                    record.interpolation(),
                    record.outside(),
                    record.normalisation(),
                )?)
            }
        })
    }

    /// Whether [`native`](Self::native) only picks pixels of the stamps, so that nothing is interpolated.
    ///
    /// # Errors
    /// [`PsfieldError::Data`] when `size` is 0.
    pub fn native_is_exact(&self, size: Option<usize>) -> Result<bool, PsfieldError> {
        let grid = self.grid();
        let picks = grid.whole_centre().is_some() && grid.oversampling().fract() == 0.0;
        Ok(picks || self.native_target(size)? == grid)
    }

    fn native_target(&self, size: Option<usize>) -> Result<StampGrid, PsfieldError> {
        Ok(match size {
            None => native_grid(self.grid())?,
            Some(n) => {
                StampGrid::new(n, n)?.with_pixel_response_included(self.grid().pixel_response_included())
            }
        })
    }
}

/// The largest stack of stamps that is made: 16 GiB.
const MAX_STACK_BYTES: usize = 16 << 30;

/// Refuses stacks of stamps that are larger than any that are meant.
///
/// # Errors
/// [`PsfieldError::TooLarge`].
pub fn check_stack(stamps: usize, grid: StampGrid) -> Result<(), PsfieldError> {
    let bytes = stamps
        .saturating_mul(grid.pixel_count())
        .saturating_mul(size_of::<f64>());
    if bytes > MAX_STACK_BYTES {
        return Err(PsfieldError::TooLarge {
            stamps,
            nx: grid.nx(),
            ny: grid.ny(),
            limit: MAX_STACK_BYTES,
        });
    }
    Ok(())
}

/// The samples as a model represents them, before any scaling to unit flux.
///
/// # Errors
/// [`DataError`] when the truncated basis leaves a sample without flux.
fn samples_of(record: &PsfModelRecord) -> Result<PsfSamples, DataError> {
    let (basis, coefficients) = (record.basis(), record.coefficients());
    let (ny, nx) = basis.grid().dim();
    let components = basis
        .components()
        .into_shape_with_order((basis.rank(), ny * nx))
        .expect("row-major");
    let stamps = coefficients.values().dot(&components);
    let count = coefficients.positions().len();
    let mut stamps: Array3<f64> = stamps
        .as_standard_layout()
        .into_owned()
        .into_shape_with_order((count, ny, nx))
        .expect("row-major");
    if let Some(mean) = basis.mean() {
        stamps += &mean.slice(s![.., ..]);
    }
    PsfSamples::new(stamps, coefficients.positions().clone(), basis.grid())
}
