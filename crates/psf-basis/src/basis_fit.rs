//! What every basis method gives.

use ndarray::{Array2, ArrayView2, Axis};
use psf_types::{PsfBasis, PsfSamples, SampleCoefficients};

use crate::{BasisError, Spectrum};

/// Something that turns PSF samples into a basis and the samples' coefficients.
///
/// Object-safe, so that methods can be swapped at run time. An implementation usually ends with [`BasisFit::new`], which
/// measures the truncation errors itself.
pub trait BasisMethod: std::fmt::Debug {
    /// Fits a basis to the samples.
    ///
    /// # Errors
    /// [`BasisError`]; methods implemented elsewhere use [`BasisError::External`].
    fn fit(&self, samples: &PsfSamples) -> Result<BasisFit, BasisError>;
}

/// A basis, the samples' coefficients in it, and how well it represents them.
#[derive(Debug, Clone, PartialEq)]
pub struct BasisFit {
    basis: PsfBasis,
    coefficients: SampleCoefficients,
    spectrum: Option<Spectrum>,
    errors: Vec<f64>,
}

impl BasisFit {
    /// Puts a fit together and measures the truncation error of every sample,
    /// `||h_j - B_0 - sum_k a_jk B_k||_2 / ||h_j||_2`.
    ///
    /// # Errors
    /// [`BasisError::Data`] when the parts do not fit each other or the samples.
    pub fn new(
        samples: &PsfSamples,
        basis: PsfBasis,
        coefficients: Array2<f64>,
        spectrum: Option<Spectrum>,
    ) -> Result<Self, BasisError> {
        // The record checks that there is one coefficient a component.
        let coefficients = SampleCoefficients::new(coefficients, samples.positions().clone())?;
        let (expected, got) = (basis.rank(), coefficients.component_count());
        if expected != got {
            let what = "coefficients, one for each component of the basis";
            return Err(psf_types::DataError::CountMismatch { what, expected, got }.into());
        }
        if basis.grid() != samples.grid() {
            let (expected, got) = (samples.grid().dim(), basis.grid().dim());
            return Err(psf_types::DataError::StampShape { expected, got }.into());
        }
        let errors = truncation_errors(samples, &basis, coefficients.values());
        Ok(Self {
            basis,
            coefficients,
            spectrum,
            errors,
        })
    }

    /// The basis.
    pub fn basis(&self) -> &PsfBasis {
        &self.basis
    }

    /// The samples' coefficients.
    pub fn coefficients(&self) -> &SampleCoefficients {
        &self.coefficients
    }

    /// Basis and coefficients, without a copy.
    pub fn into_parts(self) -> (PsfBasis, SampleCoefficients) {
        (self.basis, self.coefficients)
    }

    /// The singular values and what was read from them, where the method has any.
    pub fn spectrum(&self) -> Option<&Spectrum> {
        self.spectrum.as_ref()
    }

    /// The number of components, the mean not counted.
    pub fn rank(&self) -> usize {
        self.basis.rank()
    }

    /// The truncation error of every sample: relative L2, in sample order.
    pub fn errors(&self) -> &[f64] {
        &self.errors
    }

    /// The largest truncation error over the samples.
    pub fn max_error(&self) -> f64 {
        self.errors.iter().copied().fold(0.0, f64::max)
    }

    /// The root mean square of the truncation errors.
    pub fn rms_error(&self) -> f64 {
        (self.errors.iter().map(|e| e * e).sum::<f64>() / self.errors.len() as f64).sqrt()
    }
}

/// Samples are treated in blocks of this many, so that the residuals of thousands of samples need little memory.
const BLOCK: usize = 64;

fn truncation_errors(samples: &PsfSamples, basis: &PsfBasis, coefficients: ArrayView2<'_, f64>) -> Vec<f64> {
    let pixels = basis.grid().pixel_count();
    let stamps = samples
        .stamps()
        .into_shape_with_order((samples.len(), pixels))
        .expect("row-major");
    let components = basis
        .components()
        .into_shape_with_order((basis.rank(), pixels))
        .expect("row-major");
    let mean = basis
        .mean()
        .map(|m| m.into_shape_with_order(pixels).expect("row-major"));
    let mut errors = Vec::with_capacity(samples.len());
    for (block, weights) in stamps
        .axis_chunks_iter(Axis(0), BLOCK)
        .zip(coefficients.axis_chunks_iter(Axis(0), BLOCK))
    {
        let mut residual = &block - &weights.dot(&components);
        if let Some(mean) = mean {
            residual -= &mean;
        }
        for (stamp, rest) in block.outer_iter().zip(residual.outer_iter()) {
            errors.push((rest.dot(&rest) / stamp.dot(&stamp)).sqrt());
        }
    }
    errors
}
