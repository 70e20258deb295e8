//! Comparison of an image with its reference, and statistics of many numbers.

use ndarray::{ArrayView, ArrayView3, Axis, Dimension};
use psf_types::Real;
use psf_types::maths::unravel;
use serde::Serialize;

use crate::MetricsError;

/// Measures of the difference between a result `F` and its reference `T`. Both are arrays of equal
/// shape with any number of dimensions.
///
/// | measure | formula |
/// |---|---|
/// | [`mae`](Self::mae) | `mean abs(F - T)` |
/// | [`mse`](Self::mse) | `mean (F - T)^2` |
/// | [`relative_l2`](Self::relative_l2) | `norm(F - T) / norm(T)` |
/// | [`max_abs`](Self::max_abs) | `max abs(F - T)` |
/// | [`max_over_peak`](Self::max_over_peak) | `max abs(F - T) / max T` |
/// | [`mae_over_mean`](Self::mae_over_mean) | `mean abs(F - T) / mean T` |
/// | [`snr_db`](Self::snr_db) | `10 log10(P_signal / P_noise)`, `P_signal = mean T^2`, `P_noise = mean (F - T)^2` |
///
/// Sums are taken in f64 with compensation, in row-major order, so they do not depend on the memory
/// layout. Either array may be `f32` or `f64`. [`mae`](Self::mae), [`mse`](Self::mse) and
/// [`max_abs`](Self::max_abs) are defined for every pair of arrays. Each of the other measures
/// returns an error with the reason if it is not defined.
///
/// A serialised comparison holds all measures and the index of the largest error. A measure that is
/// not defined is `null`.
///
/// ```
/// use psf_metrics::Comparison;
/// use ndarray::array;
/// let comparison = Comparison::of(array![[3.0, 0.0]].view(), array![[3.0, 4.0]].view())?;
/// assert_eq!((comparison.mae(), comparison.mse(), comparison.max_abs()), (2.0, 8.0, 4.0));
/// assert_eq!(comparison.relative_l2()?, 0.8);
/// assert_eq!(comparison.max_abs_index(), [0, 1]);
/// # Ok::<(), psf_metrics::MetricsError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(into = "ComparisonRecord")]
pub struct Comparison {
    mae: f64,
    mse: f64,
    max_abs: f64,
    max_abs_index: Vec<usize>,
    relative_l2: f64,
    reference_peak: f64,
    reference_mean: f64,
    reference_is_zero: bool,
}

#[derive(Serialize)]
struct ComparisonRecord {
    mae: f64,
    mse: f64,
    relative_l2: Option<f64>,
    max_abs: f64,
    max_abs_index: Vec<usize>,
    max_over_peak: Option<f64>,
    mae_over_mean: Option<f64>,
    snr_db: Option<f64>,
}

impl Comparison {
    /// Compares `result` with `reference`.
    ///
    /// # Errors
    /// [`MetricsError::ShapeMismatch`], [`MetricsError::Empty`], [`MetricsError::NonFinite`] for
    /// NaN or infinity in either array, [`MetricsError::Overflow`] when a square exceeds the range
    /// of double precision.
    pub fn of<F: Real, T: Real, D: Dimension>(
        result: ArrayView<'_, F, D>,
        reference: ArrayView<'_, T, D>,
    ) -> Result<Self, MetricsError> {
        let shape = result.shape();
        check_shapes(shape, reference.shape())?;
        let largest = largest_magnitude(&result)?.max(largest_magnitude(&reference)?);
        // Scaling by a power of two loses no digits, and keeps squares of very small and very large
        // values in range.
        let scale = if largest >= f64::MIN_POSITIVE {
            largest.log2().floor().exp2()
        } else {
            1.0
        };
        let [mut error, mut error2, mut signal, mut signal2] = [CompensatedSum::default(); 4];
        let mut peak = f64::NEG_INFINITY;
        let (mut max_abs, mut max_at) = (0.0, 0);
        for (i, (f, t)) in result.iter().zip(reference.iter()).enumerate() {
            let t = t.as_f64();
            let (scaled, difference) = (t / scale, f.as_f64() / scale - t / scale);
            let size = difference.abs();
            error.add(size);
            error2.add(difference * difference);
            signal.add(scaled);
            signal2.add(scaled * scaled);
            peak = peak.max(t);
            if size > max_abs {
                (max_abs, max_at) = (size, i);
            }
        }
        let n = result.len() as f64;
        let (error2, signal2) = (error2.value(), signal2.value());
        let comparison = Self {
            mae: error.value() / n * scale,
            mse: error2 / n * scale * scale,
            max_abs: max_abs * scale,
            max_abs_index: unravel(max_at, shape),
            relative_l2: if signal2 > 0.0 {
                (error2 / signal2).sqrt()
            } else {
                0.0
            },
            reference_peak: peak,
            reference_mean: signal.value() / n * scale,
            reference_is_zero: signal2 == 0.0,
        };
        if comparison.mse.is_finite() && comparison.max_abs.is_finite() {
            Ok(comparison)
        } else {
            Err(MetricsError::Overflow { largest })
        }
    }

