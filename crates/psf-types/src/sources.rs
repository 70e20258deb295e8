//! Stars and galaxies of a scene: the light before convolution, which may extend beyond the frame.

use serde::{Deserialize, Serialize};

use crate::frame::{DataError, Position, read_through_new};

/// A star: a position in pixels, counted from the scene's first pixel, and a finite flux. The
/// position may lie between pixels and outside the scene.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawPointSource")]
pub struct PointSource {
    position: Position,
    flux: f64,
}

read_through_new!(RawPointSource => PointSource { position: Position, flux: f64 });

impl PointSource {
    /// A star of this total flux.
    ///
    /// # Errors
    /// [`DataError::SourceFlux`] when the flux is NaN or infinite.
    pub fn new(position: Position, flux: f64) -> Result<Self, DataError> {
        if flux.is_finite() {
            Ok(Self { position, flux })
        } else {
            Err(DataError::SourceFlux { position, flux })
        }
    }

    /// Its position, in pixels counted from the scene's first pixel.
    pub fn position(self) -> Position {
        self.position
    }

    /// Its total flux.
    pub fn flux(self) -> f64 {
        self.flux
    }
}

/// The largest half-light radius that is allowed, in pixels. No frame is as large.
const LARGEST_RADIUS_PX: f64 = 1e6;
/// The smallest Sersic index that is allowed. Real galaxies have a larger index.
const SMALLEST_INDEX: f64 = 0.3;
/// The largest Sersic index that is allowed. Fits of real galaxies with a larger index are not meaningful.
const LARGEST_INDEX: f64 = 8.0;
/// The smallest axis ratio that is allowed. Edge-on discs have a ratio a hundred times larger. The light
/// of a thinner galaxy changes within a small part of a pixel far from its centre, which takes long
/// to draw.
const SMALLEST_AXIS_RATIO: f64 = 1e-3;

/// A Sersic profile with elliptical isophotes: the distribution of a galaxy's light.
///
/// The surface brightness at elliptical radius `r` (measured along the major axis) is
///
/// ```text
/// I(r) = I_e exp(-b [(r / re)^(1/n) - 1]),    P(2n, b) = 1/2
/// ```
///
/// (Sersic 1968, in the form of Graham and Driver 2005, PASA 22, 118). `P` is the regularised lower
/// incomplete gamma function, so half of the light lies within the ellipse of semi-major axis `re`.
/// `n = 0.5` is a Gaussian, `n = 1` an exponential disc, and `n = 4` a de Vaucouleurs profile.
///
/// ```
/// use psf_types::SersicProfile;
/// // re = 3 pixels along the major axis, n = 1, b/a = 0.5,
/// // the major axis 30 degrees from +x towards +y
/// let disc = SersicProfile::new(3.0, 1.0, 0.5, 30.0)?;
/// assert_eq!(disc.axis_ratio(), 0.5);
/// assert!(SersicProfile::new(3.0, 9.0, 0.5, 30.0).is_err());
/// # Ok::<(), psf_types::DataError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawProfile")]
pub struct SersicProfile {
    half_light_radius_px: f64,
    index: f64,
    axis_ratio: f64,
    angle_deg: f64,
}

read_through_new!(RawProfile => SersicProfile { half_light_radius_px: f64, index: f64, axis_ratio: f64, angle_deg: f64 });

impl SersicProfile {
    /// Creates a profile from four parameters:
    ///
    /// * `half_light_radius_px` (`re`): along the major axis in pixels, above 0, at most 1e6,
    /// * `index` (`n`): from 0.3 to 8,
    /// * `axis_ratio` (`q = b/a`): from 0.001 to 1,
    /// * `angle_deg`: angle of the major axis in degrees from +x towards +y.
    ///
    /// # Errors
    /// [`DataError::Galaxy`] with the parameter that is out of range.
    pub fn new(
        half_light_radius_px: f64,
        index: f64,
        axis_ratio: f64,
        angle_deg: f64,
    ) -> Result<Self, DataError> {
        let re = half_light_radius_px;
        let (parameter, allowed, got) = if !(re > 0.0 && re <= LARGEST_RADIUS_PX) {
            ("the half-light radius re", "above 0 and at most 1e6 pixels", re)
        } else if !(SMALLEST_INDEX..=LARGEST_INDEX).contains(&index) {
            ("the Sersic index n", "from 0.3 to 8", index)
        } else if !(SMALLEST_AXIS_RATIO..=1.0).contains(&axis_ratio) {
            ("the axis ratio q", "from 0.001 to 1", axis_ratio)
        } else if !angle_deg.is_finite() {
            (
                "the angle of the major axis",
                "a finite number of degrees",
                angle_deg,
            )
        } else {
            return Ok(Self {
                half_light_radius_px,
                index,
                axis_ratio,
                angle_deg,
            });
        };
        Err(DataError::Galaxy {
            parameter,
            allowed,
            got,
        })
    }

