//! The few modes whose linear combinations represent all PSFs of a region.

use nalgebra::{Cholesky, DMatrix, SymmetricEigen};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis, s};
use psf_types::{ErrorLimit, PixelRegion, PsfModel, ToleranceOn};

use super::growth_curves::{GrowthCurves, TailGrowth};
use super::norm::{dot, norm};
use super::region_cells::RegionCells;
use super::span::span;
use crate::simd::{Lanes, SimdReal as _, WithIsa};

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
    growth: Option<GrowthCurves>,
}

/// The largest error of the coefficients in cells ([`ErrorLimit`]).
#[derive(Debug, Clone, Copy)]
pub struct CellError {
    /// The largest size.
    pub size: f64,
    /// The factor of the components' fluxes in the size. 0 if PSFs are not scaled to unit flux.
    pub flux_weight: f64,
}

/// The part of the mean outside the components' span is ignored if its norm is below this fraction
/// of the mean's norm.
const NEGLIGIBLE_REMAINDER: f64 = 1e-14;

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

    /// A first guess of the error of cells that leaves most of the tolerance to the modes of a region:
    /// [`SHARE_OF_CELLS`] of it for the faintest of a few PSFs.
    fn error_of_cells(&self, region: PixelRegion, tolerance: f64) -> CellError {
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
        // An error of the flux then counts as much as one of the coefficients.
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

    fn with_limit<R>(&self, error: CellError, work: impl FnOnce(ErrorLimit<'_>) -> R) -> R {
        let mut flux = Vec::new();
        if error.flux_weight > 0.0 {
            let components = self.fluxes.iter().take(self.model.field().component_count());
            flux.extend(components.map(|flux| error.flux_weight * flux));
        }
        let size = error.size;
        work(ErrorLimit { size, flux: &flux })
    }

    /// A few cells of a region, without any error.
    pub(crate) fn sampled_cells(&self, region: PixelRegion) -> RegionCells {
        RegionCells::sampled(self.model.field(), region)
    }

    /// About how many cells [`region`](Self::region) makes.
    pub(crate) fn expected_cells(&self, region: PixelRegion, tolerance: f64) -> usize {
        let error = self.error_of_cells(region, tolerance);
        self.with_limit(error, |limit| {
            RegionCells::expected(self.model.field(), region, limit)
        })
    }

    /// The modes of [`sampled_cells`](Self::sampled_cells). The tolerance must not be below the
    /// rounding of f64.
    pub(crate) fn modes_of(&self, cells: &RegionCells, tolerance: f64) -> LocalModes {
        LocalModes::new(self, cells, 0.0, tolerance).expect("these cells have no error")
    }

    /// The cells, their error and the modes of a region. The tolerance must not be below the rounding
    /// of f64.
    pub fn region(&self, region: PixelRegion, tolerance: f64) -> (RegionCells, CellError, LocalModes) {
        let first = self.error_of_cells(region, tolerance);
        let mut error = first;
        loop {
            let cells = self.cells(region, error);
            if let Some(modes) = LocalModes::new(self, &cells, error.flux_weight, tolerance) {
                return (cells, error, modes);
            }
            // Somewhere in the region, PSFs are much fainter than expected.
            error.size *= if error.size > SMALLEST_ERROR * first.size {
                0.4
            } else {
                0.0
            };
        }
    }

    /// `sign` is the sign of the PSFs' flux.
    fn errors(&self, tolerance: f64, cells: CellError, sign: f64) -> AllowedErrors {
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
        let Some(growth) = &self.growth else {
            return size <= tolerance * psf_norm;
        };
        size <= tolerance * psf_norm
            && (size <= ROUNDING_NORM * psf_norm || growth.largest_flux(error) <= tolerance * flux.abs())
    }

    /// The PSFs of nodes of the coefficient field, without the mean, `[node, direction]`.
    pub(crate) fn nodes(&self, nodes: &[usize]) -> Array2<f64> {
        let values = self.model.field().node_values();
        let mut rows = Array2::zeros((nodes.len(), self.mean.len()));
        for (mut row, &node) in rows.outer_iter_mut().zip(nodes) {
            row.slice_mut(s![..values.ncols()]).assign(&values.row(node));
        }
        rows
    }
}

/// An error is rounding if its norm is at most this fraction of the PSF's norm. Its flux in circles
/// is then not tested.
const ROUNDING_NORM: f64 = 1e-15;

/// A local basis: `h(x) = flux(x) reference + sum_j c_j(x) mode_j`. The modes hold no flux, so
/// leaving out modes keeps the flux. The exception is a region without a reference: its first mode
/// holds all the flux, if there is any, and is then always kept.
///
/// The modes are orthonormal. Apart from a first mode that holds the flux, they are ordered by
/// their mean squared coefficient, the largest first. As few modes are kept as represent every PSF
/// of the region within the tolerance. The error of a PSF is relative to the PSF's own norm.
///
/// It is enough to test the corners of each cell ([`RegionCells`]), because PSFs are bilinear in a
/// cell. Along any row or column of the cell, the norm of the error is convex. The limit for this
/// norm is the tolerance times the PSF's projection on the region's mean. Along the row or column,
/// this limit is linear. So if the norm is within the limit at both ends, it is also within the
/// limit in between. The projection is at most the PSF's norm, so the relative error is within the
/// tolerance.
///
/// With [`ToleranceOn::Aperture`], the flux of the error in every circle is bounded too
/// (`GrowthCurves`). The largest of these fluxes is also convex, and its limit, the tolerance
/// times the PSF's flux, is also linear along a row or column. So the corners are enough here, too.
/// The modes are then orthonormal in another scalar product, `<u, v> + weight sum_R u(R) v(R)`. In
/// this sum, `u(R)` is the flux of `u` in the circle of radius `R`. So the first modes represent
/// both the PSFs and their curves of growth. The norm of this product is at least the L2 norm.
#[derive(Debug)]
pub struct LocalModes {
    /// The region's mean PSF, scaled to unit flux, `[direction]`. `None` if it holds too little
    /// flux.
    reference: Option<Array1<f64>>,
    /// `[mode, direction]`.
    pub(crate) modes: Array2<f64>,
    /// `[mode, direction]`. The scalar product of a row and a PSF's vector is the PSF's coefficient
    /// of the mode. `None` if these rows equal the modes.
    duals: Option<Array2<f64>>,
    /// Flux and coefficients.
    values: CornerTable,
}

/// The number of bands (neighbouring rows, [`RegionCells`]) whose PSFs determine the directions of
/// the modes. All bands determine how many modes are kept.
const SUPPORT_BANDS: usize = 5;
/// The largest number of cells used from each of these bands. The last cell of the band is used in
/// addition.
const SUPPORT_CELLS: usize = 8;
/// The region's mean is the reference if it holds more than this fraction of the largest flux that
/// a vector of its norm can hold.
const MIN_REFERENCE_FLUX: f64 = 1e-3;
/// The flux direction is the direction of the vector [`PsfSpace::fluxes`]. The part of a node along
/// it counts as rounding if it is at most this fraction of the largest norm of the nodes. A span
/// has no flux if at most this fraction of the vector lies in the span ([`flux_axis`]).
const NO_FLUX: f64 = 1e-12;
/// A direction counts as rounding if no node's part along it exceeds this fraction of the largest
/// norm of the nodes.
const ROUNDING: f64 = 2e-16;
/// Directions in which PSFs differ by at most this fraction of the smallest allowed error are left
/// out.
const OUTSIDE_SPAN: f64 = 0.2;
/// The fraction of the tolerance that is left to the cells. Small cells cost little.
const SHARE_OF_CELLS: f64 = 0.2;
/// An error of coefficients below this fraction of the first guess counts as 0. The cells of a
/// polynomial are then single pixels.
const SMALLEST_ERROR: f64 = 1e-6;

impl LocalModes {
    /// Computes the modes of a region. The tolerance must not be below the rounding of f64. `None` if
    /// the error of the cells may use most of the tolerance.
    fn new(space: &PsfSpace, cells: &RegionCells, flux_weight: f64, tolerance: f64) -> Option<Self> {
        let mut nodes = space.nodes(&cells.nodes);
        let mut offset = space.mean.clone();
        if cells.is_partition_of_unity() {
            nodes += &offset;
            offset.fill(0.0);
        }
        let support = Support::of(cells);
        let centre = support.mean_weights(nodes.nrows()).dot(&nodes) + &offset;
        // beta(x) = <h(x), centre> / |centre| is linear in the weights of the nodes. It is at most
        // the norm of h(x).
        let along = &centre / norm(centre.view()).max(f64::MIN_POSITIVE);
        let flux = centre.dot(&space.fluxes);
        let possible = norm(centre.view()) * norm(space.fluxes.view());
        let reference = (flux.abs() > MIN_REFERENCE_FLUX * possible).then(|| &centre / flux);
        let scale = nodes
            .outer_iter()
            .chain([offset.view()])
            .map(norm)
            .fold(0.0, f64::max);
        // The last row is the offset.
        let mut rows = ndarray::concatenate(Axis(0), &[nodes.view(), offset.view().insert_axis(Axis(0))])
            .expect("equally many columns");
        let (betas, fluxes) = (rows.dot(&along), rows.dot(&space.fluxes));
        if let Some(reference) = &reference {
            for (mut row, &flux) in rows.outer_iter_mut().zip(&fluxes) {
                row.scaled_add(-flux, reference);
            }
        }
        let of_cells = CellError {
            size: cells.error,
            flux_weight,
        };
        let errors = space.errors(tolerance, of_cells, flux.signum());
        // The modes must represent these remainders of the nodes and of the offset. Directions in
        // which they differ by a small fraction of the allowed errors are left out.
        let stop = match reference {
            Some(_) => OUTSIDE_SPAN * errors.least(cells, betas.view(), fluxes.view()),
            // Directions left out would hold flux.
            None => 0.0,
        };
        let (span, outside) = span(rows.view(), stop.max(ROUNDING * scale));
        let rows = rows.dot(&span.t());
        // From here on, the scalar product of coordinates is that in which modes are orthonormal.
        let metric = space.growth.as_ref().and_then(|growth| {
            let psf_norm = reference.as_ref().map_or(0.0, |reference| norm(reference.view()));
            Metric::new(growth.circles.dot(&span.t()), psf_norm)
        });
        let rows = match &metric {
            None => rows,
            Some(metric) => rows.dot(&metric.root),
        };
        let flux_axis = flux_axis(&span, space.fluxes.view()).map(|axis| match &metric {
            None => axis,
            Some(metric) => {
                let axis = metric.inverse.dot(&axis);
                let length = norm(axis.view());
                axis / length
            }
        });
        let covariance = support.covariance(rows.view());
        let (rotation, forced) = mode_axes(
            &covariance,
            flux_axis,
            rows.view(),
            reference.is_some(),
            NO_FLUX * scale,
        );
        let rows = rows.dot(&rotation);
        // The span in the coordinates of the metric, `[coordinate, direction]`.
        let axes = match &metric {
            None => span.clone(),
            Some(metric) => metric.inverse.dot(&span),
        };
        let growth = space.growth.as_ref().map(|growth| {
            let circles = rotation.t().dot(&axes).dot(&growth.circles.t());
            TailGrowth::new(circles, growth.remainder)
        });
        let table = |first: &[ArrayView1<'_, f64>], rank: usize| {
            let first = first.iter().map(|column| column.insert_axis(Axis(1)));
            let columns: Vec<ArrayView2<'_, f64>> = first.chain([rows.slice(s![.., ..rank])]).collect();
            let joined = ndarray::concatenate(Axis(1), &columns).expect("equally many rows");
            CornerTable::new(&joined)
        };
        let needed = f64::dispatch(CountModes {
            cells,
            table: &table(&[betas.view(), fluxes.view()], rows.ncols()),
            errors,
            reference: reference.as_ref().map_or(0.0, |reference| norm(reference.view())),
            outside,
            growth,
        })?;
        let rank = forced.max(needed);
        let kept = rotation.slice(s![.., ..rank]);
        Some(Self {
            modes: kept.t().dot(&axes),
            duals: metric.map(|metric| kept.t().dot(&metric.root.t()).dot(&span)),
            values: table(&[fluxes.view()], rank),
            reference,
        })
    }

    /// The mean PSF of a region, `[direction]`, not scaled to unit flux.
    pub(crate) fn mean(space: &PsfSpace, cells: &RegionCells) -> Array1<f64> {
        let weights = Support::of(cells).mean_weights(cells.nodes.len());
        weights.dot(&space.nodes(&cells.nodes)) + &space.mean
    }

    /// The number of modes, without the reference.
    pub(crate) fn rank(&self) -> usize {
        self.modes.nrows()
    }

    /// `[mode, direction]`. The scalar product of a row and the vector of a PSF is the coefficient
    /// of the mode. If there is a reference, the vector must hold no flux.
    pub(crate) fn duals(&self) -> &Array2<f64> {
        self.duals.as_ref().unwrap_or(&self.modes)
    }

    pub(crate) fn reference(&self) -> Option<ArrayView1<'_, f64>> {
        self.reference.as_ref().map(|r| r.view())
    }

    /// The PSFs that combine to those of the block: the reference if there is one, then the modes.
    pub(crate) fn directions(&self) -> impl Iterator<Item = ArrayView1<'_, f64>> {
        self.reference().into_iter().chain(self.modes.outer_iter())
    }

    /// Computes the values at one corner of a cell: the flux, then the coefficient of each mode.
    /// `end` holds the weights of the nodes at this corner.
    pub(crate) fn values_into(&self, end: &[(usize, f64)], values: &mut [f64]) {
        self.values.at(end, values);
    }
}

