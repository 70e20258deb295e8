//! Second moments: adaptive (with a matching Gaussian weight) and unweighted.

use ndarray::ArrayView2;
use psf_types::Real;
use serde::Serialize;

use crate::adaptive_weight::{Weight, WeightedPixels, check_width};
use crate::comparison::CompensatedSum;
use crate::{Covariance, MetricsError, Window};

/// The centroid and the ellipse of second moments, common to both kinds of moments.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Shape {
    x_centroid: f64,
    y_centroid: f64,
    sigma_px: f64,
    e1: f64,
    e2: f64,
    g1: f64,
    g2: f64,
}

impl Shape {
    fn new((x_centroid, y_centroid): (f64, f64), covariance: Covariance) -> Self {
        let (e, g) = (covariance.distortion(), covariance.reduced_shear());
        Self {
            x_centroid,
            y_centroid,
            sigma_px: covariance.sigma_px(),
            e1: e.e1(),
            e2: e.e2(),
            g1: g.g1(),
            g2: g.g2(),
        }
    }
}

/// Implements the accessors of a [`Shape`] and of the second moments. `$letter` is the name of the
/// second moments in the equations of the type.
macro_rules! shape_accessors {
    ($moments:ident, $letter:literal, $kind:literal) => {
        impl $moments {
            /// Column coordinate of the centroid, a 0-based index of the stamp.
            pub fn x_centroid(&self) -> f64 {
                self.shape.x_centroid
            }

            /// Row coordinate of the centroid, a 0-based index of the stamp.
            pub fn y_centroid(&self) -> f64 {
                self.shape.y_centroid
            }

            #[doc = concat!("The size `det(", $letter, ")^(1/4)`.")]
            pub fn sigma_px(&self) -> f64 {
                self.shape.sigma_px
            }

            #[doc = concat!("Distortion along the axes of the grid, `(", $letter, "xx - ", $letter, "yy)")]
            #[doc = concat!("/ (", $letter, "xx + ", $letter, "yy)`.")]
            pub fn e1(&self) -> f64 {
                self.shape.e1
            }

            #[doc = concat!("Distortion along the diagonals of the grid, `2 ", $letter, "xy")]
            #[doc = concat!("/ (", $letter, "xx + ", $letter, "yy)`.")]
            pub fn e2(&self) -> f64 {
                self.shape.e2
            }

            /// The ellipticity `|e| = sqrt(e1^2 + e2^2)`, the length of the distortion.
            pub fn ellipticity(&self) -> f64 {
                self.e1().hypot(self.e2())
            }

            /// Reduced shear along the axes of the grid.
            pub fn g1(&self) -> f64 {
                self.shape.g1
            }

            /// Reduced shear along the diagonals of the grid.
            pub fn g2(&self) -> f64 {
                self.shape.g2
            }

            #[doc = concat!("The ", $kind, " `", $letter, "`.")]
            pub fn covariance(&self) -> Covariance {
                self.covariance
            }
        }
    };
}

/// Adaptive moments, as [`AdaptiveMomentFinder`] measures them. Lengths are in pixels of the stamp.
/// Every number is finite.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AdaptiveMoments {
    amplitude: f64,
    #[serde(flatten)]
    shape: Shape,
    iterations: usize,
    covariance: Covariance,
}

shape_accessors!(AdaptiveMoments, "M", "adaptive second moments");

impl AdaptiveMoments {
    /// Flux of the best-fit elliptical Gaussian, `2 sum w I`, in the units of the stamp's values
    /// (HSM's amplitude). [`AdaptiveMomentFinder`] defines `w` and `I`.
    pub fn amplitude(&self) -> f64 {
        self.amplitude
    }

    /// The number of iterations of the measurement.
    pub fn iterations(&self) -> usize {
        self.iterations
    }
}

