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
    /// Whether it is below.
    pub met: bool,
}

/// 90 % of the differences of ellipticity (the paper: 0.0901), the largest of them, and MAE over the mean.
const ELLIPTICITY_Q90: f64 = 1e-3;
const ELLIPTICITY_LARGEST: f64 = 5e-3;
const MAE_OVER_MEAN: f64 = 2e-4;
/// What the paper reports for the first.
pub(super) const PAPER_ELLIPTICITY_Q90: f64 = 0.0901;

impl Target {
    fn new(what: String, limit: f64, measured: Option<f64>) -> Self {
        Self {
            what,
            limit,
            measured,
            met: measured.is_some_and(|m| m < limit),
        }
    }

    /// The targets for objects of a kind.
    pub(super) fn of(kind: &str, summary: &ErrorSummary) -> Vec<Self> {
        let e = |of: fn(Spread) -> f64| summary.ellipticity.map(of);
        let mae = |of: fn(Spread) -> f64| summary.mae_over_mean.map(of);
        vec![
            Self::new(
                format!("{kind}: 90 % of the differences of ellipticity"),
                ELLIPTICITY_Q90,
                e(|s| s.q90),
            ),
            Self::new(
                format!("{kind}: largest difference of ellipticity"),
                ELLIPTICITY_LARGEST,
                e(|s| s.largest),
            ),
            Self::new(
                format!("{kind}: MAE / mean, mean over the objects"),
                MAE_OVER_MEAN,
                mae(|s| s.mean),
            ),
            Self::new(
                format!("{kind}: MAE / mean, largest of the objects"),
                MAE_OVER_MEAN,
                mae(|s| s.largest),
            ),
        ]
    }
}
