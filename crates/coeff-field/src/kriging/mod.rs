//! Kriging: the best linear prediction of a random field.

mod choice;
mod field;
mod kernel;
mod noisy;
mod system;

use std::sync::Arc;

use ndarray::Array2;
use psf_types::maths::term_count;
use psf_types::{CoefficientField, KrigingParameters, OutsidePolicy, Position, SampleCoefficients};

use self::field::{Functions, KrigingField};
use self::kernel::Scaled;
use self::system::{Covariances, Equations};

pub use self::noisy::NoisyKrigingFit;
use crate::error::CoeffFieldError;
use crate::geometry::{Hull, Point, Points, query, range};
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
        let chosen = choice::chosen(&prepared.scaled_points, samples.values());
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
#[derive(Debug)]
struct Prepared {
    points: Points,
    scaled: Scaled,
    scaled_points: Vec<Point>,
}

impl Prepared {
    fn new(samples: &SampleCoefficients) -> Result<Self, CoeffFieldError> {
        let positions = samples.positions();
        CoeffFieldError::unless_one_state(positions)?;
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
        let equations = Covariances::new(&self.scaled_points, &parameters)
            .and_then(|covariances| Equations::new(covariances, parameters.nugget()))
            .ok_or_else(|| few(samples, term_count(parameters.trend())))?;
        let solution = equations.solve(samples.values());
        let precisions = equations.precisions();
        let squares = solution.duals.outer_iter().map(|dual| dual.dot(&dual));
        let squares = squares.zip(&precisions).map(|(square, a)| square / a);
        let variance = squares.sum::<f64>() / precisions.len() as f64;
        let bends = of_kernel(&parameters, precisions.len());
        let field = KrigingField {
            functions: Functions::new(&self.scaled_points, &parameters),
            solution,
            hull: Hull::new(&self.points, outside)?,
            scale: self.scaled.pixels(bends),
            values: samples.values().to_owned(),
            scaled: self.scaled,
        };
        Ok(KrigingFit {
            parameters,
            field: Arc::new(field),
            equations,
            points: self.points,
            variance,
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
    equations: Equations<Covariances>,
    points: Points,
    /// The variance of the coefficients together, in units of the kernel.
    variance: f64,
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
        self.equations.nugget()
    }

    /// The predicted field.
    pub fn field(&self) -> Arc<dyn CoefficientField> {
        Arc::<KrigingField>::clone(&self.field)
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
        let expected = positions
            .iter()
            .map(|&position| Ok(self.expected_error(query(position)?)));
        expected.collect()
    }

    fn expected_error(&self, p: Point) -> f64 {
        let variance = self.equations.variance(self.field.scaled.at(p));
        (self.variance * variance).sqrt()
    }

    /// The candidates with the largest expected errors, one after another: each is the one with the
    /// largest error that is left when the values at the candidates before it are known, too. So they
    /// are spread over the field. At most `count`, each with its expected error times its weight.
    ///
    /// Sampling at these positions is a sequential design: the variance of kriging depends on positions
    /// and parameters alone, so it can be known before a sample is drawn (J. Sacks, W. Welch, T. Mitchell
    /// and H. Wynn 1989, Statistical Science 4, 409, section 5).
    ///
    /// # Errors
    /// [`CoeffFieldError::QueryRange`] for positions that are too far away.
    ///
    /// # Panics
    /// When there is not one weight for each candidate.
    pub fn least_known(
        &self,
        candidates: &[Position],
        weights: &[f64],
        count: usize,
    ) -> Result<Vec<(usize, f64)>, CoeffFieldError> {
        assert_eq!(candidates.len(), weights.len(), "one weight for each candidate");
        let points = candidates
            .iter()
            .map(|&position| Ok(self.field.scaled.at(query(position)?)));
        let predictions = self
            .equations
            .predictions(points.collect::<Result<_, CoeffFieldError>>()?);
        let all = 0..candidates.len();
        let mut variances: Vec<f64> = all.clone().map(|i| predictions.variance(i)).collect();
        // For each chosen candidate, the covariances with all: the columns of Cholesky's factor, pivoted.
        let mut known: Vec<Vec<f64>> = Vec::with_capacity(count);
        let mut chosen: Vec<(usize, f64)> = Vec::with_capacity(count);
        while chosen.len() < count {
            let weighted = |i: usize| variances[i] * weights[i] * weights[i];
            let left = all.clone().filter(|i| chosen.iter().all(|(taken, _)| taken != i));
            let Some(next) = left.max_by(|&a, &b| weighted(a).total_cmp(&weighted(b)).then(b.cmp(&a))) else {
                break;
            };
            chosen.push((next, (self.variance * weighted(next)).sqrt()));
            let scale = (variances[next] + self.equations.nugget_in_kernel()).sqrt();
            let column: Vec<f64> = all
                .clone()
                .map(|i| {
                    let before: f64 = known.iter().map(|column| column[i] * column[next]).sum();
                    (predictions.covariance(i, next) - before) / scale
                })
                .collect();
            for (variance, part) in variances.iter_mut().zip(&column) {
                *variance = (*variance - part * part).max(0.0);
            }
            known.push(column);
        }
        Ok(chosen)
    }

    /// The root mean square of the expected errors over the convex hull of the samples.
    pub(crate) fn expected_rms_error(&self) -> f64 {
        let inside = inside(&self.points, &self.field.hull);
        rms(&self.expected_errors(&inside).unwrap_or_default())
    }

    /// Predicts every sample from all others, in closed form, with the parameters of all samples.
    pub(crate) fn leave_one_out(&self, samples: &SampleCoefficients, outside: OutsidePolicy) -> Outcomes {
        let errors = self.leave_one_out_errors();
        let KrigingField {
            scaled,
            functions,
            solution,
            ..
        } = &*self.field;
        let values = samples.values();
        hull_leave_one_out(samples, &self.points, outside, |sample, at| {
            if at == self.points.points[sample] {
                return match errors[sample] {
                    error if error.is_finite() => Ok(error),
                    _ => Err(Unpredictable::Undetermined),
                };
            }
            // Without a sample, the field is the one with the sample's value as the others predict it.
            let mut unit = Array2::zeros((values.nrows(), 1));
            unit[(sample, 0)] = 1.0;
            let influence = self.equations.solve(unit.view());
            let at = scaled.at(at);
            let change = &solution.duals.row(sample) / self.precisions[sample];
            let predicted = functions.at(solution, at) - change * functions.at(&influence, at)[0];
            let error = predicted - values.row(sample);
            Ok(error.dot(&error).sqrt())
        })
    }
}

/// The number of positions along each axis at which expected errors are averaged.
const ALONG_AXIS: usize = 16;

/// The root mean square. 0 for an empty list.
fn rms(values: &[f64]) -> f64 {
    let squares = values.iter().map(|value| value * value);
    (squares.sum::<f64>() / values.len().max(1) as f64).sqrt()
}

/// The positions of a grid over the samples that lie in their convex hull.
fn inside(points: &Points, hull: &Hull) -> Vec<Position> {
    let ranges = [0, 1].map(|axis| range(&points.points, axis));
    let place = |i: usize, axis: usize| {
        let (low, high) = ranges[axis];
        low + (i as f64 + 0.5) / ALONG_AXIS as f64 * (high - low)
    };
    let grid = (0..ALONG_AXIS * ALONG_AXIS).map(|i| [place(i % ALONG_AXIS, 0), place(i / ALONG_AXIS, 1)]);
    let inside = grid.filter(|&p| hull.contains(p));
    inside.filter_map(|[x, y]| Position::new(x, y).ok()).collect()
}

impl FieldInterpolation for Kriging {
    fn interpolate(&self, samples: &SampleCoefficients, outside: OutsidePolicy) -> Interpolated {
        Ok(self.fit(samples, outside)?.field())
    }

    /// In closed form, with the parameters of all samples.
    fn leave_one_out(&self, samples: &SampleCoefficients, outside: OutsidePolicy) -> Outcomes {
        self.fit(samples, outside)?.leave_one_out(samples, outside)
    }
}
