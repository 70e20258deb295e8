//! Positions on the frame, frame shapes, rectangles of pixels, and the errors of invalid data.

use serde::{Deserialize, Serialize};

use thiserror::Error;

/// Makes serde build a type through its constructor, so that files obey the constructor's checks.
/// The error type is [`DataError`] if none is given.
#[doc(hidden)]
#[macro_export]
macro_rules! read_through_new {
    ($raw:ident => $checked:ident { $($fields:tt)+ }) => {
        $crate::read_through_new!($raw => $checked, $crate::DataError { $($fields)+ });
    };
    ($raw:ident => $checked:ident, $error:ty { $($field:ident: $kind:ty),+ }) => {
        #[derive(serde::Deserialize)]
        struct $raw {
            $($field: $kind),+
        }

        impl TryFrom<$raw> for $checked {
            type Error = $error;
            fn try_from(raw: $raw) -> Result<Self, $error> {
                Self::new($(raw.$field),+)
            }
        }
    };
}
pub(crate) use crate::read_through_new;

/// A position in pixels of the frame. Coordinates are 0-based, and an integer is the centre of a
/// pixel.
///
/// Both coordinates are finite. Positions may lie between pixels and outside the frame.
///
/// ```
/// use psf_types::Position;
/// let p = Position::new(10.5, -3.0)?;
/// assert_eq!((p.x(), p.y()), (10.5, -3.0));
/// assert!(Position::new(f64::NAN, 0.0).is_err());
/// # Ok::<(), psf_types::DataError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "(f64, f64)", into = "(f64, f64)")]
pub struct Position {
    x: f64,
    y: f64,
}

impl Position {
    /// A position from its coordinates in pixels.
    ///
    /// # Errors
    /// [`DataError::NonFinitePosition`] when a coordinate is NaN or infinite.
    pub fn new(x: f64, y: f64) -> Result<Self, DataError> {
        if x.is_finite() && y.is_finite() {
            Ok(Self { x, y })
        } else {
            Err(DataError::NonFinitePosition { x, y })
        }
    }

    /// The centre of the pixel in column `column` and row `row`. Columns left of the frame and rows
    /// below the frame are negative.
    pub fn of_pixel(column: i64, row: i64) -> Self {
        Self {
            x: column as f64,
            y: row as f64,
        }
    }

    /// Column coordinate in pixels.
    pub fn x(self) -> f64 {
        self.x
    }

    /// Row coordinate in pixels.
    pub fn y(self) -> f64 {
        self.y
    }

    /// The bits of both coordinates, to look positions up. Equal positions have equal bits.
    pub fn bits(self) -> [u64; 2] {
        // Adding 0.0 turns -0.0 into 0.0.
        [(self.x + 0.0).to_bits(), (self.y + 0.0).to_bits()]
    }

    /// The point half way to `other`.
    #[must_use]
    pub fn midpoint(self, other: Self) -> Self {
        Self {
            x: f64::midpoint(self.x, other.x),
            y: f64::midpoint(self.y, other.y),
        }
    }

    /// Euclidean distance to `other` in pixels.
    pub fn distance(self, other: Self) -> f64 {
        (self.x - other.x).hypot(self.y - other.y)
    }

    /// The smallest and the largest coordinate of some positions, for x and for y. Without
    /// positions they are plus and minus infinity.
    ///
    /// ```
    /// use psf_types::Position;
    /// let positions = [Position::of_pixel(3, -1), Position::of_pixel(0, 7)];
    /// assert_eq!(Position::bounds(&positions), [(0.0, 3.0), (-1.0, 7.0)]);
    /// ```
    pub fn bounds(positions: &[Self]) -> [(f64, f64); 2] {
        [Self::x, Self::y].map(|of: fn(Self) -> f64| {
            let coordinates = positions.iter().map(|&position| of(position));
            coordinates.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
                (low.min(v), high.max(v))
            })
        })
    }
}

impl std::fmt::Display for Position {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "({}, {})", self.x, self.y)
    }
}

