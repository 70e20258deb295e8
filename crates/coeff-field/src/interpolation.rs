//! The two traits of an interpolator (the method and its prepared weights), lists of weights, and
//! leave-one-out errors.

use std::fmt::Debug;
use std::sync::Arc;

use ndarray::{Array2, ArrayView2};
use psf_types::{
    BilinearCells, CoefficientField, DataError, ErrorLimit, FieldError, OutsidePolicy, PixelRegion, Position,
    RowRun, SampleCoefficients, SamplePositions,
};
use thiserror::Error;

use crate::error::CoeffFieldError;
use crate::geometry::{Hull, Point, Points, Row};

/// An interpolation method with its parameters. It makes a coefficient field from samples.
///
/// Implement this trait to add your own method. Everything in this crate accepts
/// `&dyn FieldInterpolation`. The field may be any [`CoefficientField`]. A method with few weights at each
/// position returns an [`InterpolatedField`](crate::InterpolatedField) of its [`FieldWeights`].
///
/// ```
/// use std::sync::Arc;
///
/// use coeff_field::{CoeffFieldError, FieldInterpolation};
/// use psf_types::{
///     CoefficientField, FieldError, OutsidePolicy, Position, SampleCoefficients, SamplePositions,
/// };
///
/// /// The mean of all samples, at every position.
/// #[derive(Debug)]
/// struct Mean;
/// #[derive(Debug)]
/// struct Constant(Vec<f64>);
///
/// impl FieldInterpolation for Mean {
///     fn interpolate(
///         &self,
///         samples: &SampleCoefficients,
///         _outside: OutsidePolicy,
///     ) -> Result<Arc<dyn CoefficientField>, CoeffFieldError> {
///         let mean = samples.values().mean_axis(ndarray::Axis(0)).expect("at least one sample");
///         Ok(Arc::new(Constant(mean.to_vec())))
///     }
/// }
/// impl CoefficientField for Constant {
///     fn component_count(&self) -> usize {
///         self.0.len()
///     }
///     fn evaluate_into(&self, _at: Position, coefficients: &mut [f64]) -> Result<(), FieldError> {
///         coefficients.copy_from_slice(&self.0);
///         Ok(())
///     }
/// }
///
/// let positions = SamplePositions::new(vec![Position::of_pixel(0, 0), Position::of_pixel(8, 0)], None)?;
/// let samples = SampleCoefficients::new(ndarray::array![[1.0], [3.0]], positions)?;
/// let field = Mean.interpolate(&samples, OutsidePolicy::Nearest)?;
/// let mut value = [0.0];
/// field.evaluate_into(Position::of_pixel(5, 5), &mut value)?;
/// assert_eq!(value, [2.0]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait FieldInterpolation: Debug + Send + Sync {
    /// Interpolates the samples of one state.
    ///
    /// # Errors
    /// [`CoeffFieldError`] when the samples do not suit the method.
    fn interpolate(
        &self,
        samples: &SampleCoefficients,
        outside: OutsidePolicy,
    ) -> Result<Arc<dyn CoefficientField>, CoeffFieldError>;

    /// Predicts every sample from all others. See [`LeaveOneOut`].
    ///
    /// The provided method interpolates again for each sample left out, which is slow for thousands of
    /// samples. The interpolators of this crate have shortcuts. Their results
    /// equal those of the provided method, with two exceptions: without one sample there is no
    /// regular grid, so [`Bilinear`](crate::Bilinear) and [`Bicubic`](crate::Bicubic) predict along
    /// the sample's row and column.
    ///
    /// # Errors
    /// [`CoeffFieldError`] when the method does not work for these samples at all. A sample that
    /// cannot be predicted is not an error. Its outcome is [`LeftOut::Unpredictable`].
    fn leave_one_out(
        &self,
        samples: &SampleCoefficients,
        outside: OutsidePolicy,
    ) -> Result<LeaveOneOut, CoeffFieldError> {
        self.interpolate(samples, outside)?;
        let without = |sample, policy| rebuilt_without(self, samples, sample, policy);
        // The policy `Error` is tried first, because it tells whether the other samples cover the
        // position.
        let predict = |sample| match without(sample, OutsidePolicy::Error) {
            Err(Unpredictable::OutsideSamples) if outside != OutsidePolicy::Error => {
                Ok((false, without(sample, outside)?))
            }
            found => Ok((true, found?)),
        };
        Ok(outcomes_of(samples, outside, predict))
    }
}

