//! Positions on the frame.

use serde::{Deserialize, Serialize};

use crate::DataError;

/// A position in pixels of the frame: 0-based, an integer is the centre of a pixel.
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

    /// The centre of the pixel in column `column` and row `row` (negative left of or below the frame).
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
