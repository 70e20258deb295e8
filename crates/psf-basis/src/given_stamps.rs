//! A basis of given stamps.

use ndarray::{Array2, Array3, Axis};
use psf_types::{PsfBasis, PsfSamples};

use crate::{BasisError, BasisFit, BasisMethod};

/// A basis of given, mutually orthogonal stamps, with an optional mean stamp: for bases that come from elsewhere, such as
/// analytic modes or the principal components of another instrument.
///
/// The stamps are scaled to unit norm; the coefficients are inner products, `a_jk = <h_j - B_0, B_k>`, the least-squares
/// solution for an orthonormal basis.
#[derive(Debug, Clone, PartialEq)]
pub struct GivenStamps {
    mean: Option<Array2<f64>>,
    stamps: Array3<f64>,
}

impl GivenStamps {
    /// Stamps `[component, y, x]`, mutually orthogonal, of any norm but 0.
    ///
    /// # Errors
    /// [`BasisError::ZeroStamp`]. Orthogonality is checked when the basis is made.
    pub fn new(mut stamps: Array3<f64>, mean: Option<Array2<f64>>) -> Result<Self, BasisError> {
        for (index, mut stamp) in stamps.axis_iter_mut(Axis(0)).enumerate() {
            let norm = stamp.iter().map(|v| v * v).sum::<f64>().sqrt();
            if norm == 0.0 {
                return Err(BasisError::ZeroStamp { index });
            }
            stamp.mapv_inplace(|v| v / norm);
        }
        Ok(Self { mean, stamps })
    }
}

impl BasisMethod for GivenStamps {
    fn fit(&self, samples: &PsfSamples) -> Result<BasisFit, BasisError> {
        let basis = PsfBasis::new(self.mean.clone(), self.stamps.clone(), samples.grid())?;
        let pixels = samples.grid().pixel_count();
        let mut rows = samples
            .stamps()
            .into_shape_with_order((samples.len(), pixels))
            .expect("row-major")
            .to_owned();
        if let Some(mean) = basis.mean() {
            rows -= &mean.into_shape_with_order(pixels).expect("row-major");
        }
        let components = basis
            .components()
            .into_shape_with_order((basis.rank(), pixels))
            .expect("row-major");
        let coefficients = rows.dot(&components.t());
        BasisFit::new(samples, basis, coefficients, None)
    }
}
