//! The round trip: samples from the stars of a frame, a model, simulated frames, and a comparison
//! of the stars in the frame and in the simulated frames.

use conv_core::StarPainter;
use ndarray::{Array2, ArrayView2, Zip};
use psf_stars::{Source, StarSamples, StarSampling};
use psf_types::{Anchor, FrameShape, Image, NoProgress, PointSource, Position, PsfModel, PsfModelRecord};
use psfield::fit::{fit, model_of};
use psfield::measure::{MeasureOptions, Measurement};
use psfield::{FitOptions, PsfieldError};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, Poisson, StandardNormal};
use serde::Serialize;

use crate::LabError;
use crate::star_comparison::{Agreement, Distribution, LightComparison, StarComparison, aperture_px};

/// The round trip of the method's paper (section 3.1).
///
/// 1. PSF samples are made from the stars of the frame ([`StarSampling`]), and a model is fitted to
///    them.
/// 2. Frames are simulated. The model draws every source found (if its flux is positive) as a point
///    source, at its measured position and with its measured flux, on the measured background. If
///    the saturation level is known, values above it are set to that level.
/// 3. FWHM and eccentricity of the stars that became samples are measured in the same way in the
///    frame and in the simulated frames. An elliptical Gaussian and a constant background are
///    fitted in a small window around the same pixel.
/// 4. The light of isolated stars is compared: the flux in an aperture, and the residuals as a
///    reduced chi-square ([`StarComparison`]). The drawn stars have no noise here.
///
/// Noise widens the distribution of measured values. Each simulated frame therefore gets the noise
/// of the frame: the measured background noise, and the photon noise of the stars if the gain is
/// known. The noise of one frame is a single random draw, so the distributions combine the stars of
/// several simulated frames ([`realisations`](RoundTripOptions::realisations)).
///
/// The compared stars are those from which the model was made. The comparison therefore judges the
/// whole chain, but not the PSF between the stars. To judge this PSF too, steps 2 to 4 are repeated
/// with models that leave stars out ([`RoundTripReport::left_out`]). The stars are divided into
/// five groups. Each group is drawn by a model made from the stars of the other four groups alone.
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
    /// FWHM in all simulated frames, of the stars that can also be measured in the frame.
    pub simulated_fwhm_px: Vec<f64>,
    /// Eccentricity `sqrt(1 - b^2 / a^2)` in all simulated frames, of the stars that can also be
    /// measured in the frame.
    pub simulated_eccentricity: Vec<f64>,
    /// The results in numbers.
    pub report: RoundTripReport,
}

/// The settings of a round trip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RoundTripOptions {
    /// Settings for finding and selecting stars.
    pub sampling: StarSampling,
    /// Settings for fitting the model to the samples.
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
    /// Runs the round trip on a frame `[y, x]`. NaN stands for a masked pixel
    /// ([`StarSampling::run_masked`]). The comparison replaces it by the drawn value plus the
    /// background.
    ///
    /// # Errors
    /// [`ErrorKind::Data`](psfield::ErrorKind::Data) for a frame without pixels,
    /// [`ErrorKind::Stars`](psfield::ErrorKind::Stars) when the frame gives no samples,
    /// [`LabError::NothingMeasured`] when no star can be measured in both the frame and its
    /// simulation, and the errors of fitting and drawing.
    pub fn run(mut frame: Array2<f64>, options: &RoundTripOptions) -> Result<Self, LabError> {
        let shape = FrameShape::new(frame.ncols(), frame.nrows())?;
        let sampling = options.sampling.with_cross_validation();
        let stars = sampling.run_masked(frame.clone())?;
        let fitted = fit(stars.samples.clone(), &options.fit)?;
        let (record, singular_values) = (fitted.record().clone(), fitted.singular_values().to_vec());
        let model = model_of(record.clone())?;
        let sources = drawn_sources(&stars)?;
        let light = drawn(&model, &sources, shape)?;
        Zip::from(&mut frame)
            .and(&light)
            .and(stars.background.level())
            .for_each(|value, light, level| {
                if value.is_nan() {
                    *value = light + level;
                }
            });
        let comparing = Comparing::new(frame.view(), &stars, options)?;
        let all = comparing.with(&light)?;
        let left_out = light_of_left_out(&model, &stars, &options.fit, shape)
            .and_then(|light| light.map(|light| comparing.with(&light)).transpose());
        // The comparison with all stars holds even if stars cannot be left out.
        let (left_out, left_out_error) = match left_out {
            Ok(left_out) => (left_out, None),
            Err(error) => (None, Some(psfield::error::error_text(&error))),
        };

        let residual = &frame - &all.simulated;
        let deviations = residual
            .iter()
            .zip(stars.background.rms())
            .map(|(r, s)| (r / s).powi(2));
        let report = RoundTripReport {
            stars: stars.samples.len(),
            drawn: sources.len(),
            window_px: comparing.window,
            aperture_px: comparing.aperture_px,
            realisations: comparing.realisations,
            noise: options.noise,
            photon_noise: options.gain.is_some(),
            rank: record.basis().rank(),
            residual_over_noise: (deviations.sum::<f64>() / residual.len() as f64).sqrt(),
            all: all.comparison,
            left_out: left_out.as_ref().map(|c| c.comparison.clone()),
            left_out_error,
        };
        let rows = rows(
            &stars,
            &comparing.in_frame,
            &all.stars,
            left_out.as_ref().map(|c| c.stars.as_slice()),
        );
        Ok(Self {
            model: record,
            singular_values,
            simulated: Image::new(all.simulated)?,
            residual: Image::new(residual)?,
            rows,
            simulated_fwhm_px: all.fwhm_px,
            simulated_eccentricity: all.eccentricity,
            report,
            stars,
        })
    }
}

