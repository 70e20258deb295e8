//! One basis for the PSFs of several frames, as in the paper's table of four frames of GWAC.

use std::time::Instant;

use metrics::{Comparison, Summary};
use ndarray::Array3;
use psf_optics::Telescope;
use psf_sample::draw_states;
use psf_types::maths::ConvexHull;
use psf_types::{Interpolation, NoProgress, Position, PsfBasis, PsfSamples, PsfSource, StateKind};
use psfield::fit::fit_in_basis;
use psfield::psf::join_samples;
use psfield::psf_basis::RankSelection;
use psfield::{FitOptions, Psf};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;

use crate::LabError;
use crate::bench::random_position;
use crate::report::document::{Column, Section, Table, short};
use crate::report::model_rows::psf_errors;
use crate::report::scenes::true_psfs;
use crate::report::{ErrorSummary, ObjectRow, Spread, Target};

/// Number of stars in each frame from which samples are made.
const STARS: usize = 150;
/// Number of positions in each frame at which the model is compared with the truth.
const HELD_OUT: usize = 60;
/// Defocus that is added to the telescope's, in waves r.m.s., its slope along x, and the FWHM of
/// the seeing in arcsec, of each frame.
const DRIFT: [[f64; 3]; 4] = [
    [0.0, 0.0, 1.5],
    [0.06, 0.03, 2.5],
    [0.12, 0.06, 4.0],
    [0.18, 0.09, 6.0],
];
/// Noll's index of defocus.
const DEFOCUS: usize = 4;
/// Photons of a star: the smallest and the largest number.
const PHOTONS: (f64, f64) = (1e5, 1e7);
/// Photons of the sky per pixel.
const SKY: f64 = 1000.0;
/// Target for the seconds to find the coefficients of a frame.
const SECONDS: f64 = 0.01;
/// The time of a frame is the least of this number of runs.
const RUNS: usize = 5;

/// Frames of one telescope with drifting focus and seeing, and one basis for the PSFs of all of
/// them.
///
/// Samples are the images of single stars at random positions, with the noise of their photons and
/// of the sky. The PSFs of the model at other positions are compared with those of the optics.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct FrameComparison {
    /// The telescope's name.
    pub telescope: String,
    /// Number of components of the basis, the mean not counted.
    pub rank: usize,
    /// Interpolation of the coefficients over the field.
    pub interpolation: Interpolation,
    /// The frames.
    pub frames: Vec<FrameRow>,
}

/// A frame: its samples, and the errors of its PSFs at positions without samples.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct FrameRow {
    /// Number of the frame.
    pub frame: usize,
    /// Number of samples.
    pub samples: usize,
    /// Signal-to-noise ratio of a sample in dB, `10 log10(P_signal / P_noise)` (equation 6 of the
    /// paper; [`Comparison::snr_db`]). `P` are sums of squares over the pixels of the stamp. The
    /// median over the samples.
    pub sample_snr_db: f64,
    /// The ratio `sample_snr_db` as a plain number, of the r.m.s. of signal and noise: `sqrt(P_signal /
    /// P_noise)`.
    pub sample_signal_to_noise: f64,
    /// Errors of the model's PSFs at positions without samples.
    pub psfs: ErrorSummary,
    /// Differences of the ellipticity: lengths of the differences of `(e1, e2)`.
    pub ellipticity: Option<Spread>,
    /// Seconds to find the coefficients of the frame's samples in the basis ([`fit_in_basis`]).
    pub seconds: f64,
}

