//! The PSFs of a model as vectors.

use std::iter;
use std::ops::Range;
use std::sync::Arc;

use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis, s};
use psf_types::{
    BilinearCells, CoefficientField, ErrorLimit, FieldError, MeanParts, PixelRegion, Position, PsfModel,
    ToleranceOn,
};

use super::allowed_errors::{AllowedErrors, CellError, ROUNDING_NORM};
use super::checked_cells::{Measure, OF_TABLE};
use super::growth_curves::GrowthCurves;
use super::norm::norm;
use super::region_cells::{CellLimits, RegionCells, node_count};
use super::smooth_table::{SmoothTable, Tabulated};
use crate::{ConvReal, view};

/// Coordinates in which the norm of a vector is the L2 norm of its PSF.
///
/// Each direction is a stamp, and these stamps are orthonormal. The first holds the part of the mean
/// stamp that the components of the basis do not span, if there is such a part. The others are the
/// components. An unscaled PSF of the model is `mean + sum_n w_n node_n`, where `w_n` is the weight
/// of node `n` of the coefficient field.
#[derive(Debug)]
pub struct PsfSpace {
    /// The model of each layer. They share their stamps.
    pub(crate) models: Vec<PsfModel>,
    /// The number of nodes of all layers before each.
    first_nodes: Vec<usize>,
    pub(crate) mean: Array1<f64>,
    /// The flux of each direction.
    pub(crate) fluxes: Array1<f64>,
    /// Tables of the fields that do not know their cells. May be empty.
    tables: Vec<Option<SmoothTable>>,
    /// The flux in circles. `None` if the tolerance only bounds the L2 error.
    pub(crate) growth: Option<Arc<GrowthCurves>>,
}

/// The number of nodes of all models before each.
fn first_nodes(models: &[PsfModel]) -> Vec<usize> {
    let mut first = vec![0];
    for model in &models[..models.len() - 1] {
        let before = first[first.len() - 1];
        first.push(before + node_count(model.field()));
    }
    first
}

/// Fluxes count by this factor more in the errors of tables than in those of cells. So tables suit most
/// blocks.
const FLUX_OF_TABLES: f64 = 1.3;
/// If PSFs are scaled to unit flux, an error of their flux changes the flux in circles by at most about
/// this multiple of it.
const FLUX_IN_CIRCLES: f64 = 2.0;
/// Tables have less than the part [`OF_TABLE`] of the error of cells, by this factor. So they suit most
/// blocks.
const SHARE_OF_TABLES: f64 = 0.7 * OF_TABLE;
/// The number of parts of a region along each axis that determine the error of tables.
const PARTS: usize = 8;
/// The fraction of the tolerance that is left to the cells. More of it makes cells larger and needs
/// more modes.
const SHARE_OF_CELLS: f64 = 0.3;
/// The largest number of rows of cells that are looked at to find modes for sources.
const MOST_ROWS: usize = 17;

impl PsfSpace {
    /// The space of the PSFs of models that share their stamps, one for each layer. Plans that use
    /// this space bound the errors that `on` names.
    ///
    /// # Panics
    /// When there are no models.
    pub fn new(models: &[PsfModel], on: ToleranceOn) -> Self {
        let mut space = Self::without_growth(models);
        let model = &models[0];
        if on == ToleranceOn::Aperture {
            // Without a mean, these coefficients are usually those of PSFs.
            let some = (!model.is_mean_centred()).then(|| model.some_coefficients().mean_axis(Axis(0)));
            let some = some.flatten();
            let typical = some.as_ref().unwrap_or(&space.mean);
            let growth = GrowthCurves::new(space.stamps().view(), model.grid(), typical.view());
            space.growth = Some(Arc::new(growth));
        }
        space
    }

    /// The space of other models' PSFs. The fluxes in circles are those of the stamps, so they are not
    /// computed again if the models have the same basis.
    pub(crate) fn for_other_models(&self, models: &[PsfModel], on: ToleranceOn) -> Self {
        match &self.growth {
            Some(growth) if models[0].has_basis_of(self.model()) => Self {
                growth: Some(Arc::clone(growth)),
                ..Self::without_growth(models)
            },
            _ => Self::new(models, on),
        }
    }

