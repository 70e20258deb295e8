//! The few modes whose linear combinations represent all PSFs of a region.

use nalgebra::{Cholesky, DMatrix, SymmetricEigen};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis, s};
use psf_types::PixelRegion;

use super::allowed_errors::{CellError, CountModes};
use super::growth_curves::TailGrowth;
use super::node_functions::NodeFunctions;
use super::norm::{add_scaled, dot, norm, values};
use super::psf_space::PsfSpace;
use super::region_cells::RegionCells;
use super::span::{leave_out, span};
use crate::simd::vectorized;

/// A local basis: `h(x) = flux(x) reference + sum_j c_j(x) mode_j`. The modes hold no flux, so
/// leaving out modes keeps the flux. The exception is a region without a reference: its first mode
/// holds all the flux, if there is any, and is then always kept.
///
/// The modes are orthonormal. Apart from a first mode that holds the flux, they are ordered by
/// their mean squared coefficient, the largest first. As few modes are kept as represent every PSF
/// of the region within the tolerance. The error of a PSF is relative to the PSF's own norm.
///
/// It is enough to test the corners of each cell ([`RegionCells`]), and with
/// [`ToleranceOn::Aperture`](psf_types::ToleranceOn::Aperture), which also bounds the flux of the error in every
/// circle (`GrowthCurves`), the modes are orthonormal in the scalar product
/// `<u, v> + weight sum_R u(R) v(R)`, where `u(R)` is the flux of `u` in the circle of radius `R`. The
/// reasons are in `docs/decisions/006-local-modes.md`.
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
    values: NodeFunctions,
    /// The number of directions that the modes hold, counted from the first.
    pub(crate) directions: usize,
}

/// The number of bands (neighbouring rows, [`RegionCells`]) of each layer whose PSFs determine the
/// directions of the modes. All bands determine how many modes are kept.
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
/// The last directions are left out as far as PSFs hold at most this fraction of the smallest allowed
/// error of them.
const LAST_DIRECTIONS: f64 = 0.05;
/// An error of coefficients below this fraction of the first guess counts as 0. The cells of a
/// polynomial are then single pixels.
const SMALLEST_ERROR: f64 = 1e-6;

impl LocalModes {
    /// The cells of a region, their error, and the modes. The tolerance must not be below the
    /// rounding of f64.
    pub fn of_region(
        space: &PsfSpace,
        region: PixelRegion,
        tolerance: f64,
    ) -> (RegionCells, CellError, Self) {
        let first = space.error_of_cells(region, tolerance);
        let mut error = first;
        loop {
            let cells = space.cells(region, error);
            match Self::new(space, &cells, error.flux_weight, tolerance) {
                Ok(modes) => return (cells, error, modes),
                // Somewhere in the region, PSFs are much fainter than expected.
                Err(factor) if error.size > SMALLEST_ERROR * first.size => error = error.times(factor),
                Err(_) => error = CellError::ZERO,
            }
        }
    }

    /// The modes of cells without any error. The tolerance must not be below the rounding of f64.
    pub(crate) fn of_exact_cells(space: &PsfSpace, cells: &RegionCells, tolerance: f64) -> Self {
        Self::new(space, cells, 0.0, tolerance).expect("these cells have no error")
    }

    /// Computes the modes of a region. The tolerance must not be below the rounding of f64.
    /// Errors are those of [`CountModes`].
    fn new(space: &PsfSpace, cells: &RegionCells, flux_weight: f64, tolerance: f64) -> Result<Self, f64> {
        let mut rows = space.rows(cells);
        let support = Support::of(cells);
        let centre = support.mean(&rows);
        // beta(x) = <h(x), centre> / |centre| is linear in the weights of the nodes. It is at most
        // the norm of h(x).
        let along = &centre / norm(centre.view()).max(f64::MIN_POSITIVE);
        let flux = centre.dot(&space.fluxes);
        let possible = norm(centre.view()) * norm(space.fluxes.view());
        let reference = (flux.abs() > MIN_REFERENCE_FLUX * possible).then(|| &centre / flux);
        let (scale, betas, fluxes) = vectorized!(sizes(&rows, values(&along), values(&space.fluxes)));
        if let Some(reference) = &reference {
            vectorized!(for (mut row, &flux) in rows.outer_iter_mut().zip(&fluxes) {
                add_scaled(row.as_slice_mut().expect("row-major"), -flux, values(reference));
            });
        }
        let of_cells = CellError {
            size: cells.error,
            flux_weight,
            l2: cells.error,
            circle: cells.circle_error,
        };
        let errors = space.errors(tolerance, of_cells, flux.signum());
        // The modes must represent these remainders of the nodes and of the offset. Directions in
        // which they differ by a small fraction of the allowed errors are left out.
        let least = match reference {
            Some(_) => errors.least(cells, betas.view(), fluxes.view()),
            // Directions left out would hold flux.
            None => 0.0,
        };
        let left_out = vectorized!(leave_out(
            &mut rows,
            values(&space.fluxes),
            LAST_DIRECTIONS * least
        ));
        let used = ..left_out.directions;
        let rows = rows.slice(s![.., used]);
        let (span, outside) = span(rows, (OUTSIDE_SPAN * least).max(ROUNDING * scale));
        let rows = rows.dot(&span.t());
        // From here on, modes are orthonormal in the scalar product of coordinates.
        let metric = space.growth.as_ref().and_then(|growth| {
            let psf_norm = reference.as_ref().map_or(0.0, |reference| norm(reference.view()));
            Metric::new(growth.circles.slice(s![.., used]).dot(&span.t()), psf_norm)
        });
        let rows = match &metric {
            None => rows,
            Some(metric) => rows.dot(&metric.root),
        };
        let flux_axis = flux_axis(&span, space.fluxes.slice(s![used])).map(|axis| match &metric {
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
            let circles = growth.circles.slice(s![.., used]);
            let circles = rotation.t().dot(&axes).dot(&circles.t());
            TailGrowth::new(circles, growth.remainder)
        });
        let [betas, fluxes] = [&betas, &fluxes].map(|column| column.view().insert_axis(Axis(1)));
        let modes = CountModes {
            cells,
            table: &NodeFunctions::new(&[betas, fluxes, rows.view()]),
            errors,
            reference: reference.as_ref().map_or(0.0, |reference| norm(reference.view())),
            outside: outside.hypot(left_out.part),
            moved: left_out.moved,
            growth,
        };
        let needed = vectorized!(modes.count())?;
        let rank = forced.max(needed);
        let kept = rotation.slice(s![.., ..rank]);
        let in_all = |modes: Array2<f64>| in_all_directions(&modes, space.mean.len());
        Ok(Self {
            modes: in_all(kept.t().dot(&axes)),
            duals: metric.map(|metric| in_all(kept.t().dot(&metric.root.t()).dot(&span))),
            directions: left_out.directions,
            values: NodeFunctions::new(&[fluxes, rows.slice(s![.., ..rank])]),
            reference,
        })
    }

