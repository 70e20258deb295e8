//! Sources of a frame: the Gaussian fitted to each, and the reasons why some are rejected as
//! samples.

use nalgebra::{SMatrix, SVector};
use ndarray::ArrayView2;
use psf_types::maths::FWHM_PER_SIGMA;
use serde::{Serialize, Serializer};

/// A reason why a source does not serve as a PSF sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Rejection {
    /// A pixel of its core is at or above the saturation level.
    Saturated,
    /// Its centre is too close to the frame's edge: by default, so close that its stamp would
    /// extend beyond the frame.
    Edge,
    /// Its signal-to-noise ratio does not exceed the limit, or its flux from the registration is
    /// not positive.
    LowSnr,
    /// Another source is too close and too bright.
    Neighbour,
    /// No Gaussian fits it, or the fit found a brighter source near it.
    NoFit,
    /// It is narrower than the stars near it: a hot pixel or a cosmic ray.
    TooSharp,
    /// It is broader than the stars near it: a galaxy or a blend.
    TooBroad,
    /// Its elongation differs from that of the stars near it: a blend, a trail or a galaxy.
    Elongated,
    /// It does not agree with the oversampled PSF fitted to all stars.
    PsfMismatch,
    /// It is held out of the samples, to check a model
    /// ([`StarSampling::with_hold_out`](crate::StarSampling::with_hold_out)).
    HeldOut,
    /// A pixel in or near its core is masked.
    Masked,
}

impl Rejection {
    /// All reasons, in the order in which tables list them.
    pub const ALL: [Self; 11] = [
        Self::Saturated,
        Self::Edge,
        Self::LowSnr,
        Self::Neighbour,
        Self::NoFit,
        Self::TooSharp,
        Self::TooBroad,
        Self::Elongated,
        Self::PsfMismatch,
        Self::HeldOut,
        Self::Masked,
    ];

    /// The short name used in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Saturated => "saturated",
            Self::Edge => "edge",
            Self::LowSnr => "low-snr",
            Self::Neighbour => "neighbour",
            Self::NoFit => "no-fit",
            Self::TooSharp => "too-sharp",
            Self::TooBroad => "too-broad",
            Self::Elongated => "elongated",
            Self::PsfMismatch => "psf-mismatch",
            Self::HeldOut => "held-out",
            Self::Masked => "masked",
        }
    }
}

/// The reasons why a source was rejected. The set is empty for a source that serves as a sample.
/// The text form is the names of the reasons, joined by `+`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Rejections(u16);

impl Rejections {
    /// Returns whether the set is empty.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Returns whether the set contains `reason`.
    pub fn contains(self, reason: Rejection) -> bool {
        self.0 & (1 << reason as u16) != 0
    }

    /// The reasons in the set.
    pub fn iter(self) -> impl Iterator<Item = Rejection> {
        Rejection::ALL
            .into_iter()
            .filter(move |&reason| self.contains(reason))
    }

    pub(crate) fn insert(&mut self, reason: Rejection) {
        self.0 |= 1 << reason as u16;
    }
}

impl std::fmt::Display for Rejections {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (k, reason) in self.iter().enumerate() {
            if k > 0 {
                f.write_str("+")?;
            }
            f.write_str(reason.name())?;
        }
        Ok(())
    }
}

impl Serialize for Rejections {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

psf_types::table_row! {
    /// A source of a frame, either a PSF sample or rejected.
    #[derive(Debug, Clone, PartialEq, Serialize)]
    #[non_exhaustive]
    SOURCE_COLUMNS Source {
        /// Column coordinate of the centre, 0-based pixels of the frame. For a sample of an oversampled
        /// PSF, it comes from the fit of this PSF. Otherwise it comes from the Gaussian fit. If no
        /// Gaussian fits, it is the centre of the light around the peak.
        x: f64,
        /// Row coordinate of the centre.
        y: f64,
        /// Flux in units of the frame. A PSF stamp of unit flux, multiplied by this flux, gives the
        /// star. For a sample, the flux results from the registration, which subtracts the background
        /// near the star. For other sources, the flux results from a fit of the nearest sample's PSF.
        /// This fit ignores masked and saturated pixels.
        flux: f64,
        /// Signal-to-noise ratio ([`Camera::snr`](crate::Camera::snr)). The radius of the aperture is
        /// 1.25 times the FWHM of the frame's stars, at least 2 pixels.
        snr: f64,
        /// Height of the matched-filtered peak in sigma of the background noise.
        significance: f64,
        /// The value of the brightest pixel of its core, background included.
        peak: f64,
        /// The background at its centre.
        background: f64,
        /// The noise of the background at its centre.
        background_rms: f64,
        /// FWHM of the Gaussian fit in pixels (geometric mean of the axes). `None` if there is no fit.
        fwhm_px: Option<f64>,
        /// Distortion of the Gaussian fit along the axes of the frame.
        e1: Option<f64>,
        /// Distortion along the diagonals.
        e2: Option<f64>,
        /// Number of pixels above the threshold that belong to it.
        pixel_count: usize,
        /// Distance to the nearest other source in pixels. `None` if there is no other source.
        nearest_px: Option<f64>,
        /// Index of its PSF sample. `None` if it was rejected.
        sample: Option<usize>,
        /// The reasons why it was rejected.
        rejected: Rejections,
    }
}

type Parameters = SVector<f64, 6>;
type Normal = SMatrix<f64, 6, 6>;

/// The Gaussian fitted to a source, in pixels of the frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Gaussian {
    pub(crate) amplitude: f64,
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) fwhm_px: f64,
    /// Distortion along the axes of the frame.
    pub(crate) e1: f64,
    /// Distortion along the diagonals.
    pub(crate) e2: f64,
}

