//! The PSF of a star as a vector of the space that all PSFs of a model span.

use ndarray::Array1;
use psf_types::{FieldError, Position, PsfModel};

use crate::lowrank::internals::{LocalModes, PsfSpace};

/// Vectors of one star after the other, in memory that is used again.
#[derive(Debug)]
pub(super) struct StarVectors<'a> {
    model: &'a PsfModel,
    space: &'a PsfSpace,
    coefficients: Vec<f64>,
    psf: Array1<f64>,
    flux: f64,
}

impl<'a> StarVectors<'a> {
    pub(super) fn new(model: &'a PsfModel, space: &'a PsfSpace) -> Self {
        Self {
            model,
            space,
            coefficients: vec![0.0; model.stamp_count()],
            psf: space.mean().to_owned(),
            flux: 0.0,
        }
    }

    /// Sets the PSF at a position, before any scaling to unit flux, and gives that scale.
    pub(super) fn set(&mut self, position: Position) -> Result<f64, FieldError> {
        self.model.coefficients_into(position, &mut self.coefficients)?;
        let first = usize::from(self.model.is_mean_centred());
        self.psf.assign(&self.space.mean());
        for (value, a) in self.psf.iter_mut().zip(&self.coefficients[first..]) {
            *value += a;
        }
        self.flux = self.psf.dot(&self.space.fluxes());
        if !self.model.needs_flux_scaling() {
            Ok(1.0)
        } else if self.flux > 0.0 && self.flux.is_finite() {
            Ok(1.0 / self.flux)
        } else {
            Err(FieldError::NonPositiveFlux {
                position,
                flux: self.flux,
            })
        }
    }

    pub(super) fn norm(&self) -> f64 {
        self.psf.dot(&self.psf).sqrt()
    }

    /// The coefficients of a block's kernels for this PSF, which becomes what they leave of it.
    pub(super) fn project(&mut self, modes: &LocalModes, coefficients: &mut Vec<f64>) {
        coefficients.clear();
        if let Some(reference) = modes.reference() {
            self.psf.scaled_add(-self.flux, &reference);
            coefficients.push(self.flux);
        }
        for mode in modes.modes().outer_iter() {
            let c = mode.dot(&self.psf);
            self.psf.scaled_add(-c, &mode);
            coefficients.push(c);
        }
    }
}