/// Functions that are linear in the weights of the nodes.
#[derive(Debug)]
struct CornerTable {
    width: usize,
    /// The functions of each node, then those that belong to no node, `[node, function]`.
    values: Vec<f64>,
}

impl CornerTable {
    fn new(rows: &Array2<f64>) -> Self {
        Self {
            width: rows.ncols(),
            values: rows.iter().copied().collect(),
        }
    }

    /// Writes the functions for some weights of the nodes.
    #[inline(always)]
    fn at(&self, end: &[(usize, f64)], values: &mut [f64]) {
        values.copy_from_slice(&self.values[self.values.len() - self.width..]);
        for &(node, weight) in end {
            let row = &self.values[node * self.width..(node + 1) * self.width];
            for (value, of_node) in values.iter_mut().zip(row) {
                *value += weight * of_node;
            }
        }
    }
}

/// A scalar product of coordinates: their ordinary scalar product plus a multiple of the scalar
/// product of their fluxes in circles.
struct Metric {
    /// The lower triangular matrix `L` of Cholesky's decomposition `L L^T` of the product's matrix.
    /// The coordinates `L^T v` have the ordinary scalar product.
    root: Array2<f64>,
    /// `L^-1`.
    inverse: Array2<f64>,
}

impl Metric {
    /// `circles` holds the flux of each coordinate in circles, `[circle, coordinate]`. `psf_norm`
    /// is the norm of a PSF of unit flux. `None` if the norm is 0, or a matrix overflows.
    fn new(circles: Array2<f64>, psf_norm: f64) -> Option<Self> {
        // The tolerance allows a norm of `psf_norm` and a flux of 1. Scaled in this way, both have
        // similar weights.
        let weight = psf_norm * psf_norm / circles.nrows() as f64;
        let mut product = circles.t().dot(&circles) * weight;
        if weight == 0.0 || product.iter().any(|v| !v.is_finite()) {
            return None;
        }
        product.diag_mut().mapv_inplace(|v| v + 1.0);
        let n = product.nrows();
        let root = Cholesky::new(DMatrix::from_fn(n, n, |i, j| product[[i, j]]))?.unpack();
        let inverse = root.solve_lower_triangular(&DMatrix::identity(n, n))?;
        let array = |matrix: DMatrix<f64>| Array2::from_shape_fn((n, n), |(i, j)| matrix[(i, j)]);
        Some(Self {
            root: array(root),
            inverse: array(inverse),
        })
    }
}

