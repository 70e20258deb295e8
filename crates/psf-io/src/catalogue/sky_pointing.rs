//! Points a camera at the sky: the world coordinates of its detectors.

use super::sky_coordinates::{degrees, dot, local_axes, place};
use super::world_header::{World, WorldCoordinatesError, unsupported};
use crate::fits::card::Card;
use crate::fits::header_cards::HeaderCards;

/// A direction on the sky, and the rotation of a camera that looks there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SkyPointing {
    /// Right ascension in degrees.
    pub ra_deg: f64,
    /// Declination in degrees, -90 to 90.
    pub dec_deg: f64,
    /// The position angle of the camera's north, in degrees from north towards east.
    pub rotation_deg: f64,
}

impl SkyPointing {
    /// The camera's own coordinates: right ascension and declination 0, without a rotation.
    pub const OF_CAMERA: Self = Self {
        ra_deg: 0.0,
        dec_deg: 0.0,
        rotation_deg: 0.0,
    };

    /// The direction, and those of the camera's east and north there.
    fn axes(self) -> [[f64; 3]; 3] {
        let [at, east, north] = local_axes(self.ra_deg, self.dec_deg);
        let (sin, cos) = self.rotation_deg.to_radians().sin_cos();
        let sum = |a: f64, b: f64| [0, 1, 2].map(|i| a * east[i] + b * north[i]);
        [at, sum(cos, -sin), sum(sin, cos)]
    }

    /// The pointing that is `(east, north)` arcseconds away, along the sky's own axes. The rotation is that from the north
    /// of the new place, which near a pole differs from that of the old one.
    #[must_use]
    pub fn moved_by_arcsec(self, (east, north): (f64, f64)) -> Self {
        let distance = east.hypot(north);
        if distance == 0.0 {
            return self;
        }
        let angle = (distance / 3600.0).to_radians();
        let [at, to_east, to_north] = local_axes(self.ra_deg, self.dec_deg);
        let along = |i: usize| (east * to_east[i] + north * to_north[i]) / distance;
        let (ra_deg, dec_deg) = place([0, 1, 2].map(|i| angle.cos() * at[i] + angle.sin() * along(i)));
        Self {
            ra_deg,
            dec_deg,
            ..self
        }
    }