    /// Compares two cubes plane by plane along their first axis. [`Summary`] computes statistics of
    /// a measure over the planes.
    ///
    /// # Errors
    /// The errors of [`of`](Self::of). An error in a single plane is returned as
    /// [`MetricsError::Plane`].
    pub fn by_plane<F: Real, T: Real>(
        result: ArrayView3<'_, F>,
        reference: ArrayView3<'_, T>,
    ) -> Result<Vec<Self>, MetricsError> {
        check_shapes(result.shape(), reference.shape())?;
        let planes = result.axis_iter(Axis(0)).zip(reference.axis_iter(Axis(0)));
        planes
            .enumerate()
            .map(|(plane, (f, t))| {
                Self::of(f, t).map_err(|source| MetricsError::Plane {
                    plane,
                    source: Box::new(source),
                })
            })
            .collect()
    }

    /// Mean absolute error, `mean abs(F - T)`.
    pub fn mae(&self) -> f64 {
        self.mae
    }

    /// Mean squared error, `mean (F - T)^2`.
    pub fn mse(&self) -> f64 {
        self.mse
    }

    /// Largest error, `max abs(F - T)`.
    pub fn max_abs(&self) -> f64 {
        self.max_abs
    }

    /// Index of the largest error, in the arrays' order of axes. If several errors are equally
    /// large, this is the index of the first. If the arrays are equal, it is all zeros.
    pub fn max_abs_index(&self) -> &[usize] {
        &self.max_abs_index
    }

    /// Relative L2 error, `norm(F - T) / norm(T)`.
    ///
    /// # Errors
    /// [`MetricsError::ZeroReference`].
    pub fn relative_l2(&self) -> Result<f64, MetricsError> {
        if self.reference_is_zero {
            Err(MetricsError::ZeroReference)
        } else {
            Ok(self.relative_l2)
        }
    }

    /// Largest error relative to the reference's peak, `max abs(F - T) / max T`.
    ///
    /// # Errors
    /// [`MetricsError::ZeroReference`]. [`MetricsError::NonPositivePeak`] when no reference value
    /// is positive. [`MetricsError::Overflow`] when the quotient exceeds the range of double
    /// precision.
    pub fn max_over_peak(&self) -> Result<f64, MetricsError> {
        if self.reference_is_zero {
            Err(MetricsError::ZeroReference)
        } else if self.reference_peak > 0.0 {
            self.quotient(self.max_abs, self.reference_peak)
        } else {
            Err(MetricsError::NonPositivePeak {
                peak: self.reference_peak,
            })
        }
    }

    /// Mean absolute error relative to the reference's mean, `mean abs(F - T) / mean T`.
    ///
    /// # Errors
    /// [`MetricsError::ZeroReference`]. [`MetricsError::NonPositiveMean`] when the reference's mean
    /// is not positive. [`MetricsError::Overflow`] when the quotient exceeds the range of double
    /// precision.
    pub fn mae_over_mean(&self) -> Result<f64, MetricsError> {
        if self.reference_is_zero {
            Err(MetricsError::ZeroReference)
        } else if self.reference_mean > 0.0 {
            self.quotient(self.mae, self.reference_mean)
        } else {
            Err(MetricsError::NonPositiveMean {
                mean: self.reference_mean,
            })
        }
    }

