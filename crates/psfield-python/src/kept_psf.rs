//! A PSF and what follows from it.

use std::sync::{Arc, OnceLock};

use psfield::psf_types::{PsfModel, PsfModelRecord};
use psfield::{Fit, PsfInput, PsfieldError, fit, model_of};

/// Samples with the options of their fit, or a model; what follows from them is made when it is first needed, and kept.
#[derive(Debug)]
pub(crate) struct KeptPsf {
    input: Arc<PsfInput>,
    fit: OnceLock<Fit>,
    model: OnceLock<PsfModel>,
}

impl KeptPsf {
    pub(crate) fn new(input: PsfInput) -> Self {
        Self {
            input: Arc::new(input),
            fit: OnceLock::new(),
            model: OnceLock::new(),
        }
    }

    /// As it was given.
    pub(crate) fn input(&self) -> &PsfInput {
        &self.input
    }

    /// The fit of samples; none for a model.
    pub(crate) fn fitted(&self) -> Result<Option<&Fit>, PsfieldError> {
        let PsfInput::Samples(samples, options) = &*self.input else {
            return Ok(None);
        };
        if let Some(fit) = self.fit.get() {
            return Ok(Some(fit));
        }
        let made = fit(samples.clone(), options)?;
        Ok(Some(self.fit.get_or_init(|| made)))
    }

    /// The model as it is stored.
    pub(crate) fn record(&self) -> Result<&PsfModelRecord, PsfieldError> {
        match &*self.input {
            PsfInput::Model(record) => Ok(record),
            PsfInput::Samples(..) => Ok(self.fitted()?.expect("samples have a fit").record()),
        }
    }

    /// The model on the stamps' own grid.
    pub(crate) fn model(&self) -> Result<&PsfModel, PsfieldError> {
        if let Some(model) = self.model.get() {
            return Ok(model);
        }
        let made = model_of(self.record()?.clone())?;
        Ok(self.model.get_or_init(|| made))
    }

    /// The PSF for a simulation: where its stamps are not resampled first, samples need not be fitted again.
    pub(crate) fn for_simulation(&self, resampled: bool) -> Result<PsfInput, PsfieldError> {
        if resampled {
            Ok((*self.input).clone())
        } else {
            Ok(PsfInput::Model(self.record()?.clone()))
        }
    }
}
