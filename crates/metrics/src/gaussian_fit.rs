//! Gaussian fits by least squares.

use std::f64::consts::TAU;

use ndarray::ArrayView2;
use psf_types::Real;
use serde::Serialize;

use crate::gaussian_model::{GaussianModel, Profile, coarse_search};
use crate::levenberg_marquardt::minimise;
use crate::window::Cutout;
use crate::{Covariance, FWHM_PER_SIGMA, MetricsError, Window};

/// The result of a [`GaussianFitter`]. Lengths are in pixels of the stamp. Every number is finite.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GaussianFit {
    flux: f64,
    amplitude: f64,
    x_centroid: f64,
    y_centroid: f64,
    fwhm_px: f64,
    fwhm_major_px: f64,
    fwhm_minor_px: f64,
    angle_rad: f64,
    eccentricity: f64,
    background: Option<f64>,
    residual_rms: f64,
    iterations: usize,
    covariance: Covariance,
}

impl GaussianFit {
    /// The integral of the Gaussian, `2 pi A sigma_major sigma_minor`, in units of the stamp. It
    /// excludes the background and includes the light beyond the window.
    pub fn flux(&self) -> f64 {
        self.flux
    }

    /// The height of the Gaussian's peak above the background.
    pub fn amplitude(&self) -> f64 {
        self.amplitude
    }

    /// Column coordinate of the centre, a 0-based index of the stamp.
    pub fn x_centroid(&self) -> f64 {
        self.x_centroid
    }

    /// Row coordinate of the centre, a 0-based index of the stamp.
    pub fn y_centroid(&self) -> f64 {
        self.y_centroid
    }

    /// Geometric mean of the two FWHM.
    pub fn fwhm_px(&self) -> f64 {
        self.fwhm_px
    }

    /// FWHM along the major axis.
    pub fn fwhm_major_px(&self) -> f64 {
        self.fwhm_major_px
    }

    /// FWHM along the minor axis.
    pub fn fwhm_minor_px(&self) -> f64 {
        self.fwhm_minor_px
    }

    /// Direction of the major axis from +x towards +y, in (-pi/2, pi/2]. It is 0 for a round fit.
    pub fn angle_rad(&self) -> f64 {
        self.angle_rad
    }

    /// The eccentricity `sqrt(1 - b^2 / a^2)` of the axes `a >= b`. It is not a distortion: see
    /// [`covariance`](Self::covariance) for that.
    pub fn eccentricity(&self) -> f64 {
        self.eccentricity
    }

    /// The former name of [`eccentricity`](Self::eccentricity).
    #[deprecated = "use `eccentricity`, or `covariance().distortion().length()` for |e|"]
    pub fn ellipticity(&self) -> f64 {
        self.eccentricity
    }

    /// The constant background, if it was fitted.
    pub fn background(&self) -> Option<f64> {
        self.background
    }

    /// Root of the mean squared residual over the window, in units of the stamp.
    pub fn residual_rms(&self) -> f64 {
        self.residual_rms
    }

    /// The number of iterations of the fit.
    pub fn iterations(&self) -> usize {
        self.iterations
    }

    /// The Gaussian's covariance, with its distortion and its reduced shear.
    pub fn covariance(&self) -> Covariance {
        self.covariance
    }
}

/// Fits a Gaussian to a stamp by unweighted least squares.
///
/// ```text
/// minimise  sum over pixels [A exp(-(r - r0)^T C^-1 (r - r0) / 2) + B - stamp]^2
/// ```
///
/// over the amplitude `A`, the centre `r0`, the covariance `C` (round or elliptical) and, if
/// requested, the constant background `B`. The model is the Gaussian *at pixel centres*, not its
/// integral over the pixel. The FWHM therefore includes the pixel response if the stamp includes
/// it. The minimum is found by Levenberg-Marquardt (Marquardt 1963) with an analytic Jacobian, and by
/// Newton's method in the last steps. Where the Gaussian is negligible, below 1e-15 of the largest
/// value or less, it counts as 0. The parameters are the elements of a Cholesky factor of `C^-1`, with
/// the logarithms of its diagonal. They need no bounds, and a round PSF is not a special case. The fit
/// starts at the best of a coarse grid of round Gaussians.
///
/// The stamp is `[y, x]`, `f32` or `f64`, in any units.
///
/// ```
/// use psf_metrics::{FWHM_PER_SIGMA, GaussianFitter, Window};
/// use ndarray::Array2;
/// let stamp = Array2::from_shape_fn((64, 64), |(y, x)| {
///     let (dx, dy) = (x as f64 - 32.2, y as f64 - 31.9);
///     5.0 * (-0.5 * (dx * dx / 4.0 + dy * dy / 2.25)).exp()
/// });
/// let fit = GaussianFitter::elliptical().with_window(Window::central(15)).fit(stamp.view())?;
/// assert!((fit.x_centroid() - 32.2).abs() < 1e-9);
/// assert!((fit.fwhm_major_px() - 2.0 * FWHM_PER_SIGMA).abs() < 1e-9);
/// assert!((fit.eccentricity() - (1.0f64 - 2.25 / 4.0).sqrt()).abs() < 1e-9);
/// # Ok::<(), psf_metrics::MetricsError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GaussianFitter {
    profile: Profile,
    background: bool,
    window: Window,
}

