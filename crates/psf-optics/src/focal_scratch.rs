//! Work arrays of one drawing thread.

use rustfft::num_complex::Complex64;

use crate::pupil_cells::PupilCells;
use crate::pupil_polynomial::{PupilPolynomial, PupilRowPolynomial, PupilRowValues};

/// Buffers that a drawing overwrites entirely: what they held before never matters.
#[derive(Debug)]
pub(crate) struct FocalScratch {
    /// Pupil rows `[row][length]`, then their transforms.
    pub(crate) amplitude: Vec<Complex64>,
    /// Some columns, `[column][length]`.
    pub(crate) block: Vec<Complex64>,
    /// `[lag in y][length]`.
    pub(crate) lags: Vec<Complex64>,
    /// `[period][period]`.
    pub(crate) folded: Vec<Complex64>,
    /// Scratch of the transforms.
    pub(crate) fft: Vec<Complex64>,
    row: PupilRowPolynomial,
    values: PupilRowValues,
    coverage: Vec<f64>,
}

impl FocalScratch {
    pub(crate) fn new(
        side: usize,
        length: usize,
        lags: usize,
        period: usize,
        block: usize,
        fft: usize,
    ) -> Self {
        let zeros = |n: usize| vec![Complex64::ZERO; n];
        Self {
            amplitude: zeros(side * length),
            block: zeros((block * length).max(period)),
            lags: zeros((lags + 1) * length),
            folded: zeros(period * period),
            fft: zeros(fft),
            row: PupilRowPolynomial::default(),
            values: PupilRowValues::default(),
            coverage: Vec::new(),
        }
    }

    /// Writes the amplitude of every cell: the mean over the cell of `exp(i phase)` where it is lit, the phase taken as
    /// linear within the cell. Returns the steepest gradient along an axis in radians per cell.
    pub(crate) fn fill_amplitude(
        &mut self,
        pupil: &PupilCells,
        phase: &PupilPolynomial,
        length: usize,
    ) -> f64 {
        if !phase.is_finite() {
            return f64::INFINITY;
        }
        self.amplitude.fill(Complex64::ZERO);
        let mut steepest = 0f64;
        for row in pupil.rows() {
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
                    let (gx, gy) = (dx * pupil.cell(), dy * pupil.cell());
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

/// The mean of `exp(i g t)` over `-1/2 <= t <= 1/2`, `sin(g/2) / (g/2)`, by its series: 2e-6 off at most for `|g| <= pi`.
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
