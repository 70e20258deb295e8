//! PSF models: a basis and the fields of its coefficients.

use std::ops::Range;
use std::sync::Arc;

use ndarray::{Array2, Array3, ArrayView1, ArrayView2, ArrayViewMut2, ArrayViewMut3, s};

use crate::{
    CoefficientField, DataError, FieldError, FrameShape, Normalisation, PixelRegion, Position, PsfBasis,
    Stamp, StampGrid,
};

/// A PSF at every position: `h(u; x) = [B_0(u) + sum_k a_k(x) B_k(u)] / s(x)`.
///
/// The stamps `B_0` (if the basis is mean-centred) and `B_1 ... B_K` are kept in one array, the mean first; its
/// coefficient is 1 everywhere. `s(x)` is the flux of the bracket under [`Normalisation::Unit`] and 1 under
/// [`Normalisation::Keep`].
#[derive(Debug, Clone)]
pub struct PsfModel {
    /// Mean first, `[stamp, y, x]`.
    stamps: Array3<f64>,
    fluxes: Vec<f64>,
    mean_centred: bool,
    grid: StampGrid,
    field: Arc<dyn CoefficientField>,
    field_shape: Option<FrameShape>,
    normalisation: Normalisation,
    needs_scaling: bool,
}

/// PSFs whose flux is this close to 1 need no scaling: it is rounding of the sum over a stamp's pixels.
const UNIT_FLUX_TOLERANCE: f64 = 1e-14;

