//! Second moments of an ellipse.

use std::f64::consts::FRAC_PI_2;

use serde::{Deserialize, Serialize};

use crate::{Distortion, MetricsError, ReducedShear};

/// FWHM of a Gaussian over its sigma, `2 sqrt(2 ln 2)`.
pub const FWHM_PER_SIGMA: f64 = 2.354_820_045_030_949_3;

/// Flatter ellipses are taken for lines: rounding decides what their minor axis is.
const SMALLEST_AXIS_RATIO: f64 = 1e-7;

/// A positive definite matrix of second moments in square pixels, and the ellipse that it describes.
///
/// ```text
/// | xx  xy |       eigenvalues sigma_major^2 >= sigma_minor^2
/// | xy  yy |
/// ```
///
/// ```
/// use metrics::Covariance;
/// // An ellipse of sigma 3 x 2 pixels whose major axis lies along y.
/// let c = Covariance::new(4.0, 0.0, 9.0)?;
/// assert_eq!((c.sigma_major_px(), c.sigma_minor_px()), (3.0, 2.0));
/// assert_eq!(c.angle_rad(), std::f64::consts::FRAC_PI_2);
/// # Ok::<(), metrics::MetricsError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Elements", into = "Elements")]
pub struct Covariance {
    xx: f64,
    xy: f64,
    yy: f64,
}

#[derive(Serialize, Deserialize)]
struct Elements {
    xx: f64,
    xy: f64,
    yy: f64,
}

impl Covariance {
    /// A covariance from its elements in square pixels.
    ///
    /// # Errors
    /// [`MetricsError::DegenerateCovariance`] when the matrix is not finite and positive definite with an axis ratio above
    /// 1e-7.
    pub fn new(xx: f64, xy: f64, yy: f64) -> Result<Self, MetricsError> {
        let c = Self { xx, xy, yy };
        let (det, largest) = (c.determinant(), c.largest_eigenvalue());
        // NaN fails every comparison; the accessors divide by these and take their roots.
        if xx > 0.0
            && yy > 0.0
            && det > SMALLEST_AXIS_RATIO * SMALLEST_AXIS_RATIO * largest * largest
            && det >= f64::MIN_POSITIVE
            && det.is_finite()
            && largest.is_finite()
        {
            Ok(c)
        } else {
            Err(MetricsError::DegenerateCovariance { xx, xy, yy })
        }
    }

    /// Second moment along x in square pixels.
    pub fn xx(self) -> f64 {
        self.xx
    }

    /// Mixed second moment in square pixels.
    pub fn xy(self) -> f64 {
        self.xy
    }

    /// Second moment along y in square pixels.
    pub fn yy(self) -> f64 {
        self.yy
    }

    /// The determinant `xx yy - xy^2`.
    pub fn determinant(self) -> f64 {
        self.xx * self.yy - self.xy * self.xy
    }

    /// The size `det^(1/4)`, the geometric mean of the two sigmas, in pixels.
    pub fn sigma_px(self) -> f64 {
        self.determinant().sqrt().sqrt()
    }

    /// Sigma along the major axis in pixels.
    pub fn sigma_major_px(self) -> f64 {
        self.largest_eigenvalue().sqrt()
    }

    /// Sigma along the minor axis in pixels.
    pub fn sigma_minor_px(self) -> f64 {
        (self.determinant() / self.largest_eigenvalue()).sqrt()
    }

    /// Direction of the major axis, from +x towards +y, in (-pi/2, pi/2]; 0 for a circle.
    pub fn angle_rad(self) -> f64 {
        let angle = 0.5 * (2.0 * self.xy).atan2(self.xx - self.yy);
        if angle <= -FRAC_PI_2 { FRAC_PI_2 } else { angle }
    }

    /// The eccentricity `e = sqrt(1 - b^2 / a^2)` of the axes `a >= b`: 0 for a circle, towards 1 for a line.
    pub fn ellipticity(self) -> f64 {
        // 1 - b^2/a^2 = (a^2 - b^2) / a^2 without the cancellation near round.
        (self.eigenvalue_difference() / self.largest_eigenvalue()).sqrt()
    }

    /// The distortion `e1 = (xx - yy) / (xx + yy)`, `e2 = 2 xy / (xx + yy)`.
    pub fn distortion(self) -> Distortion {
        let trace = self.xx + self.yy;
        Distortion::new((self.xx - self.yy) / trace, 2.0 * self.xy / trace)
            .expect("the constructor checked that the length is below 1")
    }

    /// The same ellipse as reduced shear.
    pub fn reduced_shear(self) -> ReducedShear {
        self.distortion().to_reduced_shear()
    }

    fn eigenvalue_difference(self) -> f64 {
        (self.xx - self.yy).hypot(2.0 * self.xy)
    }

    fn largest_eigenvalue(self) -> f64 {
        0.5 * (self.xx + self.yy + self.eigenvalue_difference())
    }
}

impl TryFrom<Elements> for Covariance {
    type Error = MetricsError;
    fn try_from(m: Elements) -> Result<Self, MetricsError> {
        Self::new(m.xx, m.xy, m.yy)
    }
}

impl From<Covariance> for Elements {
    fn from(c: Covariance) -> Self {
        Self {
            xx: c.xx,
            xy: c.xy,
            yy: c.yy,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matrices_that_are_no_ellipse_are_refused() {
        for (xx, xy, yy) in [
            (1.0, 1.0, 1.0),
            (-1.0, 0.0, -1.0),
            (0.0, 0.0, 1.0),
            (1.0, 2.0, 1.0),
            (f64::NAN, 0.0, 1.0),
            (1.0, f64::INFINITY, 1.0),
            (1e-200, 0.0, 1e-200),
            (1e300, 0.0, 1e300),
            (1.0, 0.0, 1e-15),
        ] {
            let error = Covariance::new(xx, xy, yy).unwrap_err();
            assert!(
                matches!(error, MetricsError::DegenerateCovariance { .. }),
                "{error}"
            );
        }
    }

    #[test]
    fn half_of_the_peak_is_reached_at_half_the_fwhm() {
        let half = 0.5 * FWHM_PER_SIGMA;
        assert!(((-0.5 * half * half).exp() - 0.5).abs() < f64::EPSILON);
    }

    #[test]
    fn the_angle_is_in_the_half_open_range() {
        let angle = |xx, xy, yy| Covariance::new(xx, xy, yy).unwrap().angle_rad();
        assert_eq!(angle(1.0, 0.0, 1.0), 0.0);
        assert_eq!(angle(1.0, 0.0, 2.0), FRAC_PI_2);
        assert_eq!(angle(1.0, -0.0, 2.0), FRAC_PI_2);
        assert_eq!(angle(1.0, 0.5, 1.0), FRAC_PI_2 / 2.0);
        assert_eq!(angle(1.0, -0.5, 1.0), -FRAC_PI_2 / 2.0);
    }
}