/// Unweighted moments of the light in a window. Lengths are in pixels of the stamp. Every number is
/// finite.
///
/// ```text
/// flux = sum I      x0 = sum I x / flux      Q = sum I (x - x0)(x - x0)^T / flux
/// ```
///
/// The sums run over the pixels, with value `I` at position `x`.
///
/// All pixels have equal weight. A background, noise and distant diffraction wings contribute with
/// the square of their distance, so the result depends on the window. [`AdaptiveMomentFinder`]
/// gives distant pixels almost no weight.
///
/// ```
/// use psf_metrics::{QuadrupoleMoments, Window};
/// use ndarray::array;
/// let stamp = array![[0.0, 1.0, 0.0], [2.0, 0.0, 2.0], [0.0, 1.0, 0.0]];
/// let moments = QuadrupoleMoments::measure(stamp.view(), Window::whole())?;
/// assert_eq!((moments.flux(), moments.x_centroid(), moments.y_centroid()), (6.0, 1.0, 1.0));
/// assert!((moments.e1() - 1.0 / 3.0).abs() < 1e-15); // Qxx = 4/6, Qyy = 2/6
/// # Ok::<(), psf_metrics::MetricsError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct QuadrupoleMoments {
    flux: f64,
    #[serde(flatten)]
    shape: Shape,
    covariance: Covariance,
}

shape_accessors!(QuadrupoleMoments, "Q", "second moments");

impl QuadrupoleMoments {
    /// Measures `stamp`, `[y, x]`, inside `window`. Centroids are 0-based indices of the whole
    /// stamp.
    ///
    /// # Errors
    /// * [`MetricsError::WindowOutsideStamp`]: the window does not fit on the stamp.
    /// * [`MetricsError::TooFewPixels`]: fewer than 2 pixels along an axis.
    /// * [`MetricsError::NonFinite`]: NaN or infinity in the window.
    /// * [`MetricsError::NonPositiveFlux`]: the window's sum is not positive.
    /// * [`MetricsError::CentreLeftWindow`]: negative pixels move the centroid out of the window.
    /// * [`MetricsError::DegenerateCovariance`]: all flux is in one pixel or on one line, or there
    ///   are negative pixels far from the centre.
    /// * [`MetricsError::Overflow`]: a sum exceeds the range of double precision.
    pub fn measure<T: Real>(stamp: ArrayView2<'_, T>, window: Window) -> Result<Self, MetricsError> {
        let cutout = window.cut(stamp, 2)?;
        let mut sums = [CompensatedSum::default(); 3];
        for (x, y, value) in cutout.pixels() {
            for (sum, term) in sums.iter_mut().zip([value, value * x, value * y]) {
                sum.add(term);
            }
        }
        let [flux, x, y] = sums.map(CompensatedSum::value);
        let overflow = || MetricsError::Overflow {
            largest: cutout.extreme(),
        };
        if !(flux.is_finite() && x.is_finite() && y.is_finite()) {
            return Err(overflow());
        }
        if flux <= 0.0 {
            return Err(MetricsError::NonPositiveFlux { flux });
        }
        let (x0, y0) = (x / flux, y / flux);
        cutout.check_centre(x0, y0)?;
        let mut sums = [CompensatedSum::default(); 3];
        for (x, y, value) in cutout.pixels() {
            let (dx, dy) = (x - x0, y - y0);
            for (sum, term) in sums.iter_mut().zip([dx * dx, dx * dy, dy * dy]) {
                sum.add(value * term);
            }
        }
        let [xx, xy, yy] = sums.map(|sum| sum.value() / flux);
        if !(xx.is_finite() && xy.is_finite() && yy.is_finite()) {
            return Err(overflow());
        }
        let covariance = Covariance::new(xx, xy, yy)?;
        Ok(Self {
            flux,
            shape: Shape::new(cutout.on_stamp(x0, y0), covariance),
            covariance,
        })
    }

    /// The sum of the values in the window.
    pub fn flux(&self) -> f64 {
        self.flux
    }
}

