//! Leave-one-out errors: every sample predicted from all others.

use ndarray::ArrayView2;
use psf_types::{FieldError, OutsidePolicy, SampleCoefficients, SamplePositions};
use thiserror::Error;

use crate::geometry::Outside;
use crate::{CoeffFieldError, FieldInterpolation, WeightList};

/// How well each sample is predicted by an interpolator that does not know it.
///
/// The error is `||a_predicted - a||_2` over the components. With an orthonormal basis that is the L2 norm of the
/// difference of the two stamps, in the units of the stamps. Where the field is sampled evenly, it overestimates the error
/// between samples: the gap to bridge is twice as wide, so a linear method does about four times worse.
///
/// ```
/// use coeff_field::{LeftOut, NaturalNeighbour, leave_one_out};
/// use psf_types::{OutsidePolicy, Position, SampleCoefficients, SamplePositions};
/// let positions = (0..5).map(|i| Position::of_pixel(i, 0)).collect();
/// let positions = SamplePositions::new(positions, None)?;
/// let squares = ndarray::array![[0.0], [1.0], [4.0], [9.0], [16.0]];
/// let samples = SampleCoefficients::new(squares, positions)?;
/// let errors = leave_one_out(&samples, &NaturalNeighbour, OutsidePolicy::Nearest)?;
/// // (1 + 9) / 2 predicts 4.
/// assert!(matches!(errors.outcomes()[2], LeftOut::Predicted { error } if error == 1.0));
/// // An end can only be extrapolated.
/// assert!(matches!(errors.outcomes()[4], LeftOut::Extrapolated { error } if error == 7.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct LeaveOneOut {
    outcomes: Vec<LeftOut>,
}

/// What came of leaving one sample out.
#[derive(Debug)]
#[non_exhaustive]
pub enum LeftOut {
    /// The others surround the sample and predict it.
    Predicted {
        /// L2 error over the components.
        error: f64,
    },
    /// The others do not cover the sample's position (a corner of the field): the outside policy made the prediction.
    Extrapolated {
        /// L2 error over the components.
        error: f64,
    },
    /// There is no prediction.
    Unpredictable {
        /// Why not.
        reason: Unpredictable,
    },
}

/// Why the others say nothing about a sample.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Unpredictable {
    /// They do not cover its position, and the policy is to refuse there.
    #[error("the other samples do not cover it")]
    OutsideSamples,
    /// There are no others.
    #[error("there is no other sample")]
    NoOthers,
    /// They do not determine the polynomial.
    #[error("the other samples do not determine the polynomial")]
    Undetermined,
    /// The interpolator cannot be prepared for them.
    #[error("the interpolator cannot be prepared without it")]
    NotPrepared(#[source] CoeffFieldError),
    /// The field has no value at its position.
    #[error("the field has no value there")]
    NoValue(#[source] FieldError),
}

impl LeaveOneOut {
    /// Collects outcomes, one for each sample.
    pub fn new(outcomes: Vec<LeftOut>) -> Self {
        Self { outcomes }
    }

    /// One outcome for each sample, in sample order.
    pub fn outcomes(&self) -> &[LeftOut] {
        &self.outcomes
    }

    /// (sample, error) of the samples predicted from around them; extrapolated ones are not among them.
    pub fn predicted(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.outcomes
            .iter()
            .enumerate()
            .filter_map(|(sample, outcome)| match outcome {
                LeftOut::Predicted { error } => Some((sample, *error)),
                _ => None,
            })
    }

    /// The predicted sample with the largest error; none when none could be predicted.
    pub fn worst(&self) -> Option<(usize, f64)> {
        self.predicted().max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Root mean square of the predicted samples' errors; none when none could be predicted.
    pub fn rms(&self) -> Option<f64> {
        let (count, sum) = self.predicted().fold((0_usize, 0.0), |(n, sum), (_, error)| {
            (n + 1, sum + error * error)
        });
        (count > 0).then(|| (sum / count as f64).sqrt())
    }
}

/// Predicts every sample from all others; the same as [`FieldInterpolation::leave_one_out`].
///
/// # Errors
/// [`CoeffFieldError`] when the method cannot serve these samples at all.
pub fn leave_one_out(
    samples: &SampleCoefficients,
    method: &dyn FieldInterpolation,
    outside: OutsidePolicy,
) -> Result<LeaveOneOut, CoeffFieldError> {
    method.leave_one_out(samples, outside)
}

/// The plain way: prepares the method anew without each sample.
pub(crate) fn by_rebuilding<M: FieldInterpolation + ?Sized>(
    method: &M,
    samples: &SampleCoefficients,
    outside: OutsidePolicy,
) -> Result<LeaveOneOut, CoeffFieldError> {
    method.prepare(samples.positions(), outside)?;
    let outcomes = (0..samples.positions().len()).map(|sample| {
        // Under the strict policy first, which tells interpolation from extrapolation.
        match rebuilt_without(method, samples, sample, OutsidePolicy::Error) {
            Ok(error) => LeftOut::Predicted { error },
            Err(Unpredictable::OutsideSamples) if outside != OutsidePolicy::Error => {
                match rebuilt_without(method, samples, sample, outside) {
                    Ok(error) => LeftOut::Extrapolated { error },
                    Err(reason) => LeftOut::Unpredictable { reason },
                }
            }
            Err(reason) => LeftOut::Unpredictable { reason },
        }
    });
    Ok(LeaveOneOut::new(outcomes.collect()))
}

fn rebuilt_without<M: FieldInterpolation + ?Sized>(
    method: &M,
    samples: &SampleCoefficients,
    left_out: usize,
    outside: OutsidePolicy,
) -> Result<f64, Unpredictable> {
    let all = samples.positions();
    let others: Vec<usize> = (0..all.len()).filter(|&sample| sample != left_out).collect();
    if others.is_empty() {
        return Err(Unpredictable::NoOthers);
    }
    let positions = others.iter().map(|&sample| all.as_slice()[sample]).collect();
    let positions = SamplePositions::new(positions, all.field()).expect("part of valid positions is valid");
    let weights_of = method
        .prepare(&positions, outside)
        .map_err(Unpredictable::NotPrepared)?;
    let values = samples.values().select(ndarray::Axis(0), &others);
    let nodes = weights_of
        .node_values(values.view())
        .map_err(Unpredictable::NotPrepared)?;
    let mut weights = WeightList::new();
    weights_of
        .weights_into(all.as_slice()[left_out], &mut weights)
        .map_err(|error| match error {
            FieldError::OutsideSamples { .. } => Unpredictable::OutsideSamples,
            other => Unpredictable::NoValue(other),
        })?;
    Ok(prediction_error(samples, left_out, nodes.view(), &weights))
}

/// The error of the prediction `sum_n w_n v_n` of a sample.
pub(crate) fn prediction_error(
    samples: &SampleCoefficients,
    sample: usize,
    nodes: ArrayView2<'_, f64>,
    weights: &WeightList,
) -> f64 {
    let truth = samples.values();
    let mut difference = truth.row(sample).mapv(|v| -v);
    for &(node, weight) in weights {
        difference.scaled_add(weight, &nodes.row(node));
    }
    difference.dot(&difference).sqrt()
}

/// What follows from a prediction's error and whether the others cover the sample.
pub(crate) fn judge(outside: Outside, covered: bool, error: f64) -> LeftOut {
    match (covered, outside) {
        (true, _) => LeftOut::Predicted { error },
        (false, Outside::Error) => LeftOut::Unpredictable {
            reason: Unpredictable::OutsideSamples,
        },
        (false, _) => LeftOut::Extrapolated { error },
    }
}
