//! Summarises the differences between simulated and true objects, and compares them with targets.

use metrics::Summary;
use ndarray::Array2;
use psf_types::{FrameShape, Position};
use rayon::prelude::*;
use serde::Serialize;

use crate::report::{Histogram, ObjectRow};

/// Objects of one kind, each measured in the simulated and in the true image.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Evaluation {
    /// The differences between simulated and true objects.
    pub summary: ErrorSummary,
    /// Absolute differences of the eccentricity `sqrt(1 - b^2 / a^2)`.
    pub eccentricity_differences: Histogram,
    /// FWHM along rows in pixels of the frame: of the true objects, then of the simulated ones.
    pub fwhm_rows_px: [Histogram; 2],
    /// FWHM along columns in pixels of the frame: of the true objects, then of the simulated ones.
    pub fwhm_columns_px: [Histogram; 2],
    /// Mean absolute error (MAE) in the window of each object, divided by the mean of the true
    /// window.
    pub mae_over_mean: Histogram,
    /// One row per object.
    #[serde(skip)]
    pub rows: Vec<ObjectRow>,
    /// The frame, if it is known.
    #[serde(skip)]
    pub frame: Option<FrameShape>,
    /// Number of columns if the objects form a grid.
    #[serde(skip)]
    pub grid_columns: Option<usize>,
}

const BINS: usize = 50;

impl Evaluation {
    /// Measures pairs of windows: one simulated and one true window for each position. The windows
    /// have `oversampling` pixels per frame pixel along each axis.
    pub fn measure(
        positions: &[Position],
        simulated: &[Array2<f64>],
        truth: &[Array2<f64>],
        oversampling: f64,
        frame: Option<FrameShape>,
        grid_columns: Option<usize>,
    ) -> Self {
        let objects = positions.par_iter().zip(simulated.par_iter().zip(truth));
        let rows: Vec<ObjectRow> = objects
            .map(|(&at, (ours, theirs))| ObjectRow::measure(at, ours.view(), theirs.view(), oversampling))
            .collect();
        let values = |of: fn(&ObjectRow) -> Option<f64>| rows.iter().filter_map(of).collect::<Vec<f64>>();
        let from_zero = |values: Vec<f64>| {
            let most = values.iter().copied().fold(0.0, f64::max);
            Histogram::new(values, (0.0, if most > 0.0 { most } else { 1.0 }), BINS)
        };
        let pair = |a: fn(&ObjectRow) -> Option<f64>, b: fn(&ObjectRow) -> Option<f64>| {
            Histogram::of_all([&values(a), &values(b)], BINS)
        };
        Self {
            summary: ErrorSummary::of(&rows),
            eccentricity_differences: from_zero(values(|r| r.eccentricity_difference().map(f64::abs))),
            fwhm_rows_px: pair(|r| r.fwhm_rows_px_true, |r| r.fwhm_rows_px),
            fwhm_columns_px: pair(|r| r.fwhm_columns_px_true, |r| r.fwhm_columns_px),
            mae_over_mean: from_zero(values(|r| r.mae_over_mean)),
            rows,
            frame,
            grid_columns,
        }
    }
}

/// The differences between simulated and true objects.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ErrorSummary {
    /// Number of objects.
    pub objects: usize,
    /// Number of objects whose measurement failed in at least one of the two images. The
    /// differences of shape leave these objects out.
    pub failed: usize,
    /// Differences of the eccentricity `sqrt(1 - b^2 / a^2)`, which the paper (Bai, Jia et al.
    /// 2025) calls ellipticity.
    pub eccentricity: Option<Spread>,
    /// Differences of `e1` of the distortion.
    pub e1: Option<Spread>,
    /// Differences of `e2` of the distortion.
    pub e2: Option<Spread>,
    /// Differences of the FWHM in pixels of the frame.
    pub fwhm_px: Option<Spread>,
    /// Mean absolute error divided by the mean of the true window.
    pub mae_over_mean: Option<Spread>,
    /// Mean squared error, in squared units of the image.
    pub mse: Option<Spread>,
    /// Relative L2 error.
    pub relative_l2: Option<Spread>,
    /// Largest absolute error divided by the peak of the true image.
    pub max_over_peak: Option<Spread>,
}

