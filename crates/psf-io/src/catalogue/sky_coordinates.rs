//! Converts positions on the sky to pixels of the frame.

use std::sync::Arc;

use mapproj::cylindrical::car::Car;
use mapproj::zenithal::{arc::Arc as ArcProjection, sin::Sin, stg::Stg, tan::Tan, zea::Zea, zpn::Zpn};
use mapproj::{ProjXY, Projection, XYZ};
use psf_types::Position;

use crate::catalogue::sky_motion::ObservationDate;
use crate::catalogue::world_header::{
    Distortion, World, WorldCoordinatesError, inverted, product, unsupported,
};
use crate::fits::card::{Card, CardValue};
use crate::fits::header_cards::HeaderCards;
use crate::units::angle_in_deg;

/// The usual LONPOLE of a zenithal projection: the longitude of the celestial pole in the
/// projection.
const USUAL_POLE_LONGITUDE: f64 = 180.0;
/// The largest allowed coordinate on the projection, in radians. The squares of larger ones would
/// overflow, and mapproj would return invalid vectors.
const MAX_PROJECTED: f64 = 1e150;

/// The world coordinates of a frame, which convert positions on the sky to pixels and back.
///
/// The projections `TAN`, `SIN`, `ZEA`, `ARC`, `STG`, `ZPN` and `CAR` of right ascension and declination
/// are supported, with `CDi_j`, with `PCi_j` and `CDELTi`, or with `CDELTi` and `CROTA2` (Calabretta
/// and Greisen 2002, A&A 395, 1077). `PC001002` is `PC1_2`, as in old headers. `CUNITi` may be `deg`,
/// `arcmin`, `arcsec`, `mas` or `rad`. Supported distortions are:
///
/// - `SIP` (`A_p_q` and `B_p_q`), also if `CTYPEi` does not end in `-SIP`, as in astropy. The
///   inverse is solved numerically, without `AP_p_q` and `BP_p_q`.
/// - `TPV`, also written as `TAN` with `PVi_m`, as SCAMP does.
///
/// Other distortions (`CPDISn`, `CQDISn`, `D2IMDISn`) and reference points moved by `PVi_m` are
/// errors and never ignored. Coordinates are in degrees, in the system of the header (`RADESYS`),
/// and are not converted to another system.
///
/// ```
/// use psf_io::{Card, HeaderCards, SkyCoordinates};
/// let mut header = HeaderCards::new();
/// for (keyword, value) in [("CRPIX1", 50.5), ("CRPIX2", 40.5), ("CRVAL1", 150.0), ("CRVAL2", 2.0)] {
///     header.push(Card::new(keyword, value, "")?);
/// }
/// header.push(Card::new("CTYPE1", "RA---TAN", "")?);
/// header.push(Card::new("CTYPE2", "DEC--TAN", "")?);
/// header.push(Card::new("CDELT1", -1e-4, "")?);
/// header.push(Card::new("CDELT2", 1e-4, "")?);
/// let sky = SkyCoordinates::from_header(&header)?;
/// let centre = sky.pixel(150.0, 2.0).expect("on the projection"); // 0-based
/// assert!((centre.x() - 49.5).abs() < 1e-9 && (centre.y() - 39.5).abs() < 1e-9);
/// assert!(sky.pixel(330.0, -2.0).is_none()); // on the far side of the sky
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct SkyCoordinates {
    /// Projects the sphere around the vector (1, 0, 0) to a plane in radians.
    projection: Arc<dyn Projection + Send + Sync>,
    /// Rotates the reference point to (1, 0, 0).
    rotation: [[f64; 3]; 3],
    /// The name of the projection, for the `Debug` output.
    name: String,
    /// The reference pixel, 0-based.
    reference: [f64; 2],
    /// Converts pixels to degrees on the projection. The rows are longitude and latitude.
    matrix: [[f64; 2]; 2],
    inverse: [[f64; 2]; 2],
    distortion: Distortion,
    date: Option<ObservationDate>,
}