impl PsfModel {
    /// A model from a basis and its coefficient field, over a field of the given shape where that is known.
    ///
    /// # Errors
    /// [`DataError::CountMismatch`] when the field does not give one coefficient a component.
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
        Ok(Self {
            stamps,
            fluxes,
            mean_centred: mean_count == 1,
            grid,
            field,
            field_shape,
            normalisation,
            needs_scaling: normalisation == Normalisation::Unit && !exact,
        })
    }

    /// The same model without the scaling to unit flux where samples with these coefficients `[sample, component]` show it to be
    /// needless: where the components take no flux from a mean of unit flux at any sample, they take none between them.
    pub(crate) fn without_needless_scaling(self, coefficients: ArrayView2<'_, f64>) -> Self {
        let first = usize::from(self.mean_centred);
        let unit_mean = first == 1 && (self.fluxes[0] - 1.0).abs() <= UNIT_FLUX_TOLERANCE;
        let taken = |row: ArrayView1<'_, f64>| -> f64 {
            row.iter().zip(&self.fluxes[first..]).map(|(a, f)| a * f).sum()
        };
        let none_taken = coefficients
            .outer_iter()
            .all(|row| taken(row).abs() <= UNIT_FLUX_TOLERANCE);
        Self {
            needs_scaling: self.needs_scaling && !(unit_mean && none_taken),
            ..self
        }
    }

    /// The pixel grid of the stamps.
    pub fn grid(&self) -> StampGrid {
        self.grid
    }

    /// The shape of the field, if it is known.
    pub fn field_shape(&self) -> Option<FrameShape> {
        self.field_shape
    }

    /// The fields of the components' coefficients.
    pub fn field(&self) -> &dyn CoefficientField {
        self.field.as_ref()
    }

    /// Whether the first stamp is the mean.
    pub fn is_mean_centred(&self) -> bool {
        self.mean_centred
    }

    /// Whether every PSF is scaled to unit flux.
    pub fn normalisation(&self) -> Normalisation {
        self.normalisation
    }

    /// The number of components `K`, the mean not counted.
    pub fn rank(&self) -> usize {
        self.field.component_count()
    }

    /// The number of stamps: `K`, and one more for the mean.
    pub fn stamp_count(&self) -> usize {
        self.stamps.dim().0
    }

    /// The stamps `[stamp, y, x]`, row-major, the mean first where there is one.
    pub fn stamps(&self) -> ndarray::ArrayView3<'_, f64> {
        self.stamps.view()
    }

    /// One stamp `[y, x]`.
    ///
    /// # Panics
    /// When there is no such stamp.
    pub fn stamp(&self, index: usize) -> ArrayView2<'_, f64> {
        self.stamps.index_axis(ndarray::Axis(0), index)
    }

    /// Whether `s(x)` differs from 1, so that [`flux_region_into`](Self::flux_region_into) must be applied.
    pub fn needs_flux_scaling(&self) -> bool {
        self.needs_scaling
    }

    /// The coefficients of all stamps at `position`, before the division by `s(x)`.
    ///
    /// # Errors
    /// [`FieldError`] where the field has no value.
    ///
    /// # Panics
    /// When `coefficients.len() != self.stamp_count()`.
    pub fn coefficients_into(&self, position: Position, coefficients: &mut [f64]) -> Result<(), FieldError> {
        assert_eq!(coefficients.len(), self.stamp_count(), "one coefficient a stamp");
        let first = usize::from(self.mean_centred);
        coefficients[..first].fill(1.0);
        self.field.evaluate_into(position, &mut coefficients[first..])
    }

    /// The coefficients of all stamps at `position`, divided by `s(x)`.
    ///
    /// # Errors
    /// [`FieldError`] where the field has no value or the PSF no flux.
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

    /// The coefficients of a range of stamps at every pixel of a region, `[stamp, y, x]`, before the division by `s(x)`.
    ///
    /// # Errors
    /// [`FieldError`] where the field has no value.
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
            "one plane a stamp"
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

    /// The flux `s(x)` of the unscaled PSF at every pixel of a region, `[y, x]`.
    ///
    /// # Errors
    /// [`FieldError`] where the field has no value or the flux is not positive.
    ///
    /// # Panics
    /// When `fluxes` does not have the region's shape.
    pub fn flux_region_into(
        &self,
        region: PixelRegion,
        mut fluxes: ArrayViewMut2<'_, f64>,
    ) -> Result<(), FieldError> {
        let shape = region.shape();
        assert_eq!(fluxes.dim(), (shape.ny(), shape.nx()), "one flux a pixel");
        let mut coefficients = vec![0.0; self.stamp_count()];
        for ((row, column), flux) in fluxes.indexed_iter_mut() {
            let position = region.position(column, row);
            self.coefficients_into(position, &mut coefficients)?;
            *flux = self.checked_flux(position, &coefficients)?;
        }
        Ok(())
    }

    /// The PSF at `position`, in double precision.
    ///
    /// # Errors
    /// [`FieldError`] where the field has no value or the PSF no flux.
    pub fn psf_at(&self, position: Position) -> Result<Stamp, FieldError> {
        let mut coefficients = vec![0.0; self.stamp_count()];
        self.scaled_coefficients_into(position, &mut coefficients)?;
        // Stamp by stamp over contiguous memory: a product of a vector and a row-major matrix strides through it.
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
    if rank == coefficients {
        Ok(())
    } else {
        Err(DataError::CountMismatch {
            what: "coefficients, one for each component of the basis",
            expected: rank,
            got: coefficients,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    /// a_1 = x, a_2 = y.
    #[derive(Debug)]
    struct Plane;
    impl CoefficientField for Plane {
        fn component_count(&self) -> usize {
            2
        }
        fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
            a.copy_from_slice(&[p.x(), p.y()]);
            Ok(())
        }
    }

    fn model(mean: Option<Array2<f64>>, normalisation: Normalisation) -> PsfModel {
        let components = Array3::from_shape_vec((2, 1, 3), vec![1.0, 0.0, 0.0, 0.0, 0.0, 1.0]).unwrap();
        let basis = PsfBasis::new(mean, components, StampGrid::new(3, 1).unwrap()).unwrap();
        PsfModel::new(&basis, Arc::new(Plane), normalisation, None).unwrap()
    }

    #[test]
    fn the_psf_is_the_weighted_sum_of_the_stamps() {
        let p = Position::new(2.0, 5.0).unwrap();
        let keep = model(Some(array![[0.0, 1.0, 0.0]]), Normalisation::Keep)
            .psf_at(p)
            .unwrap();
        assert_eq!(keep.values(), array![[2.0, 1.0, 5.0]]);
        let unit = model(None, Normalisation::Unit).psf_at(p).unwrap();
        assert!((unit.values()[[0, 2]] - 5.0 / 7.0).abs() < 1e-15);
        let dark = model(None, Normalisation::Unit).psf_at(Position::new(1.0, -1.0).unwrap());
        assert!(matches!(dark, Err(FieldError::NonPositiveFlux { .. })));
    }

    #[test]
    fn every_range_of_stamps_gives_the_same_planes() {
        let model = model(Some(array![[0.0, 1.0, 0.0]]), Normalisation::Keep);
        let region = PixelRegion::new(-1, 3, FrameShape::new(4, 2).unwrap());
        let mut all = Array3::from_elem((3, 2, 4), f64::NAN);
        model
            .coefficients_region_into(region, 0..3, all.view_mut())
            .unwrap();
        assert_eq!(all[[0, 1, 1]], 1.0);
        assert_eq!((all[[1, 1, 0]], all[[2, 1, 0]]), (-1.0, 4.0));
        for range in [0..1, 1..2, 0..2, 1..3, 2..3, 1..1] {
            let mut part = Array3::from_elem((range.len(), 2, 4), f64::NAN);
            model
                .coefficients_region_into(region, range.clone(), part.view_mut())
                .unwrap();
            assert_eq!(part, all.slice(s![range, .., ..]));
        }
    }
}
