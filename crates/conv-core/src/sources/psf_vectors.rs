//! The PSFs of single sources, as vectors.

use ndarray::Array1;
use psf_types::{FieldError, Position, PsfModel};

use super::slopes::with_slopes;
use crate::plan::local_modes::LocalModes;
use crate::plan::psf_space::PsfSpace;

/// Computes the vectors of sources' PSFs in [`PsfSpace`], one source at a time. All sources use the same
/// memory.
#[derive(Debug)]
pub(crate) struct PsfVectors<'a> {
    model: &'a PsfModel,
    space: &'a PsfSpace,
    coefficients: Vec<f64>,
    pub(crate) psf: Array1<f64>,
    flux: f64,
}

impl<'a> PsfVectors<'a> {
    /// The model has the stamps of the space.
    pub(crate) fn new(model: &'a PsfModel, space: &'a PsfSpace) -> Self {
        Self {
            model,
            space,
            coefficients: vec![0.0; model.stamp_count()],
            psf: space.mean.clone(),
            flux: 0.0,
        }
    }

    /// Computes the PSF at a position, not scaled to unit flux. Returns the factor that scales it
    /// to unit flux, or 1 if the model needs no scaling.
    pub(crate) fn set(&mut self, position: Position) -> Result<f64, FieldError> {
        self.space
            .psf_into(self.model, position, &mut self.coefficients, &mut self.psf)?;
        self.flux = self.psf.dot(&self.space.fluxes);
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

    /// The PSF at a position, scaled to unit flux if the model needs it, and its derivatives with respect to x and y
    /// ([`with_slopes`]).
    pub(crate) fn with_slopes(&mut self, position: Position) -> Result<[Array1<f64>; 3], FieldError> {
        with_slopes(position, |position| Ok(self.set(position)? * &self.psf))
    }

    /// Replaces the PSF by another one, not scaled to unit flux.
    pub(crate) fn set_vector(&mut self, psf: &Array1<f64>) {
        self.psf.assign(psf);
        self.flux = psf.dot(&self.space.fluxes);
    }

    pub(crate) fn norm(&self) -> f64 {
        self.psf.dot(&self.psf).sqrt()
    }

    /// Returns whether the remainder of [`project`](Self::project) is within the tolerance. `whole`
    /// is the norm of the PSF before.
    pub(crate) fn is_within(&self, tolerance: f64, whole: f64) -> bool {
        self.space.is_within(tolerance, self.psf.view(), whole, self.flux)
    }

    /// Computes the coefficients of a block's kernels for this PSF. Replaces the PSF by the
    /// remainder that the kernels do not represent.
    pub(crate) fn project(&mut self, modes: &LocalModes, coefficients: &mut Vec<f64>) {
        coefficients.clear();
        if let Some(reference) = modes.reference() {
            self.psf.scaled_add(-self.flux, &reference);
            coefficients.push(self.flux);
        }
        for (mode, dual) in modes.modes.outer_iter().zip(modes.duals().outer_iter()) {
            let c = dual.dot(&self.psf);
            self.psf.scaled_add(-c, &mode);
            coefficients.push(c);
        }
    }
}
