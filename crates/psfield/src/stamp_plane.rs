//! Stamps in Fourier space, where they are shifted by fractions of a pixel.

use std::f64::consts::TAU;
use std::sync::Arc;

use ndarray::parallel::prelude::*;
use ndarray::{Array2, ArrayView2, s};
use psf_types::StampGrid;
use psf_types::maths::{sinc, smooth_size};
use rustfft::num_complex::Complex64;
use rustfft::{Fft, FftPlanner};

use crate::error::{ErrorKind, PsfieldError};

/// Stamp pixels around the shifted stamps, in which the interpolation between pixels fades.
const MARGIN: f64 = 8.0;

/// The most pixels of widened stamps.
const MOST_PIXELS: usize = 1 << 24;

/// The pixels by which stamps grow on either side if they are shifted by these distances in stamp
/// pixels.
pub(crate) fn margin_of(shifts: impl Iterator<Item = f64>) -> usize {
    (shifts.fold(0.0, |most: f64, shift| most.max(shift.abs())) + MARGIN).ceil() as usize
}

/// A grid with `margin` (x, y) more pixels on either side.
///
/// # Errors
/// [`ErrorKind::TooLarge`] for stamps of more than 16 million pixels.
pub(crate) fn widened(grid: StampGrid, margin: [usize; 2]) -> Result<StampGrid, PsfieldError> {
    let wide = grid.with_margins(margin)?;
    if wide.pixel_count() > MOST_PIXELS.max(grid.pixel_count()) {
        let [right, up] = margin.map(|margin| margin as f64 / grid.oversampling());
        let message = format!(
            "light is shifted by up to {right:.3e} pixels along x and {up:.3e} along y, for which PSF stamps would need more \
             than {MOST_PIXELS} pixels: check the units of the shifts"
        );
        return Err(PsfieldError::new(ErrorKind::TooLarge, message));
    }
    Ok(wide)
}

/// A shift of light along a line, with equal light at each of its points, or to one point. Shifts are along x
/// and y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Line {
    pub(crate) weight: f64,
    pub(crate) middle: [f64; 2],
    /// From the start to the end.
    pub(crate) length: [f64; 2],
}

/// Transforms of stamps of one size, with room around them for shifts.
pub(crate) struct StampPlane {
    /// Rows and columns of the stamps that come back.
    room: (usize, usize),
    /// Rows and columns of the transforms.
    size: [usize; 2],
    /// Along y and x, forward and inverse.
    steps: [[Arc<dyn Fft<f64>>; 2]; 2],
}

impl std::fmt::Debug for StampPlane {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { room, size, .. } = self;
        f.debug_struct("StampPlane")
            .field("room", room)
            .field("size", size)
            .finish_non_exhaustive()
    }
}

impl StampPlane {
    /// Room for stamps of `(ny, nx)` pixels, margins included. Transforms have a multiple of `step` rows
    /// and columns.
    pub(crate) fn new(room: (usize, usize), step: usize) -> Self {
        let mut planner = FftPlanner::new();
        let size = [room.0, room.1].map(|n| smooth_size(n, step, 5));
        let steps = size.map(|n| [planner.plan_fft_forward(n), planner.plan_fft_inverse(n)]);
        Self { room, size, steps }
    }

    /// Rows and columns of the transforms.
    pub(crate) fn shape(&self) -> [usize; 2] {
        self.size
    }