/// Draws the light of the frame `[y, x]`. A fold is a group of stars that became samples. A model
/// fitted to the stars outside a fold draws the stars of the fold, and `model` draws the sources
/// that are not samples. None if there are no folds.
fn light_of_left_out(
    model: &PsfModel,
    stars: &StarSamples,
    options: &FitOptions,
    frame: FrameShape,
) -> Result<Option<Array2<f64>>, LabError> {
    if stars.folds.is_empty() {
        return Ok(None);
    }
    let others = stars.sources.iter().filter(|s| s.sample.is_none());
    let mut light = drawn(model, &point_sources(others, Some(frame))?, frame)?;
    for fold in &stars.folds {
        let fitted = fit(fold.samples.clone(), options)?;
        let sources = point_sources(fold.left_out.iter(), Some(frame))?;
        light += &drawn(&model_of(fitted.record().clone())?, &sources, frame)?;
    }
    Ok(Some(light))
}

/// Compares the stars of a frame with drawn stars.
struct Comparing<'a> {
    stars: &'a StarSamples,
    options: &'a RoundTripOptions,
    /// The frame minus its background map `[y, x]`.
    excess: Array2<f64>,
    positions: Vec<Position>,
    window: usize,
    aperture_px: f64,
    realisations: u32,
    measuring: MeasureOptions,
    in_frame: Vec<Measurement>,
}

/// The result of a comparison.
struct Compared {
    /// The first simulated frame `[y, x]`.
    simulated: Array2<f64>,
    /// The stars in the first simulated frame.
    stars: Vec<ComparedStar>,
    fwhm_px: Vec<f64>,
    eccentricity: Vec<f64>,
    comparison: StarComparison,
}

/// A star in the first simulated frame, and its flux ratio and reduced chi-square if it is
/// isolated.
struct ComparedStar {
    measurement: Measurement,
    light: Option<(f64, f64)>,
}

impl<'a> Comparing<'a> {
    fn new(
        frame: ArrayView2<'_, f64>,
        stars: &'a StarSamples,
        options: &'a RoundTripOptions,
    ) -> Result<Self, LabError> {
        let samples = stars.sources.iter().filter(|s| s.sample.is_some());
        let positions = samples
            .map(|s| Position::new(s.x, s.y))
            .collect::<Result<Vec<_>, _>>()?;
        let window = options.window.unwrap_or_else(|| measuring_window(stars.fwhm_px));
        let measuring = MeasureOptions {
            window: Some(window),
            background: true,
        };
        Ok(Self {
            stars,
            options,
            excess: &frame - &stars.background.level(),
            window,
            aperture_px: aperture_px(stars.fwhm_px),
            realisations: if options.noise {
                options.realisations.max(1)
            } else {
                1
            },
            in_frame: measuring.image(frame, &positions),
            measuring,
            positions,
        })
    }

