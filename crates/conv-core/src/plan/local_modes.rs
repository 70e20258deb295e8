//! The few modes whose linear combinations represent all PSFs of a region.

use nalgebra::{Cholesky, DMatrix, SymmetricEigen};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis, s};
use psf_types::{PsfModel, ToleranceOn};

use super::growth_curves::{GrowthCurves, TailGrowth};
use super::norm::{norm, norm_squared};
use super::region_cells::{CORNERS, RegionCells};

/// Coordinates in which the norm of a vector is the L2 norm of its PSF.
///
/// Each direction is a stamp, and these stamps are orthonormal. The first are the components of the
/// basis. One more direction holds the part of the mean stamp that the components do not span. An
/// unscaled PSF of the model is `mean + sum_n w_n node_n`, where `w_n` is the weight of node `n` of
/// the coefficient field.
#[derive(Debug)]
pub struct PsfSpace {
    /// Orthonormal stamps, `[direction, stamp pixel]`.
    pub(crate) stamps: Array2<f64>,
    /// For each node of the coefficient field, its PSF minus the mean, `[node, direction]`.
    nodes: Array2<f64>,
    pub(crate) mean: Array1<f64>,
    /// The flux of each orthonormal stamp.
    pub(crate) fluxes: Array1<f64>,
    /// The flux in circles. `None` if the tolerance only bounds the L2 error.
    growth: Option<GrowthCurves>,
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
        let values = model.field().node_values();
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
        let mut nodes = Array2::zeros((values.nrows(), rank + extra));
        nodes.slice_mut(s![.., ..rank]).assign(&values);
        let fluxes = stamps
            .outer_iter()
            .map(|stamp| model.grid().flux_of_sum(stamp.sum()))
            .collect();
        let growth = (on == ToleranceOn::Aperture).then(|| {
            // Without a mean, the nodes are usually PSFs.
            let of_nodes = nodes.mean_axis(Axis(0)).filter(|_| first == 0);
            let typical = of_nodes.as_ref().unwrap_or(&mean);
            GrowthCurves::new(stamps.view(), model.grid(), typical.view())
        });
        Self {
            stamps,
            nodes,
            mean,
            fluxes,
            growth,
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

    pub(crate) fn node(&self, node: usize) -> ArrayView1<'_, f64> {
        self.nodes.row(node)
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
    /// The part of flux and coefficients that does not depend on the nodes.
    offset: Array1<f64>,
    /// Flux and coefficients of the region's nodes, `[node, 1 + mode]`.
    node_values: Array2<f64>,
}

/// The number of bands (neighbouring rows, [`RegionCells`]) whose PSFs determine the directions of
/// the modes. All bands determine how many modes are kept.
const SUPPORT_BANDS: usize = 5;
/// The largest number of cells used from each of these bands. The last cell of the band is used in
/// addition.
const SUPPORT_CELLS: usize = 16;
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

/// In [`span`], the remainder of a node counts as rounding if less than this fraction of it is
/// orthogonal to the directions found before.
const MIN_NEW_PART: f64 = 0.5;

impl LocalModes {
    /// Computes the modes of a region. The tolerance must not be below the rounding of f64.
    pub fn new(space: &PsfSpace, cells: &RegionCells, tolerance: f64) -> Self {
        let mut nodes = Array2::zeros((cells.nodes.len(), space.mean.len()));
        for (mut row, &node) in nodes.outer_iter_mut().zip(&cells.nodes) {
            row.assign(&space.node(node));
        }
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
        let (beta, beta_offset) = (nodes.dot(&along), offset.dot(&along));
        let fluxes = nodes.dot(&space.fluxes);
        let flux_offset = offset.dot(&space.fluxes);
        let flux = centre.dot(&space.fluxes);
        let possible = norm(centre.view()) * norm(space.fluxes.view());
        let reference = (flux.abs() > MIN_REFERENCE_FLUX * possible).then(|| &centre / flux);
        let scale = nodes
            .outer_iter()
            .chain([offset.view()])
            .map(norm)
            .fold(0.0, f64::max);
        if let Some(reference) = &reference {
            for (mut node, &flux) in nodes.outer_iter_mut().zip(&fluxes) {
                node.scaled_add(-flux, reference);
            }
            offset.scaled_add(-flux_offset, reference);
        }
        // The modes must represent these remainders of the nodes and of the offset.
        let span = span(nodes.view(), offset.view(), ROUNDING * scale);
        let (nodes, offset) = (nodes.dot(&span.t()), span.dot(&offset));
        // From here on, the scalar product of coordinates is that in which modes are orthonormal.
        let metric = space.growth.as_ref().and_then(|growth| {
            let psf_norm = reference.as_ref().map_or(0.0, |reference| norm(reference.view()));
            Metric::new(growth.circles.dot(&span.t()), psf_norm)
        });
        let (nodes, offset) = match &metric {
            None => (nodes, offset),
            Some(metric) => (nodes.dot(&metric.root), offset.dot(&metric.root)),
        };
        let covariance = support.covariance(nodes.view(), offset.view());
        let flux_axis = flux_axis(&span, space.fluxes.view()).map(|axis| match &metric {
            None => axis,
            Some(metric) => {
                let axis = metric.inverse.dot(&axis);
                let length = norm(axis.view());
                axis / length
            }
        });
        let (rotation, forced) = mode_axes(
            &covariance,
            flux_axis,
            (nodes.view(), offset.view()),
            reference.is_some(),
            NO_FLUX * scale,
        );
        let (nodes, offset) = (nodes.dot(&rotation), offset.dot(&rotation));
        // The span in the coordinates of the metric, `[coordinate, direction]`.
        let axes = match &metric {
            None => span.clone(),
            Some(metric) => metric.inverse.dot(&span),
        };
        let growth = space.growth.as_ref().map(|growth| {
            let circles = rotation.t().dot(&axes).dot(&growth.circles.t());
            TailGrowth::new(circles, growth.remainder)
        });
        let at = |end: &[(usize, f64)], values: &Array1<f64>, offset: f64| {
            end.iter().map(|&(n, w)| w * values[n]).sum::<f64>() + offset
        };
        let limits = |end: &[(usize, f64)]| Limits {
            norm: tolerance * at(end, &beta, beta_offset).max(0.0),
            flux: tolerance * (flux.signum() * at(end, &fluxes, flux_offset)).max(0.0),
        };
        let rounding = ROUNDING_NORM / tolerance;
        let rank = forced.max(needed(
            cells,
            nodes.view(),
            offset.view(),
            limits,
            growth,
            rounding,
        ));
        let kept = rotation.slice(s![.., ..rank]);
        let modes = kept.t().dot(&axes);
        let duals = metric.map(|metric| kept.t().dot(&metric.root.t()).dot(&span));
        let with_flux = |flux: ArrayView2<'_, f64>, values: ArrayView2<'_, f64>| {
            ndarray::concatenate(Axis(1), &[flux, values]).expect("equally many rows")
        };
        let kept = offset.slice(s![..rank]).insert_axis(Axis(0)).to_owned();
        let offset = with_flux(ndarray::aview2(&[[flux_offset]]), kept.view());
        Self {
            reference,
            modes,
            duals,
            offset: offset.row(0).to_owned(),
            node_values: with_flux(fluxes.view().insert_axis(Axis(1)), nodes.slice(s![.., ..rank])),
        }
    }