const MAX_ITERATIONS: usize = 60;
/// The fit ends when a step changes the centre by less than this number of pixels, and the widths
/// by less than this fraction.
const CONVERGED: f64 = 1e-6;
/// If the centre moves farther from the peak than this, in pixels, the fit has found another
/// source.
const MAX_CENTRE_SHIFT_PX: f64 = 2.0;
/// A fit with a smaller FWHM in pixels is not a valid measurement.
const SMALLEST_FWHM: f64 = 0.3;

impl Gaussian {
    /// Fits `A exp(-|L^T r|^2 / 2)` with `L = [[exp a, 0], [b, exp c]]` by least squares
    /// (Levenberg-Marquardt). Here `r` is the offset from the centre. The data are the frame minus
    /// its background, within `reach` pixels of a peak along each axis. Returns `None` if the fit
    /// does not converge near the peak to a plausible width.
    ///
    /// The fit is fast enough for thousands of peaks: it starts from the stars' width and stops at
    /// 1e-6 pixels. The fit of `psf-metrics` is slower: it searches for its start and iterates
    /// until only rounding errors remain.
    pub(crate) fn fit(
        excess: ArrayView2<'_, f64>,
        (column, row): (usize, usize),
        reach: usize,
        fwhm_px: f64,
    ) -> Option<Self> {
        let (ny, nx) = excess.dim();
        let about = |at: usize, n: usize| at.saturating_sub(reach)..(at + reach + 1).min(n);
        let (columns, rows) = (about(column, nx), about(row, ny));
        if columns.len() * rows.len() < 9 {
            return None;
        }
        let (x0, y0) = (column as f64, row as f64);
        let pixels: Vec<(f64, f64, f64)> = rows
            .flat_map(|y| columns.clone().map(move |x| (x, y)))
            .map(|(x, y)| (x as f64 - x0, y as f64 - y0, excess[[y, x]]))
            .collect();
        let inverse_sigma = (FWHM_PER_SIGMA / fwhm_px).ln();
        let peak = excess[[row, column]];
        if peak <= 0.0 {
            return None;
        }
        let p = minimise(
            &pixels,
            Parameters::from([peak, 0.0, 0.0, inverse_sigma, 0.0, inverse_sigma]),
        )?;
        let found = Self::of(&p, x0, y0)?;
        let near = p[1].abs() <= MAX_CENTRE_SHIFT_PX && p[2].abs() <= MAX_CENTRE_SHIFT_PX;
        let sized = (SMALLEST_FWHM..=4.0 * reach as f64).contains(&found.fwhm_px);
        (near && sized && found.amplitude > 0.0).then_some(found)
    }

    fn of(p: &Parameters, x0: f64, y0: f64) -> Option<Self> {
        let (l, m, n) = (p[3].exp(), p[4], p[5].exp());
        // The inverse covariance is L L^T.
        let (qxx, qxy, qyy) = (l * l, l * m, m * m + n * n);
        let determinant = qxx * qyy - qxy * qxy;
        let (xx, yy, xy) = (qyy / determinant, qxx / determinant, -qxy / determinant);
        let fwhm_px = FWHM_PER_SIGMA * determinant.powf(-0.25);
        let trace = xx + yy;
        (fwhm_px.is_finite() && trace.is_finite()).then(|| Self {
            amplitude: p[0],
            x: x0 + p[1],
            y: y0 + p[2],
            fwhm_px,
            e1: (xx - yy) / trace,
            e2: 2.0 * xy / trace,
        })
    }
}

/// Returns half the sum of squared residuals, its gradient and the normal matrix.
fn linearised(pixels: &[(f64, f64, f64)], p: &Parameters) -> (f64, Parameters, Normal) {
    let (l, m, n) = (p[3].exp(), p[4], p[5].exp());
    let (mut cost, mut gradient, mut normal) = (0.0, Parameters::zeros(), Normal::zeros());
    for &(x, y, value) in pixels {
        let (dx, dy) = (x - p[1], y - p[2]);
        let (u, v) = (l * dx + m * dy, n * dy);
        let shape = (-0.5 * (u * u + v * v)).exp();
        let model = p[0] * shape;
        let row = Parameters::from([
            shape,
            model * u * l,
            model * (u * m + v * n),
            -model * u * l * dx,
            -model * u * dy,
            -model * v * n * dy,
        ]);
        let residual = model - value;
        cost += 0.5 * residual * residual;
        gradient += row * residual;
        normal += row * row.transpose();
    }
    (cost, gradient, normal)
}

