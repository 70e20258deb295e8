//! What a round trip found.

use metrics::Summary;
use serde::Serialize;

use super::ks::kolmogorov_smirnov;

/// The columns of a table of [`RoundTripRow`]s.
pub const ROUND_TRIP_COLUMNS: [&str; 12] = [
    "x",
    "y",
    "flux",
    "snr",
    "fwhm_frame_px",
    "fwhm_simulated_px",
    "ellipticity_frame",
    "ellipticity_simulated",
    "e1_frame",
    "e1_simulated",
    "e2_frame",
    "e2_simulated",
];

/// A star in the frame and in the first simulated frame, measured in the same way. An empty field is a measurement that failed.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
#[allow(
    missing_docs,
    reason = "the columns of the table; e1, e2 are distortions from adaptive moments"
)]
pub struct RoundTripRow {
    pub x: f64,
    pub y: f64,
    pub flux: f64,
    pub snr: f64,
    pub fwhm_frame_px: Option<f64>,
    pub fwhm_simulated_px: Option<f64>,
    pub ellipticity_frame: Option<f64>,
    pub ellipticity_simulated: Option<f64>,
    pub e1_frame: Option<f64>,
    pub e1_simulated: Option<f64>,
    pub e2_frame: Option<f64>,
    pub e2_simulated: Option<f64>,
}

/// A quantity of the stars of the frame beside that of the simulated stars.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Agreement {
    /// In the frame, one value a star.
    pub frame: Distribution,
    /// In all simulated frames together.
    pub simulated: Distribution,
    /// Median of the simulated stars over that of the frame's.
    pub median_ratio: f64,
    /// Mean absolute difference of a star in the first simulated frame from the same star in the frame: with the noise of both.
    pub mean_absolute_error: f64,
    /// Kolmogorov-Smirnov distance of the two distributions.
    pub ks_distance: f64,
}

/// Median and quantiles.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names say it: q10 is the 0.1 quantile")]
pub struct Distribution {
    pub count: usize,
    pub q10: f64,
    pub q25: f64,
    pub median: f64,
    pub q75: f64,
    pub q90: f64,
}

impl Distribution {
    fn of(values: &[f64]) -> Option<Self> {
        let summary = Summary::of(values.iter().copied()).ok()?;
        let quantile = |q| summary.quantile(q).ok();
        Some(Self {
            count: summary.count(),
            q10: quantile(0.1)?,
            q25: quantile(0.25)?,
            median: summary.median(),
            q75: quantile(0.75)?,
            q90: quantile(0.9)?,
        })
    }
}

impl Agreement {
    /// `pairs`: a star in the frame and in the first simulated frame; `simulated`: the same stars in all simulated frames.
    pub(crate) fn of(pairs: &[(f64, f64)], simulated: &[f64]) -> Option<Self> {
        let frame: Vec<f64> = pairs.iter().map(|p| p.0).collect();
        let (of_frame, of_simulated) = (Distribution::of(&frame)?, Distribution::of(simulated)?);
        let differences = pairs.iter().map(|(a, b)| (a - b).abs()).sum::<f64>();
        Some(Self {
            median_ratio: of_simulated.median / of_frame.median,
            mean_absolute_error: differences / pairs.len() as f64,
            ks_distance: kolmogorov_smirnov(&frame, simulated)?,
            frame: of_frame,
            simulated: of_simulated,
        })
    }
}

/// The figures of a round trip.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct RoundTripReport {
    /// Stars that became PSF samples.
    pub stars: usize,
    /// Those that could be measured in the frame and in the first simulated frame.
    pub measured: usize,
    /// Point sources drawn into each simulated frame.
    pub drawn: usize,
    /// Pixels along each side of the window that a Gaussian was fitted in.
    pub window_px: usize,
    /// Simulated frames.
    pub realisations: u32,
    /// Whether they have noise.
    pub noise: bool,
    /// Components of the PSF model, the mean not counted.
    pub rank: usize,
    /// FWHM in pixels (Gaussian fit, geometric mean of the axes).
    pub fwhm_px: Agreement,
    /// Ellipticity `sqrt(1 - b^2 / a^2)` of the Gaussian fit.
    pub ellipticity: Agreement,
    /// R.m.s. of the difference of frame and first simulated frame, in units of the background noise.
    pub residual_over_noise: f64,
}