    /// Signal-to-noise ratio in decibels, `10 log10(P_signal / P_noise)`, where the signal is the
    /// reference and the noise is the error.
    ///
    /// # Errors
    /// [`MetricsError::ZeroReference`]. [`MetricsError::Identical`] when there is no difference.
    pub fn snr_db(&self) -> Result<f64, MetricsError> {
        match self.relative_l2()? {
            0.0 => Err(MetricsError::Identical),
            relative => Ok(-20.0 * relative.log10()),
        }
    }

    fn quotient(&self, error: f64, reference: f64) -> Result<f64, MetricsError> {
        let quotient = error / reference;
        if quotient.is_finite() {
            Ok(quotient)
        } else {
            Err(MetricsError::Overflow {
                largest: self.max_abs,
            })
        }
    }
}

impl From<Comparison> for ComparisonRecord {
    fn from(c: Comparison) -> Self {
        Self {
            mae: c.mae,
            mse: c.mse,
            relative_l2: c.relative_l2().ok(),
            max_abs: c.max_abs,
            max_over_peak: c.max_over_peak().ok(),
            mae_over_mean: c.mae_over_mean().ok(),
            snr_db: c.snr_db().ok(),
            max_abs_index: c.max_abs_index,
        }
    }
}

/// Returns an error for arrays of unequal shapes, or without values.
fn check_shapes(result: &[usize], reference: &[usize]) -> Result<(), MetricsError> {
    if result != reference {
        return Err(MetricsError::ShapeMismatch {
            result: result.to_vec(),
            reference: reference.to_vec(),
        });
    }
    if result.contains(&0) {
        return Err(MetricsError::Empty);
    }
    Ok(())
}

/// Returns the largest absolute value, or an error with the index of a value that is not finite.
fn largest_magnitude<T: Real, D: Dimension>(array: &ArrayView<'_, T, D>) -> Result<f64, MetricsError> {
    let mut largest = 0.0_f64;
    for (i, v) in array.iter().enumerate() {
        if !v.is_finite() {
            return Err(MetricsError::NonFinite {
                index: unravel(i, array.shape()),
                value: v.as_f64(),
            });
        }
        largest = largest.max(v.as_f64().abs());
    }
    Ok(largest)
}

/// Minimum, median, maximum, mean, root mean square and any quantile of a list of finite values.
///
/// ```
/// use psf_metrics::Summary;
/// let summary = Summary::of([4.0, 1.0, 2.0, 3.0])?;
/// assert_eq!((summary.min(), summary.median(), summary.max()), (1.0, 2.5, 4.0));
/// assert_eq!(summary.quantile(0.9)?, 3.7);
/// # Ok::<(), psf_metrics::MetricsError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(into = "SummaryRecord")]
pub struct Summary {
    sorted: Vec<f64>,
    mean: f64,
    rms: f64,
}

#[derive(Serialize)]
struct SummaryRecord {
    count: usize,
    min: f64,
    median: f64,
    max: f64,
    mean: f64,
    rms: f64,
}

