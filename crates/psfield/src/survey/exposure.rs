//! An exposure of one detector: its header, its place on the sky, the settings of the detector.

use detector::{Detector, DetectorParams};
use psf_io::{Card, HeaderCards, ObservationDate, SkyCoordinates, SkyPointing};
use psf_types::Position;

use super::file::refused;
use super::frames::{Survey, SurveyFrame};
use crate::error::PsfieldError;

impl Survey {
    /// The header of a frame: that of its detector at the pointing, with cards of the exposure.
    ///
    /// # Errors
    /// [`ErrorKind::Data`](crate::ErrorKind::Data) for a detector whose projection cannot be turned.
    pub fn header(&self, frame: &SurveyFrame) -> Result<HeaderCards, PsfieldError> {
        let detector = &self.detectors()[frame.detector];
        let [ra_deg, dec_deg, rotation_deg] = self.file.boresight.unwrap_or([0.0; 3]);
        let from = SkyPointing {
            ra_deg,
            dec_deg,
            rotation_deg,
        };
        let header = frame.pointing.header(&detector.header, from);
        let mut header =
            header.map_err(|error| refused(format!("detector {}: {error}", detector.entry.name)))?;
        let pointing = frame.pointing;
        let mut cards = vec![
            Card::new("EXPNAME", frame.exposure.as_str(), "name of the exposure")?,
            Card::new("CCDNAME", detector.entry.name.as_str(), "name of the detector")?,
            Card::new("PNTRA", pointing.ra_deg, "[deg] right ascension of the boresight")?,
            Card::new("PNTDEC", pointing.dec_deg, "[deg] declination of the boresight")?,
            Card::new(
                "PNTROT",
                pointing.rotation_deg,
                "[deg] position angle of the camera's north",
            )?,
        ];
        if let Some(band) = &frame.band {
            cards.push(Card::new("FILTER", band.as_str(), "band")?);
        }
        if let Some(date) = frame.observation_date()? {
            cards.push(Card::new("MJD-OBS", date.mjd(), "date of the observation")?);
            let text = frame.date.as_deref().unwrap_or_default();
            if text.parse::<f64>().is_err() {
                cards.push(Card::new("DATE-OBS", text, "date of the observation (UTC)")?);
            }
        }
        if let Some(seconds) = frame.exposure_s {
            cards.push(Card::new("EXPTIME", seconds, "[s] exposure time")?);
        }
        for card in cards {
            header.set(card);
        }
        Ok(header)
    }

    /// The positions on the sky of the corners of a frame, its centre, and the distance in degrees from there to
    /// the farthest position within `margin_px` of the frame.
    ///
    /// # Errors
    /// [`ErrorKind::Data`](crate::ErrorKind::Data) for a frame that is not inside its projection.
    pub fn footprint(&self, frame: &SurveyFrame, margin_px: f64) -> Result<Footprint, PsfieldError> {
        let sky =
            SkyCoordinates::from_header(&self.header(frame)?).map_err(|error| refused(error.to_string()))?;
        self.footprint_on(&sky, frame, margin_px)
    }

