//! The core and the wings of a PSF.

use ndarray::Array3;
use psf_types::{Normalisation, PsfModelRecord, SampleCoefficients, WingsRecord};

use super::{Origin, Psf};
use crate::error::{ErrorKind, PsfieldError};
use crate::fit::{fit_undivided, splits};

impl Psf {
    /// Returns whether the PSF has wings: stamps that are larger and vary less than those of its core. Samples
    /// with large stamps get them when they are fitted.
    ///
    /// # Errors
    /// The errors of [`record`](Self::record).
    pub fn has_wings(&self) -> Result<bool, PsfieldError> {
        Ok(self.wings_record()?.is_some())
    }

    /// The wings, as a file stores them.
    fn wings_record(&self) -> Result<Option<&WingsRecord>, PsfieldError> {
        match &self.0.origin {
            Origin::Samples(samples, _) if !splits(samples.grid()) => Ok(None),
            Origin::Model(model, _) if model.wings().is_none() => Ok(None),
            _ => Ok(self.record()?.wings()),
        }
    }

    /// The core of the PSF, which is the whole PSF if there are no wings.
    ///
    /// # Errors
    /// The errors of [`record`](Self::record).
    pub fn core(&self) -> Result<Self, PsfieldError> {
        if self.wings_record()?.is_none() {
            return Ok(self.clone());
        }
        Ok(self.with_record(self.record()?.clone().with_wings(None)?))
    }

    /// The wings as a PSF of their own, which is added to the core. None if there are none.
    ///
    /// # Errors
    /// The errors of [`record`](Self::record).
    pub fn wings(&self) -> Result<Option<Self>, PsfieldError> {
        let Some(wings) = self.wings_record()? else {
            return Ok(None);
        };
        let (record, nodes) = (self.record()?, wings.coefficients());
        let stamps = wings.stamps().mapv(f64::from);
        if stamps.iter().all(|&v| v == 0.0) {
            return Ok(None);
        }
        let (basis, values) = psf_basis::orthonormal_in_order(None, stamps, nodes.values(), wings.grid())?;
        let coefficients = SampleCoefficients::new(values, nodes.positions().clone())?;
        let made = record.with_parts(basis, coefficients)?;
        let made = made.with_policies(record.outside(), Normalisation::Keep);
        Ok(Some(self.with_record(made)))
    }

    /// This PSF for work that does not know wings. If it has samples, they are fitted as they are.
    pub(crate) fn undivided(&self) -> Result<Self, PsfieldError> {
        match self.samples() {
            Some((samples, options)) if splits(samples.grid()) => {
                Ok(Self::from(fit_undivided(samples.clone(), options)?))
            }
            _ => Ok(self.clone()),
        }
    }

    /// The record of a PSF for work that does not know wings.
    ///
    /// # Errors
    /// [`ErrorKind::Setting`] for a PSF with wings, and the errors of [`record`](Self::record).
    pub(crate) fn record_without_wings(&self) -> Result<&PsfModelRecord, PsfieldError> {
        let record = self.record()?;
        if record.wings().is_none() {
            return Ok(record);
        }
        let message = "a PSF with wings cannot be moved, dispersed, resampled or interpolated by your own method: take a PSF \
                       without wings";
        Err(PsfieldError::new(ErrorKind::Setting, message))
    }

    /// Makes the same linear change to the core and to the wings. None if there are no wings.
    pub(super) fn changed_by_parts(
        &self,
        change: impl Fn(&Self) -> Result<Self, PsfieldError>,
    ) -> Result<Option<Self>, PsfieldError> {
        let Some(wings) = self.wings()? else {
            return Ok(None);
        };
        let (core, wings) = (change(&self.core()?)?, change(&wings)?);
        let of_wings = wings.record()?;
        let stamps: Array3<f32> = of_wings.basis().components().mapv(|v| v as f32);
        let wings = WingsRecord::new(stamps, of_wings.coefficients().clone(), of_wings.basis().grid())?;
        Ok(Some(
            self.with_record(core.record()?.clone().with_wings(Some(wings))?),
        ))
    }
}
