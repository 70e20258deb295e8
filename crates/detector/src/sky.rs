//! The sky.

use psf_types::FrameShape;

use crate::error::{at_least_zero, require};
use crate::{DetectorError, DetectorParams, SkyGradient};

/// A sky that is constant or rises along a direction: `level + gx (x - (nx - 1) / 2) + gy (y - (ny - 1) / 2)` electrons.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sky {
    level_e: f64,
    gradient: SkyGradient,
}

impl Sky {
    pub(crate) fn new(params: &DetectorParams) -> Result<Self, DetectorError> {
        let gradient = params.sky_gradient_e_per_px.unwrap_or_default();
        require("sky_gradient_e_per_px.x", "a finite number", gradient.x, |_| true)?;
        require("sky_gradient_e_per_px.y", "a finite number", gradient.y, |_| true)?;
        Ok(Self {
            level_e: at_least_zero("sky_e", params.sky_e)?,
            gradient,
        })
    }

    /// The sky over a frame, nowhere negative.
    pub(crate) fn over(self, frame: FrameShape) -> Result<FrameSky, DetectorError> {
        let middle = |n: usize| (n - 1) as f64 / 2.0;
        let sky = FrameSky {
            at_origin_e: self.level_e
                - self.gradient.x * middle(frame.nx())
                - self.gradient.y * middle(frame.ny()),
            gradient: self.gradient,
        };
        let lowest = |slope: f64, n: usize| if slope < 0.0 { n - 1 } else { 0 };
        let (x, y) = (
            lowest(self.gradient.x, frame.nx()),
            lowest(self.gradient.y, frame.ny()),
        );
        let lowest_e = sky.at(x, y);
        // A sky that just reaches 0 may be off by rounding.
        if lowest_e < -1e-9 * self.level_e || !lowest_e.is_finite() {
            return Err(DetectorError::NegativeSky {
                lowest_e,
                index: [y, x],
            });
        }
        Ok(sky)
    }
}

/// The sky over a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FrameSky {
    at_origin_e: f64,
    gradient: SkyGradient,
}

impl FrameSky {
    /// Electrons in a pixel.
    pub(crate) fn at(&self, x: usize, y: usize) -> f64 {
        self.at_origin_e + self.gradient.x * x as f64 + self.gradient.y * y as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sky(level: f64, x: f64, y: f64) -> Sky {
        Sky::new(&DetectorParams {
            sky_e: level,
            sky_gradient_e_per_px: Some(SkyGradient { x, y }),
            ..DetectorParams::default()
        })
        .unwrap()
    }

    #[test]
    fn the_level_is_that_of_the_middle() {
        let sky = sky(100.0, 2.0, -0.5)
            .over(FrameShape::new(11, 21).unwrap())
            .unwrap();
        assert_eq!(sky.at(5, 10), 100.0);
        assert_eq!(sky.at(6, 10), 102.0);
        assert_eq!(sky.at(5, 12), 99.0);
        assert_eq!(sky.at(0, 20), 85.0);
    }

    #[test]
    fn a_sky_below_zero_is_refused_with_its_corner() {
        let frame = FrameShape::new(11, 21).unwrap();
        assert!(sky(15.0, 2.0, -0.5).over(frame).is_ok());
        match sky(14.0, 2.0, -0.5).over(frame) {
            Err(DetectorError::NegativeSky { lowest_e, index }) => {
                assert_eq!((lowest_e, index), (-1.0, [20, 0]));
            }
            other => panic!("{other:?}"),
        }
    }
}
