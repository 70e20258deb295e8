//! An ellipse in its three forms: second moments, distortion and reduced shear.

use std::f64::consts::FRAC_PI_2;

use psf_types::read_through_new;
use serde::{Deserialize, Serialize};

use crate::MetricsError;

/// An ellipse with a smaller axis ratio is refused, because rounding errors would determine its
/// minor axis.
const SMALLEST_AXIS_RATIO: f64 = 1e-7;

/// A positive definite matrix of second moments in square pixels, and the ellipse that it
/// describes.
///
/// ```text
/// | xx  xy |       eigenvalues sigma_major^2 >= sigma_minor^2
/// | xy  yy |
/// ```
///
/// ```
/// use psf_metrics::Covariance;
/// // An ellipse of sigma 3 x 2 pixels whose major axis lies along y.
/// let c = Covariance::new(4.0, 0.0, 9.0)?;
/// assert_eq!((c.sigma_major_px(), c.sigma_minor_px()), (3.0, 2.0));
/// assert_eq!(c.angle_rad(), std::f64::consts::FRAC_PI_2);
/// # Ok::<(), psf_metrics::MetricsError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Elements")]
pub struct Covariance {
    xx: f64,
    xy: f64,
    yy: f64,
}

read_through_new!(Elements => Covariance, MetricsError { xx: f64, xy: f64, yy: f64 });

impl Covariance {
    /// A covariance from its elements in square pixels.
    ///
    /// # Errors
    /// [`MetricsError::DegenerateCovariance`] unless the matrix is finite and positive definite,
    /// its axis ratio is above 1e-7, and its determinant is in the range of double precision.
    pub fn new(xx: f64, xy: f64, yy: f64) -> Result<Self, MetricsError> {
        let c = Self { xx, xy, yy };
        let (det, largest) = (c.determinant(), c.largest_eigenvalue());
        // NaN fails every comparison. The accessors divide by these values and take their roots.
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

    /// Direction of the major axis, from +x towards +y, in (-pi/2, pi/2]. It is 0 for a circle.
    pub fn angle_rad(self) -> f64 {
        let angle = 0.5 * (2.0 * self.xy).atan2(self.xx - self.yy);
        if angle <= -FRAC_PI_2 { FRAC_PI_2 } else { angle }
    }

    /// The eccentricity `e = sqrt(1 - b^2 / a^2)` of the axes `a >= b`: 0 for a circle, close to 1
    /// for a line.
    pub fn eccentricity(self) -> f64 {
        // 1 - b^2/a^2 = (a^2 - b^2) / a^2 without cancellation for a nearly round ellipse.
        (self.eigenvalue_difference() / self.largest_eigenvalue()).sqrt()
    }

    /// The distortion `e1 = (xx - yy) / (xx + yy)`, `e2 = 2 xy / (xx + yy)`.
    pub fn distortion(self) -> Distortion {
        let trace = self.xx + self.yy;
        Distortion::new((self.xx - self.yy) / trace, 2.0 * self.xy / trace)
            .expect("Covariance::new checked the axis ratio, so |e| < 1")
    }

    /// Converts the ellipse to reduced shear.
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

/// The code that [`Distortion`] and [`ReducedShear`] share: the checked constructor, the components
/// and the record for deserialisation.
macro_rules! ellipticity {
    ($kind:ident, $record:ident, $first:ident, $second:ident, $what:literal, $length:literal) => {
        read_through_new!($record => $kind, MetricsError { $first: f64, $second: f64 });

        impl $kind {
            #[doc = concat!($what, " from its components.")]
            ///
            /// # Errors
            /// [`MetricsError::Ellipticity`] when the length is not below 1.
            pub fn new($first: f64, $second: f64) -> Result<Self, MetricsError> {
                if $first.hypot($second) < 1.0 {
                    Ok(Self { $first, $second })
                } else {
                    Err(MetricsError::Ellipticity {
                        first: $first,
                        second: $second,
                    })
                }
            }

            /// Makes an ellipticity from components that were converted from another form of the
            /// ellipse. Shortens them if rounding made the length 1 or more.
            fn rounded(mut $first: f64, mut $second: f64) -> Self {
                while $first.hypot($second) >= 1.0 {
                    $first *= 1.0 - f64::EPSILON;
                    $second *= 1.0 - f64::EPSILON;
                }
                Self { $first, $second }
            }

            /// Component along the axes of the grid.
            pub fn $first(self) -> f64 {
                self.$first
            }

            /// Component along the diagonals of the grid.
            pub fn $second(self) -> f64 {
                self.$second
            }

            #[doc = concat!("The length `", $length, "`.")]
            pub fn length(self) -> f64 {
                self.$first.hypot(self.$second)
            }
        }
    };
}

/// The distortion `(e1, e2)` of an ellipse with axes `a >= b` and position angle `phi`.
///
/// ```text
/// |e| = (a^2 - b^2) / (a^2 + b^2)      e1 = |e| cos 2 phi      e2 = |e| sin 2 phi
/// ```
///
/// In second moments `e1 = (Mxx - Myy) / (Mxx + Myy)` and `e2 = 2 Mxy / (Mxx + Myy)` (Bernstein &
/// Jarvis 2002, AJ 123, 583). `|e|` is below 1. `phi` runs from +x towards +y.
///
/// ```
/// use psf_metrics::Distortion;
/// let e = Distortion::new(0.6, 0.0)?;
/// assert!((e.to_reduced_shear().g1() - 1.0 / 3.0).abs() < 1e-15);
/// # Ok::<(), psf_metrics::MetricsError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "DistortionComponents")]
pub struct Distortion {
    e1: f64,
    e2: f64,
}

ellipticity!(
    Distortion,
    DistortionComponents,
    e1,
    e2,
    "A distortion",
    "(a^2 - b^2) / (a^2 + b^2)"
);

impl Distortion {
    /// Converts the ellipse to reduced shear: `g = e / (1 + sqrt(1 - |e|^2))`.
    pub fn to_reduced_shear(self) -> ReducedShear {
        let length = self.length();
        // (1 - e)(1 + e) keeps its digits near e = 1, where 1 - e^2 would lose them.
        let scale = 1.0 / (1.0 + ((1.0 - length) * (1.0 + length)).sqrt());
        ReducedShear::rounded(self.e1 * scale, self.e2 * scale)
    }
}

/// The reduced shear `(g1, g2)` of an ellipse with axes `a >= b` and position angle `phi`.
///
/// ```text
/// |g| = (a - b) / (a + b)      g1 = |g| cos 2 phi      g2 = |g| sin 2 phi
/// ```
///
/// `|g|` is below 1. `phi` runs from +x towards +y.
///
/// ```
/// use psf_metrics::ReducedShear;
/// let g = ReducedShear::new(0.0, 0.5)?;
/// assert!((g.to_distortion().e2() - 0.8).abs() < 1e-15);
/// # Ok::<(), psf_metrics::MetricsError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "ReducedShearComponents")]
pub struct ReducedShear {
    g1: f64,
    g2: f64,
}

ellipticity!(
    ReducedShear,
    ReducedShearComponents,
    g1,
    g2,
    "A reduced shear",
    "(a - b) / (a + b)"
);

impl ReducedShear {
    /// Converts the ellipse to distortion: `e = 2 g / (1 + |g|^2)`.
    pub fn to_distortion(self) -> Distortion {
        let length = self.length();
        let scale = 2.0 / (1.0 + length * length);
        Distortion::rounded(self.g1 * scale, self.g2 * scale)
    }
}

#[cfg(test)]
mod tests {
    use psf_types::maths::FWHM_PER_SIGMA;

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
