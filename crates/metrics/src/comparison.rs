//! How far an image is from its reference.

use ndarray::{ArrayView, ArrayView3, Axis, Dimension};
use psf_types::Real;
use serde::Serialize;

use crate::MetricsError;
use crate::compensated_sum::CompensatedSum;

/// The difference of a result `F` from its reference `T`, arrays of equal shape and any number of dimensions.
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
/// Sums are taken in f64 with compensation, in row-major order, so they do not depend on the memory layout. Either array
/// may be `f32` or `f64`. Measures that exist for every pair are plain numbers, the others say why they do not exist.
///
/// Serialised, a comparison is a record of these measures, with `null` for those that do not exist.
///
/// ```
/// use metrics::Comparison;
/// use ndarray::array;
/// let comparison = Comparison::of(array![[3.0, 0.0]].view(), array![[3.0, 4.0]].view())?;
/// assert_eq!((comparison.mae(), comparison.mse(), comparison.max_abs()), (2.0, 8.0, 4.0));
/// assert_eq!(comparison.relative_l2()?, 0.8);
/// assert_eq!(comparison.max_abs_index(), [0, 1]);
/// # Ok::<(), metrics::MetricsError>(())
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
    /// [`MetricsError::ShapeMismatch`], [`MetricsError::Empty`], [`MetricsError::NonFinite`] for NaN or infinity in either
    /// array, [`MetricsError::Overflow`] when the squares exceed double precision.
    pub fn of<F: Real, T: Real, D: Dimension>(
        result: ArrayView<'_, F, D>,
        reference: ArrayView<'_, T, D>,
    ) -> Result<Self, MetricsError> {
        let shape = result.shape();
        if shape != reference.shape() {
            return Err(MetricsError::ShapeMismatch {
                result: shape.to_vec(),
                reference: reference.shape().to_vec(),
            });
        }
        if result.is_empty() {
            return Err(MetricsError::Empty);
        }
        let largest = largest_magnitude(&result)?.max(largest_magnitude(&reference)?);
        // A power of two costs no digits, and keeps squares of very small and very large values in range.
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

    /// Compares two cubes plane by plane along their first axis; [`Summary`](crate::Summary) condenses the outcome.
    ///
    /// # Errors
    /// As [`of`](Self::of), and what is wrong in a single plane comes as [`MetricsError::Plane`].
    pub fn by_plane<F: Real, T: Real>(
        result: ArrayView3<'_, F>,
        reference: ArrayView3<'_, T>,
    ) -> Result<Vec<Self>, MetricsError> {
        if result.shape() != reference.shape() {
            return Err(MetricsError::ShapeMismatch {
                result: result.shape().to_vec(),
                reference: reference.shape().to_vec(),
            });
        }
        if result.is_empty() {
            return Err(MetricsError::Empty);
        }
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

    /// Index of the largest error, in the arrays' order of axes; the first of several, all zeros when there is no error.
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

    /// Largest error over the reference's peak, `max abs(F - T) / max T`.
    ///
    /// # Errors
    /// [`MetricsError::ZeroReference`]; [`MetricsError::NonPositivePeak`] when no reference value is positive.
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

    /// Mean absolute error over the reference's mean, `mean abs(F - T) / mean T`.
    ///
    /// # Errors
    /// [`MetricsError::ZeroReference`]; [`MetricsError::NonPositiveMean`] when the reference's mean is not positive.
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

    /// Signal-to-noise ratio in decibels, `10 log10(P_signal / P_noise)`, where the signal is the reference and the noise
    /// is the error.
    ///
    /// # Errors
    /// [`MetricsError::ZeroReference`]; [`MetricsError::Identical`] when there is no error at all.
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

/// The largest absolute value, or where the array is not finite.
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

/// The index along each axis of the `i`-th value in row-major order.
fn unravel(mut i: usize, shape: &[usize]) -> Vec<usize> {
    let mut index: Vec<usize> = shape
        .iter()
        .rev()
        .map(|&n| {
            let along = i % n;
            i /= n;
            along
        })
        .collect();
    index.reverse();
    index
}
