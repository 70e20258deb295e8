//! The PSFs of a model as vectors.

use ndarray::{Array1, Array2, ArrayView1, Axis, s};
use psf_types::{ErrorLimit, PixelRegion, PsfModel, ToleranceOn};

use super::allowed_errors::{AllowedErrors, CellError, ROUNDING_NORM};
use super::growth_curves::GrowthCurves;
use super::norm::norm;
use super::region_cells::RegionCells;

/// Coordinates in which the norm of a vector is the L2 norm of its PSF.
///
/// Each direction is a stamp, and these stamps are orthonormal. The first are the components of the
/// basis. One more direction holds the part of the mean stamp that the components do not span. An
/// unscaled PSF of the model is `mean + sum_n w_n node_n`, where `w_n` is the weight of node `n` of
/// the coefficient field.
#[derive(Debug)]
pub struct PsfSpace {
    model: PsfModel,
    /// Orthonormal stamps, `[direction, stamp pixel]`.
    pub(crate) stamps: Array2<f64>,
    pub(crate) mean: Array1<f64>,
    /// The flux of each orthonormal stamp.
    pub(crate) fluxes: Array1<f64>,
    /// The flux in circles. `None` if the tolerance only bounds the L2 error.
    pub(crate) growth: Option<GrowthCurves>,
}

/// The part of the mean outside the components' span is ignored if its norm is below this fraction
/// of the mean's norm.
const NEGLIGIBLE_REMAINDER: f64 = 1e-14;
/// The fraction of the tolerance that is left to the cells. More of it makes cells larger and needs
/// more modes.
const SHARE_OF_CELLS: f64 = 0.3;

impl PsfSpace {
    /// The space of a model's PSFs. Plans that use this space bound the errors that `on` names.
    pub fn new(model: &PsfModel, on: ToleranceOn) -> Self {
        let (count, ny, nx) = model.stamps().dim();
        let flat = model
            .stamps()
            .into_shape_with_order((count, ny * nx))
            .expect("stamps are row-major");
        let first = usize::from(model.is_mean_centred());
        let components = flat.slice(s![first.., ..]);
        let rank = components.nrows();
        // Divides the mean into its part along the components and the rest. After two passes the
        // rest is orthogonal to the components up to rounding (Kahan, in Parlett 1980, section
        // 6-9).
        let mut along = Array1::zeros(rank);
        let mut rest: Array1<f64> = if first == 1 {
            flat.row(0).to_owned()
        } else {
            Array1::zeros(ny * nx)
        };
        let whole = norm(rest.view());
        for _ in 0..2 {
            for (k, component) in components.outer_iter().enumerate() {
                let p = component.dot(&rest);
                along[k] += p;
                rest.scaled_add(-p, &component);
            }
        }
        let left = norm(rest.view());
        let extra = usize::from(left > NEGLIGIBLE_REMAINDER * whole);
        let mut stamps = Array2::zeros((rank + extra, ny * nx));
        stamps.slice_mut(s![..rank, ..]).assign(&components);
        let mut mean = Array1::zeros(rank + extra);
        mean.slice_mut(s![..rank]).assign(&along);
        if extra == 1 {
            stamps.row_mut(rank).assign(&(rest / left));
            mean[rank] = left;
        }
        let fluxes = stamps
            .outer_iter()
            .map(|stamp| model.grid().flux_of_sum(stamp.sum()))
            .collect();
        let growth = (on == ToleranceOn::Aperture).then(|| {
            // Without a mean, the nodes are usually PSFs.
            let of_nodes = model
                .field()
                .node_values()
                .mean_axis(Axis(0))
                .filter(|_| first == 0);
            let typical = of_nodes.as_ref().unwrap_or(&mean);
            GrowthCurves::new(stamps.view(), model.grid(), typical.view())
        });
        Self {
            model: model.clone(),
            stamps,
            mean,
            fluxes,
            growth,
        }
    }

    /// A first guess of the error of cells that leaves most of the tolerance to the modes of a
    /// region: [`SHARE_OF_CELLS`] of it for the faintest of a few PSFs.
    pub(crate) fn error_of_cells(&self, region: PixelRegion, tolerance: f64) -> CellError {
        let last = (region.shape().nx() - 1, region.shape().ny() - 1);
        let first = usize::from(self.model.is_mean_centred());
        let mut coefficients = vec![0.0; self.model.stamp_count()];
        let mut sizes = Vec::new();
        for (column, row) in [(0, 0), (last.0, 0), (0, last.1), last, (last.0 / 2, last.1 / 2)] {
            let position = region.position(column, row);
            if self.model.coefficients_into(position, &mut coefficients).is_err() {
                continue;
            }
            let mut psf = self.mean.clone();
            for (value, a) in psf.iter_mut().zip(&coefficients[first..]) {
                *value += a;
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
            let components = self.fluxes.iter().take(self.model.field().component_count());
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
        for (mut row, &node) in nodes.outer_iter_mut().zip(&cells.nodes) {
            row.slice_mut(s![..values.ncols()]).assign(&values.row(node));
        }
        if cells.is_partition_of_unity() {
            nodes += &self.mean;
        } else {
            offset += &self.mean;
        }
        rows
    }
}