    /// Compares with drawn `light` `[y, x]`, which has no background and no noise.
    fn with(&self, light: &Array2<f64>) -> Result<Compared, LabError> {
        let mut first = None;
        let (mut fwhm_px, mut eccentricity) = (Vec::new(), Vec::new());
        for realisation in 0..self.realisations {
            let simulated = simulated_frame(light, self.stars, self.options, realisation);
            let measured = self.measuring.image(simulated.view(), &self.positions);
            // A simulated star counts only if the star can also be measured in the frame.
            for (a, b) in self.in_frame.iter().zip(&measured) {
                if let (Some(_), Some(found)) = (shape(a), shape(b)) {
                    fwhm_px.push(found.0);
                    eccentricity.push(found.1);
                }
            }
            first.get_or_insert((simulated, measured));
        }
        let (simulated, measured) = first.expect("at least one realisation");
        let pairs = self.in_frame.iter().zip(&measured);
        let pairs: Vec<_> = pairs.filter_map(|(a, b)| shape(a).zip(shape(b))).collect();
        let agreement = |of: fn((f64, f64)) -> f64, simulated: &[f64]| {
            let pairs: Vec<_> = pairs.iter().map(|&(a, b)| (of(a), of(b))).collect();
            Agreement::of(&pairs, simulated).ok_or(LabError::NothingMeasured {
                stars: self.positions.len(),
                window: self.window,
            })
        };
        let samples = self.stars.sources.iter().filter(|s| s.sample.is_some());
        let compared = LightComparison {
            frame: self.excess.view(),
            drawn: light.view(),
            rms: self.stars.background.rms(),
            gain: self.options.gain,
            window: self.window,
            aperture_px: self.aperture_px,
        };
        let lights = samples.map(|star| compared.of(star));
        let stars: Vec<ComparedStar> = measured
            .into_iter()
            .zip(lights)
            .map(|(measurement, light)| ComparedStar { measurement, light })
            .collect();
        let of_lights = |of: fn((f64, f64)) -> f64| {
            let values: Vec<f64> = stars.iter().filter_map(|s| s.light.map(of)).collect();
            Distribution::of(&values)
        };
        let comparison = StarComparison {
            measured: pairs.len(),
            fwhm_px: agreement(|s| s.0, &fwhm_px)?,
            eccentricity: agreement(|s| s.1, &eccentricity)?,
            flux_ratio: of_lights(|s| s.0),
            reduced_chi_square: of_lights(|s| s.1),
        };
        Ok(Compared {
            simulated,
            stars,
            fwhm_px,
            eccentricity,
            comparison,
        })
    }
}

/// Returns FWHM and eccentricity of the Gaussian fit. None if it failed.
fn shape(measurement: &Measurement) -> Option<(f64, f64)> {
    measurement.fwhm_px.zip(measurement.eccentricity)
}

/// The rows of the stars that became samples, in the order of the sources.
fn rows(
    stars: &StarSamples,
    in_frame: &[Measurement],
    drawn: &[ComparedStar],
    left_out: Option<&[ComparedStar]>,
) -> Vec<RoundTripRow> {
    let samples = stars.sources.iter().filter(|s| s.sample.is_some());
    samples
        .zip(in_frame.iter().zip(drawn))
        .enumerate()
        .map(|(k, (source, (a, star)))| {
            let (b, left_out) = (&star.measurement, left_out.map(|stars| &stars[k]));
            let (light, left_out_light) = (star.light, left_out.and_then(|s| s.light));
            RoundTripRow {
                x: source.x,
                y: source.y,
                flux: source.flux,
                snr: source.snr,
                fwhm_frame_px: a.fwhm_px,
                fwhm_simulated_px: b.fwhm_px,
                fwhm_left_out_px: left_out.and_then(|s| s.measurement.fwhm_px),
                eccentricity_frame: a.eccentricity,
                eccentricity_simulated: b.eccentricity,
                eccentricity_left_out: left_out.and_then(|s| s.measurement.eccentricity),
                e1_frame: a.e1,
                e1_simulated: b.e1,
                e2_frame: a.e2,
                e2_simulated: b.e2,
                flux_ratio: light.map(|l| l.0),
                flux_ratio_left_out: left_out_light.map(|l| l.0),
                reduced_chi_square: light.map(|l| l.1),
                reduced_chi_square_left_out: left_out_light.map(|l| l.1),
            }
        })
        .collect()
}

