//! A camera: the world coordinates of its detectors.

use std::path::Path;

use psf_io::{Card, HeaderCards, SkyCoordinates};
use serde::{Deserialize, Serialize};

use super::file::{DetectorEntry, refused, text_of};
use crate::error::PsfieldError;

/// The place of a detector in the focal plane, for a plane (`TAN`) projection.
///
/// | key | value | default |
/// |---|---|---|
/// | `pixel_scale_arcsec` | size of a pixel | required |
/// | `centre_arcsec` | the detector's centre, towards east and north of the boresight | `[0, 0]` |
/// | `rotation_deg` | position angle of the detector's +y axis, from the camera's north towards east | 0 |
/// | `flipped` | +x points east, not west, at rotation 0 | `false` |
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GeometryEntry {
    /// The size of a pixel.
    pub pixel_scale_arcsec: f64,
    /// The centre of the detector.
    #[serde(default)]
    pub centre_arcsec: [f64; 2],
    /// The position angle of +y.
    #[serde(default)]
    pub rotation_deg: f64,
    /// The sense of +x.
    #[serde(default)]
    pub flipped: bool,
}

impl GeometryEntry {
    /// The header of a detector with these columns and rows, relative to the boresight.
    fn header(self, [nx, ny]: [usize; 2]) -> Result<HeaderCards, PsfieldError> {
        let scale = self.pixel_scale_arcsec / 3600.0;
        if !(scale > 0.0 && scale.is_finite()) {
            let got = self.pixel_scale_arcsec;
            return Err(refused(format!(
                "geometry.pixel_scale_arcsec must be above 0, got {got}"
            )));
        }
        let (sin, cos) = self.rotation_deg.to_radians().sin_cos();
        let x = if self.flipped { 1.0 } else { -1.0 };
        // Columns: the directions (east, north) of +x and of +y.
        let matrix = [[scale * x * cos, scale * sin], [-scale * x * sin, scale * cos]];
        let [[a, b], [c, d]] = matrix;
        let determinant = a * d - b * c;
        let [east, north] = self.centre_arcsec.map(|arcsec| arcsec / 3600.0);
        let from_centre = [
            (d * east - b * north) / determinant,
            (a * north - c * east) / determinant,
        ];
        let centre = [nx, ny].map(|n| 0.5 * (n as f64 + 1.0));
        let mut header = HeaderCards::new();
        let mut add = |keyword: &str, value: f64| -> Result<(), PsfieldError> {
            header.push(Card::new(keyword, value, "")?);
            Ok(())
        };
        add("CRPIX1", centre[0] - from_centre[0])?;
        add("CRPIX2", centre[1] - from_centre[1])?;
        add("CRVAL1", 0.0)?;
        add("CRVAL2", 0.0)?;
        add("CD1_1", a)?;
        add("CD1_2", b)?;
        add("CD2_1", c)?;
        add("CD2_2", d)?;
        for (keyword, value) in [
            ("CTYPE1", "RA---TAN"),
            ("CTYPE2", "DEC--TAN"),
            ("RADESYS", "ICRS"),
        ] {
            header.push(Card::new(keyword, value, "")?);
        }
        Ok(header)
    }
}

/// A detector of a camera, with its world coordinates.
#[derive(Debug, Clone)]
pub struct CameraDetector {
    /// The keys of its table.
    pub entry: DetectorEntry,
    /// The header, whose world coordinates refer to the camera's boresight.
    pub header: HeaderCards,
}

/// Cards of a camera's header that would tell of another exposure.
const OF_EXPOSURE: [&str; 9] = [
    "MJD-AVG", "DATE-AVG", "MJD-OBS", "DATE-OBS", "MJD-END", "DATE-END", "MJD-BEG", "DATE-BEG", "EXPTIME",
];

impl CameraDetector {
    pub(super) fn new(entry: DetectorEntry) -> Result<Self, PsfieldError> {
        let in_detector = |problem: String| refused(format!("detector {}: {problem}", entry.name));
        let mut header = match (&entry.wcs, &entry.cards, entry.geometry) {
            (Some(path), None, None) => cards_of(path, entry.wcs_extension.as_deref())?,
            (None, Some(cards), None) => HeaderCards::from_text(cards),
            (None, None, Some(geometry)) => geometry
                .header(entry.shape)
                .map_err(|error| in_detector(error.to_string()))?,
            _ => {
                return Err(in_detector(
                    "its world coordinates are needed: give either wcs (a file) or geometry".to_owned(),
                ));
            }
        };
        SkyCoordinates::from_header(&header).map_err(|error| {
            let file = entry
                .wcs
                .as_ref()
                .map_or_else(String::new, |path| format!("{}: ", path.display()));
            in_detector(format!("{file}{error}"))
        })?;
        for keyword in OF_EXPOSURE {
            header.remove(keyword);
        }
        Ok(Self { entry, header })
    }
}

/// The cards of a FITS file, or those of a text file with a card in each line.
fn cards_of(path: &Path, extension: Option<&str>) -> Result<HeaderCards, PsfieldError> {
    let is_text = |ending: &str| ["hdr", "head", "ahead", "txt"].contains(&ending);
    let ending = path
        .extension()
        .map(|text| text.to_string_lossy().to_ascii_lowercase());
    if !ending.is_some_and(|ending| is_text(&ending)) {
        let extension = extension.map(str::parse).transpose()?;
        return Ok(psf_io::read_cards(path, extension.as_ref())?);
    }
    let in_file = |problem: &str| refused(format!("{}: {problem}", path.display()));
    if extension.is_some() {
        return Err(in_file("wcs_extension applies only to FITS files"));
    }
    let text = text_of(path)?;
    let keyword = |line: &str| line.split([' ', '=']).next().unwrap_or_default().to_owned();
    let (header, rest) = match text.lines().position(|line| line.trim_end() == "END") {
        Some(end) => (text.lines().take(end), text.lines().skip(end + 1)),
        None => (text.lines().take(usize::MAX), text.lines().skip(usize::MAX)),
    };
    if rest.into_iter().any(|line| !line.trim().is_empty()) {
        return Err(in_file(
            "the file has several headers: give each detector a file with its own",
        ));
    }
    let is_card = |line: &&str| {
        let keyword = keyword(line);
        !["", "SIMPLE", "XTENSION", "BITPIX", "EXTEND", "PCOUNT", "GCOUNT"].contains(&keyword.as_str())
            && !keyword.starts_with("NAXIS")
    };
    let records = header.filter(is_card).map(|line| format!("{line:<80.80}"));
    Ok(HeaderCards::from_text(&records.collect::<String>()))
}
