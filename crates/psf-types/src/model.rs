//! PSF models, for evaluation and for storage: a basis and the fields of its coefficients.

use std::ops::Range;
use std::sync::Arc;

use ndarray::{Array2, Array3, ArrayView1, ArrayView2, ArrayViewMut2, ArrayViewMut3, Axis, s};
use serde::{Deserialize, Serialize};

use crate::basis::{PsfBasis, SampleCoefficients};
use crate::choices::{Interpolation, Normalisation, OutsidePolicy};
use crate::coefficient_field::{CoefficientField, FieldError};
use crate::frame::{DataError, FrameShape, PixelRegion, Position};
use crate::mean_parts::MeanParts;
use crate::stamp::{Stamp, StampGrid};
use crate::wings::{Wings, WingsRecord};

/// A PSF at every position: `h(u; x) = [B_0(u) + sum_k a_k(x) B_k(u)] / s(x)`, at position `x` and
/// offset `u` from it.
///
/// One array stores the stamps `B_0` (if the basis is mean-centred) and `B_1 ... B_K`, the mean
/// first. The coefficient of the mean is 1 everywhere. `s(x)` is the flux of the sum in brackets
/// for [`Normalisation::Unit`], and 1 for [`Normalisation::Keep`].
///
/// If the PSF has [`Wings`], this is its core, and the whole PSF is the sum of both
/// ([`psf_at`](Self::psf_at)). All other functions concern the core.
#[derive(Debug, Clone)]
pub struct PsfModel {
    /// `[stamp, y, x]`, beginning with the mean if there is one.
    stamps: Arc<Array3<f64>>,
    fluxes: Vec<f64>,
    mean_parts: Arc<MeanParts>,
    mean_centred: bool,
    grid: StampGrid,
    field: Arc<dyn CoefficientField>,
    field_shape: Option<FrameShape>,
    normalisation: Normalisation,
    needs_scaling: bool,
    wings: Option<Wings>,
}

/// A PSF needs no scaling if its flux differs from 1 by at most this. Such a difference is a
/// rounding error of the sum over a stamp's pixels.
const UNIT_FLUX_TOLERANCE: f64 = 1e-14;

impl PsfModel {
    /// A model from a basis and its coefficient field. `field_shape` is the shape of the frame over
    /// which the PSF is known, or `None` if this shape is not known.
    ///
    /// # Errors
    /// [`DataError::CountMismatch`] when the field does not return one coefficient per component.
    pub fn new(
        basis: &PsfBasis,
        field: Arc<dyn CoefficientField>,
        normalisation: Normalisation,
        field_shape: Option<FrameShape>,
    ) -> Result<Self, DataError> {
        check_components(basis.rank(), field.component_count())?;
        let grid = basis.grid();
        let mean_count = usize::from(basis.mean().is_some());
        let mut stamps = Array3::zeros((basis.rank() + mean_count, grid.ny(), grid.nx()));
        if let Some(mean) = basis.mean() {
            stamps.slice_mut(s![0, .., ..]).assign(&mean);
        }
        stamps
            .slice_mut(s![mean_count.., .., ..])
            .assign(&basis.components());
        let fluxes: Vec<f64> = stamps
            .outer_iter()
            .map(|stamp| grid.flux_of_sum(stamp.sum()))
            .collect();
        let exact = mean_count == 1
            && (fluxes[0] - 1.0).abs() <= UNIT_FLUX_TOLERANCE
            && fluxes[1..].iter().all(|f| f.abs() <= UNIT_FLUX_TOLERANCE);
        let shape = (stamps.dim().0, grid.pixel_count());
        let flat = stamps.view().into_shape_with_order(shape).expect("row-major");
        let (mean, components) = flat.split_at(Axis(0), mean_count);
        let mean_parts = Arc::new(MeanParts::new(mean.outer_iter().next(), components));
        Ok(Self {
            stamps: Arc::new(stamps),
            fluxes,
            mean_parts,
            mean_centred: mean_count == 1,
            grid,
            field,
            field_shape,
            normalisation,
            needs_scaling: normalisation == Normalisation::Unit && !exact,
            wings: None,
        })
    }

    /// This model with wings, which are added to its PSFs, or without.
    ///
    /// # Errors
    /// [`DataError::WingsDoNotFit`] for wings with another sampling than the model's stamps, or smaller ones.
    pub fn with_wings(self, wings: Option<Wings>) -> Result<Self, DataError> {
        let fits = |wings: &Wings| self.grid.place_in(wings.grid()).is_some();
        let fits = wings.as_ref().is_none_or(fits);
        fits.then_some(Self { wings, ..self })
            .ok_or(DataError::WingsDoNotFit)
    }