    /// This space with tables of the fields that do not know their cells and are slow. `region` is where
    /// plans need them.
    pub(crate) fn with_tables(mut self, region: PixelRegion, tolerance: f64) -> Self {
        // All cells of a large tree take long to list. A single pixel tells whether cells are known.
        let pixel = view::region(region.x0(), region.y0(), (1, 1));
        let scale_of = |model: &PsfModel| match model.field().bilinear_cells(pixel, ErrorLimit::ZERO) {
            BilinearCells::Unknown { scale, slow: true } => Some(scale),
            _ => None,
        };
        let scales: Vec<Option<f64>> = self.models.iter().map(scale_of).collect();
        if scales.iter().all(Option::is_none) {
            return self;
        }
        let error = self.error_of_parts(region, tolerance);
        if error.l2 > 0.0 {
            self.tables = self.with_limits(error, |limits| {
                let table = |(model, scale): (&PsfModel, Option<f64>)| {
                    Some(SmoothTable::new(model.field(), region, (scale?, limits.measure)))
                };
                self.models.iter().zip(scales).map(table).collect()
            });
        }
        self
    }

    /// The smallest first guess of the error of cells over parts of a region.
    fn error_of_parts(&self, region: PixelRegion, tolerance: f64) -> CellError {
        let shape = region.shape();
        let mut least = self.error_of_cells(region, tolerance);
        for row in 0..PARTS.min(shape.ny()) {
            for column in 0..PARTS.min(shape.nx()) {
                let place = |i: usize, pixels: usize| (i * pixels).div_ceil(PARTS);
                let (x, y) = (place(column, shape.nx()), place(row, shape.ny()));
                let size = |i: usize, pixels: usize| place(i + 1, pixels).min(pixels) - place(i, pixels);
                let size = (size(column, shape.nx()).max(1), size(row, shape.ny()).max(1));
                let part = view::region(region.x0() + x as i64, region.y0() + y as i64, size);
                let error = self.error_of_cells(part, tolerance);
                least.l2 = least.l2.min(error.l2);
                least.circle = least.circle.zip(error.circle).map(|(a, b)| a.min(b));
                least.flux_weight = least.flux_weight.max(error.flux_weight);
            }
        }
        least.flux_weight *= FLUX_OF_TABLES;
        least.times(SHARE_OF_TABLES)
    }

    fn without_growth(models: &[PsfModel]) -> Self {
        let model = &models[0];
        let MeanParts { along, rest } = model.mean_parts();
        let (mut mean, mut fluxes) = (Vec::new(), Vec::new());
        if let Some((norm, rest)) = rest {
            mean.push(*norm);
            fluxes.push(model.grid().flux_of_sum(rest.sum()));
        }
        mean.extend(along);
        fluxes.extend_from_slice(&model.stamp_fluxes()[model.stamp_count() - along.len()..]);
        Self {
            models: models.to_vec(),
            first_nodes: first_nodes(models),
            mean: Array1::from(mean),
            fluxes: Array1::from(fluxes),
            tables: Vec::new(),
            growth: None,
        }
    }

    /// The model of the first layer, whose stamps all layers share.
    pub(crate) fn model(&self) -> &PsfModel {
        &self.models[0]
    }

    /// Lends the field of each layer, with a table if its error is small beside `error`.
    fn with_fields<R>(&self, error: CellError, use_fields: impl FnOnce(&[&dyn CoefficientField]) -> R) -> R {
        let tables = self.tables.iter().map(Option::as_ref).chain(iter::repeat(None));
        let fields = self.models.iter().zip(tables);
        let fields = fields.map(|(model, table)| Tabulated {
            field: model.field(),
            table: table.filter(|table| table.limit.is_within(error.times(OF_TABLE))),
        });
        let fields: Vec<Tabulated<'_>> = fields.collect();
        let fields: Vec<&dyn CoefficientField> = fields.iter().map(|field| field as _).collect();
        use_fields(&fields)
    }

    /// The number of pixels of a stamp.
    pub(crate) fn pixel_count(&self) -> usize {
        self.model().grid().pixel_count()
    }

    /// The stamps of the directions, `[direction, stamp pixel]`.
    pub(crate) fn stamps(&self) -> Array2<f64> {
        self.first_stamps(self.mean.len(), 0..self.pixel_count())
    }

    /// Some pixels of the first directions' stamps, `[direction, stamp pixel]`.
    pub(crate) fn first_stamps<T: ConvReal>(&self, count: usize, pixels: Range<usize>) -> Array2<T> {
        let directions = self
            .rest_of_mean()
            .into_iter()
            .chain(self.components().into_outer_iter());
        let mut stamps = Array2::zeros((count, pixels.len()));
        for (mut stamp, direction) in stamps.outer_iter_mut().zip(directions) {
            stamp.zip_mut_with(&direction.slice(s![pixels.clone()]), |to, &v| *to = T::nearest(v));
        }
        stamps
    }

