//! A part of the field whose stars are drawn from one local basis.

use ndarray::{Array1, ArrayView1, ArrayView2};
use psf_types::{PixelRegion, PsfModel, StampGrid};

use super::phases::PhasedAxis;
use crate::ConvReal;
use crate::lowrank::internals::{Aligned, LocalModes, PsfSpace, RegionRuns};
use crate::stamp_interpolator::Kernel;

/// The local basis of a block as interpolation coefficients, by phases.
#[derive(Debug)]
pub(super) struct StarBlock<T> {
    modes: LocalModes,
    /// `[row, kernel, residue, q]`, rows and `q` in the order of the coefficients kept.
    values: Aligned<T>,
}

/// How the coefficients of a kernel's row lie.
#[derive(Debug, Clone, Copy)]
pub(super) struct RowLayout {
    /// Values from one residue to the next: a whole number of cache lines.
    pub(super) residue: usize,
    /// Values of a row of one kernel.
    pub(super) kernel: usize,
}

const CACHE_LINE: usize = 64;

impl RowLayout {
    pub(super) fn new<T>(columns: &PhasedAxis) -> Self {
        let line = CACHE_LINE / size_of::<T>();
        let residue = columns
            .kept()
            .div_ceil(columns.oversampling())
            .next_multiple_of(line);
        Self {
            residue,
            kernel: residue * columns.oversampling(),
        }
    }
}

impl<T: ConvReal> StarBlock<T> {
    /// Rows that are looked at stand for the others: every star is checked for itself.
    pub(super) fn new(
        model: &PsfModel,
        space: &PsfSpace,
        region: PixelRegion,
        [columns, rows]: &[PhasedAxis; 2],
        tolerance: f64,
    ) -> Self {
        let runs = RegionRuns::sampled(model.field(), region);
        let modes = LocalModes::new(space, &runs, tolerance);
        let layout = RowLayout::new::<T>(columns);
        let count = modes.rank() + usize::from(modes.reference().is_some());
        let mut aligned = Aligned::zeros(rows.kept() * count * layout.kernel);
        let values = aligned.get_mut();
        let modes_alone = modes.modes();
        let directions = modes.reference().into_iter().chain(modes_alone.outer_iter());
        for (kernel, direction) in directions.enumerate() {
            let coefficients = coefficients_of(space.stamps(), direction, model.grid());
            for row in 0..rows.kept() {
                let Some(j) = rows.index(row) else { continue };
                let to = &mut values[(row * count + kernel) * layout.kernel..][..layout.kernel];
                for column in 0..columns.kept() {
                    if let Some(i) = columns.index(column) {
                        let (q, residue) = (column / columns.oversampling(), column % columns.oversampling());
                        to[residue * layout.residue + q] = T::nearest(coefficients[[j, i]]);
                    }
                }
            }
        }
        Self {
            modes,
            values: aligned,
        }
    }

    pub(super) fn kernel_count(&self) -> usize {
        self.modes.rank() + usize::from(self.modes.reference().is_some())
    }

    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.values.get())
    }

    pub(super) fn values(&self) -> &[T] {
        self.values.get()
    }

    /// The kernels' coefficients for the PSF that `psf` stands for, which becomes what they leave of it.
    pub(super) fn project(&self, flux: f64, psf: &mut Array1<f64>) -> Vec<f64> {
        let mut coefficients = Vec::with_capacity(self.kernel_count());
        if let Some(reference) = self.modes.reference() {
            psf.scaled_add(-flux, &reference);
            coefficients.push(flux);
        }
        for mode in self.modes.modes().outer_iter() {
            let c = mode.dot(psf);
            psf.scaled_add(-c, &mode);
            coefficients.push(c);
        }
        coefficients
    }
}

/// The interpolation coefficients of a combination of stamps.
fn coefficients_of(
    stamps: ArrayView2<'_, f64>,
    direction: ArrayView1<'_, f64>,
    grid: StampGrid,
) -> ndarray::Array2<f64> {
    let mut values = Array1::zeros(grid.pixel_count());
    for (&a, stamp) in direction.iter().zip(stamps.outer_iter()) {
        values.scaled_add(a, &stamp);
    }
    let values = values
        .into_shape_with_order(grid.dim())
        .expect("a stamp's pixels");
    Kernel::of(grid.interpolation()).coefficients(values.view())
}
