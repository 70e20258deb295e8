//! From the pupil to the stamp: two Fourier transforms give the optical transfer function, and a
//! third transform gives the stamp.

use std::sync::{Arc, Mutex};

use ndarray::ArrayViewMut2;
use psf_types::maths::smooth_size;
use rustfft::num_complex::Complex64;
use rustfft::{Fft, FftPlanner};

use crate::pupil::PupilCells;
use crate::wavefront::{PupilPolynomial, PupilRowPolynomial, PupilRowValues};

/// Number of columns that are copied out of the rows together: 16 complex numbers are four cache
/// lines.
const BLOCK: usize = 16;

/// The data for the transforms of one telescope. They do not depend on the field position.
///
/// A pupil cell is `lambda / (M step)` wide. Here `step` is the stamp's pixel size and `M` the
/// period of the computed focal plane in stamp pixels. Lag `k` of the pupil's autocorrelation then
/// is the spatial frequency `k / M` cycles per stamp pixel. The inverse transform then gives values
/// exactly at the stamp's pixels, for any ratio of pixel size to lambda / D.
pub(crate) struct FocalPlane {
    pupil: PupilCells,
    /// Length of the transforms: long enough that the autocorrelation does not wrap around at the
    /// lags in use.
    length: usize,
    /// Highest lag in use.
    lags: usize,
    /// Width of the computed focal plane in stamp pixels.
    pub(crate) period: usize,
    forward: Arc<dyn Fft<f64>>,
    inverse: Arc<dyn Fft<f64>>,
    /// `1 / sinc^2(m / length)` along an axis of the focal plane, for the index `m` counted from
    /// the centre. It corrects for the averaging of the amplitude over a pupil cell.
    cell_correction: Vec<f64>,
    /// Transfer function of the seeing at the lags `[ky][kx]`, each from 0 to `lags`.
    seeing: Option<Vec<f64>>,
    scratch: Mutex<Vec<FocalScratch>>,
}

/// Transfer function along one axis at the lags 0 to `lags`: pixel, detector blur, and the phase
/// for the position of the source on the stamp.
pub(crate) struct AxisTransfer(pub(crate) Vec<Complex64>);

impl std::fmt::Debug for FocalPlane {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FocalPlane")
            .field("pupil_side", &self.pupil.side)
            .field("length", &self.length)
            .field("lags", &self.lags)
            .field("period", &self.period)
            .finish_non_exhaustive()
    }
}

impl FocalPlane {
    /// The length of the transforms for a pupil of `side` cells and lags up to `lags`.
    pub(crate) fn transform_length(side: usize, lags: usize) -> usize {
        smooth_size(side + lags, 2, 7)
    }

    pub(crate) fn new(pupil: PupilCells, lags: usize, period: usize, seeing: Option<Vec<f64>>) -> Self {
        let length = Self::transform_length(pupil.side, lags);
        let mut planner = FftPlanner::new();
        let cell_correction = (0..length)
            .map(|m| {
                let signed = m.min(length - m) as f64 / length as f64;
                psf_types::maths::sinc(signed).powi(-2)
            })
            .collect();
        Self {
            forward: planner.plan_fft_forward(length),
            inverse: planner.plan_fft_inverse(period),
            pupil,
            length,
            lags,
            period,
            cell_correction,
            seeing,
            scratch: Mutex::new(Vec::new()),
        }
    }

    /// Draws the stamp of a pupil phase. The PSF is scaled to a mean of `gain` over the computed
    /// focal plane.
    ///
    /// Returns the steepest phase gradient in radians per cell. If it exceeds pi, the stamp is not
    /// drawn.
    pub(crate) fn draw(
        &self,
        phase: &PupilPolynomial,
        (transfer_x, transfer_y): (&AxisTransfer, &AxisTransfer),
        gain: f64,
        stamp: ArrayViewMut2<'_, f64>,
    ) -> f64 {
        let pooled = self.scratch.lock().ok().and_then(|mut pool| pool.pop());
        let mut scratch = pooled.unwrap_or_else(|| self.new_scratch());
        let steepest = scratch.fill_amplitude(&self.pupil, phase, self.length);
        if steepest <= std::f64::consts::PI {
            self.transform_rows(&mut scratch);
            self.correlate_columns(&mut scratch);
            self.fold(&mut scratch, transfer_x, transfer_y);
            let norm = gain / (self.pupil.lit_cells * (self.length * self.length) as f64);
            self.transform_back(&mut scratch, norm, stamp);
        }
        if let Ok(mut pool) = self.scratch.lock() {
            pool.push(scratch);
        }
        steepest
    }