/// A prepared interpolator: weights of nodes at any position.
///
/// Every interpolator here is linear in the sample values, `a_k(x) = sum_n w_n(x) v_nk`, so a
/// position's weights serve all components. In most methods the nodes are the samples. A method may
/// have other nodes, such as the terms of a polynomial. Then [`node_values`](Self::node_values)
/// computes the values at the nodes from those at the samples.
pub trait FieldWeights: Debug + Send + Sync {
    /// The number of samples the interpolator was prepared for.
    fn sample_count(&self) -> usize;

    /// The number of nodes. The lists of weights refer to a node by its index, which is below this
    /// number.
    fn node_count(&self) -> usize {
        self.sample_count()
    }

    /// Returns the values at the nodes `[node, component]` for values at the samples
    /// `[sample, component]`. The provided method returns the sample values.
    ///
    /// # Errors
    /// [`DataError::CountMismatch`] when there is not one row per sample.
    fn node_values(&self, sample_values: ArrayView2<'_, f64>) -> Result<Array2<f64>, CoeffFieldError> {
        check_rows(self.sample_count(), sample_values)?;
        Ok(sample_values.to_owned())
    }

    /// Replaces the content of `weights` with the (node, weight) pairs at `position`. No node
    /// appears twice.
    ///
    /// The result depends only on the position, not on earlier calls.
    ///
    /// # Errors
    /// [`FieldError`] if there is no value at the position.
    fn weights_into(&self, position: Position, weights: &mut WeightList) -> Result<(), FieldError>;

    /// The division of a region into cells in which the coefficients are bilinear, up to an error.
    /// `values` are the [node values](Self::node_values). See
    /// [`CoefficientField::bilinear_cells`](psf_types::CoefficientField::bilinear_cells).
    fn bilinear_cells(
        &self,
        _values: ArrayView2<'_, f64>,
        region: PixelRegion,
        _error: ErrorLimit<'_>,
    ) -> BilinearCells {
        BilinearCells::every_row(region)
    }

    /// Calls `visit` with the weights at each of `positions` in turn. The weights equal those of
    /// [`weights_into`](Self::weights_into), but some interpolators compute them faster in
    /// sequence.
    ///
    /// # Errors
    /// [`FieldError`] at the first position without a value.
    fn weights_each(
        &self,
        positions: &mut dyn Iterator<Item = Position>,
        visit: &mut dyn FnMut(&WeightList),
    ) -> Result<(), FieldError> {
        let mut weights = WeightList::new();
        for position in positions {
            self.weights_into(position, &mut weights)?;
            visit(&weights);
        }
        Ok(())
    }

