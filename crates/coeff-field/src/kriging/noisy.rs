//! Kriging of samples with noise.

use ndarray::{Array2, ArrayView1, ArrayView2, Axis};
use psf_types::maths::term_count;
use psf_types::{DataError, KrigingKernel, KrigingParameters, OutsidePolicy, Position, SampleCoefficients};

use super::choice::{LENGTHS, Samples, Scored, best_of, neighbours_of, refined};
use super::system::{Covariances, Equations};
use super::{Prepared, few, inside, rms};
use crate::error::CoeffFieldError;
use crate::geometry::{Hull, Point, query};
use crate::interpolation::LeaveOneOut;

/// Kriging of samples whose noise is known up to a factor.
///
/// Coefficient `k` of sample `i` is `y_ik = f_k(x_i) + e_ik`. The field `f_k` has the covariance
/// `v_k K`, with one kernel for all components. The noise `e_ik` has the variance `s_k n_i^2`, with the
/// given noise `n_i` of each sample. Factors `v_k` (signal) and `s_k` (near 1) belong to a component, because
/// the first components of a basis hold much signal and the last ones little. Parameters are those with
/// which the samples predict each other best, as for [`Kriging`](super::Kriging).
///
/// The result is the samples without noise, as predicted from all samples ([`samples`](Self::samples)).
/// Kriging with the same kernel and no nugget through them is the predicted field.
#[derive(Debug)]
pub struct NoisyKrigingFit {
    parameters: KrigingParameters,
    samples: SampleCoefficients,
    /// `[sample, component]`, each predicted from the other samples.
    predictions: Array2<f64>,
    prepared: Prepared,
    covariances: Covariances,
    groups: Vec<Group>,
}

/// Components with one ratio of noise to signal.
#[derive(Debug)]
struct Group {
    nugget: f64,
    /// The sum of the variances `v_k`.
    variance: f64,
}

/// The ratios of noise to signal that are tried.
const NUGGETS: [f64; 21] = [
    1e-6, 3e-6, 1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0,
    1e3, 3e3, 1e4,
];
/// The standard deviation of the logarithm of `s_k`. The noise of a sample is estimated from its pixels.
const SPREAD: f64 = 0.3;
/// All lengths are tried on at most this many samples, and the best refined on more.
const FIRST_SAMPLES: usize = 120;
const MOST_SAMPLES: usize = 250;
const MOST_ROUNDS: usize = 8;
/// Kernels with lengths.
const KERNELS: [KrigingKernel; 3] = [
    KrigingKernel::Gaussian,
    KrigingKernel::Matern52,
    KrigingKernel::Matern32,
];

impl NoisyKrigingFit {
    /// Fits samples of one state. `noise` is the standard deviation of each sample's coefficients.
    ///
    /// # Errors
    /// The errors of [`Kriging::fit`](super::Kriging::fit). [`CoeffFieldError::Parameter`] for a noise that
    /// is not above 0, and [`DataError::CountMismatch`] if there is not one value for each sample.
    pub fn new(samples: &SampleCoefficients, noise: &[f64]) -> Result<Self, CoeffFieldError> {
        let prepared = Prepared::new(samples)?;
        let count = samples.positions().len();
        DataError::check_count("values of noise, one for each sample", count, noise.len())?;
        if let Some(&wrong) = noise.iter().find(|n| !(**n > 0.0 && n.is_finite())) {
            return Err(CoeffFieldError::Parameter {
                name: "the noise of a sample",
                allowed: "above 0",
                got: wrong,
            });
        }
        let noisy = Noisy {
            samples: Samples {
                points: prepared.scaled_points.clone(),
                values: samples.values().to_owned(),
            },
            variances: noise.iter().map(|n| n * n).collect(),
        };
        let undetermined = || few(samples, term_count(0));
        let parameters = noisy.parameters().ok_or_else(undetermined)?;
        // Ratios are found on some of the samples, because each takes a solution of the equations.
        let some = noisy.spread(MOST_SAMPLES);
        let chosen = some.score(parameters).ok_or_else(undetermined)?.nuggets;
        let covariances = noisy.covariances(parameters).ok_or_else(undetermined)?;
        let mut fit = Self {
            parameters,
            samples: samples.clone(),
            predictions: samples.values().to_owned(),
            prepared,
            covariances,
            groups: Vec::new(),
        };
        let mut values = samples.values().to_owned();
        for nugget in NUGGETS {
            let components: Vec<usize> = (0..chosen.len()).filter(|&k| chosen[k] == nugget).collect();
            if components.is_empty() {
                continue;
            }
            let group = fit.group(&noisy, nugget, &components, &mut values);
            fit.groups.push(group.ok_or_else(undetermined)?);
        }
        fit.samples = SampleCoefficients::new(values, samples.positions().clone())?;
        Ok(fit)
    }