    /// The wings of the PSF.
    pub fn wings(&self) -> Option<&Wings> {
        self.wings.as_ref()
    }

    /// A model with the stamps of this one, which it shares, and another field. The wings stay.
    ///
    /// # Errors
    /// [`DataError::CountMismatch`] when the field does not return one coefficient per component.
    pub fn with_field(&self, field: Arc<dyn CoefficientField>) -> Result<Self, DataError> {
        check_components(self.rank(), field.component_count())?;
        Ok(Self {
            field,
            ..self.clone()
        })
    }

    /// Removes the scaling to unit flux if the samples' coefficients `[sample, component]` show
    /// that it is not needed. This is so if the mean has unit flux and the components change the
    /// flux at no sample. Every interpolation is linear in the samples' coefficients, so the
    /// components then change the flux nowhere.
    pub(crate) fn without_needless_scaling(self, coefficients: ArrayView2<'_, f64>) -> Self {
        let first = usize::from(self.mean_centred);
        let unit_mean = first == 1 && (self.fluxes[0] - 1.0).abs() <= UNIT_FLUX_TOLERANCE;
        let flux_change = |row: ArrayView1<'_, f64>| -> f64 {
            row.iter().zip(&self.fluxes[first..]).map(|(a, f)| a * f).sum()
        };
        let unchanged = coefficients
            .outer_iter()
            .all(|row| flux_change(row).abs() <= UNIT_FLUX_TOLERANCE);
        Self {
            needs_scaling: self.needs_scaling && !(unit_mean && unchanged),
            ..self
        }
    }

    /// Returns whether this model has the mean, the components and the stamp grid of another one.
    pub fn has_basis_of(&self, other: &Self) -> bool {
        let same_stamps = Arc::ptr_eq(&self.stamps, &other.stamps) || self.stamps == other.stamps;
        same_stamps && self.mean_centred == other.mean_centred && self.grid == other.grid
    }

    /// The stamps `[stamp, y, x]`, row-major, beginning with the mean if there is one.
    pub fn stamps(&self) -> ndarray::ArrayView3<'_, f64> {
        self.stamps.view()
    }

    /// The flux of each of these stamps ([`StampGrid::flux_of_sum`]).
    pub fn stamp_fluxes(&self) -> &[f64] {
        &self.fluxes
    }

    /// The mean in terms of the components.
    pub fn mean_parts(&self) -> &MeanParts {
        &self.mean_parts
    }

    /// The pixel grid of the stamps.
    pub fn grid(&self) -> StampGrid {
        self.grid
    }

    /// The shape of the field, if it is known.
    pub fn field_shape(&self) -> Option<FrameShape> {
        self.field_shape
    }

    /// The choice between scaling every PSF to unit flux and keeping its flux.
    pub fn normalisation(&self) -> Normalisation {
        self.normalisation
    }

    /// The fields of the components' coefficients.
    pub fn field(&self) -> &dyn CoefficientField {
        self.field.as_ref()
    }

    /// Coefficients of the components at some positions ([`CoefficientField::some_coefficients`]).
    pub fn some_coefficients(&self) -> Array2<f64> {
        self.field.some_coefficients(self.field_shape)
    }

    /// Returns whether the first stamp is the mean.
    pub fn is_mean_centred(&self) -> bool {
        self.mean_centred
    }

    /// The number of components `K`, without the mean.
    pub fn rank(&self) -> usize {
        self.field.component_count()
    }

    /// The number of stamps: `K`, plus one for the mean if there is one.
    pub fn stamp_count(&self) -> usize {
        self.stamps.dim().0
    }

    /// One stamp `[y, x]`.
    ///
    /// # Panics
    /// When there is no such stamp.
    pub fn stamp(&self, index: usize) -> ArrayView2<'_, f64> {
        self.stamps.index_axis(Axis(0), index)
    }

    /// Returns whether `s(x)` may differ from 1. If so, callers must divide the coefficients of
    /// [`coefficients_region_into`](Self::coefficients_region_into) by the `s(x)` that
    /// [`flux_region_into`](Self::flux_region_into) writes.
    pub fn needs_flux_scaling(&self) -> bool {
        self.needs_scaling
    }

    /// Writes the coefficients of all stamps at `position`, before the division by `s(x)`.
    ///
    /// # Errors
    /// [`FieldError`] if the field has no value there.
    ///
    /// # Panics
    /// When `coefficients.len() != self.stamp_count()`.
    pub fn coefficients_into(&self, position: Position, coefficients: &mut [f64]) -> Result<(), FieldError> {
        assert_eq!(
            coefficients.len(),
            self.stamp_count(),
            "one coefficient per stamp"
        );
        let first = usize::from(self.mean_centred);
        coefficients[..first].fill(1.0);
        self.field.evaluate_into(position, &mut coefficients[first..])
    }

    /// Writes the coefficients of all stamps at `position`, divided by `s(x)`.
    ///
    /// # Errors
    /// [`FieldError`] if the field has no value there, or if the PSF must be scaled to unit flux
    /// but its flux is not positive.
    ///
    /// # Panics
    /// When `coefficients.len() != self.stamp_count()`.
    pub fn scaled_coefficients_into(
        &self,
        position: Position,
        coefficients: &mut [f64],
    ) -> Result<(), FieldError> {
        self.coefficients_into(position, coefficients)?;
        if self.needs_scaling {
            let flux = self.checked_flux(position, coefficients)?;
            for a in coefficients {
                *a /= flux;
            }
        }
        Ok(())
    }

    /// Writes the coefficients of a range of stamps at every pixel of a region, `[stamp, y, x]`,
    /// before the division by `s(x)`.
    ///
    /// # Errors
    /// [`FieldError`] if the field has no value at a pixel.
    ///
    /// # Panics
    /// When `values` is not of shape `[stamps.len(), ny, nx]`.
    pub fn coefficients_region_into(
        &self,
        region: PixelRegion,
        stamps: Range<usize>,
        mut values: ArrayViewMut3<'_, f64>,
    ) -> Result<(), FieldError> {
        assert_eq!(
            values.dim(),
            (stamps.len(), region.shape().ny(), region.shape().nx()),
            "one plane per stamp"
        );
        let first = usize::from(self.mean_centred);
        let mean_planes = first.saturating_sub(stamps.start).min(stamps.len());
        values.slice_mut(s![..mean_planes, .., ..]).fill(1.0);
        if mean_planes == stamps.len() {
            return Ok(());
        }
        let components = stamps.start + mean_planes - first..stamps.end - first;
        self.field
            .evaluate_region_into(region, components, values.slice_mut(s![mean_planes.., .., ..]))
    }

    /// Writes the flux of the unscaled PSF at every pixel of a region, `[y, x]`. For
    /// [`Normalisation::Unit`], this flux is `s(x)`.
    ///
    /// # Errors
    /// [`FieldError`] if the field has no value at a pixel or the flux is not positive.
    ///
    /// # Panics
    /// When `fluxes` does not have the region's shape.
    pub fn flux_region_into(
        &self,
        region: PixelRegion,
        mut fluxes: ArrayViewMut2<'_, f64>,
    ) -> Result<(), FieldError> {
        let shape = region.shape();
        assert_eq!(fluxes.dim(), (shape.ny(), shape.nx()), "one flux per pixel");
        let mut coefficients = vec![0.0; self.stamp_count()];
        for ((row, column), flux) in fluxes.indexed_iter_mut() {
            let position = region.position(column, row);
            self.coefficients_into(position, &mut coefficients)?;
            *flux = self.checked_flux(position, &coefficients)?;
        }
        Ok(())
    }

    /// The pixel grid of whole PSFs: that of the wings if there are any.
    pub fn whole_grid(&self) -> StampGrid {
        self.wings.as_ref().map_or(self.grid, Wings::grid)
    }

    /// Returns the whole PSF at `position`, core and wings, in double precision.
    ///
    /// # Errors
    /// As for [`core_at`](Self::core_at).
    pub fn psf_at(&self, position: Position) -> Result<Stamp, FieldError> {
        let core = self.core_at(position)?;
        let Some(wings) = &self.wings else {
            return Ok(core);
        };
        let mut values = wings.at(position)?;
        let (column, row) = self.grid.place_in(wings.grid()).expect("checked by with_wings");
        let (ny, nx) = self.grid.dim();
        let mut inner = values.slice_mut(s![row..row + ny, column..column + nx]);
        inner += &core.values();
        Stamp::new(values, wings.grid()).map_err(|source| FieldError::External {
            position,
            source: Box::new(source),
        })
    }

    /// Returns the core of the PSF at `position`, which is the whole PSF if there are no wings, in double
    /// precision.
    ///
    /// # Errors
    /// [`FieldError`] if the field has no value there, a value of the PSF is not finite, or the PSF
    /// must be scaled to unit flux but its flux is not positive.
    pub fn core_at(&self, position: Position) -> Result<Stamp, FieldError> {
        let mut coefficients = vec![0.0; self.stamp_count()];
        self.scaled_coefficients_into(position, &mut coefficients)?;
        // The loop adds stamp by stamp, over contiguous memory. A product of a vector and a
        // row-major matrix would read the matrix with strides.
        let mut values = Array2::zeros(self.grid.dim());
        for (&a, stamp) in coefficients.iter().zip(self.stamps.outer_iter()) {
            values.scaled_add(a, &stamp);
        }
        Stamp::new(values, self.grid).map_err(|source| FieldError::External {
            position,
            source: Box::new(source),
        })
    }

    fn checked_flux(&self, position: Position, coefficients: &[f64]) -> Result<f64, FieldError> {
        let flux: f64 = coefficients.iter().zip(&self.fluxes).map(|(a, f)| a * f).sum();
        if flux > 0.0 && flux.is_finite() {
            Ok(flux)
        } else {
            Err(FieldError::NonPositiveFlux { position, flux })
        }
    }
}

