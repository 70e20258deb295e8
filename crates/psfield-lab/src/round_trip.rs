//! The round trip: samples from the stars of a frame, a model, simulated frames, and a comparison
//! of the stars in the frame and in the simulated frames.

use conv_core::StarPainter;
use metrics::Summary;
use ndarray::{Array2, Zip};
use psf_stars::{StarSamples, StarSampling};
use psf_types::{Anchor, FrameShape, Image, NoProgress, PointSource, Position, PsfModel, PsfModelRecord};
use psfield::{FitOptions, MeasureOptions, Measurement, PsfieldError, fit, model_of};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, Poisson, StandardNormal};
use serde::Serialize;

use crate::LabError;

/// The round trip of the method's paper (section 3.1).
///
/// 1. PSF samples are made from the stars of the frame ([`StarSampling`]), and a model is fitted to
///    them.
/// 2. Frames are simulated. Every source found is drawn by the model as a point source, at its
///    measured position and with its measured flux, on the measured background. If the
///    saturation level is known, values above it are set to that level.
/// 3. FWHM and eccentricity of the stars that became samples are measured in the same way in the
///    frame and in the simulated frames. An elliptical Gaussian and a constant background are
///    fitted in a small window around the same pixel.
///
/// Noise widens the distribution of measured values. Each simulated frame therefore gets the noise
/// of the frame: the measured background noise, and the photon noise of the stars if the gain is
/// known. The noise of one frame is a single random draw, so the distributions combine the stars of
/// several simulated frames ([`realisations`](RoundTripOptions::realisations)).
///
/// The compared stars are also the stars from which the model was made. The comparison therefore
/// judges the whole chain, but not the PSF between the stars. The leave-one-out errors of the fit
/// measure the PSF between the stars.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct RoundTrip {
    /// Stars, sources and coverage of the frame.
    pub stars: StarSamples,
    /// The model fitted to the samples.
    pub model: PsfModelRecord,
    /// The singular values of the fit.
    pub singular_values: Vec<f64>,
    /// The first simulated frame.
    pub simulated: Image<f64>,
    /// The frame minus the first simulated frame.
    pub residual: Image<f64>,
    /// One row per star that became a sample.
    pub rows: Vec<RoundTripRow>,
    /// FWHM of the stars in all simulated frames.
    pub simulated_fwhm_px: Vec<f64>,
    /// Eccentricity `sqrt(1 - b^2 / a^2)` of the stars in all simulated frames.
    pub simulated_eccentricity: Vec<f64>,
    /// The results in numbers.
    pub report: RoundTripReport,
}

/// The settings of a round trip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RoundTripOptions {
    /// Finds and selects stars.
    pub sampling: StarSampling,
    /// Fits the model to the samples.
    pub fit: FitOptions,
    /// Pixels along each side of the measuring window. None: four FWHM, at least 7.
    pub window: Option<usize>,
    /// True if the simulated frames get noise.
    pub noise: bool,
    /// Electrons per unit of the frame's pixel values, for the photon noise of the stars. None: no
    /// photon noise.
    pub gain: Option<f64>,
    /// Number of simulated frames that are measured, at least 1. Without noise it is always 1.
    pub realisations: u32,
    /// Seed of the noise.
    pub seed: u64,
}

impl RoundTripOptions {
    /// Default number of simulated frames.
    pub const DEFAULT_REALISATIONS: u32 = 8;
}

impl Default for RoundTripOptions {
    fn default() -> Self {
        Self {
            sampling: StarSampling::default(),
            fit: FitOptions::default(),
            window: None,
            noise: true,
            gain: None,
            realisations: Self::DEFAULT_REALISATIONS,
            seed: 1,
        }
    }
}

