//! The PSFs of a model as vectors.

use std::ops::Range;

use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis, NewAxis, s};
use psf_types::{ErrorLimit, FieldError, PixelRegion, Position, PsfModel, ToleranceOn};

use super::allowed_errors::{AllowedErrors, CellError, ROUNDING_NORM};
use super::growth_curves::GrowthCurves;
use super::norm::norm;
use super::region_cells::RegionCells;

/// Coordinates in which the norm of a vector is the L2 norm of its PSF.
///
/// Each direction is a stamp, and these stamps are orthonormal. The first holds the part of the mean
/// stamp that the components of the basis do not span, if there is such a part. The others are the
/// components. An unscaled PSF of the model is `mean + sum_n w_n node_n`, where `w_n` is the weight
/// of node `n` of the coefficient field.
#[derive(Debug)]
pub struct PsfSpace {
    model: PsfModel,
    /// The direction that the components do not span, if there is one, `[stamp pixel]`.
    rest_of_mean: Option<Array1<f64>>,
    pub(crate) mean: Array1<f64>,
    /// The flux of each direction.
    pub(crate) fluxes: Array1<f64>,
    /// The flux in circles. `None` if the tolerance only bounds the L2 error.
    pub(crate) growth: Option<GrowthCurves>,
}

/// The part of the mean outside the components' span is ignored if its norm is below this fraction
/// of the mean's norm.
const NEGLIGIBLE_REMAINDER: f64 = 1e-14;
/// A second pass makes the rest of the mean orthogonal to the components if the rest is below this
/// fraction of the mean.
const NO_SECOND_PASS: f64 = 0.5;
/// The fraction of the tolerance that is left to the cells. More of it makes cells larger and needs
/// more modes.
const SHARE_OF_CELLS: f64 = 0.3;

impl PsfSpace {
    /// The space of a model's PSFs. Plans that use this space bound the errors that `on` names.
    pub fn new(model: &PsfModel, on: ToleranceOn) -> Self {
        let (mean, components) = mean_and_components(model);
        let rank = components.nrows();
        // Divides the mean into its part along the components and the rest. If the rest is much smaller
        // than the mean, it is orthogonal to the components only after a second pass (Kahan, in Parlett
        // 1980, section 6-9).
        let mut rest = mean.map_or_else(|| Array1::zeros(components.ncols()), |mean| mean.to_owned());
        let (whole, mut along) = (norm(rest.view()), Array1::<f64>::zeros(rank));
        for _ in 0..2 {
            for (along, component) in along.iter_mut().zip(components.outer_iter()) {
                let part = component.dot(&rest);
                *along += part;
                rest.scaled_add(-part, &component);
            }
            if norm(rest.view()) >= NO_SECOND_PASS * whole {
                break;
            }
        }
        let left = norm(rest.view());
        let rest_of_mean = (left > NEGLIGIBLE_REMAINDER * whole).then(|| rest / left);
        let (mut mean, mut fluxes) = (Vec::new(), Vec::new());
        if let Some(rest) = &rest_of_mean {
            mean.push(left);
            fluxes.push(model.grid().flux_of_sum(rest.sum()));
        }
        mean.extend(along);
        fluxes.extend_from_slice(&model.stamp_fluxes()[model.stamp_count() - rank..]);
        let mut space = Self {
            model: model.clone(),
            rest_of_mean,
            mean: Array1::from(mean),
            fluxes: Array1::from(fluxes),
            growth: None,
        };
        if on == ToleranceOn::Aperture {
            // Without a mean, the nodes are usually PSFs.
            let of_nodes = model
                .field()
                .node_values()
                .mean_axis(Axis(0))
                .filter(|_| !model.is_mean_centred());
            let typical = of_nodes.as_ref().unwrap_or(&space.mean);
            space.growth = Some(GrowthCurves::new(
                space.stamps().view(),
                model.grid(),
                typical.view(),
            ));
        }
        space
    }

    /// The number of pixels of a stamp.
    pub(crate) fn pixel_count(&self) -> usize {
        self.model.grid().pixel_count()
    }

    /// The stamps of the directions, `[direction, stamp pixel]`.
    pub(crate) fn stamps(&self) -> Array2<f64> {
        self.pixels_of_stamps(0..self.pixel_count())
    }

    /// Some pixels of the directions' stamps, `[direction, stamp pixel]`.
    pub(crate) fn pixels_of_stamps(&self, pixels: Range<usize>) -> Array2<f64> {
        let (_, components) = mean_and_components(&self.model);
        let rest = self.rest_of_mean.iter();
        let mut parts: Vec<_> = rest.map(|rest| rest.slice(s![NewAxis, pixels.clone()])).collect();
        parts.push(components.slice(s![.., pixels.clone()]));
        ndarray::concatenate(Axis(0), &parts).expect("equally many pixels")
    }

    /// The stamps of vectors `[vector, direction]`, `[vector, stamp pixel]`.
    pub(crate) fn stamps_of(&self, vectors: &Array2<f64>) -> Array2<f64> {
        let (_, components) = mean_and_components(&self.model);
        let mut stamps = vectors.slice(s![.., self.first_component()..]).dot(&components);
        if let Some(rest) = &self.rest_of_mean {
            for (mut stamp, vector) in stamps.outer_iter_mut().zip(vectors.outer_iter()) {
                stamp.scaled_add(vector[0], rest);
            }
        }
        stamps
    }