/// The node weights at the corners of some cells, which are spread over the region.
struct Support<'a>(Vec<&'a [(usize, f64)]>);

impl<'a> Support<'a> {
    fn of(cells: &'a RegionCells) -> Self {
        let bands = &cells.bands;
        let count = SUPPORT_BANDS.min(bands.len());
        let mut ends = Vec::new();
        for i in 0..count {
            let band = cells.cells_of(&bands[i * (bands.len() - 1) / (count - 1).max(1)]);
            let step = band.len().div_ceil(SUPPORT_CELLS);
            let chosen = band.iter().step_by(step).chain(band.last());
            ends.extend(chosen.filter_map(|cell| cell.corners).flatten());
        }
        if ends.is_empty() {
            // The chosen cells have no values. Takes the first cell that has values.
            ends.extend(cells.corners_of_cells().next().into_iter().flatten());
        }
        Self(ends.into_iter().map(|corner| cells.weights(corner)).collect())
    }

    fn mean_weights(&self, nodes: usize) -> Array1<f64> {
        let mut mean = Array1::zeros(nodes);
        for &(node, weight) in self.0.iter().copied().flatten() {
            mean[node] += weight / self.0.len() as f64;
        }
        mean
    }

    fn covariance(&self, rows: ArrayView2<'_, f64>) -> Array2<f64> {
        let table = CornerTable::new(&rows.to_owned());
        let mut values = Array2::zeros((self.0.len(), rows.ncols()));
        for (mut value, end) in values.outer_iter_mut().zip(&self.0) {
            table.at(end, value.as_slice_mut().expect("row-major"));
        }
        values.t().dot(&values)
    }
}