impl RoundTrip {
    /// Runs the round trip on a frame.
    ///
    /// # Errors
    /// [`ErrorKind::Stars`](psfield::ErrorKind::Stars) when the frame gives no samples,
    /// [`LabError::NothingMeasured`] when no star can be measured in both the frame and its
    /// simulation, and the errors of fitting and drawing.
    pub fn run(frame: &Image<f64>, options: &RoundTripOptions) -> Result<Self, LabError> {
        let stars = options.sampling.run(frame)?;
        let fitted = fit(stars.samples.clone(), &options.fit)?;
        let (record, singular_values) = (fitted.record().clone(), fitted.singular_values().to_vec());
        let model = model_of(record.clone())?;

        let sources = drawn_sources(&stars)?;
        let light = drawn(&model, &sources, frame.shape())?;

        let samples = stars.sources.iter().filter(|s| s.sample.is_some());
        let positions = samples
            .map(|s| Position::new(s.x, s.y))
            .collect::<Result<Vec<_>, _>>()?;
        let window = options.window.unwrap_or_else(|| measuring_window(stars.fwhm_px));
        let measuring = MeasureOptions {
            window: Some(window),
            background: true,
        };
        let in_frame = measuring.image(frame.pixels(), &positions);

        let with_noise = options.realisations.max(1);
        let count = if options.noise { with_noise } else { 1 };
        let mut first = None;
        let (mut simulated_fwhm_px, mut simulated_eccentricity) = (Vec::new(), Vec::new());
        for realisation in 0..count {
            let simulated = simulated_frame(&light, &stars, options, realisation);
            let measured = measuring.image(simulated.view(), &positions);
            // A simulated star counts only if the star can also be measured in the frame.
            for (a, b) in in_frame.iter().zip(&measured) {
                if let (Some(_), Some((fwhm, eccentricity))) = (shape(a), shape(b)) {
                    simulated_fwhm_px.push(fwhm);
                    simulated_eccentricity.push(eccentricity);
                }
            }
            first.get_or_insert((simulated, measured));
        }
        let (simulated, in_simulated) = first.expect("at least one realisation");

        let rows = rows(&stars, &in_frame, &in_simulated);
        let pairs: Vec<_> = in_frame
            .iter()
            .zip(&in_simulated)
            .filter_map(|(a, b)| shape(a).zip(shape(b)))
            .collect();
        let agreement = |of: fn((f64, f64)) -> f64, simulated: &[f64]| {
            let pairs: Vec<_> = pairs.iter().map(|&(a, b)| (of(a), of(b))).collect();
            Agreement::of(&pairs, simulated).ok_or(LabError::NothingMeasured {
                stars: positions.len(),
                window,
            })
        };
        let residual = &frame.pixels() - &simulated;
        let deviations = residual
            .iter()
            .zip(stars.background.rms())
            .map(|(r, s)| (r / s).powi(2));
        let report = RoundTripReport {
            stars: stars.samples.len(),
            measured: pairs.len(),
            drawn: sources.len(),
            window_px: window,
            realisations: count,
            noise: options.noise,
            rank: record.basis().rank(),
            fwhm_px: agreement(|s| s.0, &simulated_fwhm_px)?,
            eccentricity: agreement(|s| s.1, &simulated_eccentricity)?,
            residual_over_noise: (deviations.sum::<f64>() / residual.len() as f64).sqrt(),
        };
        Ok(Self {
            stars,
            model: record,
            singular_values,
            simulated: Image::new(simulated)?,
            residual: Image::new(residual)?,
            rows,
            simulated_fwhm_px,
            simulated_eccentricity,
            report,
        })
    }
}

/// Returns FWHM and eccentricity of the Gaussian fit. None if it failed.
fn shape(measurement: &Measurement) -> Option<(f64, f64)> {
    measurement.fwhm_px.zip(measurement.eccentricity)
}

/// The rows of the stars that became samples, in the order of the sources.
fn rows(stars: &StarSamples, in_frame: &[Measurement], in_simulated: &[Measurement]) -> Vec<RoundTripRow> {
    let samples = stars.sources.iter().filter(|s| s.sample.is_some());
    samples
        .zip(in_frame.iter().zip(in_simulated))
        .map(|(source, (a, b))| RoundTripRow {
            x: source.x,
            y: source.y,
            flux: source.flux,
            snr: source.snr,
            fwhm_frame_px: a.fwhm_px,
            fwhm_simulated_px: b.fwhm_px,
            eccentricity_frame: a.eccentricity,
            eccentricity_simulated: b.eccentricity,
            e1_frame: a.e1,
            e1_simulated: b.e1,
            e2_frame: a.e2,
            e2_simulated: b.e2,
        })
        .collect()
}

table_row! {
    /// A star in the frame and in the first simulated frame, measured in the same way. The cells of
    /// the table for a failed measurement are empty.
    #[derive(Debug, Clone, PartialEq, Serialize)]
    #[non_exhaustive]
    #[allow(
        missing_docs,
        reason = "the columns of the table; e1, e2 are distortions from adaptive moments"
    )]
    ROUND_TRIP_COLUMNS RoundTripRow {
        x: f64,
        y: f64,
        flux: f64,
        snr: f64,
        fwhm_frame_px: Option<f64>,
        fwhm_simulated_px: Option<f64>,
        eccentricity_frame: Option<f64>,
        eccentricity_simulated: Option<f64>,
        e1_frame: Option<f64>,
        e1_simulated: Option<f64>,
        e2_frame: Option<f64>,
        e2_simulated: Option<f64>,
    }
}

/// A quantity measured for the stars of the frame and for the simulated stars.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Agreement {
    /// In the frame, one value per star.
    pub frame: Distribution,
    /// In all simulated frames together.
    pub simulated: Distribution,
    /// Median of the simulated stars divided by the median of the stars in the frame.
    pub median_ratio: f64,
    /// Mean absolute difference between a star in the first simulated frame and the star in the
    /// frame. It includes the noise of both.
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
    /// Compares `pairs` (a star in the frame and in the first simulated frame) and `simulated` (the
    /// stars in all simulated frames). None if there are no values.
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

