//! Unweighted second moments.

use ndarray::ArrayView2;
use psf_types::Real;
use serde::Serialize;

use crate::compensated_sum::CompensatedSum;
use crate::{Covariance, MetricsError, Window};

/// Unweighted moments of the light in a window. Lengths are in pixels of the stamp, every number is finite.
///
/// ```text
/// flux = sum I      x0 = sum I x / flux      Q = sum I (x - x0)(x - x0)^T / flux
/// ```
///
/// They take the light as it is: a background, noise and diffraction wings far out count with the square of their
/// distance, so the window matters. [`AdaptiveMomentFinder`](crate::AdaptiveMomentFinder) is the robust measure.
///
/// ```
/// use metrics::{QuadrupoleMoments, Window};
/// use ndarray::array;
/// let stamp = array![[0.0, 1.0, 0.0], [2.0, 0.0, 2.0], [0.0, 1.0, 0.0]];
/// let moments = QuadrupoleMoments::measure(stamp.view(), Window::whole())?;
/// assert_eq!((moments.flux(), moments.x_centroid(), moments.y_centroid()), (6.0, 1.0, 1.0));
/// assert!((moments.e1() - 1.0 / 3.0).abs() < 1e-15); // Qxx = 4/6, Qyy = 2/6
/// # Ok::<(), metrics::MetricsError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct QuadrupoleMoments {
    flux: f64,
    x_centroid: f64,
    y_centroid: f64,
    sigma_px: f64,
    e1: f64,
    e2: f64,
    g1: f64,
    g2: f64,
    covariance: Covariance,
}

impl QuadrupoleMoments {
    /// Measures `stamp`, `[y, x]`, inside `window`. Centroids are 0-based indices of the whole stamp.
    ///
    /// # Errors
    /// * [`MetricsError::WindowOutsideStamp`]: the window does not fit on the stamp.
    /// * [`MetricsError::TooFewPixels`]: fewer than 2 pixels along an axis.
    /// * [`MetricsError::NonFinite`]: NaN or infinity in the window.
    /// * [`MetricsError::NonPositiveFlux`]: the window's sum is not positive.
    /// * [`MetricsError::CentreLeftWindow`]: negative pixels put the centroid off the window.
    /// * [`MetricsError::DegenerateCovariance`]: all light in one pixel or on one line, or negative pixels far out.
    /// * [`MetricsError::Overflow`]: values near the end of double precision.
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
            largest: cutout.largest(),
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
        let (x_centroid, y_centroid) = cutout.on_stamp(x0, y0);
        let (e, g) = (covariance.distortion(), covariance.reduced_shear());
        Ok(Self {
            flux,
            x_centroid,
            y_centroid,
            sigma_px: covariance.sigma_px(),
            e1: e.e1(),
            e2: e.e2(),
            g1: g.g1(),
            g2: g.g2(),
            covariance,
        })
    }

    /// The sum of the values in the window.
    pub fn flux(&self) -> f64 {
        self.flux
    }

    /// Column coordinate of the centroid, a 0-based index of the stamp.
    pub fn x_centroid(&self) -> f64 {
        self.x_centroid
    }

    /// Row coordinate of the centroid, a 0-based index of the stamp.
    pub fn y_centroid(&self) -> f64 {
        self.y_centroid
    }

    /// The size `det(Q)^(1/4)`.
    pub fn sigma_px(&self) -> f64 {
        self.sigma_px
    }

    /// Distortion along the axes of the grid, `(Qxx - Qyy) / (Qxx + Qyy)`.
    pub fn e1(&self) -> f64 {
        self.e1
    }

    /// Distortion along the diagonals of the grid, `2 Qxy / (Qxx + Qyy)`.
    pub fn e2(&self) -> f64 {
        self.e2
    }

    /// Reduced shear along the axes of the grid.
    pub fn g1(&self) -> f64 {
        self.g1
    }

    /// Reduced shear along the diagonals of the grid.
    pub fn g2(&self) -> f64 {
        self.g2
    }

    /// The second moments `Q`.
    pub fn covariance(&self) -> Covariance {
        self.covariance
    }
}
