//! From a frame to samples to a model to a simulated frame, and how its stars compare with those of the frame.

mod ks;
mod report;
mod sky_noise;

use conv_core::add_point_sources;
use ndarray::Array2;
use psf_stars::{StarError, StarSamples, StarSampling};
use psf_types::{Anchor, Image, Position, PsfModelRecord, Scene};

use crate::star_frame::{drawn_sources, measuring_window};
use crate::{FitOptions, MeasureOptions, Measurement, PsfieldError, fit, model_of};

pub use report::{Agreement, Distribution, ROUND_TRIP_COLUMNS, RoundTripReport, RoundTripRow};
use sky_noise::SkyNoise;

/// The round trip of the method's paper (section 3.1).
///
/// 1. PSF samples from the stars of the frame ([`StarSampling`]), and a model fitted to them.
/// 2. Simulated frames: every source found, with its measured position and flux, drawn as a point source through the model, on the
///    measured background, cut at the saturation level.
/// 3. FWHM and ellipticity of the stars that became samples, measured alike in both: an elliptical Gaussian with background in a small
///    window about the same pixel.
///
/// Noise widens the distribution of what is measured, so each simulated frame gets noise as the frame has it: the measured background
/// noise, and the photons of the stars where the gain is known. One frame of noise is one draw; the distribution compared with is that of
/// [`realisations`](RoundTripOptions::realisations) of them. The stars compared are those that the model was made of: this judges the whole
/// chain, not how well the PSF is known between the stars, which the leave-one-out errors of a fit tell.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct RoundTrip {
    /// Stars, sources and coverage of the frame.
    pub stars: StarSamples,
    /// The model fitted to the samples.
    pub model: PsfModelRecord,
    /// The singular values of its basis.
    pub singular_values: Vec<f64>,
    /// The first simulated frame.
    pub simulated: Image<f64>,
    /// The frame less the first simulated frame.
    pub residual: Image<f64>,
    /// Star by star.
    pub rows: Vec<RoundTripRow>,
    /// FWHM of the stars in all simulated frames.
    pub simulated_fwhm_px: Vec<f64>,
    /// Ellipticity of the stars in all simulated frames.
    pub simulated_ellipticity: Vec<f64>,
    /// The figures.
    pub report: RoundTripReport,
}

/// How a round trip is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RoundTripOptions {
    /// How stars are found and chosen.
    pub sampling: StarSampling,
    /// How samples become a model.
    pub fit: FitOptions,
    /// Pixels along each side of the measuring window; by default four FWHM, at least 7.
    pub window: Option<usize>,
    /// Whether the simulated frames get noise.
    pub noise: bool,
    /// Electrons per unit of the frame, for the photons of the stars.
    pub gain: Option<f64>,
    /// Simulated frames that are measured, at least 1; without noise one is enough.
    pub realisations: u32,
    /// Seed of the noise.
    pub seed: u64,
}

impl RoundTripOptions {
    /// Simulated frames unless told otherwise.
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
    /// [`PsfieldError::Stars`] when the frame gives no samples, [`PsfieldError::NothingMeasured`] when no star can be measured in both
    /// frames, and the errors of fitting and drawing.
    pub fn run(frame: &Image<f64>, options: &RoundTripOptions) -> Result<Self, PsfieldError> {
        let stars = options.sampling.run(frame)?;
        let fitted = fit(stars.samples.clone(), &options.fit)?;
        let (record, singular_values) = (fitted.record().clone(), fitted.singular_values().to_vec());
        let model = model_of(record.clone())?;

        let sources = drawn_sources(&stars)?;
        let scene = Scene::<f64>::dark(frame.shape()).with_sources(sources.clone());
        let mut light = Array2::zeros(frame.pixels().dim());
        add_point_sources(&model, &scene, Anchor::Source, &mut light)?;

        let positions = compared(&stars)?;
        let window = options.window.unwrap_or_else(|| measuring_window(stars.fwhm_px));
        let measuring = MeasureOptions {
            window: Some(window),
            background: true,
        };
        let in_frame = measuring.image(frame.pixels(), &positions);

        let noise = SkyNoise::new(&stars, options.noise, options.gain, options.seed);
        let count = if options.noise {
            options.realisations.max(1)
        } else {
            1
        };
        let mut first = None;
        let (mut simulated_fwhm_px, mut simulated_ellipticity) = (Vec::new(), Vec::new());
        for realisation in 0..count {
            let simulated = noise.frame(&light, u64::from(realisation));
            let measured = measuring.image(simulated.view(), &positions);
            // A star counts in both distributions or in neither.
            for (a, b) in in_frame.iter().zip(&measured) {
                if let (Some(_), Some((fwhm, ellipticity))) = (shape(a), shape(b)) {
                    simulated_fwhm_px.push(fwhm);
                    simulated_ellipticity.push(ellipticity);
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
            Agreement::of(&pairs, simulated).ok_or(PsfieldError::NothingMeasured {
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
            ellipticity: agreement(|s| s.1, &simulated_ellipticity)?,
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
            simulated_ellipticity,
            report,
        })
    }
}

impl From<StarError> for PsfieldError {
    fn from(error: StarError) -> Self {
        Self::Stars(Box::new(error))
    }
}

/// FWHM and ellipticity of a Gaussian fit.
fn shape(measurement: &Measurement) -> Option<(f64, f64)> {
    measurement.fwhm_px.zip(measurement.ellipticity)
}

/// The stars that became samples, in the order of the sources.
fn compared(stars: &StarSamples) -> Result<Vec<Position>, PsfieldError> {
    let samples = stars.sources.iter().filter(|s| s.sample.is_some());
    Ok(samples
        .map(|s| Position::new(s.x, s.y))
        .collect::<Result<_, _>>()?)
}

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
            ellipticity_frame: a.ellipticity,
            ellipticity_simulated: b.ellipticity,
            e1_frame: a.e1,
            e1_simulated: b.e1,
            e2_frame: a.e2,
            e2_simulated: b.e2,
        })
        .collect()
}
