//! A Moffat PSF over the field.

use std::f64::consts::PI;

use ndarray::ArrayViewMut2;
use psf_types::{FrameShape, Position, PsfSource, SourceError, StampGrid};

use crate::error::require;
use crate::profile_field::ProfileField;
use crate::{OpticsError, ProfileShape};

/// An elliptical Moffat PSF (Moffat 1969, A&A 3, 455) of unit flux over the plane whose size and shape are polynomials of
/// the field.
///
/// The density is `(beta - 1) / (pi alpha^2) (1 + q r^2)^(-beta)` with `q = 2^(1/beta) - 1`, `r` the elliptical radius in
/// units of half the FWHM `F` (geometric mean of both axes) and `alpha = F / (2 sqrt(q))`. A stamp misses the wings:
/// `(1 + (R / alpha)^2)^(1 - beta)` of the flux falls outside the radius `R`. Values are sampled as those of
/// [`GaussianField`](crate::GaussianField).
///
/// ```
/// use psf_optics::{MoffatField, ProfileShape};
/// use psf_types::{FrameShape, Position, PsfSource, StampGrid};
/// let field = FrameShape::new(100, 100)?;
/// let source = MoffatField::new(field, StampGrid::new(33, 33)?, 3.5, ProfileShape::round(3.0)?)?;
/// let stamp = source.draw(Position::new(50.0, 20.0)?)?;
/// assert!(stamp.flux() < 1.0 && stamp.flux() > 0.99);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct MoffatField {
    profile: ProfileField,
    beta: f64,
}

impl MoffatField {
    /// A Moffat profile of exponent `beta` (above 1, or its flux would be infinite) over `field`, drawn on `grid`.
    ///
    /// # Errors
    /// [`OpticsError::Setting`] for `beta`; [`OpticsError::ProfileSize`] or [`OpticsError::ProfileShape`] when the shape is
    /// impossible at a corner or at the centre of the field. Elsewhere drawing says so.
    pub fn new(
        field: FrameShape,
        grid: StampGrid,
        beta: f64,
        shape: ProfileShape,
    ) -> Result<Self, OpticsError> {
        Ok(Self {
            beta: require("beta", "a finite number above 1", beta, beta > 1.0)?,
            profile: ProfileField::new(field, grid, shape)?,
        })
    }

    /// The same profile integrated over each frame pixel by an 8 x 8 Gauss-Legendre rule; 64 times the work.
    #[must_use]
    pub fn with_pixel_integration(self) -> Self {
        Self {
            profile: self.profile.with_pixel_integration(),
            ..self
        }
    }
}

impl PsfSource for MoffatField {
    fn grid(&self) -> StampGrid {
        self.profile.grid()
    }

    fn field(&self) -> FrameShape {
        self.profile.field()
    }

    fn draw_into(&self, position: Position, stamp: ArrayViewMut2<'_, f64>) -> Result<(), SourceError> {
        self.draw_shifted_into(position, (0.0, 0.0), stamp)
    }

    fn draw_shifted_into(
        &self,
        position: Position,
        shift: (f64, f64),
        stamp: ArrayViewMut2<'_, f64>,
    ) -> Result<(), SourceError> {
        let q = 2f64.powf(1.0 / self.beta) - 1.0;
        let density = |r2: f64, fwhm: f64| {
            let alpha2 = fwhm * fwhm / (4.0 * q);
            (self.beta - 1.0) / (PI * alpha2) * (1.0 + q * r2).powf(-self.beta)
        };
        self.profile.draw(position, shift, stamp, density)
    }
}