impl SkyCoordinates {
    /// Reads the world coordinates from a header.
    ///
    /// # Errors
    /// [`WorldCoordinatesError`] with the keyword that is missing or not supported, or for a matrix
    /// that has no inverse.
    pub fn from_header(header: &HeaderCards) -> Result<Self, WorldCoordinatesError> {
        let date = ObservationDate::of_header(header);
        let header = World { header };
        let types = [header.text("CTYPE1")?, header.text("CTYPE2")?];
        let kind = |name: &str| name.split('-').next().unwrap_or_default().to_owned();
        let swapped = match [kind(&types[0]).as_str(), kind(&types[1]).as_str()] {
            ["RA", "DEC"] => false,
            ["DEC", "RA"] => true,
            _ => {
                return Err(unsupported(
                    "CTYPE1",
                    "right ascension or declination with a projection (such as RA---TAN or DEC--TAN), and CTYPE2 must be the other of the two",
                    &types.join(" and "),
                ));
            }
        };
        let (first, second) = (projection_of(&types[0]), projection_of(&types[1]));
        if first != second {
            return Err(unsupported(
                "CTYPE2",
                "a type of the same projection as CTYPE1",
                &types[1],
            ));
        }
        let units = [degrees(&header, "CUNIT1")?, degrees(&header, "CUNIT2")?];
        let axes = if swapped { ["2", "1"] } else { ["1", "2"] };
        let reference = [
            header.needed("CRPIX1", "the reference pixel")?,
            header.needed("CRPIX2", "the reference pixel")?,
        ];
        let values = [
            header.needed("CRVAL1", "the coordinate of the reference pixel")?,
            header.needed("CRVAL2", "the coordinate of the reference pixel")?,
        ];
        let mut values = [values[0] * units[0], values[1] * units[1]];
        let mut matrix = header.matrix()?;
        for (row, unit) in matrix.iter_mut().zip(units) {
            *row = row.map(|value| value * unit);
        }
        if swapped {
            matrix.swap(0, 1);
            values.swap(0, 1);
        }
        let [longitude, latitude] = values;
        let (determinant, inverse) = inverted(&matrix);
        if determinant == 0.0 || !determinant.recip().is_finite() {
            return Err(WorldCoordinatesError::Singular);
        }
        // The native latitude of the reference point: the pole, or the equator in a cylindrical projection.
        let native = if first == "CAR" { 0.0 } else { 90.0 };
        let default_pole = if latitude >= native {
            0.0
        } else {
            USUAL_POLE_LONGITUDE
        };
        let pole = header.number("LONPOLE")?.unwrap_or(default_pole);
        let distortion = Distortion::from_header(header.header, &types, axes, native)?;
        let turn = if first == "CAR" {
            // With the default, north points up at the reference point.
            let up = pole == default_pole || (latitude == 0.0 && pole == USUAL_POLE_LONGITUDE);
            if !up {
                return Err(unsupported(
                    "LONPOLE",
                    "absent or its default in the projection CAR",
                    &pole.to_string(),
                ));
            }
            0.0
        } else {
            pole - USUAL_POLE_LONGITUDE
        };
        let rotation = rotation(longitude, latitude, turn);
        let name = first.to_owned();
        let projection = projection(&header, first, axes[1])?;
        Ok(Self {
            projection,
            rotation,
            name,
            reference: reference.map(|pixel| pixel - 1.0),
            matrix,
            inverse,
            distortion,
            date,
        })
    }

    /// The date of the observation, if the header states it ([`ObservationDate::of_header`]).
    pub fn date(&self) -> Option<ObservationDate> {
        self.date
    }

    /// The pixel position (0-based) of a position on the sky in degrees. Returns `None` if the
    /// projection does not reach the position, if the distortion has no inverse there, or if the
    /// coordinates are not valid.
    pub fn pixel(&self, longitude_deg: f64, latitude_deg: f64) -> Option<Position> {
        if !longitude_deg.is_finite() || !(-90.0..=90.0).contains(&latitude_deg) {
            return None;
        }
        self.pixel_of(unit_vector(longitude_deg, latitude_deg))
    }

    /// The pixel position of a direction. It need not have unit length.
    fn pixel_of(&self, direction: [f64; 3]) -> Option<Position> {
        let [x, y, z] = self.rotation.map(|row| dot(row, direction));
        let plane = self
            .projection
            .proj_xyz(&XYZ::new_renorming_if_necessary(x, y, z))?;
        let plane = self
            .distortion
            .undo_in_plane([plane.x().to_degrees(), plane.y().to_degrees()])?;
        let offset = self.distortion.undo_in_pixels(product(&self.inverse, plane))?;
        Position::new(self.reference[0] + offset[0], self.reference[1] + offset[1]).ok()
    }