/// Fewest pixels along an axis: three are needed to separate a centre from a width.
const SMALLEST_SIDE: usize = 3;
/// A narrower Gaussian covers only one pixel: at sigma 0.2 a neighbour has 4e-6 of the peak.
const SMALLEST_SIGMA_PX: f64 = 0.2;
/// The largest sigma divided by the window's longer side. A wider Gaussian is flat in the window.
const LARGEST_SIGMA_SIDES: f64 = 2.0;

impl GaussianFitter {
    /// Fits an elliptical Gaussian without background to all pixels.
    pub fn elliptical() -> Self {
        Self {
            profile: Profile::Elliptical,
            background: false,
            window: Window::whole(),
        }
    }

    /// Fits a round Gaussian without background to all pixels.
    pub fn round() -> Self {
        Self {
            profile: Profile::Round,
            ..Self::elliptical()
        }
    }

    /// Sets whether a constant background is fitted as a further parameter.
    #[must_use]
    pub fn with_background(self, background: bool) -> Self {
        Self { background, ..self }
    }

    /// Restricts the fit to the pixels of a window.
    #[must_use]
    pub fn with_window(self, window: Window) -> Self {
        Self { window, ..self }
    }

    /// Fits `stamp`, `[y, x]`. Centroids are 0-based indices of the whole stamp, also with a
    /// window.
    ///
    /// # Errors
    /// * [`MetricsError::WindowOutsideStamp`]: the window does not fit on the stamp.
    /// * [`MetricsError::TooFewPixels`]: fewer than 3 pixels along an axis.
    /// * [`MetricsError::NonFinite`]: NaN or infinity in the window.
    /// * [`MetricsError::NoPeak`]: no Gaussian with a positive amplitude fits.
    /// * [`MetricsError::NotConverged`]: the iteration did not converge. This happens if there is
    ///   no best width: for an undersampled star centred between pixels, noise can favour ever
    ///   narrower and higher Gaussians. A round fit converges more often.
    /// * [`MetricsError::CentreLeftWindow`]: the best centre lies outside the window.
    /// * [`MetricsError::WidthOutOfRange`]: a sigma is below 0.2 pixels (a single bright pixel) or
    ///   above twice the window's longer side (a flat stamp).
    /// * [`MetricsError::DegenerateCovariance`], [`MetricsError::Undetermined`]: the pixels do not
    ///   determine the ellipse.
    /// * [`MetricsError::Overflow`]: a result exceeds the range of double precision.
    pub fn fit<T: Real>(&self, stamp: ArrayView2<'_, T>) -> Result<GaussianFit, MetricsError> {
        let mut cutout = self.window.cut(stamp, SMALLEST_SIDE)?;
        let largest = cutout.largest();
        let units = Units::normalise(&mut cutout, self.background)?;
        match (self.profile, self.background) {
            (Profile::Round, false) => self.fit_parameters::<4>(&cutout, units, largest),
            (Profile::Round, true) => self.fit_parameters::<5>(&cutout, units, largest),
            (Profile::Elliptical, false) => self.fit_parameters::<6>(&cutout, units, largest),
            (Profile::Elliptical, true) => self.fit_parameters::<7>(&cutout, units, largest),
        }
    }