/// The sum of the magnitudes of weights, with 1 for the offset.
fn sum_of_magnitudes(end: &[(usize, f64)]) -> f64 {
    end.iter().map(|(_, w)| w.abs()).sum::<f64>() + 1.0
}

/// Returns the directions of the modes as columns, and how many of them must be kept: 1 if the
/// first mode carries all flux, otherwise 0. `rows` have no flux if it is at most `no_flux`.
fn mode_axes(
    covariance: &Array2<f64>,
    flux_axis: Option<Array1<f64>>,
    rows: ArrayView2<'_, f64>,
    has_reference: bool,
    no_flux: f64,
) -> (Array2<f64>, usize) {
    let beside = |axis: &Array1<f64>| {
        let rest = complement(axis);
        rest.dot(&principal_axes(&rest.t().dot(covariance).dot(&rest)))
    };
    match flux_axis {
        None => (principal_axes(covariance), 0),
        // Without a reference, the mode along the flux axis carries all flux and must be kept.
        Some(axis) if !has_reference => {
            let rest = beside(&axis);
            let axis = axis.insert_axis(Axis(1));
            (
                ndarray::concatenate(Axis(1), &[axis.view(), rest.view()]).expect("equally many rows"),
                1,
            )
        }
        // With a reference, the nodes have no part along the flux direction, except for
        // rounding. If this rounding is small, the modes are chosen without such a part.
        Some(axis) => {
            let along = rows.dot(&axis).iter().fold(0.0_f64, |m, v| m.max(v.abs()));
            if along <= no_flux {
                (beside(&axis), 0)
            } else {
                (principal_axes(covariance), 0)
            }
        }
    }
}