impl TryFrom<(f64, f64)> for Position {
    type Error = DataError;
    fn try_from((x, y): (f64, f64)) -> Result<Self, DataError> {
        Self::new(x, y)
    }
}

impl From<Position> for (f64, f64) {
    fn from(p: Position) -> Self {
        (p.x, p.y)
    }
}

/// The shape of a frame (detector, field of view): `nx` columns by `ny` rows, both at least 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "RawFrameShape")]
pub struct FrameShape {
    nx: usize,
    ny: usize,
}

read_through_new!(RawFrameShape => FrameShape { nx: usize, ny: usize });

/// The largest number of pixels of a frame: with 16 bytes per pixel, they fit the address space.
const MAX_PIXELS: usize = isize::MAX as usize / 16;

impl FrameShape {
    /// A frame of `nx` columns and `ny` rows.
    ///
    /// # Errors
    /// [`DataError::EmptyFrame`] when `nx` or `ny` is 0, [`DataError::FrameTooLarge`] when the
    /// frame has too many pixels for the address space.
    pub fn new(nx: usize, ny: usize) -> Result<Self, DataError> {
        if nx == 0 || ny == 0 {
            return Err(DataError::EmptyFrame { nx, ny });
        }
        match nx.checked_mul(ny) {
            Some(pixels) if pixels <= MAX_PIXELS => Ok(Self { nx, ny }),
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

    /// Returns whether `position` lies on a pixel of the frame: `-0.5 <= x <= nx - 0.5`, likewise
    /// for y.
    pub fn contains(self, position: Position) -> bool {
        let inside = |v: f64, n: usize| (-0.5..=n as f64 - 0.5).contains(&v);
        inside(position.x(), self.nx) && inside(position.y(), self.ny)
    }

    /// Returns whether `position` lies on the frame or at most one pixel outside it. Grids of PSFs
    /// may begin or end just off the frame, for example at 0 in pixels that count from 1.
    pub fn is_near(self, position: Position) -> bool {
        let near = |v: f64, n: usize| (-1.5..=n as f64 + 0.5).contains(&v);
        near(position.x(), self.nx) && near(position.y(), self.ny)
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

/// A rectangle of pixels: columns `x0 .. x0 + nx` and rows `y0 .. y0 + ny`, never empty.
///
/// `x0` and `y0` may be negative, because a scene may extend beyond the frame.
///
/// Serde reads and writes `(x0, y0, nx, ny)`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "(i64, i64, usize, usize)", into = "(i64, i64, usize, usize)")]
pub struct PixelRegion {
    x0: i64,
    y0: i64,
    shape: FrameShape,
}

impl TryFrom<(i64, i64, usize, usize)> for PixelRegion {
    type Error = DataError;
    fn try_from((x0, y0, nx, ny): (i64, i64, usize, usize)) -> Result<Self, DataError> {
        Ok(Self::new(x0, y0, FrameShape::new(nx, ny)?))
    }
}

impl From<PixelRegion> for (i64, i64, usize, usize) {
    fn from(region: PixelRegion) -> Self {
        (region.x0, region.y0, region.shape.nx, region.shape.ny)
    }
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

    /// Returns this rectangle moved by (`dx`, `dy`) pixels.
    #[must_use]
    pub fn shifted(self, dx: i64, dy: i64) -> Self {
        Self {
            x0: self.x0 + dx,
            y0: self.y0 + dy,
            shape: self.shape,
        }
    }

    /// Returns whether all pixels of `other` are pixels of this region.
    pub fn contains(self, other: Self) -> bool {
        let within = |first: i64, count: usize, whole: i64, limit: usize| {
            first >= whole && i128::from(first) + count as i128 <= i128::from(whole) + limit as i128
        };
        within(other.x0, other.shape.nx, self.x0, self.shape.nx)
            && within(other.y0, other.shape.ny, self.y0, self.shape.ny)
    }

    /// The position of a pixel of the region. `column` and `row` count from the region's first
    /// pixel. The position has the same origin as `x0` and `y0`.
    pub fn position(self, column: usize, row: usize) -> Position {
        Position::of_pixel(self.x0 + column as i64, self.y0 + row as i64)
    }
}

/// The kind of a value that an error reports. Its text form names the axes of the value's index.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Quantity {
    /// A pixel of an image `[y, x]`.
    Pixel,
    /// A value of a stamp `[y, x]`.
    StampValue,
    /// A value of a stack of PSF samples `[sample, y, x]`.
    SampleValue,
    /// A value of the mean stamp `[y, x]`.
    MeanValue,
    /// A value of the basis stamps `[component, y, x]`.
    BasisValue,
    /// A coefficient `[sample, component]`.
    Coefficient,
}

impl std::fmt::Display for Quantity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Pixel => "pixel [y, x]",
            Self::StampValue => "stamp value [y, x]",
            Self::SampleValue => "PSF sample value [sample, y, x]",
            Self::MeanValue => "mean stamp value [y, x]",
            Self::BasisValue => "basis value [component, y, x]",
            Self::Coefficient => "coefficient [sample, component]",
        })
    }
}

