//! Moves positions on the sky from the epoch of a catalogue to the date of an observation.

use sofars::astro::pmpx;
use sofars::eph::epv00;
use sofars::vm::c2s;

/// Milliarcseconds in a radian.
const MAS: f64 = 180.0 * 3.6e6 / std::f64::consts::PI;
/// The Julian date of the year 2000.0, and the days of a Julian year.
const J2000: f64 = 2_451_545.0;
const DAYS_OF_YEAR: f64 = 365.25;

/// The date of an observation, and where the Earth is then.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObservationDate {
    julian_year: f64,
    /// The vector from the barycentre of the solar system to the Earth, in astronomical units.
    earth_au: [f64; 3],
}

/// The motion of a source on the sky. Missing values are 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SkyMotion {
    /// The Julian year at which the position holds.
    pub(crate) epoch: f64,
    /// Proper motions in milliarcseconds per year. That along the right ascension is a distance on the sky: it
    /// has the factor `cos(dec)`, as Gaia's `pmra`.
    pub(crate) pmra: f64,
    pub(crate) pmdec: f64,
    /// In milliarcseconds.
    pub(crate) parallax: f64,
    /// In kilometres per second, away from the Sun.
    pub(crate) radial_velocity: f64,
}

impl ObservationDate {
    /// The date of a Julian year, such as 2031.25. The time scale is that of the barycentre (TDB). UTC differs by
    /// about a minute, which moves no star by a microarcsecond.
    ///
    /// # Errors
    /// None for a year before 1900 or after 2100, for which the place of the Earth is not known.
    pub fn of_julian_year(julian_year: f64) -> Option<Self> {
        if !(1900.0..=2100.0).contains(&julian_year) {
            return None;
        }
        let (_, barycentric) = epv00(J2000, (julian_year - 2000.0) * DAYS_OF_YEAR)?;
        Some(Self {
            julian_year,
            earth_au: barycentric[0],
        })
    }

    /// The date of a modified Julian date.
    pub fn of_mjd(mjd: f64) -> Option<Self> {
        Self::of_julian_year(2000.0 + (mjd + 2_400_000.5 - J2000) / DAYS_OF_YEAR)
    }

    /// The Julian year.
    pub fn julian_year(self) -> f64 {
        self.julian_year
    }

    /// The position of a source on this date, in degrees, as seen from the Earth: with its space motion and
    /// parallax. Aberration, which moves all sources of a frame alike, is left to the world coordinates.
    pub(crate) fn position(self, (ra_deg, dec_deg): (f64, f64), motion: &SkyMotion) -> (f64, f64) {
        let (ra, dec) = (ra_deg.to_radians(), dec_deg.to_radians());
        let or_zero = |value: f64| if value.is_finite() { value } else { 0.0 };
        // The routine wants the change of the right ascension itself.
        let along_ra = or_zero(motion.pmra) / MAS / dec.cos();
        let direction = pmpx(
            ra,
            dec,
            along_ra,
            or_zero(motion.pmdec) / MAS,
            or_zero(motion.parallax) / 1e3,
            or_zero(motion.radial_velocity),
            self.julian_year - motion.epoch,
            self.earth_au,
        );
        let (ra, dec) = c2s(&direction);
        (ra.to_degrees().rem_euclid(360.0), dec.to_degrees())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stars_move_as_for_astropy() {
        // Barnard's star: SkyCoord(...).apply_space_motion(Time(2031.25, format="jyear")) and its parallax,
        // transformed to the direction from the Earth. See the command in the documentation.
        let motion = SkyMotion {
            epoch: 2016.0,
            pmra: -801.551,
            pmdec: 10_362.394,
            parallax: 546.976,
            radial_velocity: -110.468,
        };
        let date = ObservationDate::of_julian_year(2031.25).unwrap();
        let (ra, dec) = date.position((269.448_502_5, 4.739_420_1), &motion);
        assert!((ra - EXPECTED.0).abs() * 3.6e6 < 0.05, "{ra}");
        assert!((dec - EXPECTED.1).abs() * 3.6e6 < 0.05, "{dec}");
    }

    const EXPECTED: (f64, f64) = (269.445_240_982_602_46, 4.783_372_928_218_193);
}