pub(crate) fn check_components(rank: usize, coefficients: usize) -> Result<(), DataError> {
    let what = "coefficients, one for each component of the basis";
    DataError::check_count(what, rank, coefficients)
}

/// The content of a `psf-model` file: a basis, the samples' coefficients and their interpolation.
///
/// This is plain data. The crate `coeff-field` makes a [`CoefficientField`] from the coefficients
/// and the interpolation. That field and the basis make a [`PsfModel`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawPsfModelRecord")]
pub struct PsfModelRecord {
    basis: PsfBasis,
    coefficients: SampleCoefficients,
    interpolation: Interpolation,
    outside: OutsidePolicy,
    normalisation: Normalisation,
    circle_error: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    table_of: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    wings: Option<Box<WingsRecord>>,
}

#[derive(Deserialize)]
struct RawPsfModelRecord {
    basis: PsfBasis,
    coefficients: SampleCoefficients,
    interpolation: Interpolation,
    outside: OutsidePolicy,
    normalisation: Normalisation,
    #[serde(default)]
    circle_error: Option<f64>,
    #[serde(default)]
    table_of: Option<String>,
    #[serde(default)]
    wings: Option<WingsRecord>,
}

impl TryFrom<RawPsfModelRecord> for PsfModelRecord {
    type Error = DataError;
    fn try_from(raw: RawPsfModelRecord) -> Result<Self, DataError> {
        let (basis, coefficients) = (raw.basis, raw.coefficients);
        let record = Self::new(
            basis,
            coefficients,
            raw.interpolation,
            raw.outside,
            raw.normalisation,
        )?;
        record
            .with_circle_error(raw.circle_error)
            .with_table_of(raw.table_of)
            .with_wings(raw.wings)
    }
}