/// Numbers with more characters are written with an exponent.
const LONGEST_NUMBER: usize = 24;

impl DataError {
    /// Makes a [`DataError::Setting`] for a value that is not allowed.
    pub fn setting(name: &'static str, allowed: &'static str, got: impl std::fmt::Display) -> Self {
        let mut got = got.to_string();
        // Very large and very small numbers are shorter with an exponent.
        if got.len() > LONGEST_NUMBER
            && let Ok(number) = got.parse::<f64>()
        {
            got = format!("{number:e}");
        }
        Self::Setting { name, allowed, got }
    }

    /// Checks that `got` equals `expected`. `what` describes the counted things.
    ///
    /// # Errors
    /// [`DataError::CountMismatch`].
    pub fn check_count(what: &'static str, expected: usize, got: usize) -> Result<(), Self> {
        if got == expected {
            return Ok(());
        }
        Err(Self::CountMismatch { what, expected, got })
    }
}

/// Data that breaks an invariant of its type. Indices are 0-based.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum DataError {
    /// A coordinate that is NaN or infinite.
    #[error("position ({x}, {y}) is not finite")]
    NonFinitePosition {
        /// Column coordinate.
        x: f64,
        /// Row coordinate.
        y: f64,
    },
    /// A frame without pixels.
    #[error("a frame of {nx} x {ny} pixels is empty")]
    EmptyFrame {
        /// Columns.
        nx: usize,
        /// Rows.
        ny: usize,
    },
    /// A frame too large for memory.
    #[error(
        "a frame of {nx} x {ny} pixels is too large for memory: at most {MAX_PIXELS} pixels are possible"
    )]
    FrameTooLarge {
        /// Columns.
        nx: usize,
        /// Rows.
        ny: usize,
    },
    /// A stamp without pixels.
    #[error("a stamp of {nx} x {ny} pixels is empty")]
    EmptyStamp {
        /// Columns.
        nx: usize,
        /// Rows.
        ny: usize,
    },
    /// A stamp centre outside the stamp.
    #[error("the stamp centre ({x}, {y}) (0-based) lies outside the stamp of {nx} x {ny} pixels")]
    StampCentre {
        /// Column index.
        x: f64,
        /// Row index.
        y: f64,
        /// Columns of the stamp.
        nx: usize,
        /// Rows of the stamp.
        ny: usize,
    },
    /// An oversampling that is not a positive number.
    #[error("oversampling must be finite and above 0, got {got}")]
    Oversampling {
        /// The value given.
        got: f64,
    },
    /// An array whose last two axes differ from the grid's shape.
    #[error("the stamp array has the shape {got:?} [y, x], but its grid has {expected:?}")]
    StampShape {
        /// Shape of the grid.
        expected: (usize, usize),
        /// Shape of the array.
        got: (usize, usize),
    },
    /// An image of the wrong shape.
    #[error("the image has the shape {got:?} [y, x], but {expected:?} is needed")]
    ImageShape {
        /// Shape needed.
        expected: (usize, usize),
        /// Shape of the array.
        got: (usize, usize),
    },
    /// NaN or infinity among the values.
    #[error("{quantity} = {index:?} is {value}, but it must be a finite number (indices are 0-based)")]
    NonFinite {
        /// The kind of the value.
        quantity: Quantity,
        /// Index of the value, 0-based, along the axes that `quantity` names.
        index: Vec<usize>,
        /// NaN or an infinity.
        value: f64,
    },
    /// A number of things, such as rows or coefficients, that differs from the number needed.
    #[error("{what}: expected {expected}, got {got}")]
    CountMismatch {
        /// A description of the counted things.
        what: &'static str,
        /// The number expected.
        expected: usize,
        /// The number found.
        got: usize,
    },
    /// No samples at all.
    #[error("there are no samples: at least one is needed")]
    NoSamples,
    /// Two samples at one position.
    #[error(
        "samples {first} and {second} (0-based) share the position {position}: remove one, or average them"
    )]
    DuplicatePosition {
        /// The earlier of the two.
        first: usize,
        /// The later one.
        second: usize,
        /// Their position.
        position: Position,
    },
    /// Two samples of one state, such as a wavelength, at one position.
    #[error(
        "samples {first} and {second} (0-based) share the position {position} and the {state}: remove one, or average them"
    )]
    DuplicateState {
        /// The earlier of the two.
        first: usize,
        /// The later one.
        second: usize,
        /// Their position.
        position: Position,
        /// Their state, such as "wavelength 0.5 um".
        state: String,
    },
    /// A sample more than one pixel outside the field.
    #[error(
        "sample {sample} (0-based) at {position} lies outside the field of {field} pixels (the centre of the first pixel is at (0, 0))"
    )]
    OutsideField {
        /// Index of the sample.
        sample: usize,
        /// Its position.
        position: Position,
        /// The field.
        field: FrameShape,
    },
    /// A PSF without positive flux.
    #[error("PSF sample {sample} (0-based) has flux {flux}: a PSF must have positive flux")]
    NonPositiveFlux {
        /// Index of the sample.
        sample: usize,
        /// Its flux.
        flux: f64,
    },
    /// A basis without stamps.
    #[error("a basis needs a mean stamp or at least one component")]
    EmptyBasis,
    /// Basis stamps that are not orthonormal.
    #[error(
        "basis components {first} and {second} (0-based) have the inner product {product}, but orthonormal components have {expected} within {tolerance:e}"
    )]
    NotOrthonormal {
        /// First component.
        first: usize,
        /// Second component.
        second: usize,
        /// Their inner product.
        product: f64,
        /// 1 on the diagonal, else 0.
        expected: f64,
        /// The tolerance applied.
        tolerance: f64,
    },
    /// Wings that cannot be added to a core.
    #[error(
        "the wings of the PSF do not fit its core: their stamps must have the sampling of the core's stamps and the same centre, and be at least as large"
    )]
    WingsDoNotFit,
    /// A star or galaxy whose flux is NaN or infinite.
    #[error("the source at {position} has flux {flux}, but it must be a finite number")]
    SourceFlux {
        /// Its position.
        position: Position,
        /// Its flux.
        flux: f64,
    },
    /// A galaxy whose profile has a parameter out of range.
    #[error("{parameter} must be {allowed}, got {got}")]
    Galaxy {
        /// The parameter.
        parameter: &'static str,
        /// The allowed range, in words.
        allowed: &'static str,
        /// The given value.
        got: f64,
    },
    /// A frame that extends beyond the scene.
    #[error("the frame (first pixel {x0}, {y0}; {shape} pixels) reaches beyond the scene of {scene} pixels")]
    FrameOutsideScene {
        /// First column.
        x0: i64,
        /// First row.
        y0: i64,
        /// Shape of the frame.
        shape: FrameShape,
        /// Shape of the scene.
        scene: FrameShape,
    },
    /// A setting that is out of range.
    #[error("{name} must be {allowed}, got {got}")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// The allowed values, in words.
        allowed: &'static str,
        /// The given value.
        got: String,
    },
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