impl FrameComparison {
    /// Samples the frames, fits one basis, and compares the PSFs of each frame with the optics.
    ///
    /// # Errors
    /// [`LabError`] if the sampling or the fit fails, or if the optics cannot draw a PSF.
    pub(super) fn measure(seed: u64) -> Result<Self, LabError> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let telescopes = DRIFT.map(drifted).into_iter().collect::<Result<Vec<_>, _>>()?;
        let drawn = telescopes.iter().enumerate();
        let drawn = drawn.map(|(frame, telescope)| samples_of(frame, telescope, &mut rng));
        let drawn: Vec<(PsfSamples, f64)> = drawn.collect::<Result<_, LabError>>()?;
        let samples: Vec<&PsfSamples> = drawn.iter().map(|(samples, _)| samples).collect();
        let names: Vec<String> = (0..samples.len()).map(|k| format!("frame {k}")).collect();
        // The elbow, as in the paper. The noise of stars of different brightness has no edge.
        let options = FitOptions {
            rank: RankSelection::Elbow,
            ..FitOptions::default()
        };
        let psf = Psf::new(join_samples(&samples, &names)?, options);
        let record = psf.record()?;
        let basis = record.basis();
        let found = FitOptions {
            interpolation: record.interpolation(),
            ..options
        };
        let mut frames = Vec::with_capacity(DRIFT.len());
        for (frame, (telescope, (samples, snr_db))) in telescopes.iter().zip(&drawn).enumerate() {
            let errors = errors(&psf.at_state(frame as f64)?, telescope, &mut rng)?;
            let ellipticity = errors.iter().filter_map(ObjectRow::ellipticity_difference);
            frames.push(FrameRow {
                frame,
                samples: samples.len(),
                sample_snr_db: *snr_db,
                sample_signal_to_noise: 10f64.powf(snr_db / 20.0),
                psfs: ErrorSummary::of(&errors),
                ellipticity: Spread::of(ellipticity),
                seconds: seconds_in_basis(samples, basis, &found)?,
            });
        }
        Ok(Self {
            telescope: telescopes[0].params().name.clone(),
            rank: basis.rank(),
            interpolation: record.interpolation(),
            frames,
        })
    }

    /// The target for the time of a frame.
    pub(super) fn target(&self) -> Target {
        let slowest = self.frames.iter().map(|row| row.seconds).fold(0.0, f64::max);
        let what = format!("frames: seconds to find the coefficients of {STARS} stars in a given basis");
        Target::new(&what, SECONDS, Some(slowest))
    }

    pub(super) fn section(&self) -> Section {
        let median = |spread: Option<Spread>| short(spread.map(|s| s.median));
        let largest = |spread: Option<Spread>| short(spread.map(|s| s.largest));
        let columns: [Column<'_, FrameRow>; 11] = [
            ("frame", &|row| row.frame.to_string()),
            ("samples", &|row| row.samples.to_string()),
            ("SNR of samples (dB)", &|row| format!("{:.1}", row.sample_snr_db)),
            ("signal / noise", &|row| {
                format!("{:.0}", row.sample_signal_to_noise)
            }),
            ("relative L2, median", &|row| median(row.psfs.relative_l2)),
            ("relative L2, largest", &|row| largest(row.psfs.relative_l2)),
            ("FWHM (pixels), median", &|row| median(row.psfs.fwhm_px)),
            ("FWHM (pixels), largest", &|row| largest(row.psfs.fwhm_px)),
            ("ellipticity, median", &|row| median(row.ellipticity)),
            ("ellipticity, largest", &|row| largest(row.ellipticity)),
            ("seconds", &|row| short(Some(row.seconds))),
        ];
        let text = format!(
            "Four frames of a lens with a wide field ({}), with focus and seeing that drift from frame to \
             frame. Each has {STARS} samples at random positions of its own: images of single stars, with the \
             noise of their photons and of the sky. One basis with {} components serves all frames, \
             interpolated over the field by {}. The PSFs are compared with those of the optics at {HELD_OUT} \
             other positions of each frame.",
            self.telescope, self.rank, self.interpolation
        );
        Section::new("Four frames, one basis", [&text]).with_table(Table::new(
            "Frames of one basis. SNR: 10 log10(P_signal / P_noise) as in equation 6 of the paper, with sums \
             of squares over the pixels of a sample. Signal / noise: the ratio of the r.m.s. values, not in \
             dB. Both are medians over the samples. Errors: absolute differences of the model's PSFs from the \
             optics at positions between the samples. Seconds: to find the coefficients of the samples in the \
             given basis.",
            &columns,
            &self.frames,
        ))
    }
}

/// The telescope with the focus and the seeing of a frame.
fn drifted([defocus, slope, seeing]: [f64; 3]) -> Result<Telescope, LabError> {
    let mut params = Telescope::wide_field_lens().params().clone();
    let modes = params.wavefront.modes.iter_mut();
    for term in modes
        .filter(|mode| mode.noll == DEFOCUS)
        .flat_map(|mode| &mut mode.terms)
    {
        match (term.x, term.y) {
            (0, 0) => term.value += defocus,
            (1, 0) => term.value += slope,
            _ => {}
        }
    }
    if let Some(air) = &mut params.seeing {
        air.fwhm_arcsec = Some(seeing);
    }
    Ok(Telescope::new(params)?)
}

