//! PSFs of a model as vectors.

use ndarray::{Array1, Array2, ArrayView1, s};
use psf_types::PsfModel;

/// Coordinates in which the norm of a vector is the L2 norm of the PSF it stands for.
///
/// The components of a basis are orthonormal already; the mean stamp gets a direction of its own, for what the components do
/// not hold of it. A PSF of the model is `mean + sum_n w_n node_n`, with the weights of the coefficient field.
#[derive(Debug)]
pub(crate) struct PsfSpace {
    /// Orthonormal stamps, `[direction, stamp pixel]`.
    stamps: Array2<f64>,
    /// The field's nodes, `[node, direction]`.
    nodes: Array2<f64>,
    mean: Array1<f64>,
    /// The flux of each orthonormal stamp.
    fluxes: Array1<f64>,
}

/// What the components miss of the mean counts as nothing when its norm is below this part of the mean's.
const IN_SPAN: f64 = 1e-14;

impl PsfSpace {
    pub(crate) fn new(model: &PsfModel) -> Self {
        let (count, ny, nx) = model.stamps().dim();
        let flat = model
            .stamps()
            .into_shape_with_order((count, ny * nx))
            .expect("stamps are row-major");
        let first = usize::from(model.is_mean_centred());
        let components = flat.slice(s![first.., ..]);
        let rank = components.nrows();
        let values = model.field().node_values();
        // The mean's part along the components, and the rest. Twice is enough (Kahan; Parlett 1980, section 6-9).
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
        let extra = usize::from(left > IN_SPAN * whole);
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
        Self {
            stamps,
            nodes,
            mean,
            fluxes,
        }
    }

    pub(crate) fn dimension(&self) -> usize {
        self.stamps.nrows()
    }

    pub(crate) fn stamps(&self) -> ndarray::ArrayView2<'_, f64> {
        self.stamps.view()
    }

    pub(crate) fn node(&self, node: usize) -> ArrayView1<'_, f64> {
        self.nodes.row(node)
    }

    pub(crate) fn mean(&self) -> ArrayView1<'_, f64> {
        self.mean.view()
    }

    pub(crate) fn fluxes(&self) -> ArrayView1<'_, f64> {
        self.fluxes.view()
    }
}

pub(crate) fn norm(v: ArrayView1<'_, f64>) -> f64 {
    v.dot(&v).sqrt()
}