    /// The transform of one stamp or two that begin `margin` pixels (x, y) inside the plane. The second
    /// is the imaginary part.
    pub(crate) fn forward(&self, stamps: &[ArrayView2<'_, f64>], [mx, my]: [usize; 2]) -> Array2<Complex64> {
        let mut values: Array2<Complex64> = Array2::zeros(self.size);
        for (stamp, unit) in stamps.iter().zip([Complex64::ONE, Complex64::I]) {
            let (ny, nx) = stamp.dim();
            let mut part = values.slice_mut(s![my..my + ny, mx..mx + nx]);
            part.zip_mut_with(stamp, |to, &v| *to += unit * v);
        }
        self.transform(&mut values, 0);
        values
    }

    /// The stamps of a transform, with their margins: the real and the imaginary part.
    pub(crate) fn inverse(&self, mut values: Array2<Complex64>) -> [Array2<f64>; 2] {
        self.transform(&mut values, 1);
        let pixels = (self.size[0] * self.size[1]) as f64;
        let (ny, nx) = self.room;
        let stamps = values.slice(s![..ny, ..nx]);
        [stamps.mapv(|v| v.re / pixels), stamps.mapv(|v| v.im / pixels)]
    }

    /// Returns every `step`-th pixel of stamps, from the first pixel on, as a transform. The stamps are
    /// the weighted sum of some transforms, times a factor in Fourier space. Both axes of this plane must
    /// have a multiple of `step` pixels.
    pub(crate) fn thinned(
        &self,
        parts: &[(f64, &Array2<Complex64>)],
        factor: &Array2<Complex64>,
        step: usize,
    ) -> Array2<Complex64> {
        let [ny, nx] = self.size.map(|n| n / step);
        let mut thinned: Array2<Complex64> = Array2::zeros((ny, nx));
        let mut sum = vec![Complex64::ZERO; self.size[1]];
        let scale = 1.0 / (step * step) as f64;
        for (y, factor) in factor.outer_iter().enumerate() {
            sum.fill(Complex64::ZERO);
            for (weight, transform) in parts {
                let row = transform.row(y).to_slice().expect("row-major");
                sum.iter_mut().zip(row).for_each(|(sum, v)| *sum += v * weight);
            }
            let mut row = thinned.row_mut(y % ny);
            let row = row.as_slice_mut().expect("row-major");
            let factor = factor.to_slice().expect("row-major");
            for (sum, factor) in sum.chunks_exact(nx).zip(factor.chunks_exact(nx)) {
                for (to, (v, factor)) in row.iter_mut().zip(sum.iter().zip(factor)) {
                    *to += v * factor * scale;
                }
            }
        }
        thinned
    }

    /// The factor in Fourier space that shifts a stamp by several distances, or along lines, and adds up
    /// the results, `[qy, qx]`: `sum_j w_j exp(-2 pi i q m_j) sinc(q l_j)`, with the middles `m_j` and the
    /// lengths `l_j` along x and y, in stamp pixels. At the highest frequency of an even number of pixels,
    /// which is also the lowest, the factor is the mean of both, so that real stamps stay real.
    pub(crate) fn shift_factor(&self, lines: &[Line]) -> Array2<Complex64> {
        let mut factor: Array2<Complex64> = Array2::zeros(self.size);
        let [ny, nx] = self.size;
        // The exponential of a sum is the product of those of its terms.
        let turns = |n: usize, shift: f64| -> Vec<Complex64> {
            (0..n)
                .map(|k| Complex64::cis(-TAU * frequency(k, n) * shift))
                .collect()
        };
        let along =
            |n: usize, length: f64| -> Vec<f64> { (0..n).map(|k| frequency(k, n) * length).collect() };
        let is_highest = |k: usize, n: usize| 2 * k == n;
        for line in lines {
            let (xs, ys) = (turns(nx, line.middle[0]), turns(ny, line.middle[1]));
            let (phases_x, phases_y) = (along(nx, line.length[0]), along(ny, line.length[1]));
            let rows = factor.outer_iter_mut().into_par_iter();
            rows.enumerate().for_each(|(j, mut row)| {
                let weighted = line.weight * ys[j];
                let conjugate = line.weight * ys[j].conj();
                for ((i, sum), x) in row.iter_mut().enumerate().zip(&xs) {
                    let (u, v) = (phases_x[i], phases_y[j]);
                    let (plus, minus) = (sinc(u + v), || sinc(u - v));
                    *sum += match (is_highest(i, nx), is_highest(j, ny)) {
                        (false, false) => weighted * x * plus,
                        (true, false) => 0.5 * weighted * (x * plus + x.conj() * minus()),
                        (false, true) => 0.5 * x * (weighted * plus + conjugate * minus()),
                        (true, true) => {
                            (0.5 * ((weighted * x).re * plus + (conjugate * x).re * minus())).into()
                        }
                    };
                }
            });
        }
        factor
    }

    /// The factor in Fourier space of the convolution with a round Gaussian, `[qy, qx]`:
    /// `exp(-2 pi^2 sigma^2 q^2)`. `sigma` is in stamp pixels.
    pub(crate) fn gaussian_factor(&self, sigma: f64) -> Array2<f64> {
        let [ny, nx] = self.size;
        let along = |k, n| (-0.5 * (TAU * sigma * frequency(k, n)).powi(2)).exp();
        Array2::from_shape_fn(self.size, |(y, x)| along(y, ny) * along(x, nx))
    }

    fn transform(&self, values: &mut Array2<Complex64>, direction: usize) {
        // Row by row.
        self.steps[1][direction].process(values.as_slice_mut().expect("row-major"));
        let mut column = vec![Complex64::default(); self.size[0]];
        for mut of_plane in values.columns_mut() {
            column
                .iter_mut()
                .zip(&of_plane)
                .for_each(|(to, from)| *to = *from);
            self.steps[0][direction].process(&mut column);
            of_plane
                .iter_mut()
                .zip(&column)
                .for_each(|(to, from)| *to = *from);
        }
    }
}

/// The frequency of index `k` of `n`, in cycles per pixel.
fn frequency(k: usize, n: usize) -> f64 {
    let k = if 2 * k < n { k as f64 } else { k as f64 - n as f64 };
    k / n as f64
}