    fn fit_parameters<const N: usize>(
        &self,
        cutout: &Cutout,
        units: Units,
        largest: f64,
    ) -> Result<GaussianFit, MetricsError> {
        let no_peak = |amplitude| MetricsError::NoPeak { largest, amplitude };
        let start = coarse_search(cutout, self.background).ok_or_else(|| no_peak(0.0))?;
        let model = GaussianModel::new(self.profile, self.background);
        let data_norm = cutout.values.iter().map(|v| v * v).sum::<f64>().sqrt();
        let minimum = match minimise(model.parameters::<N>(start), data_norm, |p| {
            model.linearise(p, cutout)
        }) {
            Ok(minimum) => minimum,
            Err(unsettled) => {
                // A width out of range is the better report: it does not depend on the iteration
                // at which the fit was stopped.
                check_width(model.covariance(&unsettled.parameters)?, cutout)?;
                return Err(MetricsError::NotConverged {
                    iterations: unsettled.iterations,
                    change: unsettled.change,
                });
            }
        };
        let p = minimum.parameters;
        if p[0] <= 0.0 {
            return Err(no_peak(p[0] * units.scale));
        }
        let covariance = model.covariance(&p)?;
        check_width(covariance, cutout)?;
        cutout.check_centre(p[1], p[2])?;
        if !minimum.at.is_determined() {
            return Err(MetricsError::Undetermined { parameters: N });
        }
        let (x_centroid, y_centroid) = cutout.on_stamp(p[1], p[2]);
        let amplitude = p[0] * units.scale;
        let fit = GaussianFit {
            flux: TAU * amplitude * covariance.determinant().sqrt(),
            amplitude,
            x_centroid,
            y_centroid,
            fwhm_px: FWHM_PER_SIGMA * covariance.sigma_px(),
            fwhm_major_px: FWHM_PER_SIGMA * covariance.sigma_major_px(),
            fwhm_minor_px: FWHM_PER_SIGMA * covariance.sigma_minor_px(),
            angle_rad: covariance.angle_rad(),
            eccentricity: covariance.eccentricity(),
            background: model.background(&p).map(|b| b * units.scale + units.offset),
            residual_rms: (2.0 * minimum.at.cost / cutout.values.len() as f64).sqrt() * units.scale,
            iterations: minimum.iterations,
            covariance,
        };
        // The other results cannot overflow, because all pixels are finite.
        if fit.flux.is_finite() && fit.amplitude.is_finite() && fit.background.is_none_or(f64::is_finite) {
            Ok(fit)
        } else {
            Err(MetricsError::Overflow {
                largest: units.extreme,
            })
        }
    }
}

fn check_width(covariance: Covariance, cutout: &Cutout) -> Result<(), MetricsError> {
    let (rows, columns) = cutout.values.dim();
    let largest_px = LARGEST_SIGMA_SIDES * rows.max(columns) as f64;
    if covariance.sigma_minor_px() >= SMALLEST_SIGMA_PX && covariance.sigma_major_px() <= largest_px {
        return Ok(());
    }
    Err(MetricsError::WidthOutOfRange {
        major_px: covariance.sigma_major_px(),
        minor_px: covariance.sigma_minor_px(),
        smallest_px: SMALLEST_SIGMA_PX,
        largest_px,
    })
}

/// The offset and the scale that normalise the values to the range from -1 to 1:
/// `value = scaled * scale + offset`.
#[derive(Debug, Clone, Copy)]
struct Units {
    offset: f64,
    scale: f64,
    /// The value of largest magnitude before the normalisation, with its sign.
    extreme: f64,
}

impl Units {
    /// Normalises the cutout's values in place and returns the offset and the scale. If a
    /// background is fitted, the offset is the median, so that a high sky does not reduce the
    /// precision. Otherwise it is 0.
    fn normalise(cutout: &mut Cutout, background: bool) -> Result<Self, MetricsError> {
        let largest = cutout.largest();
        let offset = if background {
            let mut values: Vec<f64> = cutout.values.iter().copied().collect();
            let middle = values.len() / 2;
            *values.select_nth_unstable_by(middle, f64::total_cmp).1
        } else {
            0.0
        };
        let scale = cutout
            .values
            .iter()
            .fold(0.0, |most: f64, v| most.max((v - offset).abs()));
        if scale == 0.0 {
            return Err(MetricsError::NoPeak {
                largest,
                amplitude: 0.0,
            });
        }
        let extreme = cutout.extreme();
        if !scale.is_finite() {
            return Err(MetricsError::Overflow { largest: extreme });
        }
        cutout.values.mapv_inplace(|v| (v - offset) / scale);
        Ok(Self {
            offset,
            scale,
            extreme,
        })
    }
}