    /// The footprint of a frame with these world coordinates.
    pub(super) fn footprint_on(
        &self,
        sky: &SkyCoordinates,
        frame: &SurveyFrame,
        margin_px: f64,
    ) -> Result<Footprint, PsfieldError> {
        let detector = &self.detectors()[frame.detector].entry;
        let [nx, ny] = detector.shape.map(|n| n as f64 - 0.5);
        let at = |x: f64, y: f64| {
            let position = Position::new(x, y).ok();
            position.and_then(|position| sky.sky(position)).ok_or_else(|| {
                refused(format!(
                    "detector {}: the pixel ({x}, {y}) has no position on the sky",
                    detector.name
                ))
            })
        };
        let (low, middle, high) = (-0.5, [0.5 * (nx - 0.5), 0.5 * (ny - 0.5)], [nx, ny]);
        let corners = [
            at(low, low)?,
            at(high[0], low)?,
            at(high[0], high[1])?,
            at(low, high[1])?,
        ];
        let centre = at(middle[0], middle[1])?;
        let sides = [
            at(low, middle[1])?,
            at(high[0], middle[1])?,
            at(middle[0], low)?,
            at(middle[0], high[1])?,
        ];
        let farthest = corners
            .iter()
            .chain(&sides)
            .map(|&place| distance_deg(centre, place));
        let radius = farthest.fold(0.0, f64::max);
        // The largest size of a pixel, along the axes at the corners and the centre.
        let mut scale = 0.0_f64;
        for (x, y) in [
            (low, low),
            (high[0] - 1.0, low),
            (high[0] - 1.0, high[1] - 1.0),
            (low, high[1] - 1.0),
            (middle[0], middle[1]),
        ] {
            let here = at(x, y)?;
            scale = scale
                .max(distance_deg(here, at(x + 1.0, y)?))
                .max(distance_deg(here, at(x, y + 1.0)?));
        }
        Ok(Footprint {
            corners_deg: corners,
            centre_deg: centre,
            // Corners of the margin, and a little for the distortion beyond the frame.
            radius_deg: radius + 1.1 * std::f64::consts::SQRT_2 * margin_px * scale,
        })
    }

    /// The detector of a frame. `None` if the frame is an image of flux.
    pub(super) fn detector_of(&self, frame: &SurveyFrame) -> Result<Option<Detector>, PsfieldError> {
        let entry = &self.detectors()[frame.detector].entry;
        let Some(path) = &entry.settings else {
            return Ok(None);
        };
        let mut params = DetectorParams::from_toml_file(path)?;
        let in_file = |problem: String| refused(format!("{}: {problem}", path.display()));
        if let Some(seconds) = frame.exposure_s {
            if let Some(other) = params.exposure_s.filter(|&other| other != seconds) {
                return Err(in_file(format!(
                    "exposure_s is {other}, but exposure {} lasts {seconds} s: remove it from the settings",
                    frame.exposure
                )));
            }
            params.exposure_s = Some(seconds);
        }
        if let Some(sky) = self.band(frame).and_then(|band| band.sky_e_per_s) {
            if params.sky_e != 0.0 {
                return Err(in_file(
                    "sky_e is set here, and sky_e_per_s for the band: remove one".to_owned(),
                ));
            }
            let Some(seconds) = params.exposure_s else {
                return Err(in_file(
                    "sky_e_per_s needs the exposure time: give pointings exposure_s".to_owned(),
                ));
            };
            params.sky_e = sky * seconds;
        }
        let made = Detector::new(params);
        made.map(Some).map_err(|error| in_file(error.to_string()))
    }
}

impl SurveyFrame {
    /// The date.
    pub(super) fn observation_date(&self) -> Result<Option<ObservationDate>, PsfieldError> {
        let parsed = self.date.as_deref().map(str::parse).transpose();
        parsed.map_err(|problem: String| refused(format!("exposure {}: date: {problem}", self.exposure)))
    }
}

/// Where a frame is on the sky. Positions are right ascension and declination in degrees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Footprint {
    /// The corners of the pixels (first column and row, last column, last of both, last row).
    pub corners_deg: [(f64, f64); 4],
    /// The centre.
    pub centre_deg: (f64, f64),
    /// The distance from the centre to the farthest position.
    pub radius_deg: f64,
}

/// The angle between two positions on the sky.
fn distance_deg((ra1, dec1): (f64, f64), (ra2, dec2): (f64, f64)) -> f64 {
    let (d1, d2, dra) = (dec1.to_radians(), dec2.to_radians(), (ra2 - ra1).to_radians());
    let half = ((0.5 * (d2 - d1)).sin().powi(2) + d1.cos() * d2.cos() * (0.5 * dra).sin().powi(2)).sqrt();
    2.0 * half.min(1.0).asin().to_degrees()
}
