//! Kriging: the best linear prediction of a random field.

mod choice;
mod field;
mod kernel;
mod system;

use std::sync::Arc;

use ndarray::Array2;
use psf_types::{CoefficientField, KrigingParameters, OutsidePolicy, Position, SampleCoefficients};

use self::field::{KrigingField, Prediction};
use self::kernel::{Covariance, Scaled, term_count};
use self::system::{Covariances, Equations};
use crate::error::CoeffFieldError;
use crate::geometry::{Hull, Point, Points, query};
use crate::interpolation::{FieldInterpolation, Interpolated, Outcomes, Unpredictable, hull_leave_one_out};

/// Universal kriging, also called Gaussian process regression: a polynomial trend, and around it a
/// random field with a covariance ([`psf_types::KrigingKernel`]), observed at the samples with noise
/// (the nugget).
///
/// `a_k(x) = sum_i k(x, x_i) c_ik + sum_j p_j(x) b_jk`: the best linear unbiased prediction (N. Cressie
/// 1993, Statistics for Spatial Data, section 3.4). With the kernels thin plate, cubic and quintic, it is
/// a radial spline. Weights depend on all samples and serve all components.
///
/// Without given parameters, they are those with which the samples predict each other best: kernel,
/// lengths along x and y, degree of the trend, nugget. All components count at once. On at most 200
/// well spread samples, all parameters are tried. Then they are refined on at most 1000 samples.
///
/// For smooth fields, the Gaussian kernel has errors that are many times smaller than those of local
/// methods. The equations are then ill conditioned. So the nugget is at least `1e-14 n` for `n` samples,
/// which bounds their condition number by 1e14. The field is exact at the samples up to the nugget.
///
/// # Outside the samples
/// * Nearest: the value at the nearest point of the convex hull.
/// * Extend: the prediction itself. Far outside, it is the trend.
/// * Error: returns an error. Positions outside the hull still count as inside up to a distance of
///   1e-9 times the samples' extent (or of 1e-9 pixels, if that is more).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Kriging {
    parameters: Option<KrigingParameters>,
}

impl Kriging {
    /// The largest number of samples. The equations of more fill too much memory.
    pub const MAX_SAMPLES: usize = 10_000;

    /// Kriging with given parameters.
    pub fn new(parameters: KrigingParameters) -> Self {
        Self {
            parameters: Some(parameters),
        }
    }

    /// The given parameters, or those that suit the samples best.
    ///
    /// # Errors
    /// [`CoeffFieldError::FewForKriging`] if the samples do not determine the parameters, and
    /// [`CoeffFieldError::ManyForKriging`].
    pub fn parameters(&self, samples: &SampleCoefficients) -> Result<KrigingParameters, CoeffFieldError> {
        let prepared = Prepared::new(samples)?;
        self.parameters_of(&prepared, samples)
    }

    fn parameters_of(
        &self,
        prepared: &Prepared,
        samples: &SampleCoefficients,
    ) -> Result<KrigingParameters, CoeffFieldError> {
        if let Some(parameters) = self.parameters {
            return Ok(parameters);
        }
        let chosen = choice::chosen(&prepared.scaled_points, samples.values(), &[]);
        chosen.ok_or_else(|| few(samples, term_count(0)))
    }

    /// Fits the field, with the errors that it expects.
    ///
    /// # Errors
    /// As for [`parameters`](Self::parameters).
    pub fn fit(
        &self,
        samples: &SampleCoefficients,
        outside: OutsidePolicy,
    ) -> Result<KrigingFit, CoeffFieldError> {
        let prepared = Prepared::new(samples)?;
        let parameters = self.parameters_of(&prepared, samples)?;
        prepared.fit(samples, parameters, outside)
    }
}

/// Samples at scaled points.
struct Prepared {
    points: Points,
    scaled: Scaled,
    scaled_points: Vec<Point>,
}

impl Prepared {
    fn new(samples: &SampleCoefficients) -> Result<Self, CoeffFieldError> {
        let positions = samples.positions();
        if let Some(states) = positions.states() {
            let (kind, count) = (states.kind(), states.values().len());
            return Err(CoeffFieldError::SeveralStates { kind, count });
        }
        let (count, most) = (positions.len(), Kriging::MAX_SAMPLES);
        if count > most {
            return Err(CoeffFieldError::ManyForKriging { samples: count, most });
        }
        let points = Points::new(positions)?;
        let scaled = Scaled::of(&points.points);
        let scaled_points = points.points.iter().map(|&p| scaled.at(p)).collect();
        Ok(Self {
            points,
            scaled,
            scaled_points,
        })
    }