    /// The header of a detector, whose world coordinates are those of the camera at the pointing `from`
    /// ([`OF_CAMERA`](Self::OF_CAMERA) for coordinates relative to the boresight), with the camera at this pointing.
    /// The cards `CRVALi` and `LONPOLE` change: distortions stay those of the detector.
    ///
    /// # Errors
    /// [`WorldCoordinatesError`] for a header without world coordinates, or in the projection CAR.
    pub fn header(self, detector: &HeaderCards, from: Self) -> Result<HeaderCards, WorldCoordinatesError> {
        const REFERENCE: &str = "the coordinate of the reference pixel";
        let world = World { header: detector };
        let types = [world.text("CTYPE1")?, world.text("CTYPE2")?];
        if types[0].ends_with("CAR") {
            return Err(unsupported(
                "CTYPE1",
                "a zenithal projection, such as RA---TAN",
                &types[0],
            ));
        }
        let swapped = types[0].starts_with("DEC");
        let [longitude, latitude] = if swapped { ["2", "1"] } else { ["1", "2"] };
        let value = |axis: &str| -> Result<(f64, f64), WorldCoordinatesError> {
            let factor = degrees(&world, &format!("CUNIT{axis}"))?;
            Ok((factor * world.needed(&format!("CRVAL{axis}"), REFERENCE)?, factor))
        };
        let ((ra, ra_unit), (dec, dec_unit)) = (value(longitude)?, value(latitude)?);
        // The rotation of the sphere takes the axes of `from` to those of this pointing.
        let (before, after) = (from.axes(), self.axes());
        let turned = |v: [f64; 3]| {
            let parts = before.map(|axis| dot(axis, v));
            [0, 1, 2].map(|i| (0..3).map(|k| parts[k] * after[k][i]).sum::<f64>())
        };
        let [at, _, north] = local_axes(ra, dec);
        let (ra, dec_new) = place(turned(at));
        let [_, east_there, north_there] = local_axes(ra, dec_new);
        let north = turned(north);
        let angle = dot(north, east_there).atan2(dot(north, north_there)).to_degrees();
        let default = if dec >= 90.0 { 0.0 } else { 180.0 };
        let pole = world.number("LONPOLE")?.unwrap_or(default) + angle;
        let mut header = detector.clone();
        let mut set = |keyword: String, value: f64, comment: &str| {
            let comment = detector
                .get(&keyword)
                .map_or(comment.to_owned(), Card::comment_text);
            header.set(Card::new(&keyword, value, &comment).expect("finite numbers make cards"));
        };
        set(
            format!("CRVAL{longitude}"),
            ra / ra_unit,
            "coordinate of the reference pixel",
        );
        set(
            format!("CRVAL{latitude}"),
            dec_new / dec_unit,
            "coordinate of the reference pixel",
        );
        let pole = 180.0 - (180.0 - pole).rem_euclid(360.0);
        set(
            "LONPOLE".to_owned(),
            pole,
            "[deg] native longitude of the celestial pole",
        );
        Ok(header)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SkyCoordinates;
    use psf_types::Position;

    fn detector() -> HeaderCards {
        let mut header = HeaderCards::new();
        let mut add = |keyword: &str, value: f64| header.push(Card::new(keyword, value, "").unwrap());
        for (keyword, value) in [
            ("CRPIX1", -400.0),
            ("CRPIX2", 700.0),
            ("CRVAL1", 0.0),
            ("CRVAL2", 0.0),
        ] {
            add(keyword, value);
        }
        for (keyword, value) in [
            ("CD1_1", -1e-4),
            ("CD1_2", 2e-6),
            ("CD2_1", 1e-6),
            ("CD2_2", 1.02e-4),
        ] {
            add(keyword, value);
        }
        for (keyword, value) in [("PV1_1", 1.0), ("PV1_7", 0.3), ("PV2_1", 1.0), ("PV2_7", -0.2)] {
            add(keyword, value);
        }
        for (keyword, value) in [("CTYPE1", "RA---TPV"), ("CTYPE2", "DEC--TPV")] {
            header.push(Card::new(keyword, value, "").unwrap());
        }
        header
    }

    /// A camera that moves and turns keeps the distances between the positions of its pixels.
    #[test]
    fn a_camera_turns_without_distortion() {
        let own = SkyCoordinates::from_header(&detector()).unwrap();
        let pixels = [(0.0, 0.0), (900.0, 10.0), (300.0, 800.0)].map(|(x, y)| Position::new(x, y).unwrap());
        let to = SkyPointing {
            ra_deg: 210.0,
            dec_deg: 55.0,
            rotation_deg: 33.0,
        };
        for to in [
            to,
            SkyPointing { dec_deg: 90.0, ..to },
            SkyPointing {
                dec_deg: -89.99,
                ra_deg: 0.0,
                ..to
            },
            SkyPointing {
                ra_deg: 359.999,
                dec_deg: 0.0,
                rotation_deg: -170.0,
            },
        ] {
            let header = to.header(&detector(), SkyPointing::OF_CAMERA).unwrap();
            let sky = SkyCoordinates::from_header(&header).unwrap();
            let (before, after) = (SkyPointing::OF_CAMERA.axes(), to.axes());
            for pixel in pixels {
                let vector = |sky: &SkyCoordinates| {
                    let (ra, dec) = sky.sky(pixel).unwrap();
                    local_axes(ra, dec)[0]
                };
                let (old, new) = (vector(&own), vector(&sky));
                for (a, b) in before.into_iter().zip(after) {
                    assert!((dot(a, old) - dot(b, new)).abs() < 1e-12, "{to:?}");
                }
            }
            // And back.
            let back = SkyPointing::OF_CAMERA.header(&header, to).unwrap();
            let back = SkyCoordinates::from_header(&back).unwrap();
            let (a, b) = (back.sky(pixels[1]).unwrap(), own.sky(pixels[1]).unwrap());
            assert!(
                (a.0 - b.0).abs() < 1e-9 && (a.1 - b.1).abs() < 1e-9,
                "{to:?}: {a:?} {b:?}"
            );
        }
    }

    #[test]
    fn rotation_is_from_north_towards_east() {
        let to = SkyPointing {
            ra_deg: 40.0,
            dec_deg: 10.0,
            rotation_deg: 90.0,
        };
        let header = to.header(&detector(), SkyPointing::OF_CAMERA).unwrap();
        let sky = SkyCoordinates::from_header(&header).unwrap();
        // The camera's north (+y) points east.
        let [low, high] = [0.0, 1000.0].map(|y| sky.sky(Position::new(-401.0, y).unwrap()).unwrap());
        assert!(
            high.0 > low.0 + 0.05 && (high.1 - low.1).abs() < 0.01,
            "{low:?} {high:?}"
        );
        let moved = to.moved_by_arcsec((-36.0, 72.0));
        assert!((moved.dec_deg - 10.02).abs() < 1e-5 && (moved.ra_deg - 40.0 + 0.010_15).abs() < 1e-4);
    }
}