    /// The matrix that takes a small offset on the sky, in arcseconds to the west and to the north, to an offset in
    /// pixels along x and y. West comes first, so that a frame with north up and east to the left has a positive
    /// diagonal, as for GalSim. Returns `None` where [`pixel`](Self::pixel) does.
    pub fn pixels_per_arcsec(&self, longitude_deg: f64, latitude_deg: f64) -> Option<[[f64; 2]; 2]> {
        /// The step of the difference quotient. Its square is the relative error.
        const STEP_RAD: f64 = 1e-5;
        self.pixel(longitude_deg, latitude_deg)?;
        let [at, east, north] = local_axes(longitude_deg, latitude_deg);
        let along = |axis: [f64; 3]| {
            let moved = |step: f64| self.pixel_of([0, 1, 2].map(|i| at[i] + step * axis[i]));
            let (before, after) = (moved(-STEP_RAD)?, moved(STEP_RAD)?);
            let arcsec = 2.0 * STEP_RAD.to_degrees() * 3600.0;
            Some([
                (after.x() - before.x()) / arcsec,
                (after.y() - before.y()) / arcsec,
            ])
        };
        let (west, north) = (along(east.map(|e| -e))?, along(north)?);
        Some([[west[0], north[0]], [west[1], north[1]]])
    }

    /// The sky position of a pixel position: longitude from 0 to 360 and latitude, in degrees.
    /// Returns `None` if the pixel is outside the projection of the sky.
    pub fn sky(&self, position: Position) -> Option<(f64, f64)> {
        let offset = [position.x() - self.reference[0], position.y() - self.reference[1]];
        let plane = product(&self.matrix, self.distortion.in_pixels(offset));
        let [x, y] = self.distortion.in_plane(plane);
        let [x, y] = [x.to_radians(), y.to_radians()];
        // A distortion may overflow to NaN, which fails these comparisons and is refused too.
        if !(x.abs() < MAX_PROJECTED && y.abs() < MAX_PROJECTED) {
            return None;
        }
        let turned = self.projection.unproj_xyz(&ProjXY::new(x, y))?;
        let turned = [turned.x(), turned.y(), turned.z()];
        // The inverse of a rotation is its transpose.
        let [x, y, z] = [0, 1, 2].map(|i| dot(self.rotation.map(|row| row[i]), turned));
        Some(place([x, y, z]))
    }
}

impl std::fmt::Debug for SkyCoordinates {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SkyCoordinates")
            .field("projection", &self.name)
            .field("reference", &self.reference)
            .field("matrix", &self.matrix)
            .field("distortion", &self.distortion)
            .finish_non_exhaustive()
    }
}

/// A projection by its name.
fn projection(
    header: &World<'_>,
    name: &str,
    latitude_axis: &str,
) -> Result<Arc<dyn Projection + Send + Sync>, WorldCoordinatesError> {
    Ok(match name {
        "TAN" | "TPV" => Arc::new(Tan::new()),
        "SIN" => {
            for keyword in ["1", "2"].map(|m| format!("PV{latitude_axis}_{m}")) {
                if let Some(slant) = header.number(&keyword)?.filter(|&slant| slant != 0.0) {
                    return Err(unsupported(
                        &keyword,
                        "0 (slant orthographic projections are not supported)",
                        &slant.to_string(),
                    ));
                }
            }
            Arc::new(Sin::new())
        }
        "ZEA" => Arc::new(Zea::new()),
        "ARC" => Arc::new(ArcProjection::new()),
        "STG" => Arc::new(Stg::new()),
        "CAR" => Arc::new(Car::new()),
        "ZPN" => Arc::new(zpn(header, latitude_axis)?),
        _ => {
            return Err(unsupported(
                "CTYPE1",
                "a type of the projection TAN, TPV, SIN, ZEA, ARC, STG, ZPN or CAR",
                &header.text("CTYPE1")?,
            ));
        }
    })
}