    /// Returns this profile after a shear that keeps its area.
    ///
    /// `g1` and `g2` are the reduced shear. `g1 > 0` stretches the profile along x, and `g2 > 0`
    /// along the line from (0, 0) to (1, 1). The shear moves light from `u` to `S u` with
    ///
    /// ```text
    /// S = 1 / sqrt(1 - g1^2 - g2^2) [1 + g1    g2  ]
    ///                               [  g2    1 - g1],
    /// ```
    ///
    /// as `shear(g1=g1, g2=g2)` in GalSim. The result of an elliptical profile is elliptical, too.
    /// A round profile with half-light radius `r` gets `q = (1 - |g|) / (1 + |g|)` with
    /// `|g| = sqrt(g1^2 + g2^2)`, the semi-major axis `re = r / sqrt(q)`, the semi-minor axis
    /// `r sqrt(q)`, and the angle `atan2(g2, g1) / 2`.
    ///
    /// ```
    /// use psf_types::SersicProfile;
    /// let round = SersicProfile::new(3.0, 1.0, 1.0, 0.0)?;
    /// let sheared = round.sheared(0.0, 0.2)?;
    /// assert!((sheared.axis_ratio() - 0.8 / 1.2).abs() < 1e-12);
    /// assert!((sheared.half_light_radius_px() - 3.0 * 1.5_f64.sqrt()).abs() < 1e-12);
    /// assert!((sheared.angle_deg() - 45.0).abs() < 1e-12);
    /// # Ok::<(), psf_types::DataError>(())
    /// ```
    ///
    /// # Errors
    /// [`DataError::Galaxy`] unless `g1` and `g2` are finite and `|g|` is below 1, and if the axis
    /// ratio of the result is out of range.
    pub fn sheared(self, g1: f64, g2: f64) -> Result<Self, DataError> {
        let shear = g1.hypot(g2);
        if shear.is_nan() || shear >= 1.0 {
            return Err(DataError::Galaxy {
                parameter: "the reduced shear |g| = sqrt(g1^2 + g2^2)",
                allowed: "finite and below 1",
                got: shear,
            });
        }
        if shear == 0.0 {
            return Ok(self);
        }
        let norm = ((1.0 - shear) * (1.0 + shear)).sqrt();
        self.mapped([[(1.0 + g1) / norm, g2 / norm], [g2 / norm, (1.0 - g1) / norm]])
    }

    /// This profile under a linear map of the plane, such as that from the sky to pixels. The map takes the offset
    /// `(u, v)` from the centre to `(m[0][0] u + m[0][1] v, m[1][0] u + m[1][1] v)`. The flux stays.
    ///
    /// ```
    /// use psf_types::SersicProfile;
    /// let along_x = SersicProfile::new(3.0, 1.0, 0.5, 0.0)?;
    /// let turned = along_x.mapped([[0.0, -2.0], [2.0, 0.0]])?;
    /// assert!((turned.half_light_radius_px() - 6.0).abs() < 1e-12);
    /// assert!((turned.axis_ratio() - 0.5).abs() < 1e-12);
    /// assert!((turned.angle_deg() - 90.0).abs() < 1e-12);
    /// # Ok::<(), psf_types::DataError>(())
    /// ```
    ///
    /// # Errors
    /// [`DataError::Galaxy`] if a parameter of the result is out of range.
    pub fn mapped(self, m: [[f64; 2]; 2]) -> Result<Self, DataError> {
        // The ellipse is the image of a circle under the matrix A, and the mapped ellipse is that under M = m A. The
        // largest singular value of M is the new semi-major axis.
        let (re, q) = (self.half_light_radius_px, self.axis_ratio);
        let (sin, cos) = self.angle_deg.to_radians().sin_cos();
        let a = [[cos * re, -sin * q * re], [sin * re, cos * q * re]];
        let product = |i: usize, j: usize| m[i][0] * a[0][j] + m[i][1] * a[1][j];
        // 2 M is the sum of a multiple of a rotation (even) and of a reflection (odd).
        let (even_x, even_y) = (product(0, 0) + product(1, 1), product(1, 0) - product(0, 1));
        let (odd_x, odd_y) = (product(0, 0) - product(1, 1), product(1, 0) + product(0, 1));
        let major = 0.5 * (even_x.hypot(even_y) + odd_x.hypot(odd_y));
        // The product of the semi-axes is that of the old ones, times the change of areas.
        let area = (m[0][0] * m[1][1] - m[0][1] * m[1][0]).abs();
        let ratio = (area * q * (re / major).powi(2)).min(1.0);
        let angle = 0.5 * (odd_y.atan2(odd_x) + even_y.atan2(even_x));
        Self::new(major, self.index, ratio, angle.to_degrees())
    }