psf_types::table_row! {
    /// A star in the frame and in the first simulated frame, measured in the same way. Columns with
    /// `left_out` in the name hold the values of the star drawn by a model that was made without
    /// it. The cells of the table for a failed measurement are empty, and so are flux ratio and
    /// reduced chi-square of a star that is not isolated ([`StarComparison`]).
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
        fwhm_left_out_px: Option<f64>,
        eccentricity_frame: Option<f64>,
        eccentricity_simulated: Option<f64>,
        eccentricity_left_out: Option<f64>,
        e1_frame: Option<f64>,
        e1_simulated: Option<f64>,
        e2_frame: Option<f64>,
        e2_simulated: Option<f64>,
        flux_ratio: Option<f64>,
        flux_ratio_left_out: Option<f64>,
        reduced_chi_square: Option<f64>,
        reduced_chi_square_left_out: Option<f64>,
    }
}

/// The results of a round trip in numbers.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct RoundTripReport {
    /// Stars that became PSF samples.
    pub stars: usize,
    /// Point sources drawn into each simulated frame.
    pub drawn: usize,
    /// Pixels along each side of the window in which a Gaussian was fitted.
    pub window_px: usize,
    /// Radius of the apertures in which fluxes are compared.
    pub aperture_px: f64,
    /// Number of simulated frames.
    pub realisations: u32,
    /// True if the simulated frames have noise.
    pub noise: bool,
    /// True if the noise in the reduced chi-square contains the photon noise of the stars, which
    /// needs the gain.
    pub photon_noise: bool,
    /// Components of the PSF model, the mean not counted.
    pub rank: usize,
    /// The stars drawn by the model that was made from all of them.
    #[serde(flatten)]
    pub all: StarComparison,
    /// The stars drawn by models that were made without them (five groups, each drawn by the model
    /// of the other four). None with fewer than ten stars, or after an error.
    pub left_out: Option<StarComparison>,
    /// The error for which there is no `left_out`, such as too few stars for the fit.
    pub left_out_error: Option<String>,
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
    point_sources(stars.sources.iter(), stars.samples.positions().field())
}

/// Returns the sources on `field` with a positive flux.
fn point_sources<'a>(
    sources: impl Iterator<Item = &'a Source>,
    field: Option<FrameShape>,
) -> Result<Vec<PointSource>, PsfieldError> {
    let mut drawn = Vec::new();
    for source in sources {
        let position = Position::new(source.x, source.y)?;
        if source.flux > 0.0 && field.is_none_or(|field| field.contains(position)) {
            drawn.push(PointSource::new(position, source.flux)?);
        }
    }
    Ok(drawn)
}

#[cfg(test)]
mod tests {
    use psf_stars::{Registration, RegistrationMethod};

    use super::*;

    const SIDE: usize = 320;
    const NOISE: f64 = 3.0;

    /// The light of 64 stars `[y, x]`, Gaussians of this sigma integrated over pixels.
    fn light(sigma: f64) -> Array2<f64> {
        let mut light = Array2::zeros((SIDE, SIDE));
        let in_pixel = |offset: f64| {
            const STEPS: u32 = 16;
            let at = |k: u32| (offset + (f64::from(k) + 0.5) / f64::from(STEPS) - 0.5) / sigma;
            let sum: f64 = (0..STEPS).map(|k| (-0.5 * at(k).powi(2)).exp()).sum();
            sum / f64::from(STEPS) / (sigma * std::f64::consts::TAU.sqrt())
        };
        for k in 0..64u32 {
            let place =
                |cell: u32, step: u32| 30.0 + 36.7 * f64::from(cell) + f64::from(k * step % 17) / 17.0;
            let (x, y) = (place(k % 8, 5), place(k / 8, 7));
            let flux = 2000.0 * f64::from(1 + k * 11 % 5);
            for ((row, column), value) in light.indexed_iter_mut() {
                let (dx, dy) = (column as f64 - x, row as f64 - y);
                if dx.abs() < 12.0 && dy.abs() < 12.0 {
                    *value += flux * in_pixel(dx) * in_pixel(dy);
                }
            }
        }
        light
    }