/// The results of a round trip in numbers.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct RoundTripReport {
    /// Stars that became PSF samples.
    pub stars: usize,
    /// Stars that could be measured in the frame and in the first simulated frame.
    pub measured: usize,
    /// Point sources drawn into each simulated frame.
    pub drawn: usize,
    /// Pixels along each side of the window in which a Gaussian was fitted.
    pub window_px: usize,
    /// Number of simulated frames.
    pub realisations: u32,
    /// True if the simulated frames have noise.
    pub noise: bool,
    /// Components of the PSF model, the mean not counted.
    pub rank: usize,
    /// FWHM in pixels (Gaussian fit, geometric mean of the axes).
    pub fwhm_px: Agreement,
    /// Eccentricity `sqrt(1 - b^2 / a^2)` of the Gaussian fit.
    pub eccentricity: Agreement,
    /// R.m.s. of the difference between the frame and the first simulated frame, in units of the
    /// background noise.
    pub residual_over_noise: f64,
}

/// Returns a simulated frame: `light` `[y, x]` with background, noise and saturation. Each
/// realisation has its own noise.
fn simulated_frame(
    light: &Array2<f64>,
    stars: &StarSamples,
    options: &RoundTripOptions,
    realisation: u32,
) -> Array2<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    rng.set_stream(u64::from(realisation));
    let mut frame = light.clone();
    Zip::from(&mut frame)
        .and(stars.background.level())
        .and(stars.background.rms())
        .for_each(|value, level, rms| {
            let mut signal = *value;
            if options.noise {
                if let Some(gain) = options.gain
                    && let Ok(photons) = Poisson::new(gain * signal)
                {
                    signal = photons.sample(&mut rng) / gain;
                }
                let sky: f64 = StandardNormal.sample(&mut rng);
                signal += rms * sky;
            }
            *value = signal + level;
            if let Some(saturation) = stars.saturation.level {
                *value = value.min(saturation);
            }
        });
    frame
}

/// The two-sample Kolmogorov-Smirnov distance: the largest difference of the two cumulative
/// distributions. None if either is empty.
fn kolmogorov_smirnov(a: &[f64], b: &[f64]) -> Option<f64> {
    if a.is_empty() || b.is_empty() {
        return None;
    }
    let sorted = |values: &[f64]| {
        let mut sorted = values.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        sorted
    };
    let (a, b) = (sorted(a), sorted(b));
    let below = |values: &[f64], v: f64| values.partition_point(|x| *x <= v) as f64 / values.len() as f64;
    let distances = a.iter().chain(&b).map(|&v| (below(&a, v) - below(&b, v)).abs());
    Some(distances.fold(0.0, f64::max))
}

/// Side of the measuring window in FWHM. It is at least [`LEAST_WINDOW`] pixels.
const WINDOW_FWHM: f64 = 4.0;
const LEAST_WINDOW: usize = 7;

/// Pixels along each side of the window in which a star is measured, an odd number.
pub(crate) fn measuring_window(fwhm_px: f64) -> usize {
    ((WINDOW_FWHM * fwhm_px).ceil() as usize | 1).max(LEAST_WINDOW)
}

/// Draws stars on an empty frame `[y, x]`, without noise.
pub(crate) fn drawn(
    model: &PsfModel,
    sources: &[PointSource],
    frame: FrameShape,
) -> Result<Array2<f64>, PsfieldError> {
    let mut light = Array2::zeros((frame.ny(), frame.nx()));
    let painter = StarPainter::new(model, frame.region(), Anchor::Source, None)?;
    painter.draw_into(sources, frame.region(), light.view_mut(), &NoProgress)?;
    Ok(light)
}

/// Returns every source on the frame with a positive flux, including sources that did not become
/// samples.
pub(crate) fn drawn_sources(stars: &StarSamples) -> Result<Vec<PointSource>, PsfieldError> {
    let field = stars.samples.positions().field();
    let mut sources = Vec::with_capacity(stars.sources.len());
    for source in &stars.sources {
        let position = Position::new(source.x, source.y)?;
        if source.flux > 0.0 && field.is_none_or(|field| field.contains(position)) {
            sources.push(PointSource::new(position, source.flux)?);
        }
    }
    Ok(sources)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_distances() {
        let a = [1.0, 2.0, 3.0, 4.0];
        assert_eq!(kolmogorov_smirnov(&a, &a), Some(0.0));
        assert_eq!(kolmogorov_smirnov(&a, &[5.0, 6.0]), Some(1.0));
        assert_eq!(kolmogorov_smirnov(&a, &[4.0, 3.0, 2.5, 1.5]), Some(0.25));
        assert_eq!(kolmogorov_smirnov(&[3.0, 1.0], &[2.0]), Some(0.5));
        assert_eq!(kolmogorov_smirnov(&a, &[]), None);
    }
}
