//! How the limits follow from the pixels.

use std::str::FromStr;

use ndarray::ArrayView2;

use super::limits::two_numbers;
use super::zscale::zscale;
use super::{Limits, PreviewError};

/// Two percentiles: 0 to 100, the first below the second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Percentiles {
    low: f64,
    high: f64,
}

impl Percentiles {
    /// Checked percentiles.
    ///
    /// # Errors
    /// [`PreviewError::Percentiles`] unless 0 <= `low` < `high` <= 100.
    pub fn new(low: f64, high: f64) -> Result<Self, PreviewError> {
        if low >= 0.0 && low < high && high <= 100.0 {
            Ok(Self { low, high })
        } else {
            Err(PreviewError::Percentiles { low, high })
        }
    }
}

/// `LO,HI`.
impl FromStr for Percentiles {
    type Err = PreviewError;
    fn from_str(text: &str) -> Result<Self, PreviewError> {
        let [low, high] = two_numbers(text)?;
        Self::new(low, high)
    }
}

/// A rule for the limits. Only finite pixels count.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum LimitRule {
    /// Percentiles of the pixels, linear between neighbours: astropy's `AsymmetricPercentileInterval`.
    Percentile(Percentiles),
    /// These limits.
    Range(Limits),
    /// The median and a range about it from the slope of the sorted values, outliers left out: astropy's `ZScaleInterval`, as IRAF and ds9
    /// have it, with 1000 pixels and a contrast of 0.25.
    ZScale,
}

impl LimitRule {
    /// The limits for an image `[y, x]`.
    ///
    /// # Errors
    /// [`PreviewError::NoFinitePixel`]; [`PreviewError::Constant`] and [`PreviewError::EqualLimits`] where the rule gives no range.
    pub fn limits(self, image: ArrayView2<'_, f64>) -> Result<Limits, PreviewError> {
        if let Self::Range(limits) = self {
            return Ok(limits);
        }
        let finite: Vec<f64> = image.iter().copied().filter(|value| value.is_finite()).collect();
        if finite.is_empty() {
            return Err(PreviewError::NoFinitePixel { pixels: image.len() });
        }
        let mut sorted = finite.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        let (lowest, highest) = (sorted[0], sorted[sorted.len() - 1]);
        let (low, high, rule) = if let Self::Percentile(Percentiles { low, high }) = self {
            (
                percentile(&sorted, low),
                percentile(&sorted, high),
                format!("the range of the percentiles {low} and {high}"),
            )
        } else {
            let (low, high) = zscale(&finite);
            (low, high, "zscale".to_owned())
        };
        Limits::new(low, high).map_err(|_| {
            if lowest == highest {
                PreviewError::Constant { value: lowest }
            } else {
                PreviewError::EqualLimits {
                    rule,
                    value: low,
                    lowest,
                    highest,
                }
            }
        })
    }
}

/// Linear between the sorted values, as `numpy.percentile` has it.
fn percentile(sorted: &[f64], percent: f64) -> f64 {
    let last = sorted.len() - 1;
    let place = percent / 100.0 * last as f64;
    let below = (place.floor() as usize).min(last);
    let (low, high) = (sorted[below], sorted[(below + 1).min(last)]);
    low + (high - low) * (place - below as f64)
}

#[cfg(test)]
mod tests {
    use ndarray::{Array2, array};

    use super::*;

    /// Limits are compared with figures of 12 digits.
    const DIGITS: f64 = 1e-11;

    /// Values without a pattern, the same in every language: `(7919 i mod 1009)^2 / 1000`, with NaN and infinity among them.
    fn pixels() -> Array2<f64> {
        let mut image = Array2::from_shape_fn((37, 53), |(y, x)| {
            let value = (7919 * (53 * y + x) % 1009) as f64;
            value * value / 1000.0
        });
        image[[3, 4]] = f64::NAN;
        image[[5, 6]] = f64::INFINITY;
        image
    }

    fn agree(limits: Limits, low: f64, high: f64) {
        let near = |a: f64, b: f64| (a - b).abs() <= DIGITS * b.abs().max(1.0);
        assert!(near(limits.low(), low) && near(limits.high(), high), "{limits:?}");
    }

    // from astropy.visualization import AsymmetricPercentileInterval, ZScaleInterval; import numpy as np    (astropy 8.0.2)
    // a = ((7919*np.arange(37*53)) % 1009).astype(float)**2/1000; a = a.reshape(37, 53); a[3, 4] = np.nan; a[5, 6] = np.inf
    // AsymmetricPercentileInterval(2.5, 97).get_limits(a); ZScaleInterval().get_limits(a)
    #[test]
    fn limits_are_those_of_astropy() {
        let rule = LimitRule::Percentile("2.5,97".parse().unwrap());
        agree(rule.limits(pixels().view()).unwrap(), 0.62255, 956.484);
        agree(LimitRule::ZScale.limits(pixels().view()).unwrap(), 0.0, 1016.064);
    }

    // The same with stars and dead pixels, i = np.arange(4000): a = 100 + (7919*i % 1009)/100; a[::37] += (i[::37] % 511)**2/10; a[5::41] = 0
    // ZScaleInterval().get_limits(a.reshape(50, 80))
    #[test]
    fn zscale_leaves_stars_and_dead_pixels_out() {
        let image = Array2::from_shape_fn((50, 80), |(y, x)| {
            let i = 80 * y + x;
            let star = if i % 37 == 0 {
                ((i % 511) as f64).powi(2) / 10.0
            } else {
                0.0
            };
            if i % 41 == 5 {
                0.0
            } else {
                100.0 + (7919 * i % 1009) as f64 / 100.0 + star
            }
        });
        let limits = LimitRule::ZScale.limits(image.view()).unwrap();
        agree(limits, 83.845_566_230_5, 126.392_201_443);
    }

    #[test]
    fn zscale_of_a_few_pixels_is_their_range() {
        for few in [
            array![[3.0, 1.0, 4.0]],
            array![[3.0, 1.0, 4.0, 1.0, 5.0, 9.0, 2.0]],
        ] {
            let highest = few.iter().copied().fold(0.0, f64::max);
            agree(LimitRule::ZScale.limits(few.view()).unwrap(), 1.0, highest);
        }
    }

    #[test]
    fn what_has_no_contrast_is_said() {
        let percentile = LimitRule::Percentile(Percentiles::new(1.0, 99.0).unwrap());
        let flat = Array2::from_elem((4, 5), 7.5);
        let mut one = Array2::zeros((40, 50));
        one[[3, 3]] = 9.0;
        for rule in [percentile, LimitRule::ZScale] {
            assert_eq!(
                rule.limits(flat.view()),
                Err(PreviewError::Constant { value: 7.5 })
            );
            assert!(matches!(
                rule.limits(one.view()),
                Err(PreviewError::EqualLimits { highest: 9.0, .. })
            ));
            assert_eq!(
                rule.limits(array![[f64::NAN, f64::INFINITY]].view()),
                Err(PreviewError::NoFinitePixel { pixels: 2 })
            );
        }
        let given = LimitRule::Range(Limits::new(0.0, 1.0).unwrap());
        assert!(given.limits(flat.view()).is_ok());
    }
}
