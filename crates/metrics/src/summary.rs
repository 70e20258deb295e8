//! Quantiles and means of a list of measurements.

use serde::Serialize;

use crate::MetricsError;
use crate::compensated_sum::CompensatedSum;

/// Minimum, median, maximum, mean, root mean square and any quantile of a list of finite values.
///
/// ```
/// use metrics::Summary;
/// let summary = Summary::of([4.0, 1.0, 2.0, 3.0])?;
/// assert_eq!((summary.min(), summary.median(), summary.max()), (1.0, 2.5, 4.0));
/// assert_eq!(summary.quantile(0.9)?, 3.7);
/// # Ok::<(), metrics::MetricsError>(())
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
    /// Summarises `values`, in any order.
    ///
    /// # Errors
    /// [`MetricsError::Empty`]; [`MetricsError::NonFinite`]; [`MetricsError::Overflow`] when the squares exceed double
    /// precision.
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

    /// The value below which the fraction `q` of the values lies: linear between the sorted values, the first at `q = 0`
    /// and the last at `q = 1` (definition 7 of Hyndman & Fan 1996).
    ///
    /// # Errors
    /// [`MetricsError::Quantile`] when `q` is not in 0 to 1.
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
}