    fn new_scratch(&self) -> FocalScratch {
        let zeros = |n: usize| vec![Complex64::ZERO; n];
        let fft = self
            .forward
            .get_inplace_scratch_len()
            .max(self.inverse.get_inplace_scratch_len());
        FocalScratch {
            amplitude: zeros(self.pupil.side * self.length),
            block: zeros((BLOCK * self.length).max(self.period)),
            lags: zeros((self.lags + 1) * self.length),
            folded: zeros(self.period * self.period),
            fft: zeros(fft),
            row: PupilRowPolynomial::default(),
            values: PupilRowValues::default(),
            coverage: Vec::new(),
        }
    }

    /// Transforms each row of the pupil along x. The index in a row then is a focal-plane column.
    /// Rows beyond the pupil's grid are zero. They are neither stored nor transformed.
    fn transform_rows(&self, s: &mut FocalScratch) {
        for row in s.amplitude.chunks_exact_mut(self.length) {
            self.forward.process_with_scratch(row, &mut s.fft);
        }
    }

    /// Transforms each column along y and squares the modulus of the amplitude, which gives the
    /// intensity. Then transforms the intensity along y, which gives the lags of the pupil's
    /// autocorrelation. Two real columns share one complex transform.
    fn correlate_columns(&self, s: &mut FocalScratch) {
        let (n, side) = (self.length, self.pupil.side);
        for first in (0..n).step_by(BLOCK) {
            let width = BLOCK.min(n - first);
            s.block.fill(Complex64::ZERO);
            for (y, row) in s.amplitude.chunks_exact(n).enumerate().take(side) {
                for (c, &value) in row[first..first + width].iter().enumerate() {
                    s.block[c * n + y] = value;
                }
            }
            for pair in (0..width).step_by(2) {
                let columns = &mut s.block[pair * n..(pair + 2) * n];
                self.forward.process_with_scratch(columns, &mut s.fft);
                let (left, right) = columns.split_at_mut(n);
                let [cx, dx] = [0, 1].map(|i| self.cell_correction[first + pair + i]);
                for ((l, r), cy) in left.iter_mut().zip(right).zip(&self.cell_correction) {
                    *l = Complex64::new(l.norm_sqr() * cx * cy, r.norm_sqr() * dx * cy);
                }
                self.forward.process_with_scratch(left, &mut s.fft);
                for k in 0..=self.lags {
                    let (z, mirrored) = (left[k], left[(n - k) % n].conj());
                    let at = k * n + first + pair;
                    s.lags[at] = (z + mirrored) * 0.5;
                    s.lags[at + 1] = (z - mirrored) * Complex64::new(0.0, -0.5);
                }
            }
        }
    }

    /// Transforms each row of lags along x, which gives the pupil's transfer function. Multiplies
    /// this by the other transfer functions and folds the product onto the period.
    fn fold(&self, s: &mut FocalScratch, x: &AxisTransfer, y: &AxisTransfer) {
        let (n, m, top) = (self.length, self.period, self.lags);
        s.folded.fill(Complex64::ZERO);
        for ky in 0..=top {
            let row = &mut s.lags[ky * n..(ky + 1) * n];
            self.forward.process_with_scratch(row, &mut s.fft);
            let target = &mut s.folded[ky % m * m..(ky % m + 1) * m];
            // Row -ky is not computed: its part of the stamp is the complex conjugate of row ky's.
            // Row ky counts twice instead, because only the real part of the stamp is used.
            let weight = y.0[ky] * if ky == 0 { 1.0 } else { 2.0 };
            let reach = ((top * top - ky * ky) as f64).sqrt() as usize;
            let seeing = |kx: usize| self.seeing.as_ref().map_or(1.0, |t| t[ky * (top + 1) + kx]);
            for kx in 0..=reach {
                target[kx % m] += row[kx] * x.0[kx] * weight * seeing(kx);
            }
            for kx in 1..=reach {
                target[(m - kx % m) % m] += row[n - kx] * x.0[kx].conj() * weight * seeing(kx);
            }
        }
    }

