//! Moves positions on the sky from the epoch of a catalogue to the date of an observation.

use sofars::astro::pmpx;
use sofars::cal::cal2jd;
use sofars::eph::epv00;
use sofars::vm::c2s;

use crate::fits::header_cards::HeaderCards;

const MAS_OF_RADIAN: f64 = 180.0 * 3.6e6 / std::f64::consts::PI;
/// The Julian date of the year 2000.0, and the days of a Julian year.
const J2000: f64 = 2_451_545.0;
const DAYS_OF_YEAR: f64 = 365.25;
/// The Julian date at which the modified Julian date is 0.
const MJD_ZERO: f64 = 2_400_000.5;
/// Numbers from this one on are modified Julian dates (from 1886 on), smaller ones are Julian years.
const LEAST_MJD: f64 = 1e4;

/// The date of an observation, and where the Earth is then.
///
/// ```
/// use psf_io::ObservationDate;
/// let date: ObservationDate = "2031-04-02T06:00:00".parse().expect("a date");
/// assert!((date.julian_year() - 2031.25).abs() < 1e-3);
/// assert!("2031.25".parse::<ObservationDate>().is_ok() && "62958.3".parse::<ObservationDate>().is_ok());
/// assert!("in spring".parse::<ObservationDate>().is_err());
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObservationDate {
    mjd: f64,
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
    /// about a minute, in which no star moves by a microarcsecond. Returns `None` for a year before 1900 or after
    /// 2100, for which the place of the Earth is not known.
    pub fn of_julian_year(julian_year: f64) -> Option<Self> {
        Self::of_mjd((julian_year - 2000.0) * DAYS_OF_YEAR + J2000 - MJD_ZERO)
    }

    /// The date of a modified Julian date. Returns `None` as [`of_julian_year`](Self::of_julian_year) does.
    pub fn of_mjd(mjd: f64) -> Option<Self> {
        /// The first day of 1900, and that of 2101.
        const KNOWN: std::ops::Range<f64> = 15_020.0..88_434.0;
        let (_, barycentric) = KNOWN.contains(&mjd).then(|| epv00(MJD_ZERO, mjd))??;
        Some(Self {
            mjd,
            earth_au: barycentric[0],
        })
    }

    /// The date of an observation by its header: that of `MJD-AVG`, `DATE-AVG`, `MJD-OBS` or `DATE-OBS`,
    /// whichever comes first in this list. Returns `None` for a header without a valid date.
    pub fn of_header(header: &HeaderCards) -> Option<Self> {
        ["AVG", "OBS"].into_iter().find_map(|which| {
            let mjd = header.number(&format!("MJD-{which}")).and_then(Self::of_mjd);
            mjd.or_else(|| header.text(&format!("DATE-{which}"))?.parse().ok())
        })
    }

    /// The modified Julian date.
    pub fn mjd(self) -> f64 {
        self.mjd
    }

    /// The Julian year.
    pub fn julian_year(self) -> f64 {
        2000.0 + (self.mjd + MJD_ZERO - J2000) / DAYS_OF_YEAR
    }

    /// The position of a source on this date, in degrees, as seen from the Earth: with its space motion and
    /// parallax. Aberration, which moves all sources of a frame alike, is left to the world coordinates.
    pub(crate) fn position(self, (ra_deg, dec_deg): (f64, f64), motion: &SkyMotion) -> (f64, f64) {
        let (ra, dec) = (ra_deg.to_radians(), dec_deg.to_radians());
        let or_zero = |value: f64| if value.is_finite() { value } else { 0.0 };
        // The routine wants the change of the right ascension itself.
        let along_ra = or_zero(motion.pmra) / MAS_OF_RADIAN / dec.cos();
        let direction = pmpx(
            ra,
            dec,
            along_ra,
            or_zero(motion.pmdec) / MAS_OF_RADIAN,
            or_zero(motion.parallax) / 1e3,
            or_zero(motion.radial_velocity),
            self.julian_year() - motion.epoch,
            self.earth_au,
        );
        let (ra, dec) = c2s(&direction);
        (ra.to_degrees().rem_euclid(360.0), dec.to_degrees())
    }
}

impl std::str::FromStr for ObservationDate {
    type Err = String;

    /// Parses a date (UTC), as in `2031-05-17` or `2031-05-17T12:00:00`, a Julian year, as in `2031.25`, or a
    /// modified Julian date, as in `62700.5`.
    fn from_str(text: &str) -> Result<Self, String> {
        let text = text.trim();
        let date = match text.parse::<f64>() {
            Ok(mjd) if mjd >= LEAST_MJD => Self::of_mjd(mjd),
            Ok(year) => Self::of_julian_year(year),
            Err(_) => mjd_of(text).and_then(Self::of_mjd),
        };
        date.ok_or_else(|| {
            format!(
                "a date is needed, as in 2031-05-17 or 2031-05-17T12:00:00 (UTC), or a Julian year from 1900 to 2100 (2031.25), or \
                 a modified Julian date (62700.5), not {text:?}"
            )
        })
    }
}

/// The modified Julian date of a text as in `2031-05-17T12:00:00.5`, where the time may be missing.
fn mjd_of(text: &str) -> Option<f64> {
    let (date, time) = text.split_once(['T', ' ']).unwrap_or((text, "00:00:00"));
    let whole = |text: Option<&str>| text?.parse::<i32>().ok();
    let mut date = date.splitn(3, '-');
    let [year, month, day] = [whole(date.next())?, whole(date.next())?, whole(date.next())?];
    let (_, mjd) = cal2jd(year, month, day).ok()?;
    let mut time = time.strip_suffix('Z').unwrap_or(time).splitn(3, ':');
    let (hours, minutes) = (whole(time.next())?, whole(time.next())?);
    let seconds: f64 = time.next().unwrap_or("0").parse().ok()?;
    let valid = (0..24).contains(&hours) && (0..60).contains(&minutes) && (0.0..61.0).contains(&seconds);
    valid.then(|| mjd + (f64::from(60 * (60 * hours + minutes)) + seconds) / 86_400.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stars_move_as_for_astropy() {
        // Barnard's star: SkyCoord(...).apply_space_motion(Time(2031.25, format="jyear")) and its parallax,
        // minus that of the Earth (get_body_barycentric).
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

    #[test]
    fn dates_have_many_forms() {
        let year = |text: &str| text.parse::<ObservationDate>().map(ObservationDate::julian_year);
        // astropy: Time("2031-05-17T12:00:00").jyear, Time(62700.5, format="mjd").jyear
        for (text, expected) in [
            ("2031-05-17T12:00:00", 2_031.373_032_169_746_7),
            ("2031-05-17", 2_031.371_663_244_353_2),
            ("2031.25", 2031.25),
            // Time("1950-03-01").jyear
            ("1950-03-01", 1_950.161_533_196_440_8),
            ("62700.5", 2_030.543_463_381_245_8),
        ] {
            assert!(
                (year(text).unwrap() - expected).abs() < 1e-9,
                "{text}: {:?}",
                year(text)
            );
        }
        for text in [
            "",
            "17 May 2031",
            "2031-13-01",
            "1800",
            "NaN",
            "2031-05-17T12:00:00+02:00",
        ] {
            assert!(year(text).is_err(), "{text}");
        }
    }

    const EXPECTED: (f64, f64) = (269.445_240_982_602_46, 4.783_372_928_218_193);
}