    /// The mean PSF of a region, `[direction]`, not scaled to unit flux.
    pub(crate) fn mean(space: &PsfSpace, cells: &RegionCells) -> Array1<f64> {
        Support::of(cells).mean(&space.rows(cells))
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

    /// The number of kernels: the modes, plus 1 if there is a reference.
    pub(crate) fn kernel_count(&self) -> usize {
        self.rank() + usize::from(self.reference.is_some())
    }

    /// The vectors whose combinations are the PSFs of the region, `[kernel, direction]`: the reference
    /// if there is one, then the modes.
    pub(crate) fn kernels(&self) -> Array2<f64> {
        let reference = self.reference.iter().map(|row| row.view().insert_axis(Axis(0)));
        let rows: Vec<ArrayView2<'_, f64>> = reference.chain([self.modes.view()]).collect();
        ndarray::concatenate(Axis(0), &rows).expect("equally many directions")
    }

    /// The flux and the coefficient of each mode at the corners of cells, `[corner, function]`.
    pub fn at_corners(&self, cells: &RegionCells) -> Array2<f64> {
        let mut values = Array2::zeros((cells.corners().len(), self.values.width));
        vectorized!(
            for (mut values, corner) in values.outer_iter_mut().zip(cells.corners()) {
                self.values.at(corner, values.as_slice_mut().expect("row-major"));
            }
        );
        values
    }
}

/// The norm of the largest row, and the scalar products of all rows with two vectors.
#[inline(always)]
fn sizes(rows: &Array2<f64>, a: &[f64], b: &[f64]) -> (f64, Array1<f64>, Array1<f64>) {
    let (mut largest, mut of_a, mut of_b) = (0.0_f64, Vec::new(), Vec::new());
    for row in rows.outer_iter() {
        let row = row.to_slice().expect("row-major");
        largest = largest.max(dot(row, row));
        of_a.push(dot(row, a));
        of_b.push(dot(row, b));
    }
    (largest.sqrt(), of_a.into(), of_b.into())
}

/// Vectors `[vector, direction]` among `count` directions, from those in the first directions.
fn in_all_directions(vectors: &Array2<f64>, count: usize) -> Array2<f64> {
    let mut all = Array2::zeros((vectors.nrows(), count));
    all.slice_mut(s![.., ..vectors.ncols()]).assign(vectors);
    all
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
        let count = (SUPPORT_BANDS * cells.layers).min(bands.len());
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

    /// The mean PSF. `rows` are those of [`PsfSpace::rows`].
    fn mean(&self, rows: &Array2<f64>) -> Array1<f64> {
        let mut weights = vec![0.0; rows.nrows()];
        for &(node, weight) in self.0.iter().copied().flatten() {
            weights[node] += weight / self.0.len() as f64;
        }
        weights[rows.nrows() - 1] = 1.0;
        let mut mean = vec![0.0; rows.ncols()];
        vectorized!(for (&weight, row) in weights.iter().zip(rows.outer_iter()) {
            add_scaled(&mut mean, weight, row.to_slice().expect("row-major"));
        });
        Array1::from(mean)
    }

    fn covariance(&self, rows: ArrayView2<'_, f64>) -> Array2<f64> {
        let table = NodeFunctions::new(&[rows]);
        let mut values = Array2::zeros((self.0.len(), rows.ncols()));
        for (mut value, end) in values.outer_iter_mut().zip(&self.0) {
            table.at(end, value.as_slice_mut().expect("row-major"));
        }
        values.t().dot(&values)
    }
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
        Some(axis) if rows.dot(&axis).iter().all(|v| v.abs() <= no_flux) => (beside(&axis), 0),
        _ => (principal_axes(covariance), 0),
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
