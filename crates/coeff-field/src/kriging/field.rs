//! The field that kriging predicts.

use ndarray::{Array1, Array2};
use psf_types::{
    BilinearCells, CoefficientField, ErrorLimit, FieldError, FrameShape, KrigingParameters, PixelRegion,
    Position,
};

use super::kernel::{Covariance, Scaled, terms};
use crate::geometry::{Hull, Point};

/// The functions of which fields are sums: covariances with the samples' scaled points, and the terms of
/// the trend.
#[derive(Debug, Clone)]
pub(super) struct Functions {
    pub(super) points: Vec<Point>,
    pub(super) covariance: Covariance,
    /// The degree of the trend.
    pub(super) degree: usize,
}

/// The field is `sum_i k(x, x_i) dual_i + sum_j p_j(x) trend_j`.
#[derive(Debug)]
pub(super) struct Solution {
    /// `[sample, column]`.
    pub(super) duals: Array2<f64>,
    /// `[term, column]`.
    pub(super) trend: Array2<f64>,
}

impl Functions {
    pub(super) fn new(points: &[Point], parameters: &KrigingParameters) -> Self {
        Self {
            points: points.to_vec(),
            covariance: Covariance::new(parameters),
            degree: parameters.trend(),
        }
    }

    /// The covariances of a scaled point with the samples.
    pub(super) fn of_samples(&self, at: Point) -> Vec<f64> {
        let points = self.points.iter();
        points.map(|&p| self.covariance.between(at, p)).collect()
    }

    /// The terms of the trend at a scaled point.
    pub(super) fn of_trend(&self, at: Point) -> Vec<f64> {
        terms(self.degree, at).collect()
    }

    /// Writes the field of a solution at a scaled point.
    fn write(&self, solution: &Solution, at: Point, values: &mut [f64]) {
        values.fill(0.0);
        let arch = pulp::Arch::new();
        for (weights, rows) in [
            (self.of_samples(at), &solution.duals),
            (self.of_trend(at), &solution.trend),
        ] {
            arch.dispatch(AddRows {
                weights: &weights,
                rows: rows.as_slice().expect("row-major"),
                sums: &mut *values,
            });
        }
    }

    /// The field of a solution at a scaled point.
    pub(super) fn at(&self, solution: &Solution, at: Point) -> Array1<f64> {
        let mut values = vec![0.0; solution.duals.ncols()];
        self.write(solution, at, &mut values);
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

/// The field that kriging predicts, at positions of the frame.
#[derive(Debug)]
pub(super) struct KrigingField {
    pub(super) scaled: Scaled,
    pub(super) functions: Functions,
    pub(super) solution: Solution,
    pub(super) hull: Hull,
    /// The distance in pixels over which the field may bend.
    pub(super) scale: f64,
    /// The coefficients of the samples.
    pub(super) values: Array2<f64>,
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
        self.functions
            .write(&self.solution, self.scaled.at(p), coefficients);
        Ok(())
    }

    /// The scale is the shorter length of the kernel or, for a radial spline, the distance of samples.
    fn bilinear_cells(&self, _: PixelRegion, _: ErrorLimit<'_>) -> BilinearCells {
        BilinearCells::Unknown {
            scale: self.scale,
            slow: true,
        }
    }

    fn some_coefficients(&self, _: Option<FrameShape>) -> Array2<f64> {
        self.values.clone()
    }
}