    /// Solves for components with one ratio of noise to signal. Writes their values without noise, and the
    /// predictions of each sample from the others.
    fn group(
        &mut self,
        noisy: &Noisy,
        nugget: f64,
        components: &[usize],
        values: &mut Array2<f64>,
    ) -> Option<Group> {
        let equations = Equations::new(&self.covariances, nugget)?;
        let nugget_of_kernel = equations.nugget_in_kernel();
        let precisions = equations.precisions();
        let relative = noisy.relative();
        let columns = noisy.samples.values.select(Axis(1), components);
        let duals = equations.solve(columns.view()).duals;
        let mut variance = 0.0;
        for (&component, dual) in components.iter().zip(duals.columns()) {
            for (sample, &dual) in dual.iter().enumerate() {
                let own = noisy.samples.values[(sample, component)];
                values[(sample, component)] = own - nugget_of_kernel * relative[sample] * dual;
                self.predictions[(sample, component)] = own - dual / precisions[sample];
            }
            let ratio = nugget_of_kernel / noisy.mean_variance();
            variance += best_variance(dual, &precisions, ratio).0;
        }
        Some(Group { nugget, variance })
    }

    /// The parameters of the kernel, without a nugget.
    pub fn parameters(&self) -> KrigingParameters {
        self.parameters
    }

    /// The samples without noise, as predicted from all samples.
    pub fn samples(&self) -> &SampleCoefficients {
        &self.samples
    }

    /// The predictions of each sample's coefficients from the other samples, `[sample, component]`.
    pub fn predictions(&self) -> ArrayView2<'_, f64> {
        self.predictions.view()
    }

    /// The errors of these predictions. They include the noise of the sample that was left out.
    ///
    /// # Errors
    /// [`CoeffFieldError`] for samples with other positions.
    pub fn leave_one_out(&self, samples: &SampleCoefficients) -> Result<LeaveOneOut, CoeffFieldError> {
        LeaveOneOut::of_predictions(samples, self.predictions.view())
    }

    /// The expected L2 error over the components at some positions: the square root of the sum of the
    /// predictions' variances.
    ///
    /// # Errors
    /// [`CoeffFieldError::QueryRange`] for positions that are too far away.
    pub fn expected_errors(&self, positions: &[Position]) -> Result<Vec<f64>, CoeffFieldError> {
        let points: Vec<Point> = positions.iter().map(|&p| query(p)).collect::<Result<_, _>>()?;
        let points: Vec<Point> = points.into_iter().map(|p| self.prepared.scaled.at(p)).collect();
        let mut squares = vec![0.0; points.len()];
        for group in &self.groups {
            let equations = Equations::new(&self.covariances, group.nugget);
            let equations = equations.expect("solved before");
            let predictions = equations.predictions(points.clone());
            for (place, square) in squares.iter_mut().enumerate() {
                *square += group.variance * predictions.variance(place);
            }
        }
        Ok(squares.into_iter().map(f64::sqrt).collect())
    }

    /// The root mean square of the expected errors over the convex hull of the samples.
    pub(crate) fn expected_rms_error(&self) -> f64 {
        let hull = Hull::new(&self.prepared.points, OutsidePolicy::Nearest).expect("a known policy");
        let inside = inside(&self.prepared.points, &hull);
        rms(&self.expected_errors(&inside).unwrap_or_default())
    }
}

/// Samples and the variances of their noise.
struct Noisy {
    samples: Samples,
    variances: Vec<f64>,
}

/// The score of parameters, smaller is better, and the best ratio for each component.
struct NoisyScore {
    score: f64,
    nuggets: Vec<f64>,
}

impl Noisy {
    fn mean_variance(&self) -> f64 {
        self.variances.iter().sum::<f64>() / self.variances.len() as f64
    }