/// Draws the samples of a frame with their noise. Returns them and their median signal-to-noise
/// ratio in dB.
fn samples_of(
    frame: usize,
    telescope: &Telescope,
    rng: &mut ChaCha8Rng,
) -> Result<(PsfSamples, f64), LabError> {
    let positions = (0..STARS).map(|_| random_position(telescope.field(), rng));
    let positions: Vec<Position> = positions.collect::<Result<_, _>>()?;
    let states = (StateKind::Frame, &[frame as f64][..]);
    let exact = draw_states(&[telescope], states, &positions, &NoProgress)?;
    let mut stamps: Array3<f64> = exact.stamps().to_owned();
    let mut ratios_db = Vec::with_capacity(STARS);
    for (mut stamp, exact) in stamps.outer_iter_mut().zip(exact.stamps().outer_iter()) {
        let (low, high) = PHOTONS;
        let photons = low * (high / low).powf(rng.random());
        stamp.mapv_inplace(|value| {
            let noise: f64 = StandardNormal.sample(rng);
            value + noise * (photons * value + SKY).sqrt() / photons
        });
        ratios_db.push(Comparison::of(stamp.view(), exact)?.snr_db()?);
    }
    let median = Summary::of(ratios_db)?.median();
    Ok((
        PsfSamples::new(stamps, exact.positions().clone(), exact.grid())?,
        median,
    ))
}

/// Compares the PSFs of a frame with those of the optics, at random positions between its samples.
fn errors(psf: &Psf, telescope: &Telescope, rng: &mut ChaCha8Rng) -> Result<Vec<ObjectRow>, LabError> {
    let stars = psf.positions().as_slice().iter().map(|p| [p.x(), p.y()]);
    let hull = ConvexHull::new(&stars.collect::<Vec<_>>());
    let mut positions = Vec::with_capacity(HELD_OUT);
    while positions.len() < HELD_OUT {
        let at = random_position(telescope.field(), rng)?;
        if hull.contains([at.x(), at.y()]) {
            positions.push(at);
        }
    }
    psf_errors(psf.model()?, &positions, &true_psfs(telescope, &positions)?)
}

/// Seconds to find the coefficients of samples in a basis. The choice of an interpolation is not among them.
fn seconds_in_basis(samples: &PsfSamples, basis: &PsfBasis, options: &FitOptions) -> Result<f64, LabError> {
    let mut least = f64::INFINITY;
    for _ in 0..RUNS {
        let samples = samples.clone();
        let clock = Instant::now();
        fit_in_basis(samples, basis, options)?;
        least = least.min(clock.elapsed().as_secs_f64());
    }
    Ok(least)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::scenes::true_psf;

    #[test]
    fn frames_keep_their_own_psfs_and_find_their_coefficients_in_time() {
        let all = FrameComparison::measure(1).unwrap();
        assert_eq!(all.frames.len(), DRIFT.len());
        for row in &all.frames {
            assert_eq!(
                (row.samples, row.psfs.objects, row.psfs.failed),
                (STARS, HELD_OUT, 0)
            );
            // Stars of 1e5 to 1e7 photons, most of them in some ten pixels.
            assert!((40.0..60.0).contains(&row.sample_snr_db), "{row:?}");
            assert!((20.0 * row.sample_signal_to_noise.log10() - row.sample_snr_db).abs() < 1e-9);
            assert!(row.psfs.relative_l2.unwrap().median < MEDIAN_ERROR, "{row:?}");
        }
        // The PSFs of another frame would be wrong by far more.
        let telescopes = [DRIFT[0], DRIFT[3]].map(|drift| drifted(drift).unwrap());
        let middle = Position::of_pixel(2048, 2048);
        let [first, last] = telescopes.map(|telescope| true_psf(&telescope, middle).unwrap());
        let other = Comparison::of(last.view(), first.view())
            .unwrap()
            .relative_l2()
            .unwrap();
        assert!(other > 10.0 * MEDIAN_ERROR, "{other}");
    }

    /// Largest median error of a frame (relative L2): that of the noise and of the interpolation
    /// over 150 stars, measured as 0.008.
    const MEDIAN_ERROR: f64 = 0.015;
}