impl PsfModelRecord {
    /// A model from its parts.
    ///
    /// # Errors
    /// [`DataError::CountMismatch`] when there is not one coefficient per component.
    pub fn new(
        basis: PsfBasis,
        coefficients: SampleCoefficients,
        interpolation: Interpolation,
        outside: OutsidePolicy,
        normalisation: Normalisation,
    ) -> Result<Self, DataError> {
        check_components(basis.rank(), coefficients.component_count())?;
        Ok(Self {
            basis,
            coefficients,
            interpolation,
            outside,
            normalisation,
            circle_error: None,
            table_of: None,
            wings: None,
        })
    }

    /// This record with wings, or without.
    ///
    /// # Errors
    /// [`DataError::WingsDoNotFit`] for wings with another sampling than the basis, or smaller stamps, and
    /// [`DataError::CountMismatch`] for another number of samples.
    pub fn with_wings(self, wings: Option<WingsRecord>) -> Result<Self, DataError> {
        if let Some(wings) = &wings {
            let what = "rows of coefficients of the wings, one for each sample";
            let samples = self.coefficients.values().nrows();
            DataError::check_count(what, samples, wings.coefficients().values().nrows())?;
            let place = self.basis.grid().place_in(wings.grid());
            place.ok_or(DataError::WingsDoNotFit)?;
        }
        let wings = wings.map(Box::new);
        Ok(Self { wings, ..self })
    }

