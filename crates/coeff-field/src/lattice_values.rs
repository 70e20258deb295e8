//! The values at the nodes of a lattice, from those of the samples.

use ndarray::{Array1, Array2, ArrayView2, ArrayViewMut2, Axis, Zip};

use crate::interpolation::WeightList;

/// The errors at the samples count as rounding at this fraction of the largest value.
const EXACT: f64 = 2e-15;
/// The largest number of rounds in which these errors are removed.
const MOST_ROUNDS: usize = 200;
/// Conjugate gradients are repeated while the errors fall at least by this factor.
const MUST_FALL: f64 = 0.1;
/// The number of columns of values that are changed together. Few of them stay in the caches.
const COLUMNS: usize = 16;

/// Makes the values at a lattice's nodes from those of the samples.
///
/// The interpolator's own values are changed twice: so that errors in cells are about 0 in the mean
/// ([`centre_errors`](Self::centre_errors)), and so that there are none at the samples
/// ([`make_exact`](Self::make_exact)). Where the interpolator reproduces 1, x and y, linear fields need no
/// change, except around cells that cross the hull of the samples.
#[derive(Debug, Default)]
pub(crate) struct NodeValues {
    /// For each node, the weights that the interpolator gives to the samples there.
    pub(crate) own: Vec<WeightList>,
    pub(crate) middles: Vec<Middle>,
    /// For each sample, the weights of the nodes at its position.
    pub(crate) at_samples: Vec<WeightList>,
}

/// The middle of a cell.
#[derive(Debug)]
pub(crate) struct Middle {
    /// The weights that the interpolator gives to the samples there.
    pub(crate) own: WeightList,
    /// The weights of the nodes there.
    pub(crate) of_nodes: WeightList,
    /// The nodes at corners of the cell.
    pub(crate) nodes: Vec<usize>,
}

impl NodeValues {
    /// The values `[node, column]` from those of the samples, `[sample, column]`.
    pub(crate) fn at_nodes(&self, samples: ArrayView2<'_, f64>) -> Array2<f64> {
        let mut values = sums(&self.own, samples);
        self.centre_errors(&mut values, samples);
        let largest_error = EXACT * largest(samples);
        let parts = samples.axis_chunks_iter(Axis(1), COLUMNS);
        for (values, samples) in values.axis_chunks_iter_mut(Axis(1), COLUMNS).zip(parts) {
            self.make_exact(values, samples, largest_error);
        }
        values
    }

    /// Changes the nodes' values so that the errors in cells are about 0 in the mean.
    ///
    /// In a cell of width `h`, bilinear values of `c x^2 / 2` are off by up to `h^2 c / 8`, always with the
    /// same sign, and by `h^2 c / 12` in the mean. So each node is changed by two thirds of the mean
    /// error at the middles of the cells around it. That leaves 0.4 of the r.m.s. error.
    fn centre_errors(&self, values: &mut Array2<f64>, samples: ArrayView2<'_, f64>) {
        let mut changes = Array2::zeros(values.dim());
        let mut counts = Array1::<f64>::zeros(values.nrows());
        for middle in &self.middles {
            let mut error = Array1::zeros(values.ncols());
            for &(sample, weight) in &middle.own {
                error.scaled_add(weight, &samples.row(sample));
            }
            for &(node, weight) in &middle.of_nodes {
                error.scaled_add(-weight, &values.row(node));
            }
            for &node in &middle.nodes {
                counts[node] += 1.0;
                changes.row_mut(node).scaled_add(2.0 / 3.0, &error);
            }
        }
        *values += &(changes / counts.insert_axis(Axis(1)));
    }

    /// Changes the nodes' values by as little as possible, in the sum of squares, so that no error is
    /// left at the samples.
    ///
    /// With the matrix `B` of the nodes' weights at the samples, the change is `B^T m`, where the
    /// multipliers `m` solve `B B^T m = errors`. They are found by conjugate gradients for all columns at
    /// once, and again for the errors that rounding leaves. A change that does not reduce the errors is
    /// not made: rounding may give two samples the same weights.
    fn make_exact(
        &self,
        mut values: ArrayViewMut2<'_, f64>,
        samples: ArrayView2<'_, f64>,
        largest_error: f64,
    ) {
        let errors_of = |values: ArrayView2<'_, f64>| &samples - &sums(&self.at_samples, values);
        let mut errors = errors_of(values.view());
        while largest(errors.view()) > largest_error {
            let changed = &values + &self.spread(&self.multipliers(errors.clone(), largest_error));
            let left = errors_of(changed.view());
            if largest(left.view()) > MUST_FALL * largest(errors.view()) {
                return;
            }
            values.assign(&changed);
            errors = left;
        }
    }

    /// The multipliers of [`make_exact`](Self::make_exact).
    fn multipliers(&self, mut errors: Array2<f64>, largest_error: f64) -> Array2<f64> {
        let mut multipliers = Array2::zeros(errors.dim());
        let mut change = errors.clone();
        let mut size = products(&errors, &errors);
        for _ in 0..MOST_ROUNDS {
            if largest(errors.view()) <= largest_error {
                break;
            }
            let at_samples = sums(&self.at_samples, self.spread(&change).view());
            let length = ratios(&size, &products(&change, &at_samples));
            multipliers += &(&change * &length);
            errors -= &(at_samples * &length);
            let old = std::mem::replace(&mut size, products(&errors, &errors));
            change = change * &ratios(&size, &old) + &errors;
        }
        multipliers
    }

    /// For each node, the sum of rows that belong to the samples, with the node's weights there.
    fn spread(&self, rows: &Array2<f64>) -> Array2<f64> {
        let mut sums = Array2::zeros((self.own.len(), rows.ncols()));
        for (weights, row) in self.at_samples.iter().zip(rows.outer_iter()) {
            for &(node, weight) in weights {
                sums.row_mut(node).scaled_add(weight, &row);
            }
        }
        sums
    }
}

/// The sums of rows with the weights of each list.
fn sums(lists: &[WeightList], rows: ArrayView2<'_, f64>) -> Array2<f64> {
    let mut sums = Array2::zeros((lists.len(), rows.ncols()));
    for (mut sum, weights) in sums.outer_iter_mut().zip(lists) {
        for &(row, weight) in weights {
            sum.scaled_add(weight, &rows.row(row));
        }
    }
    sums
}

/// The scalar product of each column of `a` with that of `b`.
fn products(a: &Array2<f64>, b: &Array2<f64>) -> Array1<f64> {
    (a * b).sum_axis(Axis(0))
}

/// `a / b`, or 0 where `b` is 0.
fn ratios(a: &Array1<f64>, b: &Array1<f64>) -> Array1<f64> {
    Zip::from(a)
        .and(b)
        .map_collect(|&a, &b| if b > 0.0 { a / b } else { 0.0 })
}

fn largest(values: ArrayView2<'_, f64>) -> f64 {
    values.fold(0.0, |most, v| most.max(v.abs()))
}
