//! Convolutions by real two-dimensional transforms. Their spectra stay transposed.
//!
//! A plane of `rows x columns` real values has the half spectrum `[columns / 2 + 1, rows]`. So the
//! transforms along the plane's columns run over contiguous memory. No plane is ever transposed as
//! a whole, because that takes 10 to 40 % more time. Rows are read and written in blocks of
//! [`BLOCK`], so that the transposed side is accessed in whole cache lines. Rows without light are
//! never transformed.

use std::sync::Arc;

use ndarray::parallel::prelude::*;
use ndarray::{Array2, ArrayView1, ArrayView2, ArrayViewMut1, Axis, s};
use psf_types::maths::smooth_size;
use psf_types::{Cancelled, Progress};
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

/// `[columns / 2 + 1, rows]`: a column of a plane's spectrum is contiguous.
pub(crate) type Spectrum<T> = Array2<Complex<T>>;

pub(crate) struct RealFft2<'a, T: ConvReal> {
    rows: usize,
    columns: usize,
    row_forward: Arc<dyn RealToComplex<T>>,
    row_inverse: Arc<dyn ComplexToReal<T>>,
    column_forward: Arc<dyn Fft<T>>,
    column_inverse: Arc<dyn Fft<T>>,
    /// After a cancellation, transforms are skipped.
    progress: &'a dyn Progress,
}

impl<'a, T: ConvReal> RealFft2<'a, T> {
    /// Transforms of planes of at least `rows x columns`, enlarged to sizes with fast transforms.
    pub(crate) fn at_least(rows: usize, columns: usize, progress: &'a dyn Progress) -> Self {
        let (rows, columns) = (smooth_size(rows, 2, 7), smooth_size(columns, 2, 7));
        let mut real = RealFftPlanner::new();
        let mut complex = FftPlanner::new();
        Self {
            rows,
            columns,
            row_forward: real.plan_fft_forward(columns),
            row_inverse: real.plan_fft_inverse(columns),
            column_forward: complex.plan_fft_forward(rows),
            column_inverse: complex.plan_fft_inverse(rows),
            progress,
        }
    }

    /// The factor by which [`forward`](Self::forward) and [`inverse`](Self::inverse) together multiply a plane.
    pub(crate) fn gain(&self) -> f64 {
        self.rows as f64 * self.columns as f64
    }

    /// A spectrum of zeros.
    pub(crate) fn zeros(&self) -> Spectrum<T> {
        Array2::zeros((self.columns / 2 + 1, self.rows))
    }

    /// Computes the spectrum of a plane that holds light from pixel `(column, row)` on, and zeros
    /// elsewhere.
    pub(crate) fn forward(
        &self,
        light: ArrayView2<'_, T>,
        (column, row): (usize, usize),
        spectrum: &mut Spectrum<T>,
    ) {
        let columns = column..column + light.ncols();
        self.transform(spectrum, |plane_row, mut values| {
            let y = plane_row.checked_sub(row).filter(|&y| y < light.nrows());
            y.map(|y| light.row(y)).is_some_and(|line| {
                values.slice_mut(s![columns.clone()]).assign(&line);
                line.iter().any(|v| !v.is_zero())
            })
        });
    }

    /// Computes the spectrum of a stamp for cyclic convolution. The stamp's central pixel is at
    /// pixel (0, 0) of the plane, and pixels to the left or below are wrapped around. The stamp is
    /// divided by the gain of the transforms, so a convolution needs no further normalisation.
    pub(crate) fn kernel(&self, stamp: ArrayView2<'_, f64>, reach: Reach, spectrum: &mut Spectrum<T>) {
        let gain = self.rows as f64 * self.columns as f64;
        self.transform(spectrum, |row, mut values| {
            // A stamp that is larger than the plane overlaps itself. The plane is large enough that
            // the overlap does not reach the result.
            let first = (row + reach.below) % self.rows;
            for j in (first..stamp.nrows()).step_by(self.rows) {
                for (i, &value) in stamp.row(j).iter().enumerate() {
                    values[(i + self.columns - reach.left) % self.columns] += T::nearest(value / gain);
                }
            }
            first < stamp.nrows()
        });
    }

