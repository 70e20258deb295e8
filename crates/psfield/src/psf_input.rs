//! A PSF as a user brings it: samples to be fitted, or a model.

mod file_options;
mod fit_choices;
mod open;
mod psfex_record;
mod resampled;
mod scopesim_record;

use psf_types::{PsfModel, PsfModelRecord, PsfSamples, SamplePositions, StampGrid};

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

    /// Pixels of the image as far as which light beyond its edges comes in, never too few: one more than a stamp is wide, or than
    /// `stamp_size` where stamps are cut or padded ([`with_stamp_size`](crate::SimulationOptions::with_stamp_size)).
    pub fn reach(&self, stamp_size: Option<usize>) -> usize {
        let grid = self.grid();
        let own = grid.nx().max(grid.ny()) as f64 / grid.oversampling();
        stamp_size.unwrap_or(own.ceil() as usize).saturating_add(1)
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
