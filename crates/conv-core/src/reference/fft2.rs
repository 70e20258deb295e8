//! Real two-dimensional transforms. Their spectra stay transposed.
//!
//! A plane of `rows x columns` real values has the half spectrum `[columns / 2 + 1, rows]`. So the
//! transforms along the plane's columns run over contiguous memory. No plane is ever transposed as
//! a whole, because that takes 10 to 40 % more time. Rows are read and written in blocks of
//! [`BLOCK`], so that the transposed side is accessed in whole cache lines. Rows without light are
//! never transformed. Nothing is normalised: a forward and an inverse transform together multiply a
//! plane by `rows * columns`.

use std::sync::Arc;

use ndarray::parallel::prelude::*;
use ndarray::{Array2, ArrayView2, ArrayViewMut2, Axis};
use rayon::slice::ParallelSliceMut;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};

use crate::ConvReal;
use crate::view::Reach;

/// The number of rows processed together: 16 complex values are two to four cache lines.
const BLOCK: usize = 16;
/// Planes with fewer values are transformed on one thread, because the caller processes many such
/// planes in parallel.
const PARALLEL_FROM: usize = 1 << 18;

pub(crate) struct RealFft2<T: ConvReal> {
    pub(crate) rows: usize,
    pub(crate) columns: usize,
    row_forward: Arc<dyn RealToComplex<T>>,
    row_inverse: Arc<dyn ComplexToReal<T>>,
    column_forward: Arc<dyn Fft<T>>,
    column_inverse: Arc<dyn Fft<T>>,
}

/// A block of rows being read or written, and the buffers for transforms of single rows.
struct Block<T> {
    real: Vec<T>,
    /// The half spectra of [`BLOCK`] rows, one after the other.
    rows: Vec<Complex<T>>,
    scratch: Vec<Complex<T>>,
}

/// One column of the spectrum and the buffers that its transforms need.
pub(crate) struct Column<'a, T> {
    pub(crate) index: usize,
    pub(crate) values: &'a mut [Complex<T>],
    /// Two buffers, each as long as `values`. Their content is undefined.
    pub(crate) spare: [&'a mut [Complex<T>]; 2],
    /// Buffer for the transforms. The content is undefined.
    pub(crate) scratch: &'a mut [Complex<T>],
}

impl<T: ConvReal> RealFft2<T> {
    /// Transforms of planes of at least `rows x columns`, enlarged to sizes with fast transforms.
    pub(crate) fn at_least(rows: usize, columns: usize) -> Self {
        let (rows, columns) = (fast_size(rows), fast_size(columns));
        let mut real = RealFftPlanner::new();
        let mut complex = FftPlanner::new();
        Self {
            rows,
            columns,
            row_forward: real.plan_fft_forward(columns),
            row_inverse: real.plan_fft_inverse(columns),
            column_forward: complex.plan_fft_forward(rows),
            column_inverse: complex.plan_fft_inverse(rows),
        }
    }

    /// The factor by which a forward and an inverse transform multiply a plane.
    pub(crate) fn gain(&self) -> f64 {
        self.rows as f64 * self.columns as f64
    }

    /// A spectrum `[columns / 2 + 1, rows]` of zeros.
    pub(crate) fn spectrum(&self) -> Array2<Complex<T>> {
        Array2::zeros((self.columns / 2 + 1, self.rows))
    }

    pub(crate) fn forward(&self, column: &mut [Complex<T>], scratch: &mut [Complex<T>]) {
        self.column_forward.process_with_scratch(
            column,
            &mut scratch[..self.column_forward.get_inplace_scratch_len()],
        );
    }

    pub(crate) fn inverse(&self, column: &mut [Complex<T>], scratch: &mut [Complex<T>]) {
        self.column_inverse.process_with_scratch(
            column,
            &mut scratch[..self.column_inverse.get_inplace_scratch_len()],
        );
    }