    /// Sets `psf` to the vector of the PSF at a position, not scaled to unit flux. `coefficients` is
    /// memory for those of the model's stamps.
    pub(crate) fn psf_into(
        &self,
        position: Position,
        coefficients: &mut [f64],
        psf: &mut Array1<f64>,
    ) -> Result<(), FieldError> {
        self.model.coefficients_into(position, coefficients)?;
        psf.assign(&self.mean);
        let mut along_components = psf.slice_mut(s![self.first_component()..]);
        along_components += &ArrayView1::from(&coefficients[usize::from(self.model.is_mean_centred())..]);
        Ok(())
    }

    /// The index of the first direction that is a component.
    fn first_component(&self) -> usize {
        usize::from(self.rest_of_mean.is_some())
    }

    /// A first guess of the error of cells that leaves most of the tolerance to the modes of a
    /// region: [`SHARE_OF_CELLS`] of it for the faintest of a few PSFs.
    pub(crate) fn error_of_cells(&self, region: PixelRegion, tolerance: f64) -> CellError {
        let last = (region.shape().nx() - 1, region.shape().ny() - 1);
        let (mut psf, mut coefficients) = (self.mean.clone(), vec![0.0; self.model.stamp_count()]);
        let mut sizes = Vec::new();
        for (column, row) in [(0, 0), (last.0, 0), (0, last.1), last, (last.0 / 2, last.1 / 2)] {
            let position = region.position(column, row);
            if self.psf_into(position, &mut coefficients, &mut psf).is_err() {
                continue;
            }
            sizes.push((norm(psf.view()), psf.dot(&self.fluxes).abs()));
        }
        // With this weight, an error of the flux counts as much as an error of coefficients that
        // changes the scaled PSF equally.
        let flux_weight = if self.model.needs_flux_scaling() {
            let scaled = sizes.iter().map(|(size, flux)| size / flux);
            scaled.fold(0.0, f64::max)
        } else {
            0.0
        };
        let one = CellError {
            size: 1.0,
            flux_weight,
        };
        let errors = self.errors(tolerance, one, 1.0);
        let allowed = sizes.iter().map(|&(size, flux)| {
            let of_norm = size / errors.of_cells(size / flux);
            of_norm.min(flux * of_norm / (size * errors.largest_flux))
        });
        let least = allowed.fold(f64::INFINITY, f64::min);
        let size = SHARE_OF_CELLS * tolerance * least;
        if size.is_finite() && flux_weight.is_finite() {
            CellError { size, flux_weight }
        } else {
            CellError {
                size: 0.0,
                flux_weight: 0.0,
            }
        }
    }

    /// The cells of a region.
    pub fn cells(&self, region: PixelRegion, error: CellError) -> RegionCells {
        self.with_limit(error, |limit| RegionCells::new(self.model.field(), region, limit))
    }

    fn with_limit<R>(&self, error: CellError, use_limit: impl FnOnce(ErrorLimit<'_>) -> R) -> R {
        let mut flux = Vec::new();
        if error.flux_weight > 0.0 {
            let components = self.fluxes.iter().skip(self.first_component());
            flux.extend(components.map(|flux| error.flux_weight * flux));
        }
        let size = error.size;
        use_limit(ErrorLimit { size, flux: &flux })
    }

    /// A few cells of a region, without any error.
    pub(crate) fn sampled_cells(&self, region: PixelRegion) -> RegionCells {
        RegionCells::sampled(self.model.field(), region)
    }

    /// About how many cells a region has with the first guess of their error.
    pub(crate) fn expected_cells(&self, region: PixelRegion, tolerance: f64) -> usize {
        let error = self.error_of_cells(region, tolerance);
        self.with_limit(error, |limit| {
            RegionCells::expected(self.model.field(), region, limit)
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
        let values = self.model.field().node_values();
        let mut rows = Array2::zeros((cells.nodes.len() + 1, self.mean.len()));
        let (mut nodes, mut offset) = rows.view_mut().split_at(Axis(0), cells.nodes.len());
        let sums_to_1 = cells.is_partition_of_unity();
        for (mut row, &node) in nodes.outer_iter_mut().zip(&cells.nodes) {
            if sums_to_1 {
                row.assign(&self.mean);
            }
            let mut along_components = row.slice_mut(s![self.first_component()..]);
            along_components += &values.row(node);
        }
        if !sums_to_1 {
            offset += &self.mean;
        }
        rows
    }
}

/// The mean stamp, if there is one, and the components, `[component, stamp pixel]`.
fn mean_and_components(model: &PsfModel) -> (Option<ArrayView1<'_, f64>>, ArrayView2<'_, f64>) {
    let stamps = model.stamps();
    let (count, ny, nx) = stamps.dim();
    let flat = stamps
        .into_shape_with_order((count, ny * nx))
        .expect("stamps are row-major");
    let (mean, components) = flat.split_at(Axis(0), usize::from(model.is_mean_centred()));
    (mean.into_outer_iter().next(), components)
}