    /// Transforms a plane. `fill(row, values)` gets zeros, writes the values of the row and returns
    /// whether there are any.
    fn transform(
        &self,
        spectrum: &mut Spectrum<T>,
        fill: impl Fn(usize, ArrayViewMut1<'_, T>) -> bool + Sync,
    ) {
        let blocks = spectrum.axis_chunks_iter_mut(Axis(1), BLOCK).into_par_iter();
        let blocks = blocks.enumerate().with_min_len(self.least_per_task());
        blocks.for_each(|(block, mut target)| {
            if self.progress.cancelled() {
                return;
            }
            let mut rows = Array2::zeros((target.ncols(), self.columns));
            let mut transformed = Array2::zeros((target.ncols(), target.nrows()));
            let lines = rows.outer_iter_mut().zip(transformed.outer_iter_mut());
            for (row, (mut values, mut transformed)) in lines.enumerate() {
                if fill(block * BLOCK + row, values.view_mut()) {
                    let values = values.as_slice_mut().expect("row-major");
                    let transformed = transformed.as_slice_mut().expect("row-major");
                    self.row_forward
                        .process(values, transformed)
                        .expect("lines of the plan's lengths");
                }
            }
            target.assign(&transformed.t());
        });
        self.along_columns(spectrum, &*self.column_forward);
    }

    /// Computes the values `[y, x]` of a plane from pixel `(column, row)` on. The spectrum is
    /// overwritten. The results of [`forward`](Self::forward) and this function together are
    /// `rows * columns` times as large as the light.
    ///
    /// # Errors
    /// [`Cancelled`] if the progress object has cancelled this or an earlier step.
    pub(crate) fn inverse(
        &self,
        spectrum: &mut Spectrum<T>,
        (column, row): (usize, usize),
        shape: (usize, usize),
    ) -> Result<Array2<T>, Cancelled> {
        self.along_columns(spectrum, &*self.column_inverse);
        let mut output = Array2::zeros(shape);
        let blocks = output.axis_chunks_iter_mut(Axis(0), BLOCK).into_par_iter();
        let blocks = blocks.enumerate().with_min_len(self.least_per_task());
        blocks.for_each(|(block, mut target)| {
            if self.progress.cancelled() {
                return;
            }
            let rows = row + block * BLOCK..row + block * BLOCK + target.nrows();
            let mut lines = spectrum.slice(s![.., rows]).t().as_standard_layout().into_owned();
            let mut values = self.row_inverse.make_output_vec();
            for (mut line, mut out) in lines.outer_iter_mut().zip(target.outer_iter_mut()) {
                let line = line.as_slice_mut().expect("row-major");
                // For a real plane, these two values are real. `realfft` would reject rounding
                // errors in their imaginary parts, which are therefore set to 0.
                line[0].im = T::zero();
                line[self.columns / 2].im = T::zero();
                self.row_inverse
                    .process(line, &mut values)
                    .expect("lines of the plan's lengths");
                out.assign(&ArrayView1::from(&values[column..column + shape.1]));
            }
        });
        self.progress.check_cancelled().map(|()| output)
    }

    fn along_columns(&self, spectrum: &mut Spectrum<T>, transform: &dyn Fft<T>) {
        let columns = spectrum.axis_iter_mut(Axis(0)).into_par_iter();
        let columns = columns.with_min_len(self.least_per_task());
        columns.for_each(|mut column| {
            if !self.progress.cancelled() {
                transform.process(column.as_slice_mut().expect("row-major"));
            }
        });
    }

    /// The least number of blocks or columns that one task transforms.
    fn least_per_task(&self) -> usize {
        if self.rows * self.columns < PARALLEL_FROM {
            usize::MAX
        } else {
            1
        }
    }
}

#[cfg(test)]
mod tests {
    use psf_types::NoProgress;

    use super::*;

    /// Sizes below and above the limit for threads, with a dirty spectrum.
    #[test]
    fn a_plane_comes_back_times_the_gain() {
        for (rows, columns) in [(6, 10), (35, 18), (600, 500)] {
            let fft = RealFft2::<f64>::at_least(rows, columns, &NoProgress);
            let plane = Array2::from_shape_fn((fft.rows, fft.columns), |(y, x)| {
                ((y * 31 + x * 17) % 23) as f64 - 9.0
            });
            let mut spectrum = fft.zeros();
            spectrum.fill(Complex::new(f64::NAN, f64::NAN));
            fft.forward(plane.view(), (0, 0), &mut spectrum);
            let [row, column] = [3, 2];
            let shape = (fft.rows - row, fft.columns - column);
            let back = fft.inverse(&mut spectrum, (column, row), shape).unwrap();
            for ((y, x), value) in back.indexed_iter() {
                let gain = (fft.rows * fft.columns) as f64;
                assert!((value / gain - plane[[y + row, x + column]]).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn the_spectrum_is_the_sum_it_stands_for() {
        let fft = RealFft2::<f64>::at_least(6, 10, &NoProgress);
        // Row 1 is dark.
        let light = Array2::from_shape_fn((4, 7), |(y, x)| {
            if y == 1 {
                0.0
            } else {
                ((y * 7 + x * 5) % 11) as f64
            }
        });
        let mut spectrum = fft.zeros();
        fft.forward(light.view(), (3, 2), &mut spectrum);
        for ((kx, ky), value) in spectrum.indexed_iter() {
            let mut sum = Complex::new(0.0, 0.0);
            for ((y, x), &v) in light.indexed_iter() {
                let turns = kx as f64 * (x + 3) as f64 / 10.0 + ky as f64 * (y + 2) as f64 / 6.0;
                sum += Complex::from_polar(v, -std::f64::consts::TAU * turns);
            }
            assert!((sum - value).norm() < 1e-11, "{kx}, {ky}");
        }
    }
}
