//! From the pupil to the stamp: two transforms to the optical transfer function, one back.

use std::sync::{Arc, Mutex};

use ndarray::ArrayViewMut2;
use rustfft::num_complex::Complex64;
use rustfft::{Fft, FftPlanner};

use crate::fft_size::even_smooth_at_least;
use crate::focal_scratch::FocalScratch;
use crate::pupil_cells::PupilCells;
use crate::pupil_polynomial::PupilPolynomial;

/// Columns that pass through a transform together: 16 complex numbers are four cache lines.
const BLOCK: usize = 16;

/// Everything about the transforms of one telescope that does not depend on the field position.
///
/// A pupil cell is `lambda / (M step)` wide, `step` the stamp's pixel size and `M` the period of the computed focal plane
/// in stamp pixels. Lag `k` of the pupil's autocorrelation then is the spatial frequency `k / M` cycles per stamp pixel,
/// and the transform back lands on the stamp's pixels exactly, whatever the ratio of pixel size to lambda / D.
pub(crate) struct FocalPlane {
    pupil: PupilCells,
    /// Length of the transforms that hold the autocorrelation without overlap.
    length: usize,
    /// Highest lag that matters.
    lags: usize,
    period: usize,
    forward: Arc<dyn Fft<f64>>,
    inverse: Arc<dyn Fft<f64>>,
    /// `1 / sinc^2(m / length)` along an axis: undoes the averaging of the amplitude over a pupil cell.
    cell_correction: Vec<f64>,
    /// Transfer function of the seeing at lags `[ky][kx]`, both 0 to `lags`.
    seeing: Option<Vec<f64>>,
    scratch: Mutex<Vec<FocalScratch>>,
}

/// Transfer functions along one axis, lags 0 to `lags`, for one position of the source on the stamp.
pub(crate) struct AxisTransfer(pub(crate) Vec<Complex64>);

impl std::fmt::Debug for FocalPlane {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FocalPlane")
            .field("pupil_side", &self.pupil.side())
            .field("length", &self.length)
            .field("lags", &self.lags)
            .field("period", &self.period)
            .finish_non_exhaustive()
    }
}

impl FocalPlane {
    /// The length of the transforms for a pupil of `side` cells and lags up to `lags`.
    pub(crate) fn transform_length(side: usize, lags: usize) -> usize {
        even_smooth_at_least(side + lags)
    }

    pub(crate) fn new(pupil: PupilCells, lags: usize, period: usize, seeing: Option<Vec<f64>>) -> Self {
        let length = Self::transform_length(pupil.side(), lags);
        let mut planner = FftPlanner::new();
        let cell_correction = (0..length)
            .map(|m| {
                let signed = m.min(length - m) as f64 / length as f64;
                crate::sinc(signed).powi(-2)
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

    /// Width of the computed focal plane in stamp pixels.
    pub(crate) fn period(&self) -> usize {
        self.period
    }

    /// Draws the stamp of a pupil phase; `gain` turns the unit-flux density on the period into stamp values.
    ///
    /// Returns the steepest phase gradient in radians per cell; the stamp is not drawn when it exceeds pi.
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
            let norm = gain / (self.pupil.lit_cells() * (self.length * self.length) as f64);
            self.transform_back(&mut scratch, norm, stamp);
        }
        if let Ok(mut pool) = self.scratch.lock() {
            pool.push(scratch);
        }
        steepest
    }

    fn new_scratch(&self) -> FocalScratch {
        let fft = self
            .forward
            .get_inplace_scratch_len()
            .max(self.inverse.get_inplace_scratch_len());
        FocalScratch::new(self.pupil.side(), self.length, self.lags, self.period, BLOCK, fft)
    }

    /// Pupil rows to focal-plane columns; the rows beyond the pupil are zero and not transformed.
    fn transform_rows(&self, s: &mut FocalScratch) {
        for row in s.amplitude.chunks_exact_mut(self.length) {
            self.forward.process_with_scratch(row, &mut s.fft);
        }
    }

    /// Along each column: amplitude to intensity and on to lags, two real columns in one complex transform.
    fn correlate_columns(&self, s: &mut FocalScratch) {
        let (n, side) = (self.length, self.pupil.side());
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

    /// Along each row of lags to the transfer function, times the others, folded onto the period.
    fn fold(&self, s: &mut FocalScratch, x: &AxisTransfer, y: &AxisTransfer) {
        let (n, m, top) = (self.length, self.period, self.lags);
        s.folded.fill(Complex64::ZERO);
        for ky in 0..=top {
            let row = &mut s.lags[ky * n..(ky + 1) * n];
            self.forward.process_with_scratch(row, &mut s.fft);
            let target = &mut s.folded[ky % m * m..(ky % m + 1) * m];
            // Rows -ky hold the conjugate: twice the real part in the end.
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