    fn frame(light: &Array2<f64>) -> Image<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        Image::new(light.mapv(|v| {
            let noise: f64 = StandardNormal.sample(&mut rng);
            200.0 + v + NOISE * noise
        }))
        .unwrap()
    }

    fn medians(stars: &StarComparison) -> (f64, f64) {
        let median = |of: &Option<Distribution>| of.as_ref().unwrap().median;
        (median(&stars.flux_ratio), median(&stars.reduced_chi_square))
    }

    /// Undersampled stars: a FWHM of 1.4 pixels without the pixel response.
    const SIGMA: f64 = 0.6;
    /// Error of the median flux ratio of 64 stars. The noise of a single aperture is 21, or 0.4 %
    /// of the median flux.
    const RATIO: f64 = 0.005;
    /// Error of the median reduced chi-square of 64 windows of 49 pixels. It is 0.03 by chance. The
    /// clipped noise of the background adds 0.03, and three degrees of freedom that the true light
    /// does not use add 0.07.
    const CHI_SQUARE: f64 = 0.2;
    /// The PSF of the stars of a frame has errors of about 1 %, which bright stars show.
    const CHI_SQUARE_OF_FIT: f64 = 0.5;

    #[test]
    fn the_true_light_has_a_ratio_and_a_chi_square_of_1_and_wrong_light_does_not() {
        let truth = light(SIGMA);
        let frame = frame(&truth);
        let stars = StarSampling::default().run(&frame).unwrap();
        let options = RoundTripOptions {
            realisations: 1,
            ..RoundTripOptions::default()
        };
        let comparing = Comparing::new(frame.pixels(), &stars, &options).unwrap();
        let with = |light: &Array2<f64>| medians(&comparing.with(light).unwrap().comparison);

        let (ratio, chi_square) = with(&truth);
        println!("the truth: {ratio}, {chi_square}");
        assert!((ratio - 1.0).abs() < RATIO && (chi_square - 1.0).abs() < CHI_SQUARE);
        let (ratio, chi_square) = with(&(0.91 * &truth));
        println!("9 % of the light missing: {ratio}, {chi_square}");
        assert!((ratio - 0.91).abs() < RATIO && chi_square > 2.0);
        let (ratio, chi_square) = with(&light(1.15 * SIGMA));
        println!("too wide by 15 %: {ratio}, {chi_square}");
        assert!((ratio - 1.0).abs() < RATIO && chi_square > 10.0);
    }

    #[test]
    fn stars_drawn_by_a_model_made_without_them_agree_with_the_frame() {
        let frame = frame(&light(SIGMA));
        let trip = RoundTrip::run(frame.pixels().to_owned(), &RoundTripOptions::default()).unwrap();
        assert!(trip.stars.samples.len() >= 60);
        for stars in [&trip.report.all, trip.report.left_out.as_ref().unwrap()] {
            let (ratio, chi_square) = medians(stars);
            println!("{ratio}, {chi_square}");
            assert!((ratio - 1.0).abs() < RATIO && (chi_square - 1.0).abs() < CHI_SQUARE_OF_FIT);
        }
    }

    /// A star whose own pixels are its PSF agrees with itself, noise included.
    #[test]
    fn stars_left_out_are_not_compared_with_themselves() {
        let frame = frame(&light(1.2));
        let fit = FitOptions {
            rank: psfield::psf_basis::RankSelection::Full,
            // Exact at the samples, so that a star is compared with itself.
            interpolation: psfield::psf_types::Interpolation::NaturalNeighbour,
            ..FitOptions::default()
        };
        let stamps = Registration::default().with_method(RegistrationMethod::Stamps);
        let options = RoundTripOptions {
            sampling: StarSampling::default().with_registration(stamps),
            fit,
            realisations: 1,
            ..RoundTripOptions::default()
        };
        let report = RoundTrip::run(frame.pixels().to_owned(), &options)
            .unwrap()
            .report;
        let (_, itself) = medians(&report.all);
        let (_, left_out) = medians(&report.left_out.unwrap());
        println!("reduced chi-square: {itself} with the star, {left_out} without");
        assert!(itself < 0.5 && left_out > 1.0);
    }
}
