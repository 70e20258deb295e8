//! Limits: the values that are shown darkest and brightest, and the rules that choose them.

use std::fmt;
use std::str::FromStr;

use ndarray::ArrayView2;
use psfield::readable;
use serde::Serialize;

use crate::preview::PreviewError;

/// The values shown darkest and brightest: both finite, the first below the second. Values outside
/// the limits are shown like the nearer limit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Limits {
    low: f64,
    high: f64,
}

impl Limits {
    /// Makes limits from the values shown darkest (`low`) and brightest (`high`).
    ///
    /// # Errors
    /// [`PreviewError::Setting`] unless both are finite and `low` is below `high`.
    pub fn new(low: f64, high: f64) -> Result<Self, PreviewError> {
        if low.is_finite() && high.is_finite() && low < high {
            Ok(Self { low, high })
        } else {
            Err(PreviewError::Setting(format!(
                "the limits {low} and {high} are not a range: two finite numbers are needed, the lower one first"
            )))
        }
    }

    /// `(value - low) / (high - low)`, clamped to the range from 0 to 1. NaN for NaN.
    ///
    /// ```
    /// use psfield_lab::preview::Limits;
    /// let limits = Limits::new(10.0, 30.0)?;
    /// assert_eq!([5.0, 15.0, 99.0].map(|v| limits.fraction(v)), [0.0, 0.25, 1.0]);
    /// # Ok::<(), psfield_lab::preview::PreviewError>(())
    /// ```
    pub fn fraction(self, value: f64) -> f64 {
        let span = self.high - self.low;
        let fraction = if span.is_finite() {
            (value - self.low) / span
        } else {
            // The limits are so far apart that their difference overflows.
            (value / 2.0 - self.low / 2.0) / (self.high / 2.0 - self.low / 2.0)
        };
        fraction.clamp(0.0, 1.0)
    }
}

/// Number of significant digits of values in messages.
pub(super) const FIGURES: usize = 6;

/// `LO to HI`, with six significant digits.
impl fmt::Display for Limits {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [low, high] = [self.low, self.high].map(|limit| readable(limit, FIGURES));
        write!(f, "{low} to {high}")
    }
}

/// `LO,HI`.
impl FromStr for Limits {
    type Err = PreviewError;
    fn from_str(text: &str) -> Result<Self, PreviewError> {
        two_numbers(text).and_then(|[low, high]| Self::new(low, high))
    }
}

fn two_numbers(text: &str) -> Result<[f64; 2], PreviewError> {
    let mut numbers = text.split(',').map(|number| number.trim().parse().ok());
    match (numbers.next().flatten(), numbers.next().flatten(), numbers.next()) {
        (Some(low), Some(high), None) => Ok([low, high]),
        _ => Err(PreviewError::Setting(
            "two numbers LO,HI are needed, as in 0.5,99.5".to_owned(),
        )),
    }
}

/// Two percentiles from 0 to 100, the first below the second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Percentiles {
    low: f64,
    high: f64,
}

impl Percentiles {
    /// Makes percentiles, for example 0.5 and 99.5.
    ///
    /// # Errors
    /// [`PreviewError::Setting`] unless 0 <= `low` < `high` <= 100.
    pub fn new(low: f64, high: f64) -> Result<Self, PreviewError> {
        if low >= 0.0 && low < high && high <= 100.0 {
            Ok(Self { low, high })
        } else {
            Err(PreviewError::Setting(format!(
                "the percentiles {low} and {high} are not two numbers from 0 to 100, the lower one first"
            )))
        }
    }
}

/// `LO,HI`.
impl FromStr for Percentiles {
    type Err = PreviewError;
    fn from_str(text: &str) -> Result<Self, PreviewError> {
        two_numbers(text).and_then(|[low, high]| Self::new(low, high))
    }
}

/// A rule that chooses limits. Only finite pixels count.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum LimitRule {
    /// Percentiles of the pixels, interpolated linearly between the sorted values: astropy's
    /// `AsymmetricPercentileInterval`.
    Percentile(Percentiles),
    /// The given limits.
    Range(Limits),
    /// A range around the median. The slope of the sorted values without outliers gives its width:
    /// astropy's `ZScaleInterval`, as in IRAF and ds9, with at most 1000 pixels and a contrast of
    /// 0.25.
    ZScale,
}

