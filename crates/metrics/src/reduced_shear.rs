//! Ellipticity as reduced shear.

use serde::{Deserialize, Serialize};

use crate::{Distortion, MetricsError};

/// The reduced shear `(g1, g2)` of an ellipse with axes `a >= b` and position angle `phi`.
///
/// ```text
/// |g| = (a - b) / (a + b)      g1 = |g| cos 2 phi      g2 = |g| sin 2 phi
/// ```
///
/// Its length is below 1. `phi` runs from +x towards +y.
///
/// ```
/// use metrics::ReducedShear;
/// let g = ReducedShear::new(0.0, 0.5)?;
/// assert!((g.to_distortion().e2() - 0.8).abs() < 1e-15);
/// # Ok::<(), metrics::MetricsError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Components", into = "Components")]
pub struct ReducedShear {
    g1: f64,
    g2: f64,
}

#[derive(Serialize, Deserialize)]
struct Components {
    g1: f64,
    g2: f64,
}

impl ReducedShear {
    /// A reduced shear from its components.
    ///
    /// # Errors
    /// [`MetricsError::Ellipticity`] when its length is not below 1.
    pub fn new(g1: f64, g2: f64) -> Result<Self, MetricsError> {
        if g1.hypot(g2) < 1.0 {
            Ok(Self { g1, g2 })
        } else {
            Err(MetricsError::Ellipticity {
                first: g1,
                second: g2,
            })
        }
    }

    /// Component along the axes of the grid.
    pub fn g1(self) -> f64 {
        self.g1
    }

    /// Component along the diagonals of the grid.
    pub fn g2(self) -> f64 {
        self.g2
    }

    /// The length `(a - b) / (a + b)`.
    pub fn length(self) -> f64 {
        self.g1.hypot(self.g2)
    }

    /// The same ellipse as distortion: `e = 2 g / (1 + |g|^2)`.
    pub fn to_distortion(self) -> Distortion {
        let length = self.length();
        let scale = 2.0 / (1.0 + length * length);
        Distortion::from_reduced_shear(self.g1 * scale, self.g2 * scale)
    }

    pub(crate) fn from_distortion(g1: f64, g2: f64) -> Self {
        let (g1, g2) = below_one(g1, g2);
        Self { g1, g2 }
    }
}

/// Pulls a vector that rounding put on the unit circle back inside it.
pub(crate) fn below_one(first: f64, second: f64) -> (f64, f64) {
    let (mut first, mut second) = (first, second);
    while first.hypot(second) >= 1.0 {
        first *= 1.0 - f64::EPSILON;
        second *= 1.0 - f64::EPSILON;
    }
    (first, second)
}

impl TryFrom<Components> for ReducedShear {
    type Error = MetricsError;
    fn try_from(c: Components) -> Result<Self, MetricsError> {
        Self::new(c.g1, c.g2)
    }
}

impl From<ReducedShear> for Components {
    fn from(g: ReducedShear) -> Self {
        Self { g1: g.g1, g2: g.g2 }
    }
}