    /// Transforms rows into the spectrum. `fill(row, values)` gets zeros, writes the light of the
    /// row into them and returns whether the row has any light. The transforms of the columns are
    /// not done here.
    pub(crate) fn rows_forward(
        &self,
        spectrum: &mut Array2<Complex<T>>,
        fill: impl Fn(usize, &mut [T]) -> bool + Send + Sync,
    ) {
        let half = self.columns / 2 + 1;
        let zero = Complex::new(T::zero(), T::zero());
        let buffers = || self.block(self.row_forward.get_scratch_len());
        let work = |Block { real, rows, scratch }: &mut Block<T>,
                    block: usize,
                    mut target: ArrayViewMut2<'_, Complex<T>>| {
            let mut lit = false;
            for (row, transformed) in rows.chunks_exact_mut(half).take(target.ncols()).enumerate() {
                real.fill(T::zero());
                if fill(block * BLOCK + row, real) {
                    lit = true;
                    self.row_forward
                        .process_with_scratch(real, transformed, scratch)
                        .expect("buffers of the plan's size");
                } else {
                    transformed.fill(zero);
                }
            }
            if lit {
                for (column, mut values) in target.outer_iter_mut().enumerate() {
                    for (row, value) in values.iter_mut().enumerate() {
                        *value = rows[row * half + column];
                    }
                }
            } else {
                target.fill(zero);
            }
        };
        self.for_blocks(spectrum.view_mut(), Axis(1), buffers, work);
    }

    /// Calls `work` with each block of [`BLOCK`] neighbouring rows (axis 0) or columns (axis 1) of
    /// an array, on many threads if the plane is large.
    fn for_blocks<E: Send + Sync>(
        &self,
        mut array: ArrayViewMut2<'_, E>,
        axis: Axis,
        buffers: impl Fn() -> Block<T> + Send + Sync,
        work: impl Fn(&mut Block<T>, usize, ArrayViewMut2<'_, E>) + Send + Sync,
    ) {
        if self.rows * self.columns < PARALLEL_FROM {
            let mut buffers = buffers();
            for (block, lanes) in array.axis_chunks_iter_mut(axis, BLOCK).enumerate() {
                work(&mut buffers, block, lanes);
            }
        } else {
            let blocks = array
                .axis_chunks_iter_mut(axis, BLOCK)
                .into_par_iter()
                .enumerate();
            blocks.for_each_init(buffers, |buffers, (block, lanes)| work(buffers, block, lanes));
        }
    }

    fn block(&self, scratch_len: usize) -> Block<T> {
        let zero = Complex::new(T::zero(), T::zero());
        Block {
            real: vec![T::zero(); self.columns],
            rows: vec![zero; (self.columns / 2 + 1) * BLOCK],
            scratch: vec![zero; scratch_len],
        }
    }

    /// Calls `work` on every column of the spectrum.
    pub(crate) fn for_columns(
        &self,
        spectrum: &mut Array2<Complex<T>>,
        work: impl Fn(Column<'_, T>) + Send + Sync,
    ) {
        let scratch_len = self
            .column_forward
            .get_inplace_scratch_len()
            .max(self.column_inverse.get_inplace_scratch_len());
        let zero = Complex::new(T::zero(), T::zero());
        let buffers = || (vec![zero; 2 * self.rows], vec![zero; scratch_len]);
        let rows = self.rows;
        let one = |(spare, scratch): &mut (Vec<_>, Vec<_>), (index, values)| {
            let (first, second) = spare.split_at_mut(rows);
            work(Column {
                index,
                values,
                spare: [first, second],
                scratch,
            });
        };
        let values = spectrum.as_slice_mut().expect("spectra are row-major");
        if self.rows * self.columns < PARALLEL_FROM {
            let mut buffers = buffers();
            let columns = values.chunks_exact_mut(rows).enumerate();
            columns.for_each(|column| one(&mut buffers, column));
        } else {
            let columns = values.par_chunks_exact_mut(rows).enumerate();
            columns.for_each_init(buffers, one);
        }
    }

    /// Transforms rows `first_row ..` back from a spectrum whose columns are already transformed
    /// back. `store(row, out, values)` gets a full row of the plane in `values`. It writes or adds
    /// the values that it needs to `out`, which is row `row` of `output`.
    pub(crate) fn rows_inverse(
        &self,
        spectrum: &Array2<Complex<T>>,
        first_row: usize,
        output: ArrayViewMut2<'_, T>,
        store: impl Fn(usize, &mut [T], &[T]) + Send + Sync,
    ) {
        let half = self.columns / 2 + 1;
        let buffers = || self.block(self.row_inverse.get_scratch_len());
        let work =
            |Block { real, rows, scratch }: &mut Block<T>, block: usize, mut target: ArrayViewMut2<'_, T>| {
                let first = block * BLOCK;
                for (column, values) in spectrum.outer_iter().enumerate() {
                    let values = &values.to_slice().expect("spectra are row-major")[first_row + first..];
                    for (row, &value) in values.iter().take(target.nrows()).enumerate() {
                        rows[row * half + column] = value;
                    }
                }
                for (row, mut out) in target.outer_iter_mut().enumerate() {
                    let transformed = &mut rows[row * half..(row + 1) * half];
                    // For a real plane, these two values are real. `realfft` would reject rounding
                    // errors in their imaginary parts, which are therefore set to 0.
                    transformed[0].im = T::zero();
                    if self.columns.is_multiple_of(2) {
                        transformed[half - 1].im = T::zero();
                    }
                    self.row_inverse
                        .process_with_scratch(transformed, real, scratch)
                        .expect("buffers of the plan's size");
                    store(
                        first + row,
                        out.as_slice_mut().expect("rows of the output are contiguous"),
                        real,
                    );
                }
            };
        self.for_blocks(output, Axis(0), buffers, work);
    }
}