impl LimitRule {
    /// Returns the limits for an image `[y, x]`.
    ///
    /// # Errors
    /// [`PreviewError::NoFinitePixel`] if no pixel is finite. If the rule gives two equal limits:
    /// [`PreviewError::Constant`] if all finite pixels are equal, else
    /// [`PreviewError::EqualLimits`]. [`Range`](Self::Range) gives no error.
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
            let rule = format!("the range of the percentiles {low} and {high}");
            (percentile(&sorted, low), percentile(&sorted, high), rule)
        } else {
            let (low, high) = zscale(&finite);
            (low, high, "zscale".to_owned())
        };
        let (value, range) = (low, [lowest, highest]);
        Limits::new(low, high).map_err(|_| {
            if lowest == highest {
                PreviewError::Constant { value }
            } else {
                PreviewError::EqualLimits { rule, value, range }
            }
        })
    }
}

/// Returns a percentile of sorted values, interpolated linearly between neighbouring values, as in
/// `numpy.percentile`.
fn percentile(sorted: &[f64], percent: f64) -> f64 {
    let last = sorted.len() - 1;
    let place = percent / 100.0 * last as f64;
    let below = (place.floor() as usize).min(last);
    let (low, high) = (sorted[below], sorted[(below + 1).min(last)]);
    low + (high - low) * (place - below as f64)
}

/// Largest number of pixels that zscale samples.
const SAMPLES: usize = 1000;
/// zscale fits a line to the sorted samples, and divides the slope of the line by this contrast.
const CONTRAST: f64 = 0.25;
/// At least this fraction of the sampled pixels must follow the line, that is, not be rejected.
const MIN_KEPT_PART: f64 = 0.5;
/// At least this number of sampled pixels must follow the line.
const MIN_KEPT: usize = 5;
/// Pixels farther from the line than this number of standard deviations are rejected.
const REJECTION: f64 = 2.5;
/// Largest number of times that the line is fitted and pixels are rejected.
const ROUNDS: usize = 5;
/// The neighbours of a rejected pixel in the sorted list are rejected, too. This is the width of
/// the rejected range, as a fraction of the number of sampled pixels.
const GROWTH: f64 = 0.01;

/// Limits for finite values, at least one: IRAF's zscale in the form of astropy's `ZScaleInterval`
/// with its defaults.
///
/// A line is fitted to the `n` sorted samples as a function of their rank, without outliers. With
/// the `slope` of the line and the middle rank `centre`, the limits are
/// `median - (centre - 1) slope / contrast` and `median + (n - centre) slope / contrast`. They stay
/// between the lowest and the highest sample. If too few samples follow the line, the limits are
/// the lowest and the highest sample.
fn zscale(values: &[f64]) -> (f64, f64) {
    let stride = (values.len() / SAMPLES).max(1);
    let mut samples: Vec<f64> = values.iter().copied().step_by(stride).take(SAMPLES).collect();
    samples.sort_by(f64::total_cmp);
    let n = samples.len();
    let (lowest, highest) = (samples[0], samples[n - 1]);
    let least = MIN_KEPT.max((n as f64 * MIN_KEPT_PART) as usize);
    let Some(slope) = slope_of_most(&samples, least) else {
        return (lowest, highest);
    };
    let slope = slope / CONTRAST;
    let centre = (n - 1) / 2;
    let median = f64::midpoint(samples[centre], samples[n / 2]);
    (
        lowest.max(median - (centre as f64 - 1.0) * slope),
        highest.min(median + (n - centre) as f64 * slope),
    )
}

/// Returns the slope of the line that most samples follow. None if fewer than `least` samples
/// follow it.
fn slope_of_most(samples: &[f64], least: usize) -> Option<f64> {
    let n = samples.len();
    let growth = ((n as f64 * GROWTH) as usize).max(1);
    let mut rejected = vec![false; n];
    let (mut kept, mut kept_before) = (n, n + 1);
    let mut slope = None;
    for _ in 0..ROUNDS {
        if kept >= kept_before || kept < least {
            break;
        }
        // The least-squares line through the values that are not rejected, as a function of rank.
        let ranked = samples.iter().enumerate().zip(&rejected);
        let counting: Vec<(f64, f64)> = ranked
            .filter(|&(_, &rejected)| !rejected)
            .map(|((rank, &value), _)| (rank as f64, value))
            .collect();
        let count = counting.len() as f64;
        let mean = |of: fn(&(f64, f64)) -> f64| counting.iter().map(of).sum::<f64>() / count;
        let (rank_mean, value_mean) = (mean(|p| p.0), mean(|p| p.1));
        let (above, below) = counting.iter().fold((0.0, 0.0), |(above, below), (rank, value)| {
            let from = rank - rank_mean;
            (above + from * (value - value_mean), below + from * from)
        });
        let line = above / below;
        let residual = |rank: f64, value: f64| value - value_mean - line * (rank - rank_mean);
        // The mean of the residuals is 0, so their variance is the mean of their squares.
        let squares: f64 = counting.iter().map(|p| residual(p.0, p.1).powi(2)).sum();
        let threshold = REJECTION * (squares / count).sqrt();
        for (rank, (&value, rejected)) in samples.iter().zip(&mut rejected).enumerate() {
            *rejected |= residual(rank as f64, value).abs() > threshold;
        }
        rejected = grown(&rejected, growth);
        kept_before = kept;
        kept = rejected.iter().filter(|&&rejected| !rejected).count();
        slope = Some(line);
    }
    slope.filter(|_| kept >= least)
}