/// The degrees of the unit that a card names. Without the card, the unit is a degree.
pub(super) fn degrees(header: &World<'_>, keyword: &str) -> Result<f64, WorldCoordinatesError> {
    const UNITS: &str = "deg, arcmin, arcsec, mas or rad";
    match header.header.get(keyword).and_then(Card::value) {
        None => Ok(1.0),
        Some(CardValue::Text(unit)) if unit.trim().is_empty() => Ok(1.0),
        Some(CardValue::Text(unit)) => angle_in_deg(&unit).ok_or_else(|| unsupported(keyword, UNITS, &unit)),
        Some(other) => Err(unsupported(keyword, UNITS, &other.to_string())),
    }
}

/// The zenithal polynomial with the coefficients `PVi_m` of the latitude.
fn zpn(header: &World<'_>, axis: &str) -> Result<Zpn, WorldCoordinatesError> {
    /// The number of coefficients that the convention allows.
    const COEFFICIENTS: usize = 31;
    /// The accuracy of the inverse in radians, and its largest number of steps. The defaults of mapproj
    /// leave a milliarcsecond.
    const ACCURACY: f64 = 1e-15;
    const STEPS: u8 = 100;
    let keyword = |m: usize| format!("PV{axis}_{m}");
    let mut coefficients = Vec::with_capacity(COEFFICIENTS);
    for m in 0..COEFFICIENTS {
        coefficients.push(header.number(&keyword(m))?.unwrap_or(0.0));
    }
    while coefficients.pop_if(|value| *value == 0.0).is_some() {}
    let grows = coefficients.first().is_none_or(|&constant| constant == 0.0)
        && coefficients.get(1).is_some_and(|&slope| slope > 0.0);
    let projection = grows.then(|| Zpn::from_params(coefficients)).flatten();
    let mut projection = projection.ok_or_else(|| {
        unsupported(
            &keyword(1),
            "above 0, with PVi_0 = 0, in the projection ZPN",
            "another polynomial",
        )
    })?;
    projection.set_eps(ACCURACY);
    projection.set_n_iter(STEPS);
    Ok(projection)
}

pub(super) fn unit_vector(longitude_deg: f64, latitude_deg: f64) -> [f64; 3] {
    let (sin_l, cos_l) = longitude_deg.to_radians().sin_cos();
    let (sin_b, cos_b) = latitude_deg.to_radians().sin_cos();
    [cos_l * cos_b, sin_l * cos_b, sin_b]
}

/// Longitude from 0 to 360 and latitude of a direction, in degrees.
pub(super) fn place([x, y, z]: [f64; 3]) -> (f64, f64) {
    (
        y.atan2(x).to_degrees().rem_euclid(360.0),
        z.atan2(x.hypot(y)).to_degrees(),
    )
}

pub(super) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The direction of a position on the sky, and those to the east and to the north there.
pub(super) fn local_axes(longitude_deg: f64, latitude_deg: f64) -> [[f64; 3]; 3] {
    let (sin_l, cos_l) = longitude_deg.to_radians().sin_cos();
    let (sin_b, cos_b) = latitude_deg.to_radians().sin_cos();
    let (east, north) = ([-sin_l, cos_l, 0.0], [-cos_l * sin_b, -sin_l * sin_b, cos_b]);
    [unit_vector(longitude_deg, latitude_deg), east, north]
}

/// Returns a rotation that takes a position on the sky to (1, 0, 0), the direction east to +y and
/// north to +z. East and north are then turned by `turn_deg` about the first axis.
fn rotation(longitude_deg: f64, latitude_deg: f64, turn_deg: f64) -> [[f64; 3]; 3] {
    let (sin_t, cos_t) = turn_deg.to_radians().sin_cos();
    let [at, east, north] = local_axes(longitude_deg, latitude_deg);
    let combined = |a: f64, b: f64| [0, 1, 2].map(|i| a * east[i] + b * north[i]);
    [at, combined(cos_t, -sin_t), combined(sin_t, cos_t)]
}

/// The projection code in a CTYPE such as `RA---TAN-SIP`.
fn projection_of(ctype: &str) -> &str {
    ctype
        .get(5..)
        .unwrap_or_default()
        .split('-')
        .next()
        .unwrap_or_default()
        .trim()
}
