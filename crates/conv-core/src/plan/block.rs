//! A region whose pixels share one local basis.

use std::ops::Range;
use std::sync::Arc;

use ndarray::{Array2, ArrayView2, Axis, s};
use psf_types::{PixelRegion, PsfModel};

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
const PIXELS_PER_PRODUCT: usize = 512;

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
    pub(crate) fn new(
        model: &PsfModel,
        space: &PsfSpace,
        region: PixelRegion,
        tolerance: f64,
        keep_table: bool,
    ) -> Self {
        let (cells, error, modes) = LocalModes::of_region(space, region, tolerance);
        let values = modes.at_corners(&cells);
        let (role, flux) = FluxRole::of(model, &modes, &values);
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
            let made = stamps_of(space, &[self]).pop();
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

/// Computes the kernels' stamps of several blocks by matrix products. The product for references is in
/// f64: in f32, the rounding of a PSF's core would hide faint wings. Modes beside a reference hold only
/// small differences of PSFs.
pub(crate) fn stamps_of<T: ConvReal>(space: &PsfSpace, blocks: &[&Block<T>]) -> Vec<Stamps<T>> {
    let directions: Vec<Array2<f64>> = blocks.iter().map(|block| block.directions()).collect();
    // The blocks' kernels in f64 and the others, each list block by block.
    let parts = blocks.iter().zip(&directions).map(|(block, directions)| {
        let exact = if block.modes.reference().is_some() {
            1
        } else {
            directions.nrows()
        };
        directions.view().split_at(Axis(0), exact)
    });
    let (exact, rounded): (Vec<_>, Vec<_>) = parts.unzip();
    let joined = |parts: &[ArrayView2<'_, f64>]| {
        ndarray::concatenate(Axis(0), parts).expect("equally many directions")
    };
    let (of_exact, of_rounded) = (joined(&exact), joined(&rounded).mapv(T::nearest));
    let width = space.pixel_count();
    let mut shared = Array2::zeros((of_exact.nrows() + of_rounded.nrows(), width));
    // Products of few pixels stay in the caches until they are put in place.
    for first in (0..width).step_by(PIXELS_PER_PRODUCT) {
        let pixels = first..(first + PIXELS_PER_PRODUCT).min(width);
        let stamps = space.pixels_of_stamps(pixels.clone());
        let from_exact = of_exact.dot(&stamps).mapv(T::nearest);
        let from_rounded = of_rounded.dot(&stamps.mapv(T::nearest));
        let mut part = shared.slice_mut(s![.., pixels]);
        let mut kernels = part.outer_iter_mut();
        let (mut from_exact, mut from_rounded) = (from_exact.outer_iter(), from_rounded.outer_iter());
        for (exact, rounded) in exact.iter().zip(&rounded) {
            let of_block = from_exact.by_ref().take(exact.nrows());
            let of_block = of_block.chain(from_rounded.by_ref().take(rounded.nrows()));
            of_block
                .zip(kernels.by_ref())
                .for_each(|(made, mut kernel)| kernel.assign(&made));
        }
    }
    let shared = Arc::new(shared);
    let mut end = 0;
    let rows = directions.iter().map(|directions| {
        end += directions.nrows();
        end - directions.nrows()..end
    });
    let of_block = |rows| Stamps {
        shared: Arc::clone(&shared),
        rows,
    };
    rows.map(of_block).collect()
}