/// Also rejects the neighbours of rejected values, as
/// `numpy.convolve(rejected, ones(width), "same") > 0`.
fn grown(rejected: &[bool], width: usize) -> Vec<bool> {
    (0..rejected.len())
        .map(|i| {
            let first = i.saturating_sub(width / 2);
            let last = (i + (width - 1) / 2).min(rejected.len() - 1);
            rejected[first..=last].contains(&true)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, array};

    #[test]
    fn what_is_no_range_is_refused() {
        for (low, high) in [(1.0, 1.0), (2.0, 1.0), (f64::NAN, 1.0), (0.0, f64::INFINITY)] {
            assert!(Limits::new(low, high).is_err());
        }
        for text in ["", "1", "1,2,3", "a,2", "1;2"] {
            assert!(text.parse::<Limits>().is_err(), "{text}");
        }
        assert_eq!("-1.5, 2e3".parse(), Limits::new(-1.5, 2e3));
    }

    #[test]
    fn limits_are_read_without_rows_of_zeros() {
        let shown = |low, high| Limits::new(low, high).unwrap().to_string();
        assert_eq!(shown(-6.795_561_2e-16, 10.0), "-6.79556e-16 to 10");
        assert_eq!(shown(0.0, 65_535.0), "0 to 65535");
    }

    #[test]
    fn the_widest_limits_there_are() {
        let limits = Limits::new(-f64::MAX, f64::MAX).unwrap();
        assert_eq!(
            [-f64::MAX, 0.0, f64::MAX].map(|v| limits.fraction(v)),
            [0.0, 0.5, 1.0]
        );
        let tiny = Limits::new(0.0, 4e-323).unwrap();
        assert_eq!(tiny.fraction(2e-323), 0.5);
        assert!(tiny.fraction(f64::NAN).is_nan());
    }

    /// Limits are compared with reference values of 12 digits.
    const DIGITS: f64 = 1e-11;

    /// Values without a pattern, equal in every language: `(7919 i mod 1009)^2 / 1000`, with a NaN
    /// and an infinity.
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
        assert!(near(limits.low, low) && near(limits.high, high), "{limits:?}");
    }

    // From astropy 8.0.2:
    // ```python
    // from astropy.visualization import AsymmetricPercentileInterval, ZScaleInterval
    // a = ((7919 * np.arange(37 * 53)) % 1009).astype(float)**2 / 1000
    // a = a.reshape(37, 53)
    // a[3, 4], a[5, 6] = np.nan, np.inf
    // AsymmetricPercentileInterval(2.5, 97).get_limits(a)
    // ZScaleInterval().get_limits(a)
    // ```
    #[test]
    fn limits_are_those_of_astropy() {
        let rule = LimitRule::Percentile("2.5,97".parse().unwrap());
        agree(rule.limits(pixels().view()).unwrap(), 0.62255, 956.484);
        agree(LimitRule::ZScale.limits(pixels().view()).unwrap(), 0.0, 1016.064);
    }

    // From astropy 8.0.2, with stars and dead pixels:
    // ```python
    // i = np.arange(4000)
    // a = 100 + (7919 * i % 1009) / 100
    // a[::37] += (i[::37] % 511)**2 / 10
    // a[5::41] = 0
    // ZScaleInterval().get_limits(a.reshape(50, 80))
    // ```
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
                Err(PreviewError::EqualLimits {
                    range: [0.0, 9.0],
                    ..
                })
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