    /// The mean PSF of a region, `[direction]`, not scaled to unit flux.
    pub(crate) fn mean(space: &PsfSpace, cells: &RegionCells) -> Array1<f64> {
        let mut mean = space.mean.clone();
        let weights = Support::of(cells).mean_weights(cells.nodes.len());
        for (&weight, &node) in weights.iter().zip(&cells.nodes) {
            mean.scaled_add(weight, &space.node(node));
        }
        mean
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
        values.copy_from_slice(self.offset.as_slice().expect("contiguous"));
        for &(node, weight) in end {
            for (value, node_value) in values.iter_mut().zip(self.node_values.row(node)) {
                *value += weight * node_value;
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
            let band = &bands[i * (bands.len() - 1) / (count - 1).max(1)];
            // In a band of one row, the last two corners repeat the first two.
            let corners = if band.rows.len() == 1 {
                CORNERS / 2
            } else {
                CORNERS
            };
            let band = cells.cells_of(band);
            let step = band.len().div_ceil(SUPPORT_CELLS);
            let chosen = band.iter().step_by(step).chain(band.last());
            let chosen = chosen.filter_map(|cell| cells.corners(cell));
            ends.extend(chosen.flat_map(|of_cell| of_cell.into_iter().take(corners)));
        }
        if ends.is_empty() {
            // The chosen cells have no values. Takes the first cell that has values.
            ends.extend(cells.all_corners().next().into_iter().flatten());
        }
        Self(ends)
    }

    fn mean_weights(&self, nodes: usize) -> Array1<f64> {
        let mut mean = Array1::zeros(nodes);
        for &(node, weight) in self.0.iter().copied().flatten() {
            mean[node] += weight / self.0.len() as f64;
        }
        mean
    }

    fn covariance(&self, nodes: ArrayView2<'_, f64>, offset: ArrayView1<'_, f64>) -> Array2<f64> {
        let mut values = Array2::zeros((self.0.len(), offset.len()));
        for (mut value, end) in values.outer_iter_mut().zip(&self.0) {
            value.assign(&offset);
            for &(node, weight) in *end {
                value.scaled_add(weight, &nodes.row(node));
            }
        }
        values.t().dot(&values)
    }
}

/// Returns orthonormal rows that span the rows of `nodes` and `offset`, except for remainders with
/// norms below `least`.
fn span(nodes: ArrayView2<'_, f64>, offset: ArrayView1<'_, f64>, least: f64) -> Array2<f64> {
    let dimension = nodes.ncols();
    if nodes.nrows() >= dimension {
        return Array2::eye(dimension);
    }
    let mut rest =
        ndarray::concatenate(Axis(0), &[nodes, offset.insert_axis(Axis(0))]).expect("equally many columns");
    let mut basis: Vec<Array1<f64>> = Vec::new();
    while basis.len() < dimension {
        let norms = rest.outer_iter().map(norm);
        let Some((row, largest)) = norms.enumerate().max_by(|a, b| a.1.total_cmp(&b.1)) else {
            break;
        };
        if largest <= least {
            break;
        }
        let mut direction = &rest.row(row) / largest;
        rest.row_mut(row).fill(0.0);
        // Removes the rounding errors along earlier directions.
        for earlier in &basis {
            let p = earlier.dot(&direction);
            direction.scaled_add(-p, earlier);
        }
        let new = norm(direction.view());
        if new < MIN_NEW_PART {
            continue;
        }
        direction /= new;
        for mut other in rest.outer_iter_mut() {
            let p = other.dot(&direction);
            other.scaled_add(-p, &direction);
        }
        basis.push(direction);
    }
    let mut rows = Array2::zeros((basis.len(), dimension));
    for (mut row, direction) in rows.outer_iter_mut().zip(&basis) {
        row.assign(direction);
    }
    rows
}

/// Returns the directions of the modes as columns, and how many of them must be kept: 1 if the
/// first mode carries all flux, otherwise 0. `nodes` and `offset` have no flux if it is at most
/// `no_flux`.
fn mode_axes(
    covariance: &Array2<f64>,
    flux_axis: Option<Array1<f64>>,
    (nodes, offset): (ArrayView2<'_, f64>, ArrayView1<'_, f64>),
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
            let along = nodes
                .dot(&axis)
                .iter()
                .fold(offset.dot(&axis).abs(), |m, v| m.max(v.abs()));
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

/// The largest errors that the tolerance allows for a PSF.
#[derive(Clone, Copy)]
struct Limits {
    norm: f64,
    /// The flux in any circle.
    flux: f64,
}

/// Returns the smallest number of leading coordinates to keep, so that for every PSF the other
/// coordinates are within the PSF's limits: their norm and, if `growth` is given, their flux in
/// every circle. The flux is not tested if the norm is at most the fraction `rounding` of its
/// limit.
fn needed(
    cells: &RegionCells,
    nodes: ArrayView2<'_, f64>,
    offset: ArrayView1<'_, f64>,
    limits: impl Fn(&[(usize, f64)]) -> Limits,
    mut growth: Option<TailGrowth>,
    rounding: f64,
) -> usize {
    let n = offset.len();
    let (nodes, offset) = (nodes.as_standard_layout(), offset.as_standard_layout());
    let nodes = nodes.as_slice().expect("row-major");
    let offset = offset.as_slice().expect("contiguous");
    let mut value = vec![0.0; n];
    let mut needed = 0;
    for corners in cells.all_corners() {
        // A limit that is linear along rows and columns is nowhere in the cell below its least
        // value at the corners.
        let limits = corners.map(&limits);
        let least = limits.iter().map(|l| l.norm).fold(f64::INFINITY, f64::min);
        let least_flux = limits.iter().map(|l| l.flux).fold(f64::INFINITY, f64::min);
        let least = least.powi(2);
        for (i, corner) in corners.iter().enumerate() {
            if corners[..i].iter().any(|before| std::ptr::eq(*before, *corner)) {
                // This corner repeats an earlier one: the band has one row, or the cell one column.
                continue;
            }
            // Only coordinates beyond `needed` can raise the number.
            value[needed..].copy_from_slice(&offset[needed..]);
            for &(node, weight) in *corner {
                let node = &nodes[node * n + needed..(node + 1) * n];
                for (v, coordinate) in value[needed..].iter_mut().zip(node) {
                    *v += weight * coordinate;
                }
            }
            if norm_squared(&value[needed..]) > least {
                let mut tail = 0.0;
                for i in (needed..n).rev() {
                    tail += value[i] * value[i];
                    if tail > least {
                        needed = i + 1;
                        break;
                    }
                }
            }
            let Some(growth) = &mut growth else { continue };
            while needed < n {
                let tail = &value[needed..];
                if norm_squared(tail) <= rounding.powi(2) * least
                    || growth.is_within(needed, tail, least_flux)
                {
                    break;
                }
                needed += 1;
            }
        }
    }
    needed
}