    /// The wings of the PSF. The basis and the coefficients are then those of its core.
    pub fn wings(&self) -> Option<&WingsRecord> {
        self.wings.as_deref()
    }

    /// A record with the choices of this one, but another basis and other coefficients, and no wings. The
    /// error of the flux in circles is then not known.
    ///
    /// # Errors
    /// As for [`new`](Self::new).
    pub fn with_parts(&self, basis: PsfBasis, coefficients: SampleCoefficients) -> Result<Self, DataError> {
        let (outside, normalisation) = (self.outside, self.normalisation);
        let record = Self::new(basis, coefficients, self.interpolation, outside, normalisation)?;
        Ok(record.with_table_of(self.table_of.clone()))
    }

    /// A record with another policy outside the samples and another scaling.
    #[must_use]
    pub fn with_policies(self, outside: OutsidePolicy, normalisation: Normalisation) -> Self {
        Self {
            outside,
            normalisation,
            ..self
        }
    }

    /// A record with another interpolation of the coefficients.
    #[must_use]
    pub fn with_interpolation(self, interpolation: Interpolation) -> Self {
        Self {
            interpolation,
            ..self
        }
    }

    /// States the method whose values the table holds ([`table_of`](Self::table_of)). Characters other
    /// than printable ASCII become question marks, and 60 of them are kept.
    #[must_use]
    pub fn with_table_of(self, method: Option<String>) -> Self {
        let printable = |c: char| if c == ' ' || c.is_ascii_graphic() { c } else { '?' };
        let table_of = method.map(|name| name.chars().map(printable).take(60).collect());
        Self { table_of, ..self }
    }

    /// The name of the method whose values are in the table, if the interpolation is
    /// [`Interpolation::Table`] and the name is known.
    pub fn table_of(&self) -> Option<&str> {
        self.table_of.as_deref()
    }

    /// States the error of the flux in circles ([`circle_error`](Self::circle_error)). A number that is
    /// not finite, or below 0, counts as not known.
    #[must_use]
    pub fn with_circle_error(self, circle_error: Option<f64>) -> Self {
        let circle_error = circle_error.filter(|error| error.is_finite() && *error >= 0.0);
        Self { circle_error, ..self }
    }

    /// The largest error of the flux in circles about the source that the basis causes at the samples,
    /// relative to the total flux of the PSF. None if it is not known, for example in a model of older
    /// software.
    pub fn circle_error(&self) -> Option<f64> {
        self.circle_error
    }

    /// The basis.
    pub fn basis(&self) -> &PsfBasis {
        &self.basis
    }

    /// The samples' coefficients.
    pub fn coefficients(&self) -> &SampleCoefficients {
        &self.coefficients
    }

    /// The interpolation of the coefficients over the field.
    pub fn interpolation(&self) -> Interpolation {
        self.interpolation
    }

    /// The policy for positions outside the area that the samples cover.
    pub fn outside(&self) -> OutsidePolicy {
        self.outside
    }

    /// The choice between scaling every PSF to unit flux and keeping its flux.
    pub fn normalisation(&self) -> Normalisation {
        self.normalisation
    }

    /// Truncates the model to its first `rank` components. A model with fewer components is
    /// unchanged. The error of the flux in circles is then not known.
    ///
    /// # Errors
    /// [`DataError::EmptyBasis`] for rank 0 of a basis without a mean.
    pub fn truncated(&self, rank: usize) -> Result<Self, DataError> {
        if rank >= self.basis.rank() {
            return Ok(self.clone());
        }
        let basis = PsfBasis::new(
            self.basis.mean().map(|mean| mean.to_owned()),
            self.basis.components().slice(s![..rank, .., ..]).to_owned(),
            self.basis.grid(),
        )?;
        let values = self.coefficients.values().slice(s![.., ..rank]).to_owned();
        let coefficients = SampleCoefficients::new(values, self.coefficients.positions().clone())?;
        self.with_parts(basis, coefficients)?
            .with_wings(self.wings().cloned())
    }

    /// Combines the record with `field`, the caller's interpolation of [`Self::coefficients`], into
    /// a model.
    ///
    /// # Errors
    /// See [`PsfModel::new`].
    pub fn into_model(self, field: Arc<dyn CoefficientField>) -> Result<PsfModel, DataError> {
        let shape = self.coefficients.positions().field();
        let model = PsfModel::new(&self.basis, field, self.normalisation, shape)?;
        Ok(model.without_needless_scaling(self.coefficients.values()))
    }
}
