//! Frame shapes and rectangles of pixels.

use serde::{Deserialize, Serialize};

use crate::{DataError, Position};

/// The shape of a frame (detector, field of view): `nx` columns by `ny` rows, both at least 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "RawFrameShape", into = "RawFrameShape")]
pub struct FrameShape {
    nx: usize,
    ny: usize,
}

#[derive(Serialize, Deserialize)]
struct RawFrameShape {
    nx: usize,
    ny: usize,
}

impl FrameShape {
    /// A frame of `nx` columns and `ny` rows.
    ///
    /// # Errors
    /// [`DataError::EmptyFrame`] when either is 0, [`DataError::FrameTooLarge`] when the pixels cannot be counted.
    pub fn new(nx: usize, ny: usize) -> Result<Self, DataError> {
        if nx == 0 || ny == 0 {
            return Err(DataError::EmptyFrame { nx, ny });
        }
        match nx.checked_mul(ny) {
            Some(pixels) if pixels <= isize::MAX as usize / 16 => Ok(Self { nx, ny }),
            _ => Err(DataError::FrameTooLarge { nx, ny }),
        }
    }

    /// Number of columns.
    pub fn nx(self) -> usize {
        self.nx
    }

    /// Number of rows.
    pub fn ny(self) -> usize {
        self.ny
    }

    /// Number of pixels.
    pub fn pixel_count(self) -> usize {
        self.nx * self.ny
    }

    /// Whether `position` lies on a pixel of the frame: `-0.5 <= x <= nx - 0.5`, likewise for y.
    pub fn contains(self, position: Position) -> bool {
        let inside = |v: f64, n: usize| (-0.5..=n as f64 - 0.5).contains(&v);
        inside(position.x(), self.nx) && inside(position.y(), self.ny)
    }

    /// The whole frame as a region.
    pub fn region(self) -> PixelRegion {
        PixelRegion {
            x0: 0,
            y0: 0,
            shape: self,
        }
    }
}

impl std::fmt::Display for FrameShape {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} x {}", self.nx, self.ny)
    }
}

impl TryFrom<RawFrameShape> for FrameShape {
    type Error = DataError;
    fn try_from(raw: RawFrameShape) -> Result<Self, DataError> {
        Self::new(raw.nx, raw.ny)
    }
}

impl From<FrameShape> for RawFrameShape {
    fn from(shape: FrameShape) -> Self {
        Self {
            nx: shape.nx,
            ny: shape.ny,
        }
    }
}

/// A rectangle of pixels: columns `x0 .. x0 + nx` and rows `y0 .. y0 + ny`, never empty.
///
/// The origin may be negative: a scene may reach beyond the frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct PixelRegion {
    x0: i64,
    y0: i64,
    shape: FrameShape,
}

impl PixelRegion {
    /// The rectangle whose first pixel is (`x0`, `y0`).
    pub fn new(x0: i64, y0: i64, shape: FrameShape) -> Self {
        Self { x0, y0, shape }
    }

    /// First column.
    pub fn x0(self) -> i64 {
        self.x0
    }

    /// First row.
    pub fn y0(self) -> i64 {
        self.y0
    }

    /// Number of columns and rows.
    pub fn shape(self) -> FrameShape {
        self.shape
    }

    /// The same rectangle moved by (`dx`, `dy`) pixels.
    #[must_use]
    pub fn shifted(self, dx: i64, dy: i64) -> Self {
        Self {
            x0: self.x0 + dx,
            y0: self.y0 + dy,
            shape: self.shape,
        }
    }

    /// Whether all pixels of `other` are pixels of this region.
    pub fn contains(self, other: Self) -> bool {
        let within = |first: i64, count: usize, whole: i64, limit: usize| {
            first >= whole && i128::from(first) + count as i128 <= i128::from(whole) + limit as i128
        };
        within(other.x0, other.shape.nx, self.x0, self.shape.nx)
            && within(other.y0, other.shape.ny, self.y0, self.shape.ny)
    }

    /// The position of the pixel `column`, `row` counted from the region's first pixel.
    pub fn position(self, column: usize, row: usize) -> Position {
        Position::of_pixel(self.x0 + column as i64, self.y0 + row as i64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_contains_the_whole_area_of_its_pixels() {
        let frame = FrameShape::new(4, 3).unwrap();
        let inside = |x, y| frame.contains(Position::new(x, y).unwrap());
        assert!(inside(-0.5, -0.5) && inside(3.5, 2.5) && inside(0.0, 2.0));
        assert!(!inside(-0.51, 0.0) && !inside(0.0, 2.51) && !inside(3.6, 0.0));
    }

    #[test]
    fn a_region_contains_the_regions_within_its_edges() {
        let region = |x0, y0, nx, ny| PixelRegion::new(x0, y0, FrameShape::new(nx, ny).unwrap());
        let whole = region(-3, 2, 10, 8);
        for inside in [whole, region(-3, 2, 1, 1), region(6, 9, 1, 1), region(0, 3, 7, 7)] {
            assert!(whole.contains(inside), "{inside:?}");
        }
        for beyond in [
            region(-4, 2, 4, 4),
            region(-3, 1, 4, 4),
            region(6, 9, 2, 1),
            region(6, 9, 1, 2),
            region(i64::MAX, 2, 1, 1),
            region(i64::MIN, 2, 1, 1),
        ] {
            assert!(!whole.contains(beyond), "{beyond:?}");
        }
    }

    #[test]
    fn no_file_brings_in_an_empty_frame() {
        assert!(serde_json::from_str::<FrameShape>(r#"{"nx":0,"ny":3}"#).is_err());
        let frame: FrameShape = serde_json::from_str(r#"{"nx":2,"ny":3}"#).unwrap();
        assert_eq!((frame.nx(), frame.ny()), (2, 3));
    }
}