/// The direction of flux in the coordinates of a span, if the span has any flux.
fn flux_axis(span: &Array2<f64>, fluxes: ArrayView1<'_, f64>) -> Option<Array1<f64>> {
    let axis = span.dot(&fluxes);
    let length = norm(axis.view());
    (length > NO_FLUX * norm(fluxes)).then(|| axis / length)
}

/// Returns orthonormal columns orthogonal to a unit vector: all columns but the first of the
/// reflection that maps this vector to the first axis, up to its sign.
fn complement(axis: &Array1<f64>) -> Array2<f64> {
    let n = axis.len();
    let mut normal = axis.clone();
    normal[0] += axis[0].signum();
    let twice = 2.0 / normal.dot(&normal);
    Array2::from_shape_fn((n, n - 1), |(i, j)| {
        f64::from(u8::from(i == j + 1)) - twice * normal[i] * normal[j + 1]
    })
}

/// Returns the eigenvectors of a covariance as columns, the largest eigenvalue first.
fn principal_axes(covariance: &Array2<f64>) -> Array2<f64> {
    let n = covariance.nrows();
    // If the covariance overflows, it has no axes. Returns the coordinate axes.
    if n == 0 || covariance.iter().any(|v| !v.is_finite()) {
        return Array2::eye(n);
    }
    let eigen = SymmetricEigen::new(DMatrix::from_fn(n, n, |i, j| covariance[[i, j]]));
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    Array2::from_shape_fn((n, n), |(i, j)| eigen.eigenvectors[(i, order[j])])
}