/// Measures adaptive moments: second moments under the elliptical Gaussian weight that matches
/// them.
///
/// The centroid `x0` and the matrix `M` solve
///
/// ```text
/// w(x)  = exp(-(x - x0)^T M^-1 (x - x0) / 2)
/// 0     = sum w(x) I(x) (x - x0)
/// M / 2 = sum w(x) I(x) (x - x0)(x - x0)^T / sum w(x) I(x)
/// ```
///
/// where the sums run over the pixels, with value `I(x)` at position `x`.
///
/// The definition follows Bernstein & Jarvis 2002, AJ 123, 583, and Hirata & Seljak 2003, MNRAS
/// 343, 459. The step limits of the iteration follow Mandelbaum et al. 2005, MNRAS 361, 1287, whose
/// code became GalSim's HSM module. For a Gaussian, `M` is its covariance.
///
/// The weight is sampled at pixel centres, and `M` includes the pixel response if the stamp
/// includes it. Sampling limits the accuracy. For a Gaussian, the error of the size is below 0.2 %
/// at a sigma of 1 pixel, and below 3 % at 0.85 pixels. Below a sigma of about 0.75 pixels (FWHM
/// 1.8) the equations have no solution at some sub-pixel positions, and the weight shrinks to one
/// pixel. Measure such a PSF on an oversampled stamp.
///
/// The iteration starts at the window's centre pixel (index `n / 2`) with a round weight of sigma 5
/// pixels, or of a sixth of the window's shorter side if that is less.
/// [`with_start`](Self::with_start) sets another start. HSM's step, which would reach the solution at
/// once if a Gaussian were close to it, is repeated until it becomes small. Then steps of Newton's
/// method follow, where HSM's steps converge too. The iteration ends when HSM's step would change `M`
/// by less than 1e-11 of its smaller eigenvalue and the centroid by less than 1e-11 sigma. A PSF takes
/// about a dozen steps. Pixels far out, whose weighted light is below 1e-15 of the sum, are left out.
///
/// The stamp is `[y, x]`, `f32` or `f64`, in any units. It must not contain a background.
///
/// ```
/// use psf_metrics::AdaptiveMomentFinder;
/// use ndarray::Array2;
/// let stamp = Array2::from_shape_fn((64, 64), |(y, x)| {
///     let (dx, dy) = (x as f64 - 32.2, y as f64 - 31.9);
///     (-0.5 * (dx * dx / 9.0 + dy * dy / 4.0)).exp()
/// });
/// let moments = AdaptiveMomentFinder::new().measure(stamp.view())?;
/// assert!((moments.sigma_px() - 6.0f64.sqrt()).abs() < 1e-9);
/// assert!((moments.g1() - (3.0 - 2.0) / (3.0 + 2.0)).abs() < 1e-9);
/// # Ok::<(), psf_metrics::MetricsError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdaptiveMomentFinder {
    window: Window,
    start: Option<Start>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Start {
    x: f64,
    y: f64,
    sigma_px: f64,
}

/// Fewest pixels along an axis.
const SMALLEST_SIDE: usize = 5;
const MAX_ITERATIONS: usize = 1000;
/// The iteration ends when a step's relative change is below this. Rounding errors are a thousand
/// times smaller.
const CONVERGED: f64 = 1e-11;
/// Newton's method begins when the plain step changes the weight by less than this.
const NEWTON_BELOW: f64 = 0.1;
/// After a Newton step that failed, the next one is tried when the change has decreased by this
/// factor.
const NEWTON_RETRY: f64 = 0.1;
const START_SIGMA_PX: f64 = 5.0;
const START_SIDES: f64 = 1.0 / 6.0;
/// The largest final sigma divided by the window's shorter side. A flat stamp gives a sigma of
/// 0.357 of its side. A sigma near this value measures the window, not the source.
const LARGEST_SIDES: f64 = 1.0 / 3.0;
/// During the iteration, the weight may be this many times as wide as the start or the final limit,
/// whichever is wider. A wider weight is an error.
const MAX_WIDTH_RATIO: f64 = 4.0;

impl Default for AdaptiveMomentFinder {
    fn default() -> Self {
        Self::new()
    }
}

