//! What should hold, and whether it does.

use serde::Serialize;

use super::{ErrorSummary, Spread};

/// A limit and what was measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Target {
    /// The quantity.
    pub what: String,
    /// It should be below this.
    pub limit: f64,
    /// What it is; none where nothing could be measured.
    pub measured: Option<f64>,
    /// Whether it is below, and every object could be measured: those that could not would count for nothing else.
    pub met: bool,
}

/// 90 % of the differences of ellipticity (the paper: 0.0901), the largest of them, and MAE over the mean.
const ELLIPTICITY_Q90: f64 = 1e-3;
const ELLIPTICITY_LARGEST: f64 = 5e-3;
const MAE_OVER_MEAN: f64 = 2e-4;
/// What the paper reports for the first.
pub(super) const PAPER_ELLIPTICITY_Q90: f64 = 0.0901;

impl Target {
    fn new(what: String, limit: f64, measured: Option<f64>, all_measured: bool) -> Self {
        Self {
            what,
            limit,
            measured,
            met: all_measured && measured.is_some_and(|m| m < limit),
        }
    }

    /// The targets for objects of a kind.
    pub(super) fn of(kind: &str, summary: &ErrorSummary) -> Vec<Self> {
        let e = |of: fn(Spread) -> f64| summary.ellipticity.map(of);
        let all = summary.failed == 0;
        let kind = if all {
            kind.to_owned()
        } else {
            format!("{kind} ({} could not be measured)", summary.failed)
        };
        let mae = |of: fn(Spread) -> f64| summary.mae_over_mean.map(of);
        vec![
            Self::new(
                format!("{kind}: 90 % of the differences of ellipticity"),
                ELLIPTICITY_Q90,
                e(|s| s.q90),
                all,
            ),
            Self::new(
                format!("{kind}: largest difference of ellipticity"),
                ELLIPTICITY_LARGEST,
                e(|s| s.largest),
                all,
            ),
            Self::new(
                format!("{kind}: MAE / mean, mean over the objects"),
                MAE_OVER_MEAN,
                mae(|s| s.mean),
                all,
            ),
            Self::new(
                format!("{kind}: MAE / mean, largest of the objects"),
                MAE_OVER_MEAN,
                mae(|s| s.largest),
                all,
            ),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::ObjectRow;

    #[test]
    fn an_object_that_cannot_be_measured_meets_no_target() {
        let good = ObjectRow {
            ellipticity: Some(0.2),
            ellipticity_true: Some(0.2),
            mae_over_mean: Some(1e-6),
            ..ObjectRow::default()
        };
        let met = |rows: &[ObjectRow]| -> Vec<bool> {
            let targets = Target::of("stars", &ErrorSummary::of(rows));
            targets.iter().map(|target| target.met).collect()
        };
        assert_eq!(met(&[good.clone(), good.clone()]), [true; 4]);
        assert_eq!(met(&[good.clone(), ObjectRow::default()]), [false; 4]);
        let off = ObjectRow {
            ellipticity: Some(0.3),
            ..good.clone()
        };
        assert_eq!(met(&[good, off]), [false, false, true, true]);
    }
}