    fn fit(
        self,
        samples: &SampleCoefficients,
        parameters: KrigingParameters,
        outside: OutsidePolicy,
    ) -> Result<KrigingFit, CoeffFieldError> {
        let too_few = || few(samples, term_count(parameters.trend()));
        let covariances = Covariances::new(&self.scaled_points, &[], &parameters).ok_or_else(too_few)?;
        let equations = covariances.with_nugget(parameters.nugget()).ok_or_else(too_few)?;
        let solution = equations.solve(samples.values());
        let precisions = equations.precisions();
        let squares = solution.duals.outer_iter().map(|dual| dual.dot(&dual));
        let squares: Vec<f64> = squares.zip(&precisions).map(|(square, a)| square / a).collect();
        let scale = squares.iter().sum::<f64>() / squares.len() as f64;
        drop(equations);
        let hull = Hull::new(&self.points, outside)?;
        let field = KrigingField {
            scaled: self.scaled,
            points: self.scaled_points,
            covariance: Covariance::new(&parameters),
            degree: parameters.trend(),
            solution,
            hull,
            scale: self
                .scaled
                .pixels(of_kernel(&parameters, samples.positions().len())),
            values: samples.values().to_owned(),
        };
        Ok(KrigingFit {
            parameters,
            field: Arc::new(field),
            covariances,
            scaled: self.scaled,
            points: self.points,
            scale,
            precisions,
        })
    }
}

/// The scaled distance over which a field may bend.
fn of_kernel(parameters: &KrigingParameters, samples: usize) -> f64 {
    match parameters.kernel().lowest_trend() {
        None => parameters.lengths()[0].min(parameters.lengths()[1]),
        Some(_) => 2.0 / (samples as f64).sqrt(),
    }
}

fn few(samples: &SampleCoefficients, terms: usize) -> CoeffFieldError {
    CoeffFieldError::FewForKriging {
        samples: samples.positions().len(),
        terms,
    }
}

/// A field that kriging predicts, and the errors that it expects.
#[derive(Debug)]
pub struct KrigingFit {
    parameters: KrigingParameters,
    field: Arc<KrigingField>,
    covariances: Covariances,
    scaled: Scaled,
    points: Points,
    /// The variance of the coefficients together, in units of the kernel.
    scale: f64,
    /// For each sample, the inverse of its variance as predicted from the others, in units of the kernel.
    precisions: Vec<f64>,
}

impl KrigingFit {
    /// The parameters.
    pub fn parameters(&self) -> KrigingParameters {
        self.parameters
    }

    /// The nugget that is used: at least `1e-14 n` for `n` samples. The condition number of the equations
    /// is at most `n` divided by it.
    pub fn nugget(&self) -> f64 {
        self.equations().nugget()
    }

    /// The predicted field.
    pub fn field(&self) -> Arc<dyn CoefficientField> {
        Arc::<KrigingField>::clone(&self.field)
    }

    fn equations(&self) -> Equations<'_> {
        let equations = self.covariances.with_nugget(self.parameters.nugget());
        equations.expect("the fit solved these equations")
    }

    /// For each sample, the L2 error over the components of its prediction from all other samples, with
    /// the same parameters.
    pub fn leave_one_out_errors(&self) -> Vec<f64> {
        let duals = self.field.solution.duals.outer_iter();
        let errors = duals
            .zip(&self.precisions)
            .map(|(dual, a)| dual.dot(&dual).sqrt() / a);
        errors.collect()
    }

    /// The expected L2 error over the components at some positions: the square root of the prediction's
    /// variance. It is scaled so that the leave-one-out errors agree with it in the mean.
    ///
    /// # Errors
    /// [`CoeffFieldError::QueryRange`] for positions that are too far away.
    pub fn expected_errors(&self, positions: &[Position]) -> Result<Vec<f64>, CoeffFieldError> {
        let equations = self.equations();
        let expected = positions.iter().map(|&position| {
            let p = query(position)?;
            Ok((self.scale * equations.variance(self.scaled.at(p))).sqrt())
        });
        expected.collect()
    }
}

impl FieldInterpolation for Kriging {
    fn interpolate(&self, samples: &SampleCoefficients, outside: OutsidePolicy) -> Interpolated {
        Ok(self.fit(samples, outside)?.field())
    }

    /// In closed form, with the parameters of all samples.
    fn leave_one_out(&self, samples: &SampleCoefficients, outside: OutsidePolicy) -> Outcomes {
        let fit = self.fit(samples, outside)?;
        let errors = fit.leave_one_out_errors();
        let equations = fit.equations();
        let (field, values) = (&fit.field, samples.values());
        hull_leave_one_out(samples, &fit.points, outside, |sample, at| {
            if at == fit.points.points[sample] {
                return match errors[sample] {
                    error if error.is_finite() => Ok(error),
                    _ => Err(Unpredictable::Undetermined),
                };
            }
            // Without a sample, the field is the one with the sample's value as the others predict it.
            let mut unit = Array2::zeros((values.nrows(), 1));
            unit[(sample, 0)] = 1.0;
            let influence = equations.solve(unit.view());
            let influence = Prediction {
                solution: &influence,
                ..field.prediction()
            };
            let at = fit.scaled.at(at);
            let change = &field.solution.duals.row(sample) / fit.precisions[sample];
            let predicted = field.prediction().at(at) - change * influence.at(at)[0];
            let error = predicted - values.row(sample);
            Ok(error.dot(&error).sqrt())
        })
    }
}