impl AdaptiveMomentFinder {
    /// Measures all pixels, from the default start.
    pub fn new() -> Self {
        Self {
            window: Window::whole(),
            start: None,
        }
    }

    /// Restricts the measurement to the pixels of a window.
    #[must_use]
    pub fn with_window(self, window: Window) -> Self {
        Self { window, ..self }
    }

    /// Starts the iteration at the 0-based stamp index (`x`, `y`) with a round weight of
    /// `sigma_px`.
    #[must_use]
    pub fn with_start(self, x: f64, y: f64, sigma_px: f64) -> Self {
        Self {
            start: Some(Start { x, y, sigma_px }),
            ..self
        }
    }

    /// Measures `stamp`, `[y, x]`. Centroids are 0-based indices of the whole stamp, also with a
    /// window.
    ///
    /// # Errors
    /// * [`MetricsError::WindowOutsideStamp`]: the window does not fit on the stamp.
    /// * [`MetricsError::TooFewPixels`]: fewer than 5 pixels along an axis.
    /// * [`MetricsError::NonFinite`]: NaN or infinity in the window.
    /// * [`MetricsError::DegenerateCovariance`]: a start whose squared sigma is not finite and
    ///   positive.
    /// * [`MetricsError::NonPositiveFlux`]: the weighted flux is not positive.
    /// * [`MetricsError::CentreLeftWindow`]: the centroid or the start lies outside the window.
    /// * [`MetricsError::WeightCollapsed`]: the PSF or the start is too narrow for the grid (see
    ///   the type's documentation).
    /// * [`MetricsError::WidthOutOfRange`]: a sigma is above a third of the window's shorter side,
    ///   so that the window and not the source would determine the size.
    /// * [`MetricsError::NotConverged`]: the iteration did not converge.
    /// * [`MetricsError::Overflow`]: a sum exceeds the range of double precision.
    pub fn measure<T: Real>(&self, stamp: ArrayView2<'_, T>) -> Result<AdaptiveMoments, MetricsError> {
        let cutout = self.window.cut(stamp, SMALLEST_SIDE)?;
        let (rows, columns) = cutout.values.dim();
        let largest_px = LARGEST_SIDES * rows.min(columns) as f64;
        let (x, y, sigma) = match self.start {
            Some(start) => {
                let origin = cutout.on_stamp(0.0, 0.0);
                (start.x - origin.0, start.y - origin.1, start.sigma_px)
            }
            None => (
                (columns / 2) as f64,
                (rows / 2) as f64,
                START_SIGMA_PX.min(START_SIDES * rows.min(columns) as f64),
            ),
        };
        let pixels = WeightedPixels {
            cutout: &cutout,
            brightest: cutout.extreme().abs(),
            largest_px,
            // The weight may be too wide during the iteration, but not at its end.
            slack: largest_px.max(sigma) * MAX_WIDTH_RATIO / largest_px,
        };
        let start = Weight {
            x,
            y,
            m: Covariance::new(sigma * sigma, 0.0, sigma * sigma)?,
        };
        let mut now = pixels.measure(start, 0.0)?;
        let mut newton_below = NEWTON_BELOW;
        for iteration in 0..MAX_ITERATIONS {
            if now.change <= CONVERGED {
                let Weight { x, y, m } = now.weight;
                check_width(m, 1.0, largest_px)?;
                return Ok(AdaptiveMoments {
                    amplitude: 2.0 * now.flux,
                    shape: Shape::new(cutout.on_stamp(x, y), m),
                    iterations: iteration,
                    covariance: m,
                });
            }
            if now.change < newton_below {
                if let Some(there) = pixels.after_newton_step(&now)
                    && there.change < 0.5 * now.change
                {
                    now = there;
                    continue;
                }
                newton_below = NEWTON_RETRY * now.change;
            }
            now = pixels.measure(now.weight.moved(now.plain_step)?, now.flux)?;
        }
        Err(MetricsError::NotConverged {
            iterations: MAX_ITERATIONS,
            change: now.change,
        })
    }
}