fn minimise(pixels: &[(f64, f64, f64)], start: Parameters) -> Option<Parameters> {
    let mut p = start;
    let (mut cost, mut gradient, mut normal) = linearised(pixels, &p);
    let mut damping = 1e-3;
    for _ in 0..MAX_ITERATIONS {
        let mut matrix = normal;
        for k in 0..6 {
            matrix[(k, k)] = normal[(k, k)] * (1.0 + damping) + f64::MIN_POSITIVE;
        }
        let Some(step) = matrix.cholesky().map(|c| c.solve(&-gradient)) else {
            damping *= 10.0;
            continue;
        };
        let trial = p + step;
        let at = linearised(pixels, &trial);
        if at.0.is_finite() && at.0 <= cost {
            let settled = step.iter().skip(1).all(|s| s.abs() < CONVERGED);
            (p, (cost, gradient, normal)) = (trial, at);
            damping *= 0.2;
            if settled {
                return Some(p);
            }
        } else {
            damping *= 5.0;
            if damping > 1e10 {
                return None;
            }
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;

    use super::*;

    #[test]
    fn reasons_are_a_set_with_names() {
        let mut reasons = Rejections::default();
        assert!(reasons.is_empty() && reasons.to_string().is_empty());
        for reason in Rejection::ALL {
            assert!(!reasons.contains(reason));
            reasons.insert(reason);
            reasons.insert(reason);
            assert!(reasons.contains(reason));
        }
        assert_eq!(reasons.iter().count(), Rejection::ALL.len());
        assert!(reasons.to_string().starts_with("saturated+edge+low-snr"));
    }

    /// A pixel-integrated Gaussian is not a Gaussian. This is the largest resulting error in
    /// position for a FWHM of 1.4 pixels.
    const CENTRE_PX: f64 = 0.01;

    #[test]
    fn an_undersampled_pixel_integrated_star_keeps_its_place() {
        let sigma = 1.4 / FWHM_PER_SIGMA;
        for (x, y) in [(10.0, 10.0), (10.3, 9.8), (9.5, 10.49)] {
            let steps = 20;
            let frame = Array2::from_shape_fn((21, 21), |(j, i)| {
                let mut sum = 0.0;
                for k in 0..steps * steps {
                    let sub = |k: usize| (k as f64 + 0.5) / f64::from(steps as u32) - 0.5;
                    let (dx, dy) = (i as f64 + sub(k % steps) - x, j as f64 + sub(k / steps) - y);
                    sum += (-0.5 * (dx * dx + dy * dy) / (sigma * sigma)).exp();
                }
                sum
            });
            let fit = Gaussian::fit(frame.view(), (10, 10), 3, 2.0).unwrap();
            assert!(
                (fit.x - x).abs() < CENTRE_PX && (fit.y - y).abs() < CENTRE_PX,
                "{fit:?}"
            );
            // Pixel integration widens the star: sigma^2 + 1/12.
            let wide = FWHM_PER_SIGMA * (sigma * sigma + 1.0 / 12.0).sqrt();
            assert!((fit.fwhm_px / wide - 1.0).abs() < 0.03, "{fit:?} against {wide}");
        }
    }

    #[test]
    fn an_elongated_star_has_its_distortion() {
        let (xx, yy, xy) = (4.0, 2.0, 0.7);
        let determinant = xx * yy - xy * xy;
        let frame = Array2::from_shape_fn((31, 31), |(j, i)| {
            let (x, y) = (i as f64 - 15.2, j as f64 - 14.9);
            7.0 * (-0.5 * (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant).exp()
        });
        let fit = Gaussian::fit(frame.view(), (15, 15), 8, 2.0).unwrap();
        assert!(
            (fit.e1 - 2.0 / 6.0).abs() < 1e-6 && (fit.e2 - 1.4 / 6.0).abs() < 1e-6,
            "{fit:?}"
        );
        assert!((fit.fwhm_px - FWHM_PER_SIGMA * determinant.powf(0.25)).abs() < 1e-6);
        assert!((fit.amplitude - 7.0).abs() < 1e-6 && (fit.x - 15.2).abs() < 1e-6);
    }

    #[test]
    fn a_frame_without_a_peak_gives_no_fit() {
        let flat = Array2::from_elem((11, 11), -1.0);
        assert_eq!(Gaussian::fit(flat.view(), (5, 5), 3, 2.0), None);
    }
}
