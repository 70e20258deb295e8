//! The frame within the light, and the reach of stamps.

use std::ops::Range;

use ndarray::{ArrayView2, s};
use psf_types::{DataError, FrameShape, ImageView, PixelRegion, Real, StampGrid};

use crate::ConvError;

/// A stamp's extent around its central pixel: `left` columns to the left, `right` to the right,
/// `below` rows at smaller row indices and `above` rows at larger ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Reach {
    pub(crate) left: usize,
    pub(crate) right: usize,
    pub(crate) below: usize,
    pub(crate) above: usize,
}

impl Reach {
    /// Returns the reach of the stamps on a grid. Fails unless they can convolve an image: they
    /// must be at the frame's scale and centred on a pixel, and include the pixel response.
    pub(crate) fn of(grid: StampGrid) -> Result<Self, ConvError> {
        if grid.oversampling() != 1.0 {
            return Err(ConvError::StampScale {
                oversampling: grid.oversampling(),
            });
        }
        if !grid.pixel_response_included() {
            return Err(ConvError::PixelResponse);
        }
        let (cx, cy) = grid.whole_centre().ok_or(ConvError::StampCentre {
            x: grid.centre_x(),
            y: grid.centre_y(),
        })?;
        Ok(Self {
            left: cx,
            right: grid.nx() - 1 - cx,
            below: cy,
            above: grid.ny() - 1 - cy,
        })
    }

    /// The reach of the stamps turned by 180 degrees.
    pub(crate) fn turned(self) -> Self {
        Self {
            left: self.right,
            right: self.left,
            below: self.above,
            above: self.below,
        }
    }
}

/// The shape of the light, and the frame: the part of the light that the image shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct View {
    pub(crate) shape: FrameShape,
    /// The frame, in pixels of the light. The frame's first pixel is the origin of field positions.
    pub(crate) frame: PixelRegion,
}

impl View {
    /// Checks that the frame lies within the light.
    pub(crate) fn new(shape: FrameShape, frame: PixelRegion) -> Result<Self, ConvError> {
        if shape.region().contains(frame) {
            return Ok(Self { shape, frame });
        }
        Err(ConvError::Frame(DataError::FrameOutsideScene {
            x0: frame.x0(),
            y0: frame.y0(),
            shape: frame.shape(),
            scene: shape,
        }))
    }

    /// The region of all light, in field positions. It begins at `(-x0, -y0)` if the frame begins
    /// at pixel `(x0, y0)` of the light.
    pub(crate) fn field_region(self) -> PixelRegion {
        PixelRegion::new(-self.frame.x0(), -self.frame.y0(), self.shape)
    }

    /// Column and row of the frame's first pixel in the light.
    pub(crate) fn first_pixel(self) -> (usize, usize) {
        (self.frame.x0() as usize, self.frame.y0() as usize)
    }

    /// The columns and rows of the light that can reach `part`, a region of the light such as the
    /// frame. Light that is farther away than the stamps reach is left out.
    pub(crate) fn reaching(self, part: PixelRegion, reach: Reach) -> [Range<usize>; 2] {
        // Along x: pixel p gets light from pixel p - u through the stamp's offset u, which runs
        // from -left to right. So light comes from up to `right` pixels before p and `left` pixels
        // after p. Along y, `above` and `below` take these places.
        let range = |first: i64, length: usize, before: usize, after: usize, limit: usize| {
            let first = first as usize;
            first.saturating_sub(before)..(first + length + after).min(limit)
        };
        let (part_shape, shape) = (part.shape(), self.shape);
        [
            range(part.x0(), part_shape.nx(), reach.right, reach.left, shape.nx()),
            range(part.y0(), part_shape.ny(), reach.above, reach.below, shape.ny()),
        ]
    }

    /// Truncates light to the frame and a margin as wide as the stamps reach. Returns the view of
    /// the truncated light, this light, and the reach. Light beyond the margin falls on no pixel of
    /// the frame, so its PSF is never evaluated.
    pub(crate) fn within_reach<'a, T: Real>(
        light: &'a ImageView<'_, T>,
        frame: PixelRegion,
        grid: StampGrid,
    ) -> Result<(Self, ArrayView2<'a, T>, Reach), ConvError> {
        let whole = Self::new(light.shape(), frame)?;
        let reach = Reach::of(grid)?;
        let [columns, rows] = whole.reaching(frame, reach);
        let cut = Self {
            shape: FrameShape::new(columns.len(), rows.len())
                .expect("the truncated light contains the frame"),
            frame: frame.shifted(-(columns.start as i64), -(rows.start as i64)),
        };
        Ok((cut, light.pixels().slice_move(s![rows, columns]), reach))
    }
}

/// The region of `nx x ny` pixels from pixel `(x0, y0)` on.
///
/// # Panics
/// If there are no pixels.
pub(crate) fn region(x0: i64, y0: i64, (nx, ny): (usize, usize)) -> PixelRegion {
    let shape = FrameShape::new(nx, ny).expect("regions are not empty");
    PixelRegion::new(x0, y0, shape)
}

pub(crate) fn in_words(region: PixelRegion) -> String {
    format!("{} at ({}, {})", region.shape(), region.x0(), region.y0())
}