impl ErrorSummary {
    /// Summarises the differences of objects.
    pub fn of(rows: &[ObjectRow]) -> Self {
        let spread = |of: fn(&ObjectRow) -> Option<f64>| Spread::of(rows.iter().filter_map(of));
        Self {
            objects: rows.len(),
            failed: rows
                .iter()
                .filter(|r| r.eccentricity_difference().is_none())
                .count(),
            eccentricity: spread(ObjectRow::eccentricity_difference),
            e1: spread(ObjectRow::e1_difference),
            e2: spread(ObjectRow::e2_difference),
            fwhm_px: spread(ObjectRow::fwhm_difference_px),
            mae_over_mean: spread(|r| r.mae_over_mean),
            mse: spread(|r| r.mse),
            relative_l2: spread(|r| r.relative_l2),
            max_over_peak: spread(|r| r.max_over_peak),
        }
    }
}

/// The distribution of absolute differences.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Spread {
    /// Half of the values are below this value.
    pub median: f64,
    /// 90 % of the values are below this value.
    pub q90: f64,
    /// The largest value.
    pub largest: f64,
    /// The mean value.
    pub mean: f64,
}

impl Spread {
    /// Returns the spread of the absolute values. None if there are no values, or if at least one
    /// of them is not finite.
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

/// A target: a limit, and the measured value that should be below it.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Target {
    /// The name of the quantity.
    pub what: String,
    /// The measured value should be below this limit.
    pub limit: f64,
    /// The measured value. None if nothing could be measured.
    pub measured: Option<f64>,
    /// True if the value is below the limit and every object could be measured. Objects that could
    /// not be measured would otherwise be ignored.
    pub met: bool,
}

/// Target for 90 % of the differences of eccentricity.
const ECCENTRICITY_Q90: f64 = 1e-3;
/// Target for the largest difference of eccentricity.
const ECCENTRICITY_LARGEST: f64 = 5e-3;
/// Target for MAE divided by the mean of the window: for the average over all objects and for the
/// largest.
const MAE_OVER_MEAN: f64 = 2e-4;
/// The difference of eccentricity that 90 % of the objects in the paper do not exceed.
pub(super) const PAPER_ECCENTRICITY_Q90: f64 = 0.0901;

impl Target {
    /// Compares a measured value with its limit. None: not everything could be measured.
    pub(super) fn new(what: &str, limit: f64, measured: Option<f64>) -> Self {
        Self {
            what: what.to_owned(),
            limit,
            measured,
            met: measured.is_some_and(|m| m < limit),
        }
    }

    /// Compares a summary with the targets. `kind` names the objects, such as `stars`.
    pub(super) fn of(kind: &str, summary: &ErrorSummary) -> Vec<Self> {
        let (eccentricity, mae) = (summary.eccentricity, summary.mae_over_mean);
        let failed = match summary.failed {
            0 => String::new(),
            failed => format!(" ({failed} could not be measured)"),
        };
        let of = |what: &str, limit, measured| {
            let target = Self::new(&format!("{kind}{failed}: {what}"), limit, measured);
            Self {
                met: target.met && summary.failed == 0,
                ..target
            }
        };
        let mae_target = |over: &str, measured| {
            let what = format!("mean absolute error / window mean, {over} over objects");
            of(&what, MAE_OVER_MEAN, measured)
        };
        vec![
            of(
                "difference of eccentricity, 90th percentile",
                ECCENTRICITY_Q90,
                eccentricity.map(|s| s.q90),
            ),
            of(
                "largest difference of eccentricity",
                ECCENTRICITY_LARGEST,
                eccentricity.map(|s| s.largest),
            ),
            mae_target("average", mae.map(|s| s.mean)),
            mae_target("largest", mae.map(|s| s.largest)),
        ]
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

    #[test]
    fn an_object_that_cannot_be_measured_meets_no_target() {
        let good = ObjectRow {
            eccentricity: Some(0.2),
            eccentricity_true: Some(0.2),
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
            eccentricity: Some(0.3),
            ..good.clone()
        };
        assert_eq!(met(&[good, off]), [false, false, true, true]);
    }
}
