//! What a ScopeSim file does not say.

use psf_types::{DataError, Position};

/// What it takes to place a [ScopeSim PSF](crate::scopesim) on a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScopesimOptions {
    pixel_scale_arcsec: f64,
    field_centre: Position,
    wavelength_um: Option<f64>,
}

impl ScopesimOptions {
    /// Frame pixels of `pixel_scale_arcsec` arcseconds, the centre of the field at `field_centre` (0-based).
    ///
    /// # Errors
    /// [`DataError::Setting`] unless the scale is a finite number above 0.
    pub fn new(pixel_scale_arcsec: f64, field_centre: Position) -> Result<Self, DataError> {
        Ok(Self {
            pixel_scale_arcsec: positive("pixel scale in arcseconds", pixel_scale_arcsec)?,
            field_centre,
            wavelength_um: None,
        })
    }

    /// The PSFs of the nearest wavelength, in micrometres; needed where there are several.
    ///
    /// # Errors
    /// [`DataError::Setting`] unless it is a finite number above 0.
    pub fn with_wavelength_um(self, wavelength_um: f64) -> Result<Self, DataError> {
        Ok(Self {
            wavelength_um: Some(positive("wavelength in micrometres", wavelength_um)?),
            ..self
        })
    }

    /// Size of a frame pixel.
    pub fn pixel_scale_arcsec(&self) -> f64 {
        self.pixel_scale_arcsec
    }

    /// Where the centre of the field lies on the frame.
    pub fn field_centre(&self) -> Position {
        self.field_centre
    }

    /// The wavelength asked for.
    pub fn wavelength_um(&self) -> Option<f64> {
        self.wavelength_um
    }

    /// The position of a point at an offset from the centre of the field.
    pub(super) fn position(&self, x_arcsec: f64, y_arcsec: f64) -> Result<Position, DataError> {
        Position::new(
            self.field_centre.x() + x_arcsec / self.pixel_scale_arcsec,
            self.field_centre.y() + y_arcsec / self.pixel_scale_arcsec,
        )
    }
}

fn positive(name: &'static str, value: f64) -> Result<f64, DataError> {
    if value.is_finite() && value > 0.0 {
        return Ok(value);
    }
    Err(DataError::Setting {
        name,
        allowed: "a finite number above 0",
        got: value.to_string(),
    })
}
