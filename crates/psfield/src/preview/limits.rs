//! The values at the ends of the scale.

use std::fmt;
use std::str::FromStr;

use serde::Serialize;

use super::PreviewError;
use crate::readable::readable;

/// The value shown darkest and the one shown brightest: finite, the first below the second. What lies beyond is shown as the limit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Limits {
    low: f64,
    high: f64,
}

impl Limits {
    /// Checked limits.
    ///
    /// # Errors
    /// [`PreviewError::Range`] unless both are finite and `low` is below `high`.
    pub fn new(low: f64, high: f64) -> Result<Self, PreviewError> {
        if low.is_finite() && high.is_finite() && low < high {
            Ok(Self { low, high })
        } else {
            Err(PreviewError::Range { low, high })
        }
    }

    /// The value at the dark end.
    pub fn low(self) -> f64 {
        self.low
    }

    /// The value at the bright end.
    pub fn high(self) -> f64 {
        self.high
    }

    /// `(value - low) / (high - low)`, cut to 0 and 1; NaN for NaN.
    ///
    /// ```
    /// use psfield::preview::Limits;
    /// let limits = Limits::new(10.0, 30.0)?;
    /// assert_eq!([5.0, 15.0, 99.0].map(|v| limits.fraction(v)), [0.0, 0.25, 1.0]);
    /// # Ok::<(), psfield::preview::PreviewError>(())
    /// ```
    pub fn fraction(self, value: f64) -> f64 {
        let span = self.high - self.low;
        let fraction = if span.is_finite() {
            (value - self.low) / span
        } else {
            // Limits so far apart that their difference overflows.
            (value / 2.0 - self.low / 2.0) / (self.high / 2.0 - self.low / 2.0)
        };
        fraction.clamp(0.0, 1.0)
    }
}

/// Figures of a value that is shown to a reader.
pub(super) const FIGURES: usize = 6;

/// `LO to HI`, to six figures.
impl fmt::Display for Limits {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} to {}",
            readable(self.low, FIGURES),
            readable(self.high, FIGURES)
        )
    }
}

/// `LO,HI`.
impl FromStr for Limits {
    type Err = PreviewError;
    fn from_str(text: &str) -> Result<Self, PreviewError> {
        let [low, high] = two_numbers(text)?;
        Self::new(low, high)
    }
}

pub(super) fn two_numbers(text: &str) -> Result<[f64; 2], PreviewError> {
    let mut numbers = text.split(',').map(|number| number.trim().parse().ok());
    match (numbers.next().flatten(), numbers.next().flatten(), numbers.next()) {
        (Some(low), Some(high), None) => Ok([low, high]),
        _ => Err(PreviewError::NotTwoNumbers),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_range_is_refused() {
        for (low, high) in [(1.0, 1.0), (2.0, 1.0), (f64::NAN, 1.0), (0.0, f64::INFINITY)] {
            assert!(matches!(Limits::new(low, high), Err(PreviewError::Range { .. })));
        }
        for text in ["", "1", "1,2,3", "a,2", "1;2"] {
            assert_eq!(text.parse::<Limits>(), Err(PreviewError::NotTwoNumbers), "{text}");
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
}