    /// Some pixels of the stamps of vectors `[vector, direction]`, `[vector, stamp pixel]`.
    pub(crate) fn stamps_of(&self, vectors: &Array2<f64>, pixels: Range<usize>) -> Array2<f64> {
        let along_components = vectors.slice(s![.., self.first_component()..]);
        let mut stamps = along_components.dot(&self.components().slice(s![.., pixels.clone()]));
        if let Some(rest) = self.rest_of_mean() {
            let rest = rest.slice(s![pixels]);
            for (mut stamp, vector) in stamps.outer_iter_mut().zip(vectors.outer_iter()) {
                stamp.scaled_add(vector[0], &rest);
            }
        }
        stamps
    }

    /// The direction that the components do not span, if there is one, `[stamp pixel]`.
    fn rest_of_mean(&self) -> Option<ArrayView1<'_, f64>> {
        let rest = self.model().mean_parts().rest.as_ref();
        rest.map(|(_, rest)| rest.view())
    }

    /// The components, `[component, stamp pixel]`.
    fn components(&self) -> ArrayView2<'_, f64> {
        let stamps = self.model().stamps();
        let shape = (stamps.dim().0, self.pixel_count());
        let stamps = stamps.into_shape_with_order(shape).expect("stamps are row-major");
        stamps.slice_move(s![usize::from(self.model().is_mean_centred()).., ..])
    }

    /// Sets `psf` to the vector of a model's PSF at a position, not scaled to unit flux. The model has
    /// the stamps of this space. `coefficients` is memory for those of the model's stamps.
    pub(crate) fn psf_into(
        &self,
        model: &PsfModel,
        position: Position,
        coefficients: &mut [f64],
        psf: &mut Array1<f64>,
    ) -> Result<(), FieldError> {
        model.coefficients_into(position, coefficients)?;
        psf.assign(&self.mean);
        let mut along_components = psf.slice_mut(s![self.first_component()..]);
        along_components += &ArrayView1::from(&coefficients[usize::from(self.model().is_mean_centred())..]);
        Ok(())
    }

    /// The index of the first direction that is a component.
    pub(crate) fn first_component(&self) -> usize {
        usize::from(self.rest_of_mean().is_some())
    }

    /// A first guess of the error of cells that leaves most of the tolerance to the modes of a
    /// region: [`SHARE_OF_CELLS`] of it for the faintest of a few PSFs.
    pub(crate) fn error_of_cells(&self, region: PixelRegion, tolerance: f64) -> CellError {
        let last = (region.shape().nx() - 1, region.shape().ny() - 1);
        let (mut psf, mut coefficients) = (self.mean.clone(), vec![0.0; self.model().stamp_count()]);
        let mut sizes = Vec::new();
        for (column, row) in [(0, 0), (last.0, 0), (0, last.1), last, (last.0 / 2, last.1 / 2)] {
            let position = region.position(column, row);
            for model in &self.models {
                if self
                    .psf_into(model, position, &mut coefficients, &mut psf)
                    .is_ok()
                {
                    sizes.push((norm(psf.view()), psf.dot(&self.fluxes).abs()));
                }
            }
        }
        // With this weight, an error of the flux counts as much as an error of coefficients that
        // changes the scaled PSF equally.
        let flux_weight = if self.model().needs_flux_scaling() {
            let scaled = sizes.iter().map(|(size, flux)| size / flux);
            scaled.fold(0.0, f64::max)
        } else {
            0.0
        };
        let one = CellError {
            size: 1.0,
            flux_weight,
            l2: 1.0,
            circle: None,
        };
        let errors = self.errors(tolerance, one, 1.0);
        let mut least = CellError {
            size: f64::INFINITY,
            l2: f64::INFINITY,
            circle: self.growth.as_ref().map(|_| f64::INFINITY),
            ..one
        };
        for (size, flux) in sizes {
            let of_norm = size / errors.of_cells(size / flux);
            least.l2 = least.l2.min(of_norm);
            least.circle = least.circle.map(|circle| circle.min(flux));
            least.size = least
                .size
                .min(of_norm.min(flux * of_norm / (size * errors.largest_flux)));
        }
        let error = least.times(SHARE_OF_CELLS * tolerance);
        if error.size.is_finite() && error.l2.is_finite() && flux_weight.is_finite() {
            error
        } else {
            CellError::ZERO
        }
    }

    /// The cells of a region.
    pub fn cells(&self, region: PixelRegion, error: CellError) -> RegionCells {
        self.with_fields(error, |fields| {
            self.with_limits(error, |limits| RegionCells::of_layers(fields, region, limits))
        })
    }

    fn with_limits<R>(&self, error: CellError, use_limits: impl FnOnce(CellLimits<'_>) -> R) -> R {
        let mut flux = Vec::new();
        if error.flux_weight > 0.0 {
            let components = self.fluxes.iter().skip(self.first_component());
            flux.extend(components.map(|flux| error.flux_weight * flux));
        }
        let known = ErrorLimit {
            size: error.size,
            flux: &flux,
        };
        let of_size = |d: &[f64]| known.product(d, d).sqrt() / error.l2;
        let of_all = |d: &[f64]| {
            let of_size = of_size(d);
            let (Some(limit), Some(growth)) = (error.circle, &self.growth) else {
                return of_size;
            };
            let mut vector = Array1::zeros(self.mean.len());
            vector
                .slice_mut(s![self.first_component()..])
                .assign(&ArrayView1::from(d));
            let mut in_circle = growth.largest_flux(vector.view());
            if error.flux_weight > 0.0 {
                in_circle += FLUX_IN_CIRCLES * vector.dot(&self.fluxes).abs();
            }
            of_size.max(in_circle / limit)
        };
        use_limits(CellLimits {
            known,
            measure: Measure {
                limit: error,
                of_size: &of_size,
                of_all: &of_all,
            },
        })
    }

    /// Some cells of a region, without any error: `count` rows of them.
    pub(crate) fn sampled_cells(&self, region: PixelRegion, count: usize) -> RegionCells {
        let any = CellError {
            l2: f64::INFINITY,
            circle: None,
            ..CellError::ZERO
        };
        self.with_fields(any, |fields| RegionCells::sampled(fields, region, count))
    }

    /// Cells of a region whose corners are enough PSFs to find modes for sources, which are tested one by
    /// one: the cells that bilinear interpolation with this tolerance needs or, if they are many, those of
    /// [`MOST_ROWS`] rows.
    pub(crate) fn cells_for_sources(&self, region: PixelRegion, tolerance: f64) -> RegionCells {
        if self.expected_cells(region, tolerance) > MOST_ROWS * MOST_ROWS * self.models.len() {
            return self.sampled_cells(region, MOST_ROWS);
        }
        let mut cells = self.cells(region, self.error_of_cells(region, tolerance));
        // Only the corners count.
        cells.error = 0.0;
        cells.circle_error = Some(0.0);
        cells
    }

    /// About how many cells a region has with the first guess of their error.
    pub(crate) fn expected_cells(&self, region: PixelRegion, tolerance: f64) -> usize {
        let error = self.error_of_cells(region, tolerance);
        self.with_fields(error, |fields| {
            self.with_limits(error, |limits| {
                let expected = |field: &&dyn CoefficientField| RegionCells::expected(*field, region, limits);
                fields.iter().map(expected).sum()
            })
        })
    }

    /// The errors that modes may cause beside those of cells. `sign` is the sign of the PSFs' flux.
    pub(crate) fn errors(&self, tolerance: f64, cells: CellError, sign: f64) -> AllowedErrors {
        AllowedErrors {
            tolerance,
            cells,
            largest_flux: self.growth.as_ref().map_or(0.0, |growth| growth.norm),
            sign,
        }
    }

    /// Returns whether an error is within the tolerance. `error` is the error of a PSF with the
    /// given norm and flux.
    pub(crate) fn is_within(
        &self,
        tolerance: f64,
        error: ArrayView1<'_, f64>,
        psf_norm: f64,
        flux: f64,
    ) -> bool {
        let size = norm(error);
        size <= tolerance * psf_norm
            && self.growth.as_ref().is_none_or(|growth| {
                size <= ROUNDING_NORM * psf_norm || growth.largest_flux(error) <= tolerance * flux.abs()
            })
    }

    /// The rows whose sum, weighted by the nodes' weights, is a PSF: one for each node of some
    /// cells, `[node, direction]`, then the offset, whose weight is 1.
    pub(crate) fn rows(&self, cells: &RegionCells) -> Array2<f64> {
        let fields = self.models.iter().map(PsfModel::field);
        let values: Vec<_> = fields
            .map(|field| field.weighted_nodes().map(|nodes| nodes.node_values()))
            .collect();
        let value_of = |node: usize| {
            if let Some(values) = cells.values_of(node) {
                return ArrayView1::from(values);
            }
            let layer = self.first_nodes.partition_point(|&first| first <= node) - 1;
            let of_layer = values[layer].as_ref().expect("the layer has this node");
            of_layer.row(node - self.first_nodes[layer])
        };
        let mut rows = Array2::zeros((cells.nodes.len() + 1, self.mean.len()));
        let (mut nodes, mut offset) = rows.view_mut().split_at(Axis(0), cells.nodes.len());
        let sums_to_1 = cells.is_partition_of_unity();
        for (mut row, &node) in nodes.outer_iter_mut().zip(&cells.nodes) {
            if sums_to_1 {
                row.assign(&self.mean);
            }
            let mut along_components = row.slice_mut(s![self.first_component()..]);
            along_components += &value_of(node);
        }
        if !sums_to_1 {
            offset += &self.mean;
        }
        rows
    }
}