    /// Semi-major axis, in pixels, of the ellipse that contains half of the light.
    pub fn half_light_radius_px(self) -> f64 {
        self.half_light_radius_px
    }

    /// The Sersic index `n`.
    pub fn index(self) -> f64 {
        self.index
    }

    /// Minor axis divided by major axis.
    pub fn axis_ratio(self) -> f64 {
        self.axis_ratio
    }

    /// Angle of the major axis, in degrees from +x towards +y.
    pub fn angle_deg(self) -> f64 {
        self.angle_deg
    }
}

/// A galaxy: a position in pixels, counted from the scene's first pixel, a finite total flux (to
/// infinite radius) and a light profile. The position may lie between pixels and outside the scene.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SersicSource {
    light: PointSource,
    profile: SersicProfile,
}

impl SersicSource {
    /// A galaxy of this total flux, before convolution with the PSF.
    ///
    /// # Errors
    /// [`DataError::SourceFlux`] when the flux is NaN or infinite.
    pub fn new(position: Position, flux: f64, profile: SersicProfile) -> Result<Self, DataError> {
        Ok(Self {
            light: PointSource::new(position, flux)?,
            profile,
        })
    }

    /// The position of its centre, in pixels counted from the scene's first pixel.
    pub fn position(self) -> Position {
        self.light.position()
    }

    /// Its total flux, to infinite radius.
    pub fn flux(self) -> f64 {
        self.light.flux()
    }

