//! How far the light of galaxies reaches.

use psf_types::{LightProfile as _, Position, SersicProfile, SersicSource};
use sersic::SersicLight;

use crate::error::PsfieldError;

/// The distances, in half-light radii, beyond which a fraction of the flux of a Sersic profile lies.
pub(super) struct Reaches(Vec<f64>);

impl Reaches {
    /// The step of the Sersic index.
    const STEP: f64 = 0.1;

    pub(super) fn new(left_out: f64) -> Result<Self, PsfieldError> {
        let origin = Position::new(0.0, 0.0)?;
        let of = |step: usize| {
            let n = (step as f64 * Self::STEP).clamp(0.3, 8.0);
            let light = SersicLight::new(&SersicSource::new(
                origin,
                1.0,
                SersicProfile::new(1.0, n, 1.0, 0.0)?,
            )?);
            Ok(light.radius_beyond(left_out))
        };
        Ok(Self((0..=80).map(of).collect::<Result<_, PsfieldError>>()?))
    }

    pub(super) fn of(&self, n: f64) -> f64 {
        // Light of a larger index reaches farther.
        let step = (n / Self::STEP).ceil().clamp(0.0, 80.0);
        self.0[if step.is_finite() { step as usize } else { 80 }]
    }
}
