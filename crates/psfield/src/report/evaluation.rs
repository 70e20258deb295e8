//! Objects, measured in both images.

use ndarray::Array2;
use psf_types::{FrameShape, Position};
use rayon::prelude::*;
use serde::Serialize;

use super::{ErrorSummary, Histogram, ObjectRow};

/// Objects of one kind, each measured in the simulated and in the true image.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Evaluation {
    /// What they say together.
    pub summary: ErrorSummary,
    /// Of the differences of ellipticity, absolute.
    pub ellipticity_differences: Histogram,
    /// FWHM along rows in pixels: true, simulated.
    pub fwhm_rows_px: [Histogram; 2],
    /// FWHM along columns in pixels: true, simulated.
    pub fwhm_columns_px: [Histogram; 2],
    /// MAE over the mean.
    pub mae_over_mean: Histogram,
    /// One row an object.
    #[serde(skip)]
    pub rows: Vec<ObjectRow>,
    /// The field, where it is known.
    #[serde(skip)]
    pub frame: Option<FrameShape>,
    /// Columns of the grid that the objects form, if they do.
    #[serde(skip)]
    pub grid_columns: Option<usize>,
}

const BINS: usize = 50;

impl Evaluation {
    /// Measures pairs of windows, simulated and true.
    pub fn measure(
        positions: &[Position],
        simulated: &[Array2<f64>],
        truth: &[Array2<f64>],
        frame: Option<FrameShape>,
        grid_columns: Option<usize>,
    ) -> Self {
        let rows: Vec<ObjectRow> = positions
            .par_iter()
            .zip(simulated.par_iter().zip(truth))
            .map(|(&at, (ours, theirs))| ObjectRow::measure(at, ours.view(), theirs.view()))
            .collect();
        Self::of_rows(rows, frame, grid_columns)
    }

    /// Of rows that are at hand.
    pub fn of_rows(rows: Vec<ObjectRow>, frame: Option<FrameShape>, grid_columns: Option<usize>) -> Self {
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
            ellipticity_differences: from_zero(values(|r| r.ellipticity_difference().map(f64::abs))),
            fwhm_rows_px: pair(|r| r.fwhm_rows_px_true, |r| r.fwhm_rows_px),
            fwhm_columns_px: pair(|r| r.fwhm_columns_px_true, |r| r.fwhm_columns_px),
            mae_over_mean: from_zero(values(|r| r.mae_over_mean)),
            rows,
            frame,
            grid_columns,
        }
    }
}