    /// The profile of its light.
    pub fn profile(self) -> SersicProfile {
        self.profile
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fluxes_are_finite_also_from_files() {
        let at = Position::of_pixel(1, 1);
        assert!(matches!(
            PointSource::new(at, f64::NAN),
            Err(DataError::SourceFlux { .. })
        ));
        let text = serde_json::to_string(&PointSource::new(at, 2.5).unwrap()).unwrap();
        assert!(serde_json::from_str::<PointSource>(&text).is_ok());
        assert!(serde_json::from_str::<PointSource>(&text.replace("2.5", "1e999")).is_err());
    }

    #[test]
    fn profiles_out_of_range_name_the_parameter() {
        let cases = [
            ((0.0, 1.0, 1.0, 0.0), "re"),
            ((f64::INFINITY, 1.0, 1.0, 0.0), "re"),
            ((1.0, 0.29, 1.0, 0.0), "index"),
            ((1.0, 8.01, 1.0, 0.0), "index"),
            ((1.0, f64::NAN, 1.0, 0.0), "index"),
            ((1.0, 1.0, 0.0, 0.0), "ratio"),
            ((1.0, 1.0, 9e-4, 0.0), "ratio"),
            ((1.0, 1.0, 1.01, 0.0), "ratio"),
            ((1.0, 1.0, f64::NAN, 0.0), "ratio"),
            ((1.0, 1.0, 1.0, f64::NAN), "angle"),
        ];
        for ((re, n, q, angle), named) in cases {
            match SersicProfile::new(re, n, q, angle) {
                Err(DataError::Galaxy { parameter, .. }) => assert!(parameter.contains(named), "{parameter}"),
                other => panic!("{other:?}"),
            }
        }
    }

    /// Rounding error of a few operations, relative to the values.
    const ROUNDING: f64 = 1e-12;

    /// The matrix Q of a profile. The isophote of half-light radius is `u^T Q^-1 u = 1`.
    fn quadratic_form(profile: SersicProfile) -> [f64; 3] {
        let (sin, cos) = profile.angle_deg().to_radians().sin_cos();
        let a2 = profile.half_light_radius_px().powi(2);
        let b2 = a2 * profile.axis_ratio().powi(2);
        [
            a2 * cos * cos + b2 * sin * sin,
            (a2 - b2) * sin * cos,
            a2 * sin * sin + b2 * cos * cos,
        ]
    }

    #[test]
    fn shear_changes_the_isophotes_as_the_linear_map_does() {
        for (q, angle) in [(1.0, 0.0), (1.0, 33.0), (0.6, 20.0), (0.25, -70.0), (0.9, 150.0)] {
            for (g1, g2) in [(0.02, 0.0), (-0.1, 0.05), (0.0, -0.4), (0.5, 0.6), (1e-9, -1e-9)] {
                let before = SersicProfile::new(2.5, 1.5, q, angle).unwrap();
                let after = before.sheared(g1, g2).unwrap();
                // S Q S^T, with S from the definition of the shear
                let n = 1.0 - g1 * g1 - g2 * g2;
                let (s, [xx, xy, yy]) = ([1.0 + g1, g2, 1.0 - g1], quadratic_form(before));
                let expected = [
                    (s[0] * s[0] * xx + 2.0 * s[0] * s[1] * xy + s[1] * s[1] * yy) / n,
                    (s[0] * s[1] * xx + (s[0] * s[2] + s[1] * s[1]) * xy + s[1] * s[2] * yy) / n,
                    (s[1] * s[1] * xx + 2.0 * s[1] * s[2] * xy + s[2] * s[2] * yy) / n,
                ];
                let scale = expected[0] + expected[2];
                for (found, expected) in quadratic_form(after).into_iter().zip(expected) {
                    let error = (found - expected).abs();
                    assert!(
                        error <= ROUNDING * scale,
                        "q {q}, angle {angle}, g {g1}, {g2}: {after:?}"
                    );
                }
                let area = |p: SersicProfile| p.half_light_radius_px().powi(2) * p.axis_ratio();
                assert!((area(after) / area(before) - 1.0).abs() <= ROUNDING);
                assert_eq!(after.index(), 1.5);
                // The opposite shear leads back.
                let back = after.sheared(-g1, -g2).unwrap();
                assert!((back.axis_ratio() - q).abs() <= 1e-9, "{back:?}");
            }
        }
        let unsheared = SersicProfile::new(2.5, 1.5, 0.7, 20.0).unwrap();
        assert_eq!(unsheared.sheared(0.0, 0.0).unwrap(), unsheared);
    }

    #[test]
    fn shear_of_1_or_more_is_refused() {
        let round = SersicProfile::new(2.5, 1.5, 1.0, 0.0).unwrap();
        for (g1, g2) in [(1.0, 0.0), (0.8, -0.7), (f64::NAN, 0.0), (0.0, f64::INFINITY)] {
            match round.sheared(g1, g2) {
                Err(DataError::Galaxy { parameter, .. }) => {
                    assert!(parameter.contains("shear"), "{parameter}");
                }
                other => panic!("{other:?}"),
            }
        }
        // The axis ratio of the result would be below 0.001.
        assert!(round.sheared(0.9999, 0.0).is_err());
    }

    #[test]
    fn galaxies_are_checked_also_from_files() {
        let profile = SersicProfile::new(2.5, 4.0, 0.7, -30.0).unwrap();
        assert!(SersicSource::new(Position::of_pixel(0, 0), f64::NAN, profile).is_err());
        let galaxy = SersicSource::new(Position::of_pixel(3, 4), 10.0, profile).unwrap();
        let text = serde_json::to_string(&galaxy).unwrap();
        assert_eq!(serde_json::from_str::<SersicSource>(&text).unwrap(), galaxy);
        assert!(serde_json::from_str::<SersicSource>(&text.replace("2.5", "-2.5")).is_err());
    }
}