    /// Visits the weights along a row of `length` pixels that begins at `(x, y)`, in runs along
    /// which every node's weight is linear in x. See
    /// [`psf_types::WeightedNodes::weights_along_row`].
    ///
    /// A pixel's weights equal those of [`weights_into`](Self::weights_into) within rounding. The
    /// provided method visits pixel by pixel.
    ///
    /// ```
    /// use coeff_field::{Bilinear, FieldInterpolation};
    /// use psf_types::{OutsidePolicy, Position, SampleCoefficients, SamplePositions};
    /// let corners = [(0, 0), (4, 0), (0, 4), (4, 4)].map(|(x, y)| Position::of_pixel(x, y));
    /// let positions = SamplePositions::new(corners.to_vec(), None)?;
    /// let samples = SampleCoefficients::new(ndarray::Array2::zeros((4, 1)), positions)?;
    /// let field = Bilinear.interpolate(&samples, OutsidePolicy::Nearest)?;
    /// let weights = field.weighted_nodes().expect("four weights at each position");
    /// let mut runs = Vec::new();
    /// weights.weights_along_row((-2, 0), 10, &mut |run| runs.push((run.length, run.last.to_vec())))?;
    /// // Left of the cell, inside the cell (with its left and right edges), and right of the cell.
    /// assert_eq!(runs, [(2, vec![(0, 1.0)]), (5, vec![(1, 1.0)]), (3, vec![(1, 1.0)])]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`FieldError`] at the first pixel without a value, after all pixels before it have been
    /// visited.
    fn weights_along_row(
        &self,
        start: (i64, i64),
        length: usize,
        visit: &mut dyn FnMut(RowRun<'_>),
    ) -> Result<(), FieldError> {
        pixel_by_pixel(self, Row::new(start, length), visit)
    }
}

/// The result of [`FieldInterpolation::interpolate`].
pub(crate) type Interpolated = Result<Arc<dyn CoefficientField>, CoeffFieldError>;
/// The result of [`FieldInterpolation::leave_one_out`].
pub(crate) type Outcomes = Result<LeaveOneOut, CoeffFieldError>;
/// The result of visiting pixels, which stops at the first one without a value.
pub(crate) type Visited = Result<(), FieldError>;
/// Receives the runs of a row, one after the other.
pub(crate) type OnRun<'a> = &'a mut dyn FnMut(RowRun<'_>);

/// Visits a row in runs of one pixel.
pub(crate) fn pixel_by_pixel<W: FieldWeights + ?Sized>(weights: &W, row: Row, visit: OnRun<'_>) -> Visited {
    let mut positions = (0..row.length).map(|column| row.position(column));
    weights.weights_each(&mut positions, &mut |weights| visit(RowRun::of_pixel(weights)))
}

/// Returns [`FieldError::OutsideSamples`] if the position is not covered and the policy is `Error`.
pub(crate) fn admit(covered: bool, outside: OutsidePolicy, position: Position) -> Result<(), FieldError> {
    if covered || outside != OutsidePolicy::Error {
        Ok(())
    } else {
        Err(FieldError::OutsideSamples { position })
    }
}

/// Visits a row in runs. Each run extends from a column to the one before `end_of(column)`.
/// `weights_into` writes the weights at the first and the last column of a run.
pub(crate) fn in_runs(
    row: Row,
    mut weights_into: impl FnMut(usize, &mut WeightList) -> Result<(), FieldError>,
    mut end_of: impl FnMut(usize) -> usize,
    visit: OnRun<'_>,
) -> Visited {
    let (mut first, mut last) = (WeightList::new(), WeightList::new());
    let mut column = 0;
    while column < row.length {
        weights_into(column, &mut first)?;
        let end = end_of(column);
        if end == column + 1 {
            visit(RowRun::of_pixel(&first));
        } else {
            weights_into(end - 1, &mut last)?;
            visit(RowRun {
                length: end - column,
                first: &first,
                last: &last,
            });
        }
        column = end;
    }
    Ok(())
}

pub(crate) fn check_rows(samples: usize, values: ArrayView2<'_, f64>) -> Result<(), DataError> {
    DataError::check_count(
        "rows of sample values, one for each sample",
        samples,
        values.nrows(),
    )
}

/// (node, weight) pairs at one position.
pub type WeightList = Vec<(usize, f64)>;

/// Adds to a node's weight. The search for the node is linear, because lists are short.
pub(crate) fn add_weight(weights: &mut WeightList, node: usize, weight: f64) {
    if weight == 0.0 {
        return;
    }
    match weights.iter_mut().find(|(n, _)| *n == node) {
        Some((_, w)) => *w += weight,
        None => weights.push((node, weight)),
    }
}

/// Replaces the list by one node with weight 1.
pub(crate) fn single(weights: &mut WeightList, node: usize) {
    weights.clear();
    weights.push((node, 1.0));
}

/// Replaces the list by two nodes, the first with weight `1 - s` and the second with weight `s`.
/// Nodes with weight 0 are omitted.
pub(crate) fn pair(weights: &mut WeightList, first: usize, second: usize, s: f64) {
    weights.clear();
    if s != 1.0 {
        weights.push((first, 1.0 - s));
    }
    if s != 0.0 {
        weights.push((second, s));
    }
}

/// The error of predicting each sample by an interpolator that is prepared from all other samples.
///
/// The error is `||a_predicted - a||_2` over the components. With an orthonormal basis, this is the
/// L2 norm of the difference between the stamps with the coefficients `a_predicted` and `a`, in the
/// units of the stamps. On an even sampling, this error is larger than the error between samples.
/// Without the sample the local spacing is twice as wide, so a linear method has about four times
/// the error.
///
/// ```
/// use coeff_field::{LeftOut, NaturalNeighbour, leave_one_out};
/// use psf_types::{OutsidePolicy, Position, SampleCoefficients, SamplePositions};
/// let positions = (0..5).map(|i| Position::of_pixel(i, 0)).collect();
/// let positions = SamplePositions::new(positions, None)?;
/// let squares = ndarray::array![[0.0], [1.0], [4.0], [9.0], [16.0]];
/// let samples = SampleCoefficients::new(squares, positions)?;
/// let errors = leave_one_out(&samples, &NaturalNeighbour, OutsidePolicy::Nearest)?;
/// // The neighbours predict (1 + 9) / 2 = 5, but the value is 4.
/// assert!(matches!(errors.outcomes()[2], LeftOut::Predicted { error } if error == 1.0));
/// // An end can only be extrapolated.
/// assert!(matches!(errors.outcomes()[4], LeftOut::Extrapolated { error } if error == 7.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct LeaveOneOut {
    outcomes: Vec<LeftOut>,
}

/// The result of leaving one sample out.
#[derive(Debug)]
#[non_exhaustive]
pub enum LeftOut {
    /// The other samples cover this sample's position and predict its value.
    Predicted {
        /// L2 error over the components.
        error: f64,
    },
    /// The other samples do not cover this sample's position, for example at a corner of the field.
    /// The prediction follows the outside policy.
    Extrapolated {
        /// L2 error over the components.
        error: f64,
    },
    /// There is no prediction.
    Unpredictable {
        /// The reason.
        reason: Unpredictable,
    },
}

/// The reason why a sample cannot be predicted from the others.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Unpredictable {
    /// The others do not cover the sample's position, and the outside policy is `Error`.
    #[error("the other samples do not cover this sample's position")]
    OutsideSamples,
    /// There are no other samples.
    #[error("there is no other sample")]
    NoOthers,
    /// The others do not determine the interpolation.
    #[error("the other samples do not determine the interpolation")]
    Undetermined,
    /// The interpolator cannot be prepared without the sample.
    #[error("the interpolator cannot be prepared without this sample")]
    NotPrepared(#[source] CoeffFieldError),
    /// The field prepared without the sample has no value at the sample's position.
    #[error("the field has no value at this sample's position")]
    NoValue(#[source] FieldError),
}

impl LeaveOneOut {
    /// Stores the outcomes, one for each sample.
    pub fn new(outcomes: Vec<LeftOut>) -> Self {
        Self { outcomes }
    }

    /// Stores predictions of coefficients `[sample, component]`, each made without its sample. A
    /// prediction with a value that is not finite counts as none. Samples at the corners of the convex
    /// hull of their state are extrapolated.
    ///
    /// # Errors
    /// [`DataError::CountMismatch`] when there is not one prediction for each coefficient, and the
    /// errors of sample positions.
    pub fn of_predictions(
        samples: &SampleCoefficients,
        predictions: ArrayView2<'_, f64>,
    ) -> Result<Self, CoeffFieldError> {
        let (positions, values) = (samples.positions(), samples.values());
        check_rows(positions.len(), predictions)?;
        let what = "predicted coefficients of each sample";
        DataError::check_count(what, values.ncols(), predictions.ncols())?;
        let mut is_corner = vec![false; positions.len()];
        for state in 0..positions.state_count() {
            let of_state = match positions.states() {
                Some(_) => positions.of_state(state),
                None => positions.clone(),
            };
            let hull = Hull::new(&Points::new(&of_state)?, OutsidePolicy::Nearest)?;
            for (index, sample) in positions.samples_of_state(state).into_iter().enumerate() {
                is_corner[sample] = hull.is_corner(index);
            }
        }
        let outcomes = is_corner.into_iter().enumerate().map(|(sample, is_corner)| {
            let error = &predictions.row(sample) - &values.row(sample);
            match error.dot(&error).sqrt() {
                error if !error.is_finite() => LeftOut::Unpredictable {
                    reason: Unpredictable::Undetermined,
                },
                error if is_corner => LeftOut::Extrapolated { error },
                error => LeftOut::Predicted { error },
            }
        });
        Ok(Self::new(outcomes.collect()))
    }

    /// The outcomes, one for each sample, in sample order.
    pub fn outcomes(&self) -> &[LeftOut] {
        &self.outcomes
    }

    /// The (sample, error) pairs of predicted samples. Extrapolated and unpredictable samples are
    /// omitted.
    pub fn predicted(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.outcomes
            .iter()
            .enumerate()
            .filter_map(|(sample, outcome)| match outcome {
                LeftOut::Predicted { error } => Some((sample, *error)),
                _ => None,
            })
    }

    /// The predicted sample with the largest error, or `None` if no sample was predicted.
    pub fn worst(&self) -> Option<(usize, f64)> {
        self.predicted().max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Root mean square of the predicted samples' errors, or `None` if no sample was predicted.
    pub fn rms(&self) -> Option<f64> {
        let (count, sum) = self.predicted().fold((0_usize, 0.0), |(n, sum), (_, error)| {
            (n + 1, sum + error * error)
        });
        (count > 0).then(|| (sum / count as f64).sqrt())
    }
}

/// Predicts every sample from all others of its state by [`FieldInterpolation::leave_one_out`].
///
/// # Errors
/// [`CoeffFieldError`] when the method does not work for these samples at all.
pub fn leave_one_out(
    samples: &SampleCoefficients,
    method: &dyn FieldInterpolation,
    outside: OutsidePolicy,
) -> Result<LeaveOneOut, CoeffFieldError> {
    let positions = samples.positions();
    if positions.states().is_none() {
        return method.leave_one_out(samples, outside);
    }
    let mut outcomes: Vec<Option<LeftOut>> = (0..positions.len()).map(|_| None).collect();
    for state in 0..positions.state_count() {
        let found = method.leave_one_out(&samples.of_state(state), outside)?;
        for (sample, outcome) in positions.samples_of_state(state).into_iter().zip(found.outcomes) {
            outcomes[sample] = Some(outcome);
        }
    }
    let every = outcomes
        .into_iter()
        .map(|outcome| outcome.expect("every sample has a state"));
    Ok(LeaveOneOut::new(every.collect()))
}

/// The error of predicting a sample by a method prepared without this sample.
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
    let positions = SamplePositions::new(positions, all.field()).expect("a subset stays valid");
    let values = samples.values().select(ndarray::Axis(0), &others);
    let others = SampleCoefficients::new(values, positions).expect("a subset stays valid");
    let field = method
        .interpolate(&others, outside)
        .map_err(Unpredictable::NotPrepared)?;
    let mut predicted = vec![0.0; field.component_count()];
    field
        .evaluate_into(all.as_slice()[left_out], &mut predicted)
        .map_err(|error| match error {
            FieldError::OutsideSamples { .. } => Unpredictable::OutsideSamples,
            other => Unpredictable::NoValue(other),
        })?;
    let error = ndarray::Array1::from(predicted) - samples.values().row(left_out);
    Ok(error.dot(&error).sqrt())
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

/// Calls `predict` for each sample, and turns the results into outcomes. `predict` returns whether
/// the other samples cover this sample's position, and the error of the prediction.
pub(crate) fn outcomes_of(
    samples: &SampleCoefficients,
    outside: OutsidePolicy,
    mut predict: impl FnMut(usize) -> Result<(bool, f64), Unpredictable>,
) -> LeaveOneOut {
    let outcomes = (0..samples.positions().len()).map(|sample| match predict(sample) {
        Ok((true, error)) => LeftOut::Predicted { error },
        Ok((false, _)) if outside == OutsidePolicy::Error => LeftOut::Unpredictable {
            reason: Unpredictable::OutsideSamples,
        },
        Ok((false, error)) => LeftOut::Extrapolated { error },
        Err(reason) => LeftOut::Unpredictable { reason },
    });
    LeaveOneOut::new(outcomes.collect())
}

/// Predicts each sample by a method that uses the hull. The outside policy, applied to the hull of
/// the other samples, gives the point at which to evaluate the method. `predict` returns the error
/// of the value at that point.
pub(crate) fn hull_leave_one_out(
    samples: &SampleCoefficients,
    points: &Points,
    outside: OutsidePolicy,
    mut predict: impl FnMut(usize, Point) -> Result<f64, Unpredictable>,
) -> Outcomes {
    let hull = Hull::new(points, outside)?;
    Ok(outcomes_of(samples, outside, |sample| {
        let p = points.points[sample];
        if points.len() == 1 {
            return Err(Unpredictable::NoOthers);
        }
        // The hull of the other samples covers this sample's position, unless the sample is a
        // corner of the hull of all samples.
        let (covered, at) = if hull.is_corner(sample) {
            let others = points.subset((0..points.len()).filter(|&s| s != sample));
            let hull = Hull::new(&others, outside).map_err(Unpredictable::NotPrepared)?;
            match hull.admit(samples.positions().as_slice()[sample]) {
                Ok(at) => (hull.covers(p), at),
                Err(_) => (false, p),
            }
        } else {
            (true, p)
        };
        Ok((covered, predict(sample, at)?))
    }))
}