/// The largest errors that modes may cause, after those of the cells.
///
/// Let an unscaled PSF be off by `d`, and its flux by `f`, because of the error of a cell's coefficients:
/// `sqrt(|d|^2 + weight^2 f^2) <= e`. A PSF `h` scaled to unit flux is then off by at most
/// `|d| + |f| |h| <= e sqrt(1 + (|h| / weight)^2)`, divided by the flux of the unscaled PSF.
#[derive(Debug, Clone, Copy)]
struct AllowedErrors {
    tolerance: f64,
    cells: CellError,
    /// The largest flux in a circle of an error of norm 1. 0 if these fluxes are not bounded.
    largest_flux: f64,
    /// The sign of the region's mean flux.
    sign: f64,
}

impl AllowedErrors {
    /// The least allowed error of a PSF at a corner of the cells, divided by the sum of the weights'
    /// magnitudes there. `betas` and `fluxes` are those of the nodes and of the offset.
    fn least(&self, cells: &RegionCells, betas: ArrayView1<'_, f64>, fluxes: ArrayView1<'_, f64>) -> f64 {
        let last = betas.len() - 1;
        let at = |end: &[(usize, f64)], values: ArrayView1<'_, f64>| {
            end.iter().map(|&(n, w)| w * values[n]).sum::<f64>() + values[last]
        };
        let (mut least, mut most_weight) = (f64::INFINITY, 1.0_f64);
        for end in cells.corners() {
            let (beta, flux) = (at(end, betas), self.sign * at(end, fluxes));
            let by_cells = self.of_cells(beta / flux);
            let norm = self.norm(beta, by_cells);
            let flux = self.flux(flux, by_cells) / self.largest_flux;
            // Without a bound of fluxes, this is infinite or not a number.
            least = least.min(norm).min(flux);
            most_weight = most_weight.max(sum_of_magnitudes(end));
        }
        least.max(0.0) / most_weight
    }

    /// The error of an unscaled PSF because of its cell. `scaled_norm` is the norm of the cell's PSF
    /// divided by its flux. The model's PSF exceeds it by at most a factor of 1 + tolerance, because
    /// cells use at most half of the tolerance.
    #[inline(always)]
    fn of_cells(&self, scaled_norm: f64) -> f64 {
        let CellError { size, flux_weight } = self.cells;
        if flux_weight == 0.0 {
            size
        } else {
            size * (1.0 + (scaled_norm * (1.0 + self.tolerance) / flux_weight).powi(2)).sqrt()
        }
    }

    /// The allowed norm for a PSF of at least the norm `beta`. The error is relative to the PSF of
    /// the model, which differs by the error of the cell.
    #[inline(always)]
    fn norm(&self, beta: f64, by_cells: f64) -> f64 {
        self.tolerance * beta - (1.0 + self.tolerance) * by_cells
    }

    /// The allowed flux in any circle for a PSF of the given flux.
    #[inline(always)]
    fn flux(&self, flux: f64, by_cells: f64) -> f64 {
        self.tolerance * flux - (1.0 + self.tolerance) * self.largest_flux * by_cells
    }
}

