//! The field that kriging predicts.

use ndarray::{Array1, Array2};
use psf_types::{BilinearCells, CoefficientField, ErrorLimit, FieldError, FrameShape, PixelRegion, Position};

use super::kernel::{Covariance, Scaled, terms};
use super::system::Solution;
use crate::geometry::{Hull, Point};

/// `a_k(x) = sum_i k(x, x_i) dual_ik + sum_j p_j(x) trend_jk`, with the covariance `k` and the terms
/// `p` of the trend.
#[derive(Debug)]
pub(super) struct Prediction<'a> {
    /// The samples' scaled points.
    pub(super) points: &'a [Point],
    pub(super) covariance: Covariance,
    /// The degree of the trend.
    pub(super) degree: usize,
    pub(super) solution: &'a Solution,
}

impl Prediction<'_> {
    /// Writes the prediction at a scaled point.
    fn write(&self, at: Point, values: &mut [f64]) {
        values.fill(0.0);
        let of_samples: Vec<f64> = self
            .points
            .iter()
            .map(|&p| self.covariance.between(at, p))
            .collect();
        let of_trend: Vec<f64> = terms(self.degree, at).collect();
        let arch = pulp::Arch::new();
        for (weights, rows) in [
            (&of_samples, &self.solution.duals),
            (&of_trend, &self.solution.trend),
        ] {
            let rows = rows.as_slice().expect("row-major");
            arch.dispatch(AddRows {
                weights,
                rows,
                sums: &mut *values,
            });
        }
    }

    pub(super) fn at(&self, at: Point) -> Array1<f64> {
        let mut values = vec![0.0; self.solution.duals.ncols()];
        self.write(at, &mut values);
        values.into()
    }
}

/// Adds rows, each times its weight, to sums.
struct AddRows<'a> {
    weights: &'a [f64],
    rows: &'a [f64],
    sums: &'a mut [f64],
}

impl pulp::WithSimd for AddRows<'_> {
    type Output = ();

    #[allow(
        clippy::inline_always,
        reason = "only inlined code uses the wide instructions"
    )]
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        for (weight, row) in self
            .weights
            .iter()
            .zip(self.rows.chunks_exact(self.sums.len().max(1)))
        {
            for (sum, value) in self.sums.iter_mut().zip(row) {
                *sum += weight * value;
            }
        }
    }
}

/// The prediction at the positions of a frame.
#[derive(Debug)]
pub(super) struct KrigingField {
    pub(super) scaled: Scaled,
    pub(super) points: Vec<Point>,
    pub(super) covariance: Covariance,
    pub(super) degree: usize,
    pub(super) solution: Solution,
    pub(super) hull: Hull,
    /// The distance in pixels over which the field may bend.
    pub(super) scale: f64,
    /// The coefficients of the samples.
    pub(super) values: Array2<f64>,
}

impl KrigingField {
    pub(super) fn prediction(&self) -> Prediction<'_> {
        Prediction {
            points: &self.points,
            covariance: self.covariance,
            degree: self.degree,
            solution: &self.solution,
        }
    }
}

impl CoefficientField for KrigingField {
    fn component_count(&self) -> usize {
        self.solution.duals.ncols()
    }

    /// # Panics
    /// When `coefficients.len() != self.component_count()`.
    fn evaluate_into(&self, position: Position, coefficients: &mut [f64]) -> Result<(), FieldError> {
        assert_eq!(
            coefficients.len(),
            self.component_count(),
            "one coefficient per component"
        );
        let p = self.hull.admit(position)?;
        self.prediction().write(self.scaled.at(p), coefficients);
        Ok(())
    }

    /// The scale is the shorter length of the kernel or, for a radial spline, the distance of samples.
    fn bilinear_cells(&self, _: PixelRegion, _: ErrorLimit<'_>) -> BilinearCells {
        BilinearCells::Unknown { scale: self.scale }
    }

    fn some_coefficients(&self, _: Option<FrameShape>) -> Array2<f64> {
        self.values.clone()
    }
}
