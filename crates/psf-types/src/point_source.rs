//! Stars.

use serde::{Deserialize, Serialize};

use crate::{DataError, Position};

/// A star: a position in pixels of the scene (sub-pixel, possibly outside the scene) and a finite flux.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawPointSource", into = "RawPointSource")]
pub struct PointSource {
    position: Position,
    flux: f64,
}

#[derive(Serialize, Deserialize)]
struct RawPointSource {
    position: Position,
    flux: f64,
}

impl PointSource {
    /// A star of this total flux.
    ///
    /// # Errors
    /// [`DataError::SourceFlux`] when the flux is NaN or infinite.
    pub fn new(position: Position, flux: f64) -> Result<Self, DataError> {
        if flux.is_finite() {
            Ok(Self { position, flux })
        } else {
            Err(DataError::SourceFlux { position, flux })
        }
    }

    /// Where it is, in pixels of the scene.
    pub fn position(self) -> Position {
        self.position
    }

    /// Its total flux.
    pub fn flux(self) -> f64 {
        self.flux
    }
}

impl TryFrom<RawPointSource> for PointSource {
    type Error = DataError;
    fn try_from(raw: RawPointSource) -> Result<Self, DataError> {
        Self::new(raw.position, raw.flux)
    }
}

impl From<PointSource> for RawPointSource {
    fn from(source: PointSource) -> Self {
        Self {
            position: source.position,
            flux: source.flux,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fluxes_are_finite_also_from_files() {
        let at = Position::of_pixel(1, 1);
        assert!(matches!(
            PointSource::new(at, f64::NAN),
            Err(DataError::SourceFlux { .. })
        ));
        let text = serde_json::to_string(&PointSource::new(at, 2.5).unwrap()).unwrap();
        assert!(serde_json::from_str::<PointSource>(&text).is_ok());
        assert!(serde_json::from_str::<PointSource>(&text.replace("2.5", "1e999")).is_err());
    }
}
