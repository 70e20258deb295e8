//! A 2-D transform by realfft and rustfft, to compare with.

use std::sync::Arc;

use conv_core::ConvReal;
use realfft::{RealFftPlanner, RealToComplex};
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};

/// The number of rows whose spectra are transposed together: whole cache lines.
const BLOCK: usize = 16;

/// Computes the spectrum of a square plane, whose rows are lit up to a given one. Uses realfft along
/// these rows and rustfft along columns. The spectrum stays transposed.
pub(crate) struct RowsThenColumns<T: ConvReal> {
    size: usize,
    lit_rows: usize,
    along_rows: Arc<dyn RealToComplex<T>>,
    along_columns: Arc<dyn Fft<T>>,
    plane: Vec<T>,
    row: Vec<T>,
    /// The spectra of [`BLOCK`] rows.
    block: Vec<Complex<T>>,
    spectrum: Vec<Complex<T>>,
    scratch: Vec<Complex<T>>,
}

impl<T: ConvReal> RowsThenColumns<T> {
    pub(crate) fn new(size: usize, lit_rows: usize) -> Self {
        let along_rows = RealFftPlanner::new().plan_fft_forward(size);
        let along_columns = FftPlanner::new().plan_fft_forward(size);
        let zeros = |length: usize| vec![Complex::new(T::zero(), T::zero()); length];
        Self {
            size,
            lit_rows,
            plane: (0..size * size).map(|i| T::nearest((i % 17) as f64)).collect(),
            row: vec![T::zero(); size],
            block: zeros(BLOCK * (size / 2 + 1)),
            spectrum: zeros((size / 2 + 1) * size),
            scratch: zeros(
                along_rows
                    .get_scratch_len()
                    .max(along_columns.get_inplace_scratch_len()),
            ),
            along_rows,
            along_columns,
        }
    }

    pub(crate) fn forward(&mut self) {
        let half = self.size / 2 + 1;
        for column in self.spectrum.chunks_exact_mut(self.size) {
            column[self.lit_rows..].fill(Complex::new(T::zero(), T::zero()));
        }
        for first in (0..self.lit_rows).step_by(BLOCK) {
            for (values, into) in self.plane[first * self.size..self.lit_rows * self.size]
                .chunks_exact(self.size)
                .zip(self.block.chunks_exact_mut(half))
            {
                self.row.copy_from_slice(values);
                self.along_rows
                    .process_with_scratch(
                        &mut self.row,
                        into,
                        &mut self.scratch[..self.along_rows.get_scratch_len()],
                    )
                    .expect("buffers of the plan's size");
            }
            for (k, column) in self.spectrum.chunks_exact_mut(self.size).enumerate() {
                for (value, from) in column[first..self.lit_rows]
                    .iter_mut()
                    .zip(self.block.chunks_exact(half))
                {
                    *value = from[k];
                }
            }
        }
        for column in self.spectrum.chunks_exact_mut(self.size) {
            self.along_columns.process_with_scratch(column, &mut self.scratch);
        }
    }
}