    fn transform_back(&self, s: &mut FocalScratch, norm: f64, mut stamp: ArrayViewMut2<'_, f64>) {
        let m = self.period;
        for row in s.folded.chunks_exact_mut(m) {
            self.inverse.process_with_scratch(row, &mut s.fft);
        }
        for (x, mut values) in stamp.columns_mut().into_iter().enumerate() {
            let column = &mut s.block[..m];
            for (value, row) in column.iter_mut().zip(s.folded.chunks_exact(m)) {
                *value = row[x];
            }
            self.inverse.process_with_scratch(column, &mut s.fft);
            for (value, z) in values.iter_mut().zip(column) {
                *value = z.re * norm;
            }
        }
    }
}

/// Buffers. Every call of `draw` overwrites them before it reads them, so old content does not
/// matter.
#[derive(Debug)]
struct FocalScratch {
    /// Pupil rows `[row][length]`, then their transforms.
    amplitude: Vec<Complex64>,
    /// A block of columns, `[column][length]`.
    block: Vec<Complex64>,
    /// Lags in y: `[lag][length]`.
    lags: Vec<Complex64>,
    /// The transfer function folded onto the period, `[period][period]`, then its transform.
    folded: Vec<Complex64>,
    /// Scratch of the transforms.
    fft: Vec<Complex64>,
    row: PupilRowPolynomial,
    values: PupilRowValues,
    coverage: Vec<f64>,
}

impl FocalScratch {
    /// Writes the amplitude of every cell: the mean over the cell of `P exp(i phase)`, where `P` is
    /// 1 on the lit part and 0 elsewhere. The phase is taken as linear within the cell. Returns the
    /// steepest gradient along an axis in radians per cell.
    fn fill_amplitude(&mut self, pupil: &PupilCells, phase: &PupilPolynomial, length: usize) -> f64 {
        if !phase.is_finite() {
            return f64::INFINITY;
        }
        self.amplitude.fill(Complex64::ZERO);
        let mut steepest = 0f64;
        for row in &pupil.rows {
            phase.at_y(pupil.y(row), &mut self.row);
            self.row.evaluate(pupil.x(row), &mut self.values);
            let v = &mut self.values;
            self.coverage.clear();
            self.coverage.resize(row.columns.len(), 1.0);
            for grey in pupil.grey(row) {
                let i = grey.column - row.columns.start;
                self.coverage[i] = grey.coverage;
                v.value[i] += grey.dx * v.dx[i] + grey.dy * v.dy[i];
            }
            let start = row.row * length + row.columns.start;
            let target = &mut self.amplitude[start..start + row.columns.len()];
            let gradients = v.dx.iter().zip(&v.dy);
            for (((a, &coverage), &phase), (&dx, &dy)) in
                target.iter_mut().zip(&self.coverage).zip(&v.value).zip(gradients)
            {
                if coverage > 0.0 {
                    let (gx, gy) = (dx * pupil.cell, dy * pupil.cell);
                    steepest = steepest.max(gx.abs()).max(gy.abs());
                    let (sin, cos) = phase.sin_cos();
                    let mean = coverage * mean_over_cell(gx) * mean_over_cell(gy);
                    *a = Complex64::new(mean * cos, mean * sin);
                }
            }
        }
        steepest
    }
}

/// The mean of `exp(i g t)` over `-1/2 <= t <= 1/2`, which is `sin(g/2) / (g/2)`, by its series.
/// The error is below 2.3e-6 for `|g| <= pi`.
fn mean_over_cell(g: f64) -> f64 {
    let z2 = g * g / 4.0;
    1.0 - z2 / 6.0 * (1.0 - z2 / 20.0 * (1.0 - z2 / 42.0 * (1.0 - z2 / 72.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_over_a_cell() {
        for g in [-3.1, -1.0, 1e-3, 0.5, 2.0, 3.13] {
            let exact = (g / 2.0f64).sin() / (g / 2.0);
            assert!((mean_over_cell(g) - exact).abs() < 3e-6, "{g}");
        }
    }
}
