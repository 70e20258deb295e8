//! Median, 90 % and largest.

use metrics::Summary;
use serde::Serialize;

/// How large the absolute values of some differences are.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Spread {
    /// Half of them are below.
    pub median: f64,
    /// 90 % of them are below.
    pub q90: f64,
    /// The largest.
    pub largest: f64,
    /// Their mean.
    pub mean: f64,
}

impl Spread {
    /// Of the absolute values; none where there are no values, or one is not finite.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let summary = Summary::of(values.into_iter().map(f64::abs)).ok()?;
        Some(Self {
            median: summary.median(),
            q90: summary.quantile(0.9).ok()?,
            largest: summary.max(),
            mean: summary.mean(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signs_do_not_count() {
        let values = (-50..=50).map(f64::from);
        let spread = Spread::of(values).unwrap();
        assert_eq!(spread.largest, 50.0);
        assert_eq!(spread.median, 25.0);
        assert_eq!(spread.q90, 45.0);
        assert!((spread.mean - 2550.0 / 101.0).abs() < 1e-12);
        assert_eq!(Spread::of([]), None);
        assert_eq!(Spread::of([f64::NAN]), None);
    }
}
