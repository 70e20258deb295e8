//! Makes the models that records describe: interpolates their coefficients over the field.

use std::sync::Arc;

use psf_types::{CoefficientField, PsfModel, PsfModelRecord, SampleCoefficients, Wings, WingsRecord};

use crate::error::PsfieldError;

/// Makes the model that a record describes. Interpolates the record's coefficients by the method
/// that the record names.
///
/// # Errors
/// [`PsfieldError`] when the interpolation does not suit the positions, or when the record has
/// several states.
pub fn model_of(record: PsfModelRecord) -> Result<PsfModel, PsfieldError> {
    let field = field_of(&record, record.coefficients())?;
    with_state_wings(record.clone().into_model(field)?, &record, 0)
}

/// Makes the models of all states of a record, in the order of their values. They share their
/// stamps.
///
/// # Errors
/// The errors of [`model_of`].
pub(crate) fn models_of(record: &PsfModelRecord) -> Result<Vec<PsfModel>, PsfieldError> {
    let first = state_field(record, 0)?;
    let first = with_state_wings(record.clone().into_model(first)?, record, 0)?;
    let mut others = models_on(record, &first, 1)?;
    others.insert(0, first);
    Ok(others)
}

/// The models of all states from the given one on, on the stamps of a model of the same basis.
pub(crate) fn models_on(
    record: &PsfModelRecord,
    stamps: &PsfModel,
    from: usize,
) -> Result<Vec<PsfModel>, PsfieldError> {
    let states = from..record.coefficients().positions().state_count();
    states
        .map(|state| {
            let model = stamps.with_field(state_field(record, state)?)?;
            with_state_wings(model, record, state)
        })
        .collect()
}

/// A model with the wings of a state of its record.
fn with_state_wings(
    model: PsfModel,
    record: &PsfModelRecord,
    state: usize,
) -> Result<PsfModel, PsfieldError> {
    let of_state = |wings: &WingsRecord| -> Result<Wings, PsfieldError> {
        let field = field_of(record, &wings.coefficients().of_state(state))?;
        Ok(wings.with_field(field)?)
    };
    let wings = record.wings().map(of_state).transpose()?;
    Ok(model.with_wings(wings)?)
}

/// The coefficient field of a state. 0 if the PSF depends on the position only.
fn state_field(record: &PsfModelRecord, state: usize) -> Result<Arc<dyn CoefficientField>, PsfieldError> {
    field_of(record, &record.coefficients().of_state(state))
}

/// Interpolates coefficients as the record says.
pub(crate) fn field_of(
    record: &PsfModelRecord,
    coefficients: &SampleCoefficients,
) -> Result<Arc<dyn CoefficientField>, PsfieldError> {
    let method = coeff_field::interpolation(record.interpolation())?;
    Ok(method.interpolate(coefficients, record.outside())?)
}
