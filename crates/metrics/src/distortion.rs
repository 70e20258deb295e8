//! Ellipticity as distortion.

use serde::{Deserialize, Serialize};

use crate::{MetricsError, ReducedShear};

/// The distortion `(e1, e2)` of an ellipse with axes `a >= b` and position angle `phi`.
///
/// ```text
/// |e| = (a^2 - b^2) / (a^2 + b^2)      e1 = |e| cos 2 phi      e2 = |e| sin 2 phi
/// ```
///
/// In second moments `e1 = (Mxx - Myy) / (Mxx + Myy)` and `e2 = 2 Mxy / (Mxx + Myy)` (Bernstein & Jarvis 2002, AJ 123,
/// 583). Its length is below 1. `phi` runs from +x towards +y.
///
/// ```
/// use metrics::Distortion;
/// let e = Distortion::new(0.6, 0.0)?;
/// assert!((e.to_reduced_shear().g1() - 1.0 / 3.0).abs() < 1e-15);
/// # Ok::<(), metrics::MetricsError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Components", into = "Components")]
pub struct Distortion {
    e1: f64,
    e2: f64,
}

#[derive(Serialize, Deserialize)]
struct Components {
    e1: f64,
    e2: f64,
}

impl Distortion {
    /// A distortion from its components.
    ///
    /// # Errors
    /// [`MetricsError::Ellipticity`] when its length is not below 1.
    pub fn new(e1: f64, e2: f64) -> Result<Self, MetricsError> {
        if e1.hypot(e2) < 1.0 {
            Ok(Self { e1, e2 })
        } else {
            Err(MetricsError::Ellipticity {
                first: e1,
                second: e2,
            })
        }
    }

    /// Component along the axes of the grid.
    pub fn e1(self) -> f64 {
        self.e1
    }

    /// Component along the diagonals of the grid.
    pub fn e2(self) -> f64 {
        self.e2
    }

    /// The length `(a^2 - b^2) / (a^2 + b^2)`.
    pub fn length(self) -> f64 {
        self.e1.hypot(self.e2)
    }

    /// The same ellipse as reduced shear: `g = e / (1 + sqrt(1 - |e|^2))`.
    pub fn to_reduced_shear(self) -> ReducedShear {
        let length = self.length();
        // (1 - e)(1 + e) keeps its digits near 1, where 1 - e^2 would lose them.
        let scale = 1.0 / (1.0 + ((1.0 - length) * (1.0 + length)).sqrt());
        ReducedShear::from_distortion(self.e1 * scale, self.e2 * scale)
    }

    pub(crate) fn from_reduced_shear(e1: f64, e2: f64) -> Self {
        let (e1, e2) = crate::reduced_shear::below_one(e1, e2);
        Self { e1, e2 }
    }
}

impl TryFrom<Components> for Distortion {
    type Error = MetricsError;
    fn try_from(c: Components) -> Result<Self, MetricsError> {
        Self::new(c.e1, c.e2)
    }
}

impl From<Distortion> for Components {
    fn from(e: Distortion) -> Self {
        Self { e1: e.e1, e2: e.e2 }
    }
}