/// Counts the leading coordinates to keep, so that for every PSF the other coordinates are within
/// the allowed errors: their norm and, if `growth` is given, their flux in every circle. Returns
/// `None` if cells may use most of the tolerance.
struct CountModes<'a> {
    cells: &'a RegionCells,
    /// Beta, flux and coordinates.
    table: &'a CornerTable,
    errors: AllowedErrors,
    /// The norm of the reference.
    reference: f64,
    /// The norm of what the coordinates leave out of a node.
    outside: f64,
    growth: Option<TailGrowth>,
}

/// The functions before the coordinates in [`CountModes::table`].
const BEFORE: usize = 2;

impl WithIsa<f64> for CountModes<'_> {
    type Output = Option<usize>;

    #[inline(always)]
    fn run<S: Lanes<f64>>(mut self, simd: S) -> Option<usize> {
        simd.vectorized(
            #[inline(always)]
            || self.count(),
        )
    }
}

impl CountModes<'_> {
    #[inline(always)]
    fn count(&mut self) -> Option<usize> {
        let (width, errors) = (self.table.width, self.errors);
        let mut values = vec![0.0; self.cells.corners().len() * width];
        let mut outside = Vec::with_capacity(self.cells.corners().len());
        for (corner, values) in self.cells.corners().zip(values.chunks_exact_mut(width)) {
            self.table.at(corner, values);
            outside.push(self.outside * sum_of_magnitudes(corner));
        }
        let rounding = ROUNDING_NORM / errors.tolerance;
        let mut needed = 0;
        for corners in self.cells.corners_of_cells() {
            // An allowed error that is linear along rows and columns is nowhere in the cell below
            // its least value at the corners.
            let (mut beta, mut flux) = (f64::INFINITY, f64::INFINITY);
            let (mut left_out, mut scaled_norm) = (0.0_f64, 0.0_f64);
            for &corner in corners {
                let values = &values[corner * width..(corner + 1) * width];
                beta = beta.min(values[0]);
                flux = flux.min(errors.sign * values[1]);
                left_out = left_out.max(outside[corner]);
                if errors.cells.flux_weight > 0.0 && errors.cells.size > 0.0 {
                    let rest = dot(&values[BEFORE..], &values[BEFORE..]).sqrt() + outside[corner];
                    scaled_norm = scaled_norm.max(self.reference + rest / values[1].abs());
                }
            }
            let by_cells = errors.of_cells(scaled_norm);
            let norm = errors.norm(beta, by_cells);
            let flux_allowed = errors.flux(flux, by_cells);
            if errors.cells.size > 0.0 {
                let least = 0.5 * errors.tolerance;
                // Where the flux vanishes in a cell, a small error of it has no bound.
                let has_flux = errors.cells.flux_weight == 0.0 || flux > 0.0;
                let enough = norm >= least * beta && beta > 0.0 && has_flux;
                if !enough || errors.largest_flux > 0.0 && flux_allowed < least * flux {
                    return None;
                }
            }
            // The directions left out are orthogonal to the coordinates.
            let norm_squared = (norm * norm.max(0.0) - left_out * left_out).max(0.0);
            let flux = (flux_allowed - errors.largest_flux * left_out).max(0.0);
            for &corner in corners {
                let values = &values[corner * width + BEFORE..(corner + 1) * width];
                needed = needed_beyond(needed, values, norm_squared);
                let Some(growth) = &mut self.growth else { continue };
                while needed < values.len() {
                    let tail = &values[needed..];
                    let size = dot(tail, tail);
                    if size <= rounding.powi(2) * norm_squared || growth.is_within(needed, tail, flux) {
                        break;
                    }
                    needed += 1;
                }
            }
        }
        Some(needed)
    }
}

/// Returns the smallest number of leading values, at least `first`, so that the squared norm of the
/// others is at most `limit`.
#[inline(always)]
fn needed_beyond(first: usize, values: &[f64], limit: f64) -> usize {
    let tail = &values[first..];
    // The negated test also holds for values that are not numbers.
    if dot(tail, tail) <= limit {
        return first;
    }
    let mut sum = 0.0;
    let fits = |value: &&f64| {
        sum += *value * *value;
        sum <= limit
    };
    first + tail.len() - tail.iter().rev().take_while(fits).count()
}
