//! The known properties of the camera.

use ndarray::ArrayView2;
use serde::Serialize;

use crate::StarError;
use crate::error::{at_least, checked_setters};

/// The known properties of the camera: gain, read noise, saturation. Each may be unknown.
///
/// With a gain `g` (electrons per unit of the frame) the signal-to-noise ratio of a star follows
/// the CCD equation (Howell 1989, PASP 101, 616):
/// `SNR = N / sqrt(N + n_pix (N_sky + N_dark + N_read^2))`. Here `N = g F`, where `F` is the flux
/// above the background in an aperture of `n_pix` pixels. The bracket is `(g sigma)^2`, where
/// `sigma` is the noise of the background in one pixel, measured in the frame. This noise contains
/// sky, dark current and read noise. A given read noise is the lower limit of `g sigma`. Without a
/// gain the photon noise of the star itself is not known, and `SNR = F / (sigma sqrt(n_pix))`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Camera {
    gain: Option<f64>,
    read_noise: f64,
    saturation: Option<f64>,
    header_saturation: Option<f64>,
}

impl Camera {
    /// A camera of which nothing is known.
    pub fn new() -> Self {
        Self::default()
    }

    checked_setters! {
        /// Sets the gain in electrons per unit of the frame.
        ///
        /// # Errors
        /// [`StarError::Setting`] unless it is above 0.
        with_gain(gain: f64) => gain: Some, if gain.is_finite() && gain > 0.0,
            else "the gain", "a number of electrons per unit, above 0";
        /// Sets the read noise in electrons. It is used only together with a gain.
        ///
        /// # Errors
        /// [`StarError::Setting`] unless it is 0 or above.
        with_read_noise(read_noise: f64) => read_noise, if at_least(0.0, read_noise),
            else "the read noise", "a number of electrons, 0 or above";
        /// Sets the value, background included, at and above which pixels are saturated.
        ///
        /// # Errors
        /// [`StarError::Setting`] unless it is finite.
        with_saturation(level: f64) => saturation: Some, if level.is_finite(),
            else "the saturation level", "a finite number";
        /// Sets the saturation level of the frame's header (`SATURATE`), which is used if no other
        /// level is given. A level at or below the background cannot be true and is ignored
        /// ([`Saturation::ignored`]).
        ///
        /// # Errors
        /// [`StarError::Setting`] unless it is finite.
        with_header_saturation(level: f64) => header_saturation: Some, if level.is_finite(),
            else "the saturation level of the header", "a finite number";
    }

    /// Electrons per unit of the frame, if known.
    pub fn gain(&self) -> Option<f64> {
        self.gain
    }

    /// The signal-to-noise ratio of `flux` above the background in an aperture of `pixels` pixels
    /// with background noise `rms` each.
    pub fn snr(&self, flux: f64, pixels: f64, rms: f64) -> f64 {
        match self.gain {
            Some(gain) => {
                let electrons = gain * flux;
                let background = (gain * rms).powi(2).max(self.read_noise.powi(2));
                electrons / (electrons.max(0.0) + pixels * background).sqrt()
            }
            None => flux / (pixels.sqrt() * rms),
        }
    }

    /// The variance of a pixel with `signal` above a background of noise `rms`, in units of the
    /// frame.
    pub(crate) fn variance(&self, signal: f64, rms: f64) -> f64 {
        match self.gain {
            Some(gain) => rms.powi(2).max((self.read_noise / gain).powi(2)) + signal.max(0.0) / gain,
            None => rms * rms,
        }
    }

    /// Returns the given saturation level, else the header's, else the frame's largest value if
    /// several pixels have it.
    pub(crate) fn saturation_of(&self, frame: ArrayView2<'_, f64>, background: f64) -> Saturation {
        let found = |level, origin, ignored| Saturation {
            level,
            origin,
            ignored,
        };
        if self.saturation.is_some() {
            return found(self.saturation, SaturationOrigin::Given, None);
        }
        let ignored = match self.header_saturation {
            Some(level) if level > background => return found(Some(level), SaturationOrigin::Header, None),
            other => other,
        };
        let largest = frame.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let at_largest = frame.iter().filter(|&&v| v == largest).count();
        if at_largest >= MIN_SATURATED_PIXELS {
            found(Some(largest), SaturationOrigin::PileUp, ignored)
        } else {
            found(None, SaturationOrigin::Unknown, ignored)
        }
    }
}