    /// The variances of the noise, relative to their mean.
    fn relative(&self) -> Vec<f64> {
        let mean = self.mean_variance();
        self.variances.iter().map(|v| v / mean).collect()
    }

    fn spread(&self, count: usize) -> Self {
        let chosen = self.samples.spread(count);
        Self {
            variances: chosen.iter().map(|&i| self.variances[i]).collect(),
            samples: self.samples.select(&chosen),
        }
    }

    fn covariances(&self, parameters: KrigingParameters) -> Option<Covariances> {
        Covariances::new(&self.samples.points, &parameters)?.with_noise(&self.relative())
    }

    /// The parameters with the best score.
    fn parameters(&self) -> Option<KrigingParameters> {
        let first = self.spread(FIRST_SAMPLES);
        let trials = KERNELS
            .into_iter()
            .flat_map(|kernel| LENGTHS.map(|length| (kernel, length)));
        let best = best_of(trials.collect(), |(kernel, length)| {
            first.scored(KrigingParameters::new(kernel, [length; 2], 0, 0.0).ok()?)
        })?;
        let many = self.spread(MOST_SAMPLES);
        let neighbours = |of: KrigingParameters| {
            let steps = neighbours_of(of, 0.0).into_iter();
            steps.filter(|step| step.nugget() == 0.0 && *step != of).collect()
        };
        refined(best.parameters, MOST_ROUNDS, neighbours, |parameters| {
            many.scored(parameters)
        })
    }

    fn scored(&self, parameters: KrigingParameters) -> Option<Scored> {
        let score = self.score(parameters)?.score;
        Some(Scored { parameters, score })
    }

    /// Minus twice the logarithm of the density that the other samples give to a sample, in the sum over
    /// samples and components.
    fn score(&self, parameters: KrigingParameters) -> Option<NoisyScore> {
        let covariances = self.covariances(parameters)?;
        let width = self.samples.values.ncols();
        let mut best = vec![(f64::INFINITY, NUGGETS[0]); width];
        for nugget in NUGGETS {
            let Some(equations) = Equations::new(&covariances, nugget) else {
                continue;
            };
            let precisions = equations.precisions();
            let duals = equations.solve(self.samples.values.view()).duals;
            let ratio = equations.nugget_in_kernel() / self.mean_variance();
            for (best, dual) in best.iter_mut().zip(duals.columns()) {
                let (_, score) = best_variance(dual, &precisions, ratio);
                if score < best.0 {
                    *best = (score, nugget);
                }
            }
        }
        let score: f64 = best.iter().map(|(score, _)| score).sum();
        let nuggets = best.into_iter().map(|(_, nugget)| nugget).collect();
        score.is_finite().then_some(NoisyScore { score, nuggets })
    }
}

/// The variance `v` of a component's field that fits best, and its score: `sum_i ln(v / a_i) + c_i^2 / (a_i
/// v)`, with the duals `c` and the precisions `a`, and `(ln(v ratio) / SPREAD)^2` because `v ratio` is the
/// factor of the noise.
fn best_variance(dual: ArrayView1<'_, f64>, precisions: &[f64], ratio: f64) -> (f64, f64) {
    let count = precisions.len() as f64;
    let squares = dual.iter().zip(precisions).map(|(c, a)| c * c / a);
    let whole = squares.sum::<f64>().max(f64::MIN_POSITIVE);
    // The score is convex in t = ln v.
    let (mut t, prior) = ((whole / count).ln(), 1.0 / (SPREAD * SPREAD));
    let of_ratio = ratio.ln();
    for _ in 0..NEWTON_STEPS {
        let fit = whole * (-t).exp();
        let slope = count - fit + 2.0 * prior * (t + of_ratio);
        t -= (slope / (fit + 2.0 * prior)).clamp(-LARGEST_STEP, LARGEST_STEP);
    }
    let logarithms: f64 = precisions.iter().map(|a| a.ln()).sum();
    let score = count * t - logarithms + whole * (-t).exp() + prior * (t + of_ratio).powi(2);
    (t.exp(), score)
}

/// Newton's method converges in a few steps.
const NEWTON_STEPS: usize = 40;
const LARGEST_STEP: f64 = 2.0;
