//! The mixtures of a PSF's states in the exposures of a series.

use std::ops::Range;

use ndarray::{Array2, Axis};
use psf_types::{SampleStates, StateKind};

use super::exposures::{Exposures, check_covered, cut_at};
use crate::error::{ErrorKind, PsfieldError};
use crate::psf::{Psf, QUADRATURE};

/// The exposures of a group whose PSFs its local bases represent. Stars of the others are tested, too.
const REPRESENTED: usize = 4;

/// The weights of the PSF's states in an exposure, `[1, state]`. None if the states are not those of times or
/// frames: then each is a layer.
pub(super) fn weights(
    psf: &Psf,
    exposures: &Exposures,
    number: usize,
) -> Result<Option<Array2<f64>>, PsfieldError> {
    let Some(states) = psf.states().filter(|states| states.kind() != StateKind::Spectrum) else {
        return Ok(None);
    };
    let (values, (from, to)) = (states.values(), exposures.times(number));
    let mut weights = Array2::zeros((1, values.len()));
    match states.kind() {
        StateKind::Time => {
            let known = (values[0], values[values.len() - 1]);
            check_covered("the PSF", known, (from, to))?;
            for pair in cut_at(values, (from, to)).windows(2) {
                let length = pair[1] - pair[0];
                for (node, weight) in QUADRATURE {
                    for (state, of_state) in coeff_field::state_weights(values, pair[0] + node * length) {
                        weights[(0, state)] += weight * of_state * length / (to - from);
                    }
                }
            }
        }
        StateKind::Frame => {
            let Some(state) = values.iter().position(|&frame| frame == number as f64) else {
                let message = format!(
                    "exposure {number} needs the PSF of frame {number}, but the PSF is known for the frames {} to {} (a PSF with \
                     times is interpolated)",
                    values[0],
                    values[values.len() - 1]
                );
                return Err(PsfieldError::new(ErrorKind::Setting, message));
            };
            weights[(0, state)] = 1.0;
        }
        kind => {
            let message = format!(
                "the PSF of a series depends on the {kind}: choose one of its values, or give a bandpass and spectra"
            );
            let setting = (kind == StateKind::Wavelength).then_some("wavelength_um");
            return Err(PsfieldError::new(ErrorKind::Setting, message).with_setting(setting));
        }
    }
    Ok(Some(weights))
}

/// The mixtures `[mixture, state]` that the local bases of some exposures represent. None if the PSF has no
/// states that are mixed.
pub(super) fn represented(
    psf: &Psf,
    exposures: &Exposures,
    group: &Range<usize>,
) -> Result<Option<Array2<f64>>, PsfieldError> {
    let count = group.len().min(REPRESENTED);
    let chosen = (0..count).map(|i| group.start + i * (group.len() - 1) / (count - 1).max(1));
    let weights = chosen.map(|number| weights(psf, exposures, number));
    let Some(weights) = weights.collect::<Result<Option<Vec<_>>, _>>()? else {
        return Ok(None);
    };
    let rows: Vec<_> = weights.iter().map(|row| row.view()).collect();
    Ok(Some(
        ndarray::concatenate(Axis(0), &rows).expect("one weight for each state"),
    ))
}

/// Mixtures `[mixture, state]` of a PSF's states. They share the stamps of its models.
pub(super) fn mixed(psf: &Psf, weights: &Array2<f64>) -> Result<Psf, PsfieldError> {
    psf.models()?;
    let numbers: Vec<f64> = (0..weights.nrows()).map(|mixture| mixture as f64).collect();
    let labels = (weights.nrows() > 1).then_some((StateKind::Frame, &numbers[..]));
    psf.mixed(weights.view(), labels)
}

/// The kind of the states that exposures mix. None for a PSF without such states.
pub(super) fn mixed_kind(psf: &Psf) -> Option<StateKind> {
    let kind = psf.states().map(SampleStates::kind);
    kind.filter(|&kind| kind != StateKind::Spectrum)
}
