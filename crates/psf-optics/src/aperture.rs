//! The pupil's shape.

use crate::error::require;
use crate::{ApertureParams, OpticsError};

/// A disc with a central obscuration and vanes, in units of its radius.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Aperture {
    obscuration: f64,
    spider: Option<Spider>,
}

#[derive(Debug, Clone, Copy)]
struct Spider {
    vanes: usize,
    half_width: f64,
    angle_rad: f64,
}

impl Aperture {
    pub(crate) fn new(params: &ApertureParams) -> Result<Self, OpticsError> {
        let d = params.diameter_m;
        require("aperture.diameter_m", "a number of metres above 0", d, d > 0.0)?;
        let r = params.obscuration;
        require(
            "aperture.obscuration",
            "a ratio of diameters, 0 <= ratio < 1",
            r,
            (0.0..1.0).contains(&r),
        )?;
        let spider = params.spider.map(|s| {
            if !(1..=64).contains(&s.vanes) {
                return Err(OpticsError::setting(
                    "aperture.spider.vanes",
                    "from 1 to 64",
                    s.vanes,
                ));
            }
            let allowed = "a number of metres above 0 and below the diameter";
            require(
                "aperture.spider.width_m",
                allowed,
                s.width_m,
                s.width_m > 0.0 && s.width_m < d,
            )?;
            require(
                "aperture.spider.angle_deg",
                "a finite number of degrees",
                s.angle_deg,
                true,
            )?;
            Ok(Spider {
                vanes: s.vanes,
                half_width: s.width_m / d,
                angle_rad: s.angle_deg.to_radians(),
            })
        });
        Ok(Self {
            obscuration: r,
            spider: spider.transpose()?,
        })
    }

    /// Whether light passes at (`x`, `y`).
    pub(crate) fn is_lit(&self, x: f64, y: f64) -> bool {
        let rho2 = x * x + y * y;
        let in_ring = rho2 <= 1.0 && rho2 >= self.obscuration * self.obscuration;
        in_ring
            && !self
                .vanes(x, y)
                .any(|(along, across, half)| along >= 0.0 && across.abs() < half)
    }

    /// Whether an edge may pass within `distance` of (`x`, `y`).
    pub(crate) fn is_near_edge(&self, x: f64, y: f64, distance: f64) -> bool {
        let rho = x.hypot(y);
        (rho - 1.0).abs() <= distance
            || (self.obscuration > 0.0 && (rho - self.obscuration).abs() <= distance)
            || self.vanes(x, y).any(|(along, across, half)| {
                let beside = along >= -distance && (across.abs() - half).abs() <= distance;
                let at_start = along.abs() <= distance && across.abs() <= half + distance;
                beside || at_start
            })
    }

    /// For each vane: coordinates along and across it, and its half width.
    fn vanes(&self, x: f64, y: f64) -> impl Iterator<Item = (f64, f64, f64)> {
        self.spider.into_iter().flat_map(move |s| {
            (0..s.vanes).map(move |i| {
                let (sin, cos) = (s.angle_rad + std::f64::consts::TAU * i as f64 / s.vanes as f64).sin_cos();
                (x * cos + y * sin, y * cos - x * sin, s.half_width)
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SpiderParams;

    #[test]
    fn ring_and_vanes() {
        let params = ApertureParams {
            diameter_m: 2.0,
            obscuration: 0.5,
            spider: Some(SpiderParams {
                vanes: 3,
                width_m: 0.1,
                angle_deg: 90.0,
            }),
        };
        let aperture = Aperture::new(&params).unwrap();
        assert!(aperture.is_lit(0.8, 0.0), "no vane to the right");
        assert!(
            !aperture.is_lit(0.04, 0.8) && aperture.is_lit(0.06, 0.8),
            "one upwards, 0.05 to each side"
        );
        assert!(aperture.is_lit(0.0, -0.8), "none downwards");
        let (sin, cos) = 210f64.to_radians().sin_cos();
        assert!(!aperture.is_lit(0.8 * cos, 0.8 * sin));
        assert!(!aperture.is_lit(0.3, -0.3) && !aperture.is_lit(0.8, -0.7));
        assert!(aperture.is_near_edge(0.0, -0.52, 0.03) && !aperture.is_near_edge(0.0, -0.75, 0.03));
    }
}
