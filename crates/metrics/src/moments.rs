//! Second moments: adaptive (with a matching Gaussian weight) and unweighted.

use nalgebra::{SMatrix, SVector};
use ndarray::ArrayView2;
use psf_types::Real;
use serde::Serialize;

use crate::comparison::CompensatedSum;
use crate::gaussian_rows::{GaussianRow, MONOMIALS, MonomialSums, UnitGaussian, reach};
use crate::window::Cutout;
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
/// [`with_start`](Self::with_start) sets another start. The iteration ends when a step changes `M`
/// by less than 1e-11 of its smaller eigenvalue and the centroid by less than 1e-11 sigma.
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
/// Largest change of `M` in one step relative to its smaller eigenvalue, and of the centroid
/// relative to sigma.
const LARGEST_STEP: f64 = 0.25;
/// Newton's method begins when the plain step changes the weight by less than this.
const NEWTON_BELOW: f64 = 0.1;
/// After a Newton step that failed, the next one is tried when the change has decreased by this
/// factor.
const NEWTON_RETRY: f64 = 0.1;
const START_SIGMA_PX: f64 = 5.0;
const START_SIDES: f64 = 1.0 / 6.0;
/// A narrower weight covers only one pixel.
const SMALLEST_SIGMA_PX: f64 = 0.2;
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
                check_width(now.weight.m, 1.0, largest_px)?;
                return Ok(AdaptiveMoments {
                    amplitude: 2.0 * now.flux,
                    shape: Shape::new(cutout.on_stamp(now.weight.x, now.weight.y), now.weight.m),
                    iterations: iteration,
                    covariance: now.weight.m,
                });
            }
            if now.change < newton_below {
                if let Some(there) = pixels.newton(&now) {
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

/// Checks the sigmas of a weight. The larger sigma may be at most `slack * largest_px`, where
/// `largest_px` is the limit for a result.
fn check_width(m: Covariance, slack: f64, largest_px: f64) -> Result<(), MetricsError> {
    if m.sigma_minor_px() < SMALLEST_SIGMA_PX {
        return Err(MetricsError::WeightCollapsed {
            sigma_px: m.sigma_minor_px(),
        });
    }
    if m.sigma_major_px() > slack * largest_px {
        return Err(MetricsError::WidthOutOfRange {
            major_px: m.sigma_major_px(),
            minor_px: m.sigma_minor_px(),
            smallest_px: SMALLEST_SIGMA_PX,
            largest_px,
        });
    }
    Ok(())
}

/// The centre and the covariance of a weight, in pixels of the cutout.
#[derive(Debug, Clone, Copy)]
struct Weight {
    x: f64,
    y: f64,
    m: Covariance,
}

/// A step of a weight: of `x` and `y` in units of its smaller sigma, then of `Mxx`, `Mxy` and `Myy`
/// in units of the square of that sigma.
type Step = [f64; 5];

impl Weight {
    fn gaussian(&self) -> UnitGaussian {
        let height = self.m.yy().sqrt();
        let root = self.m.determinant().sqrt();
        UnitGaussian {
            x: self.x,
            y: self.y,
            lxx: height / root,
            lyx: -self.m.xy() / (height * root),
            lyy: 1.0 / height,
        }
    }

    /// Converts a step from the coordinates `(u, v)` of the weight, in which its covariance is the
    /// unit matrix. `step` holds the shift of the centre and the change of the covariance.
    fn step(&self, step: SVector<f64, 5>) -> Step {
        let UnitGaussian { lxx, lyx, lyy, .. } = self.gaussian();
        let [u, v, uu, uv, vv]: [f64; 5] = step.into();
        let sigma = self.m.sigma_minor_px();
        // dy = v / lyy, dx = (u - tilt v) / lxx
        let tilt = lyx / lyy;
        let (to_x, to_y) = (1.0 / (lxx * sigma), 1.0 / (lyy * sigma));
        [
            (u - tilt * v) * to_x,
            v * to_y,
            (uu - 2.0 * tilt * uv + tilt * tilt * vv) * to_x * to_x,
            (uv - tilt * vv) * to_x * to_y,
            vv * to_y * to_y,
        ]
    }

    /// Moves the weight by a step. Steps within [`LARGEST_STEP`] keep the smaller eigenvalue at half
    /// of its old value or more.
    fn moved(&self, [dx, dy, dxx, dxy, dyy]: Step) -> Result<Self, MetricsError> {
        let sigma = self.m.sigma_minor_px();
        let variance = sigma * sigma;
        Ok(Self {
            x: self.x + dx * sigma,
            y: self.y + dy * sigma,
            m: Covariance::new(
                self.m.xx() + dxx * variance,
                self.m.xy() + dxy * variance,
                self.m.yy() + dyy * variance,
            )?,
        })
    }
}

/// The moments under a weight, and the steps that they ask for.
#[derive(Debug, Clone, Copy)]
struct Weighted {
    weight: Weight,
    flux: f64,
    plain_step: Step,
    /// Largest component of the plain step.
    change: f64,
    /// The step of Newton's method. None far from a solution to which plain steps converge.
    newton_step: Option<Step>,
}

/// The pixels to measure, and the limits of their weight.
#[derive(Debug, Clone, Copy)]
struct WeightedPixels<'a> {
    cutout: &'a Cutout,
    /// Largest magnitude of a pixel.
    brightest: f64,
    largest_px: f64,
    slack: f64,
}

impl WeightedPixels<'_> {
    /// Measures the moments under a weight. `flux` is the flux under a weight one step away, or 0.
    fn measure(&self, weight: Weight, flux: f64) -> Result<Weighted, MetricsError> {
        self.cutout.check_centre(weight.x, weight.y)?;
        check_width(weight.m, self.slack, self.largest_px)?;
        let sums = self.sums(weight.gaussian(), flux);
        let flux = sums.of((0, 0));
        // The amplitude is twice the weighted flux.
        let all = MONOMIALS.map(|monomial| 2.0 * sums.of(monomial));
        if all.iter().any(|v| !v.is_finite()) {
            return Err(MetricsError::Overflow {
                largest: self.cutout.extreme(),
            });
        }
        if flux <= 0.0 {
            return Err(MetricsError::NonPositiveFlux { flux });
        }
        // Means of u, v, u^2 - 1/2, uv, v^2 - 1/2: a solution has only zeros here.
        let mean = |monomial| sums.of(monomial) / flux;
        let [u, v] = [mean((1, 0)), mean((0, 1))];
        let [uu, uv, vv] = [mean((2, 0)) - 0.5, mean((1, 1)), mean((0, 2)) - 0.5];
        // For a Gaussian near the weight, to first order: the weighted offset is half of the true
        // offset (factor 2). The weighted covariance differs from half of the weight's by a quarter
        // of the true covariance's difference from the weight's (factor 4).
        let plain = SVector::from([2.0 * u, 2.0 * v, 4.0 * uu, 4.0 * uv, 4.0 * vv]);
        let plain_step = weight.step(plain).map(|d| d.clamp(-LARGEST_STEP, LARGEST_STEP));
        // Minus the derivatives of the means of u, v, u^2 / 2, uv and v^2 / 2 by a shift of the
        // centre and a change of the covariance. The factors 1/2 make this matrix symmetric.
        let halves = SVector::from([1.0, 1.0, 0.5, 1.0, 0.5]);
        let products = sums.products().fixed_view::<5, 5>(1, 1) / flux;
        let products = SMatrix::<f64, 5, 5>::from_fn(|i, j| products[(i, j)] * halves[i] * halves[j]);
        let means = SVector::from([0.0, 0.0, 0.25, 0.0, 0.25]);
        let unit = SMatrix::from_diagonal(&SVector::from([1.0, 1.0, 0.25, 0.5, 0.25]));
        let matrix = unit + means * means.transpose() - products;
        // The plain step uses half of `unit` in its place for a Gaussian: plain steps converge if and
        // only if the matrix lies between 0 and twice that of a Gaussian.
        let converges = (unit - matrix).cholesky().is_some();
        let newton_step = matrix
            .cholesky()
            .filter(|_| converges)
            .map(|factor| weight.step(factor.solve(&SVector::from([u, v, 0.5 * uu, uv, 0.5 * vv]))))
            .filter(|step| step.iter().all(|d| d.abs() < LARGEST_STEP));
        Ok(Weighted {
            weight,
            flux,
            plain_step,
            change: plain_step.iter().fold(0.0, |most, d| most.max(d.abs())),
            newton_step,
        })
    }

    /// The moments after a step of Newton's method, if it at least halves the change.
    fn newton(&self, now: &Weighted) -> Option<Weighted> {
        let weight = now.weight.moved(now.newton_step?).ok()?;
        let there = self.measure(weight, now.flux).ok()?;
        (there.change < 0.5 * now.change).then_some(there)
    }

    /// Sums of the weighted light times powers of `u` and `v`. Leaves out pixels whose light is
    /// negligible next to `flux`.
    fn sums(&self, gaussian: UnitGaussian, flux: f64) -> MonomialSums {
        let (rows, columns) = self.cutout.values.dim();
        let reach = reach(self.brightest, rows * columns, flux);
        let mut row = GaussianRow::new(columns);
        let mut sums = MonomialSums::default();
        for (i, values) in self.cutout.rows().enumerate() {
            row.evaluate(gaussian, i, reach);
            sums.add(&row, &values[row.columns()]);
        }
        sums
    }
}
