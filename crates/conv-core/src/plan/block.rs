//! A region whose pixels share one local basis.

use std::ops::Range;
use std::sync::Arc;

use ndarray::linalg::general_mat_mul;
use ndarray::{Array2, ArrayView2, ArrayViewMut2, Axis, s};
use psf_types::PixelRegion;
use rayon::prelude::*;

use super::allowed_errors::CellError;
use super::coefficient_table::{CoefficientTable, FluxRole};
use super::local_modes::LocalModes;
use super::psf_space::PsfSpace;
use crate::ConvReal;

/// The local basis of a block, with coefficients and stamps if the plan has memory for them. The
/// kernels of a block are its reference, if it has one, and its modes.
#[derive(Debug)]
pub(crate) struct Block<T> {
    region: PixelRegion,
    /// The error with which the block's cells were made.
    error: CellError,
    modes: LocalModes,
    role: FluxRole,
    /// The flux to which the reference is scaled, from [`FluxRole::of`].
    flux: f64,
    /// The coefficients, if the plan has memory for them. Otherwise each execution computes them.
    pub(crate) table: Option<Arc<CoefficientTable<T>>>,
    /// The stamps, if the plan has memory for them.
    pub(crate) stamps: Option<Stamps<T>>,
}

/// The stamps of a block's kernels. Blocks whose stamps were computed together share an array.
#[derive(Debug, Clone)]
pub(crate) struct Stamps<T> {
    /// `[kernel, stamp pixel]`.
    shared: Arc<Array2<T>>,
    /// The rows of the block's kernels.
    rows: Range<usize>,
}

/// The number of pixels of stamps that are computed together.
const PIXELS_PER_PRODUCT: usize = 256;

impl<T: ConvReal> Stamps<T> {
    /// `[kernel, y, x]`.
    pub(crate) fn values(&self) -> &[T] {
        let width = self.shared.ncols();
        let all = self.shared.as_slice().expect("row-major");
        &all[self.rows.start * width..self.rows.end * width]
    }
}

impl<T: ConvReal> Block<T> {
    /// Computes the modes of a block, and its coefficients if `keep_table` is true.
    pub(crate) fn new(space: &PsfSpace, region: PixelRegion, tolerance: f64, keep_table: bool) -> Self {
        let (cells, error, modes) = LocalModes::of_region(space, region, tolerance);
        let values = modes.at_corners(&cells);
        let (role, flux) = FluxRole::of(space.model(), &modes, &values);
        let table = keep_table.then(|| Arc::new(CoefficientTable::new(region, role, values, &cells)));
        Self {
            region,
            error,
            modes,
            role,
            flux,
            table,
            stamps: None,
        }
    }

    /// The pixels of the block, in field positions.
    pub(crate) fn region(&self) -> PixelRegion {
        self.region
    }

    /// The number of kernels: the modes, plus 1 if there is a reference.
    pub(crate) fn kernel_count(&self) -> usize {
        self.modes.kernel_count()
    }

    pub(crate) fn table_bytes(&self) -> usize {
        self.table.as_ref().map_or(0, |table| table.bytes())
    }

    pub(crate) fn stamp_bytes(&self) -> usize {
        self.stamps
            .as_ref()
            .map_or(0, |stamps| size_of_val(stamps.values()))
    }

    /// The coefficients, stored or computed now.
    pub(crate) fn table_or_new(&self, space: &PsfSpace) -> Arc<CoefficientTable<T>> {
        self.table.clone().unwrap_or_else(|| {
            let cells = space.cells(self.region, self.error);
            let values = self.modes.at_corners(&cells);
            Arc::new(CoefficientTable::new(self.region, self.role, values, &cells))
        })
    }

    /// The kernels' stamps, stored or computed now.
    pub(crate) fn stamps_or_new(&self, space: &PsfSpace) -> Stamps<T> {
        self.stamps.clone().unwrap_or_else(|| {
            let made = stamps_of(space, &[self], false).pop();
            made.expect("the stamps of one block")
        })
    }

    /// The kernels as vectors `[kernel, direction]` in a [`PsfSpace`]: the reference, if there is
    /// one, then the modes.
    pub(crate) fn directions(&self) -> Array2<f64> {
        let mut kernels = self.modes.kernels();
        if self.modes.reference().is_some() {
            kernels.row_mut(0).mapv_inplace(|v| self.flux * v);
        }
        kernels
    }
}

/// Computes the kernels' stamps of several blocks, on all threads if `in_parallel` is true. Modes
/// beside a reference hold only small differences of PSFs, in the first directions. Their product is
/// in the precision of the stamps. The product for references is in f64: in f32, the rounding of a
/// PSF's core would hide faint wings.
pub(crate) fn stamps_of<T: ConvReal>(
    space: &PsfSpace,
    blocks: &[&Block<T>],
    in_parallel: bool,
) -> Vec<Stamps<T>> {
    let directions: Vec<Array2<f64>> = blocks.iter().map(|block| block.directions()).collect();
    let views: Vec<ArrayView2<'_, f64>> = directions.iter().map(|directions| directions.view()).collect();
    let all = ndarray::concatenate(Axis(0), &views).expect("equally many directions");
    let mut exact = Vec::new();
    let mut end = 0;
    let mut rows = Vec::with_capacity(blocks.len());
    for block in blocks {
        let first = end;
        end += block.kernel_count();
        let has_reference = block.modes.reference().is_some();
        exact.extend(first..if has_reference { first + 1 } else { end });
        rows.push(first..end);
    }
    let held = blocks.iter().map(|block| block.modes.directions).max();
    let held = held.unwrap_or(0);
    let of_exact = all.select(Axis(0), &exact);
    let of_modes = all.slice(s![.., ..held]).mapv(T::nearest);
    let mut shared = Array2::zeros((all.nrows(), space.pixel_count()));
    let product = |(i, mut part): (usize, ArrayViewMut2<'_, T>)| {
        let first = i * PIXELS_PER_PRODUCT;
        let pixels = first..first + part.ncols();
        let of_held = space.first_stamps(held, pixels.clone());
        general_mat_mul(T::one(), &of_modes, &of_held, T::zero(), &mut part);
        for (&kernel, stamp) in exact.iter().zip(space.stamps_of(&of_exact, pixels).outer_iter()) {
            part.row_mut(kernel).assign(&stamp.mapv(T::nearest));
        }
    };
    let parts = shared.axis_chunks_iter_mut(Axis(1), PIXELS_PER_PRODUCT);
    if in_parallel {
        parts.into_par_iter().enumerate().for_each(product);
    } else {
        parts.into_iter().enumerate().for_each(product);
    }
    let shared = Arc::new(shared);
    let of_block = |rows| Stamps {
        shared: Arc::clone(&shared),
        rows,
    };
    rows.into_iter().map(of_block).collect()
}
