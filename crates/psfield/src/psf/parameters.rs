//! The numbers that make a model: its stamps and the coefficients of its samples.

use ndarray::{Array2, Array3, ArrayView3, Axis};
use psf_types::{PsfBasis, PsfModelRecord, SampleCoefficients, StampGrid};

use super::Psf;
use super::resample::on_basis;
use crate::error::{ErrorKind, PsfieldError};

/// The mean stamp, the components and the coefficients of a model, for fits and derivatives. At sample `j`,
/// the PSF is the mean plus the sum of `coefficients[j, k]` times component `k`, before any scaling to unit
/// flux.
///
/// The components need not be orthonormal, unlike those of a [`PsfBasis`](psf_types::PsfBasis).
#[derive(Debug, Clone, PartialEq)]
pub struct PsfParameters {
    /// The mean stamp `[y, x]`, if the basis is centred.
    pub mean: Option<Array2<f64>>,
    /// The components `[component, y, x]`.
    pub components: Array3<f64>,
    /// The coefficients `[sample, component]`.
    pub coefficients: Array2<f64>,
}

impl PsfParameters {
    fn of(record: &PsfModelRecord) -> Self {
        let basis = record.basis();
        Self {
            mean: basis.mean().map(|mean| mean.to_owned()),
            components: basis.components().to_owned(),
            coefficients: record.coefficients().values().to_owned(),
        }
    }
}

impl Psf {
    /// The parameters of the model: those given to [`with_parameters`](Self::with_parameters), or the basis and
    /// the coefficients of its [`record`](Self::record). If the PSF has wings, those of its core.
    ///
    /// # Errors
    /// The errors of [`record`](Self::record).
    pub fn parameters(&self) -> Result<&PsfParameters, PsfieldError> {
        super::get_or_make(&self.0.parameters, || Ok(PsfParameters::of(self.record()?)))
    }

    /// The parameters given to [`with_parameters`](Self::with_parameters), if they are not those of the
    /// [`record`](Self::record), whose components are orthonormal.
    pub fn given_parameters(&self) -> Option<&PsfParameters> {
        let (given, record) = (self.0.parameters.get()?, self.stored()?);
        (*given != PsfParameters::of(record)).then_some(given)
    }

    /// Returns a model with other parameters, at the samples' positions. Its interpolation is that of this
    /// model, with its parameters, so that interpolated values are linear in those of the samples.
    ///
    /// ```
    /// use ndarray::Array3;
    /// use psfield::Psf;
    /// let corners = [(0.0, 0.0), (99.0, 0.0), (0.0, 79.0), (99.0, 79.0)];
    /// let stamps = Array3::from_shape_fn((4, 9, 9), |(j, y, x)| {
    ///     let square = (y as f64 - 4.0).powi(2) + (x as f64 - 4.0).powi(2);
    ///     (-square / (2.0 + j as f64)).exp()
    /// });
    /// let psf = Psf::from_samples(stamps.view(), &corners)?;
    /// let mut parameters = psf.parameters()?.clone();
    /// parameters.coefficients *= 0.5;
    /// let milder = psf.with_parameters(parameters)?;
    /// assert_eq!(milder.positions(), psf.positions());
    /// # Ok::<(), psfield::PsfieldError>(())
    /// ```
    ///
    /// # Errors
    /// [`ErrorKind::Data`] for stamps or coefficients of another shape, or with values
    /// that are not finite. [`ErrorKind::Setting`] for a PSF with wings. The errors
    /// of [`record`](Self::record).
    pub fn with_parameters(&self, parameters: PsfParameters) -> Result<Self, PsfieldError> {
        let record = self.record_without_wings()?;
        let PsfParameters {
            mean,
            components,
            coefficients,
        } = &parameters;
        let (grid, positions) = (record.basis().grid(), record.coefficients().positions());
        if mean.is_some() != record.basis().mean().is_some() {
            let wanted = if mean.is_some() { "no" } else { "a" };
            let message =
                format!("the basis of this model has {wanted} mean stamp: give parameters like its own");
            return Err(PsfieldError::new(ErrorKind::Data, message).with_setting("mean"));
        }
        if let Some(mean) = mean {
            check_stamps("mean", mean.view().insert_axis(Axis(0)), grid)?;
        }
        check_stamps("components", components.view(), grid)?;
        let choice = coeff_field::choose(
            record.interpolation(),
            record.coefficients(),
            None,
            record.outside(),
        )?;
        let made = if *components == record.basis().components() {
            let values = SampleCoefficients::new(coefficients.clone(), positions.clone())?;
            let basis = PsfBasis::new(mean.clone(), components.clone(), grid)?;
            record.with_parts(basis, values)?
        } else {
            let made = psf_basis::orthonormal(mean.clone(), components.clone(), coefficients.view(), grid)?;
            on_basis(record, made, positions.clone())?
        };
        let made = made.with_interpolation(choice.interpolation);
        let psf = self.with_record(made);
        psf.0.parameters.get_or_init(|| parameters);
        Ok(psf)
    }
}

/// Checks the shape and the values of stamps `[stamp, y, x]`.
fn check_stamps(
    name: &'static str,
    stamps: ArrayView3<'_, f64>,
    grid: StampGrid,
) -> Result<(), PsfieldError> {
    let (_, ny, nx) = stamps.dim();
    let refused = |message: String| Err(PsfieldError::new(ErrorKind::Data, message).with_setting(name));
    if (ny, nx) != grid.dim() {
        let (height, width) = grid.dim();
        return refused(format!(
            "stamps of {ny} x {nx} pixels do not suit this model, whose stamps have {height} x {width}"
        ));
    }
    if stamps.iter().all(|v| v.is_finite()) {
        return Ok(());
    }
    refused("stamps have values that are not finite".to_owned())
}