impl Summary {
    /// Summarises `values`. Their order does not matter.
    ///
    /// # Errors
    /// [`MetricsError::Empty`] or [`MetricsError::NonFinite`]. [`MetricsError::Overflow`] when a
    /// square exceeds the range of double precision.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Result<Self, MetricsError> {
        let mut sorted: Vec<f64> = values.into_iter().collect();
        if sorted.is_empty() {
            return Err(MetricsError::Empty);
        }
        if let Some(i) = sorted.iter().position(|v| !v.is_finite()) {
            return Err(MetricsError::NonFinite {
                index: vec![i],
                value: sorted[i],
            });
        }
        sorted.sort_unstable_by(f64::total_cmp);
        let [mut sum, mut squares] = [CompensatedSum::default(); 2];
        for &v in &sorted {
            sum.add(v);
            squares.add(v * v);
        }
        let n = sorted.len() as f64;
        let (mean, rms) = (sum.value() / n, (squares.value() / n).sqrt());
        if mean.is_finite() && rms.is_finite() {
            Ok(Self { sorted, mean, rms })
        } else {
            let largest = sorted[0].abs().max(sorted[sorted.len() - 1].abs());
            Err(MetricsError::Overflow { largest })
        }
    }

    /// Number of values.
    pub fn count(&self) -> usize {
        self.sorted.len()
    }

    /// Smallest value.
    pub fn min(&self) -> f64 {
        self.sorted[0]
    }

    /// Largest value.
    pub fn max(&self) -> f64 {
        self.sorted[self.sorted.len() - 1]
    }

    /// The middle value, or the mean of the two middle ones.
    pub fn median(&self) -> f64 {
        self.at(0.5)
    }

    /// Arithmetic mean.
    pub fn mean(&self) -> f64 {
        self.mean
    }

    /// Root of the mean square.
    pub fn rms(&self) -> f64 {
        self.rms
    }

    /// The value below which the fraction `q` of the values lies: the smallest value at `q = 0`,
    /// the largest at `q = 1`. The quantile is interpolated linearly between the sorted values
    /// (definition 7 of Hyndman & Fan 1996).
    ///
    /// # Errors
    /// [`MetricsError::Quantile`] when `q` is not between 0 and 1.
    pub fn quantile(&self, q: f64) -> Result<f64, MetricsError> {
        if (0.0..=1.0).contains(&q) {
            Ok(self.at(q))
        } else {
            Err(MetricsError::Quantile { got: q })
        }
    }

    fn at(&self, q: f64) -> f64 {
        let last = self.sorted.len() - 1;
        let place = q * last as f64;
        let below = (place.floor() as usize).min(last);
        let (low, high) = (self.sorted[below], self.sorted[(below + 1).min(last)]);
        low + (high - low) * (place - below as f64)
    }
}

impl From<Summary> for SummaryRecord {
    fn from(s: Summary) -> Self {
        Self {
            count: s.count(),
            min: s.min(),
            median: s.median(),
            max: s.max(),
            mean: s.mean,
            rms: s.rms,
        }
    }
}

/// A running sum whose rounding error does not grow with the number of terms.
///
/// Uses Neumaier's (1974) compensated summation with Knuth's branch-free two-sum. The relative
/// error of the result is about one rounding error, plus the square of the machine precision times
/// the condition number of the sum.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct CompensatedSum {
    sum: f64,
    lost: f64,
}

impl CompensatedSum {
    pub(crate) fn add(&mut self, term: f64) {
        let sum = self.sum + term;
        let taken = sum - self.sum;
        self.lost += (self.sum - (sum - taken)) + (term - taken);
        self.sum = sum;
    }

    pub(crate) fn value(self) -> f64 {
        self.sum + self.lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_linear_between_sorted_values() {
        let summary = Summary::of([30.0, 10.0, 20.0]).unwrap();
        for (q, expected) in [(0.0, 10.0), (0.25, 15.0), (0.5, 20.0), (0.75, 25.0), (1.0, 30.0)] {
            assert_eq!(summary.quantile(q).unwrap(), expected);
        }
        assert_eq!(Summary::of([7.0]).unwrap().quantile(0.3).unwrap(), 7.0);
        let summary = Summary::of([3.0, -4.0]).unwrap();
        assert_eq!((summary.mean(), summary.rms()), (-0.5, 12.5f64.sqrt()));
    }

    #[test]
    fn bad_lists_and_quantiles_are_refused() {
        assert_eq!(Summary::of([]).unwrap_err(), MetricsError::Empty);
        assert!(matches!(
            Summary::of([1.0, f64::NAN]),
            Err(MetricsError::NonFinite { index, .. }) if index == [1]
        ));
        assert!(matches!(Summary::of([1e200]), Err(MetricsError::Overflow { .. })));
        let summary = Summary::of([1.0, 2.0]).unwrap();
        for got in [-0.1, 1.1, f64::NAN] {
            assert!(matches!(
                summary.quantile(got),
                Err(MetricsError::Quantile { .. })
            ));
        }
    }

    #[test]
    fn small_terms_survive_large_ones() {
        let mut sum = CompensatedSum::default();
        for term in [1.0, 1e100, 1.0, -1e100] {
            sum.add(term);
        }
        assert_eq!(sum.value(), 2.0);
    }

    #[test]
    fn ten_million_tenths_add_up_to_exactly_one_million() {
        let mut sum = CompensatedSum::default();
        let mut plain = 0.0;
        for _ in 0..10_000_000 {
            sum.add(0.1);
            plain += 0.1;
        }
        assert_eq!(sum.value(), 1e6);
        assert_ne!(plain, 1e6);
    }
}