/// If at least this number of pixels have the frame's largest value, they count as saturated.
const MIN_SATURATED_PIXELS: usize = 2;

/// The level at and above which pixels count as saturated.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Saturation {
    /// The level. `None` if there is no sign of saturation.
    pub level: Option<f64>,
    /// The origin of the level.
    pub origin: SaturationOrigin,
    /// The level of the header, if it was ignored because it is at or below the background.
    pub ignored: Option<f64>,
}

/// The origin of a saturation level.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum SaturationOrigin {
    /// The caller gave it.
    Given,
    /// The frame's header states it (`SATURATE`).
    Header,
    /// Two pixels or more have the frame's largest value.
    PileUp,
    /// No level was given, and the frame's largest value occurs only once.
    Unknown,
}

impl std::fmt::Display for Saturation {
    /// Writes the level and its origin, or `not known` if there is no level.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Some(level) = self.level else {
            return f.write_str("not known");
        };
        let origin = match self.origin {
            SaturationOrigin::Header => "SATURATE of the header",
            SaturationOrigin::PileUp => "the frame's largest value",
            SaturationOrigin::Given | SaturationOrigin::Unknown => "given",
        };
        write!(f, "{level} ({origin})")
    }
}

impl Saturation {
    pub(crate) fn reached_by(self, value: f64) -> bool {
        self.level.is_some_and(|level| value >= level)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn the_ccd_equation() {
        let camera = Camera::new().with_gain(2.0).unwrap();
        // 200 electrons, 10 pixels of 8^2 electrons^2 each: 200 / sqrt(200 + 640).
        assert!((camera.snr(100.0, 10.0, 4.0) - 200.0 / 840f64.sqrt()).abs() < 1e-12);
        let noisy = camera.with_read_noise(20.0).unwrap();
        assert!((noisy.snr(100.0, 10.0, 4.0) - 200.0 / 4200f64.sqrt()).abs() < 1e-12);
        assert!((Camera::new().snr(100.0, 25.0, 4.0) - 5.0).abs() < 1e-12);
        assert!(camera.snr(-100.0, 10.0, 4.0) < 0.0);
    }

    #[test]
    fn saturation_is_given_or_piles_up_or_is_unknown() {
        let piled = array![[1.0, 9.0], [9.0, 2.0]];
        let found = Camera::new().saturation_of(piled.view(), 0.0);
        assert_eq!((found.level, found.origin), (Some(9.0), SaturationOrigin::PileUp));
        assert!(found.reached_by(9.0) && !found.reached_by(8.9));
        let single = Camera::new().saturation_of(array![[1.0, 9.0]].view(), 0.0);
        assert_eq!(single.origin, SaturationOrigin::Unknown);
        assert!(!single.reached_by(1e9));
        let given = Camera::new()
            .with_saturation(5.0)
            .unwrap()
            .saturation_of(piled.view(), 0.0);
        assert_eq!((given.level, given.origin), (Some(5.0), SaturationOrigin::Given));
    }

    #[test]
    fn a_level_of_the_header_counts_unless_the_sky_is_above_it() {
        let frame = array![[3.0, 9.0], [9.0, 2.0]];
        let camera = Camera::new().with_header_saturation(5.0).unwrap();
        let found = camera.saturation_of(frame.view(), 2.0);
        assert_eq!((found.level, found.origin), (Some(5.0), SaturationOrigin::Header));
        assert!(found.to_string().contains("SATURATE"));
        let found = camera.saturation_of(frame.view(), 5.0);
        assert_eq!((found.level, found.ignored), (Some(9.0), Some(5.0)));
        let both = camera
            .with_saturation(4.0)
            .unwrap()
            .saturation_of(frame.view(), 5.0);
        assert_eq!((both.level, both.origin), (Some(4.0), SaturationOrigin::Given));
    }

    #[test]
    fn settings_out_of_range_are_refused() {
        assert!(Camera::new().with_gain(0.0).is_err() && Camera::new().with_read_noise(-1.0).is_err());
        assert!(Camera::new().with_saturation(f64::NAN).is_err());
    }
}