/// The smallest even size of at least `n` with no prime factor above 7.
fn fast_size(n: usize) -> usize {
    let smooth = |mut m: usize| {
        for p in [2, 3, 5, 7] {
            while m.is_multiple_of(p) {
                m /= p;
            }
        }
        m == 1
    };
    let mut size = n.max(2).next_multiple_of(2);
    while !smooth(size) {
        size += 2;
    }
    size
}

/// The row transforms of a stamp laid out for circular convolution: its central pixel is at index
/// (0, 0), and pixels to the left or below are wrapped around. Only the stamp's own rows are
/// stored, because all other rows are zero. The columns are transformed when they are needed.
pub(crate) struct KernelRows<T> {
    /// `[spectral column, stamp row]`.
    transformed: Array2<Complex<T>>,
    below: usize,
}

impl<T: ConvReal> KernelRows<T> {
    /// The transforms of `stamp / fft.gain()`, so that a convolution needs no further
    /// normalisation.
    pub(crate) fn new(fft: &RealFft2<T>, stamp: ArrayView2<'_, f64>, reach: Reach) -> Self {
        let columns = fft.columns;
        let mut transformed = Array2::zeros((columns / 2 + 1, stamp.nrows()));
        fft.rows_forward(&mut transformed, |row, values| {
            for (i, &value) in stamp.row(row).iter().enumerate() {
                // A stamp that is wider than the plane overlaps itself. The plane is large enough
                // that the overlap does not reach the result.
                values[(i + columns - reach.left) % columns] += T::nearest(value / fft.gain());
            }
            true
        });
        Self {
            transformed,
            below: reach.below,
        }
    }

    /// Writes column `index` of the stamp's spectrum.
    pub(crate) fn column_into(
        &self,
        fft: &RealFft2<T>,
        index: usize,
        column: &mut [Complex<T>],
        scratch: &mut [Complex<T>],
    ) {
        let rows = fft.rows;
        column.fill(Complex::new(T::zero(), T::zero()));
        for (j, &value) in self.transformed.row(index).iter().enumerate() {
            column[(j + rows - self.below) % rows] += value;
        }
        fft.forward(column, scratch);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fast_sizes_are_the_smallest_smooth_ones() {
        for (n, size) in [
            (1, 2),
            (2, 2),
            (11, 12),
            (97, 98),
            (1055, 1080),
            (2079, 2100),
            (9248, 9408),
        ] {
            assert_eq!(fast_size(n), size, "{n}");
        }
    }

    /// Sizes below and above the limit for threads, with dirty buffers.
    #[test]
    fn a_plane_comes_back_times_the_gain() {
        for (rows, columns) in [(6, 10), (35, 18), (600, 500)] {
            let fft = RealFft2::<f64>::at_least(rows, columns);
            let plane = Array2::from_shape_fn((fft.rows, fft.columns), |(y, x)| {
                ((y * 31 + x * 17) % 23) as f64 - 9.0
            });
            let mut spectrum = fft.spectrum();
            spectrum.fill(Complex::new(f64::NAN, f64::NAN));
            fft.rows_forward(&mut spectrum, |row, values| {
                values.copy_from_slice(plane.row(row).to_slice().unwrap());
                true
            });
            fft.for_columns(&mut spectrum, |c| {
                for spare in c.spare {
                    spare.fill(Complex::new(f64::NAN, f64::NAN));
                }
                c.scratch.fill(Complex::new(f64::NAN, f64::NAN));
                fft.forward(c.values, c.scratch);
                c.scratch.fill(Complex::new(f64::NAN, f64::NAN));
                fft.inverse(c.values, c.scratch);
            });
            let first = 3;
            let mut back = Array2::from_elem((fft.rows - first, fft.columns), f64::NAN);
            fft.rows_inverse(&spectrum, first, back.view_mut(), |_, out, values| {
                out.copy_from_slice(values);
            });
            for ((y, x), value) in back.indexed_iter() {
                assert!((value / fft.gain() - plane[[y + first, x]]).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn the_spectrum_is_the_sum_it_stands_for() {
        let fft = RealFft2::<f64>::at_least(6, 10);
        let plane = Array2::from_shape_fn((6, 10), |(y, x)| ((y * 7 + x * 5) % 11) as f64);
        let mut spectrum = fft.spectrum();
        // Row 4 is dark.
        fft.rows_forward(&mut spectrum, |row, values| {
            values.copy_from_slice(plane.row(row).to_slice().unwrap());
            row != 4
        });
        fft.for_columns(&mut spectrum, |c| fft.forward(c.values, c.scratch));
        for ((kx, ky), value) in spectrum.indexed_iter() {
            let mut sum = Complex::new(0.0, 0.0);
            for ((y, x), &v) in plane.indexed_iter().filter(|((y, _), _)| *y != 4) {
                let phase =
                    -std::f64::consts::TAU * (kx as f64 * x as f64 / 10.0 + ky as f64 * y as f64 / 6.0);
                sum += Complex::from_polar(v, phase);
            }
            assert!((sum - value).norm() < 1e-11, "{kx}, {ky}");
        }
    }
}
