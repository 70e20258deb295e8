//! Analytic profiles, Gaussian and Moffat, whose size and shape vary over the field.

use std::f64::consts::{LN_2, PI};

use ndarray::ArrayViewMut2;
use psf_types::maths::gauss_legendre;
use psf_types::{FrameShape, Position, PsfSource, SourceError, StampGrid};

use crate::error::require;
use crate::{FieldCoordinates, FieldPolynomial, OpticsError};

/// Size and shape of a profile over the field.
///
/// The isophotes are ellipses of axes `a >= b`. The angle `phi` of the major axis runs from the x
/// axis towards the y axis. The polynomials give:
///
/// * `fwhm_px`: the geometric mean of the full widths at half maximum along both axes, in frame
///   pixels.
/// * `e1`, `e2`: the **distortion** `(a^2 - b^2) / (a^2 + b^2) (cos 2 phi, sin 2 phi)` (not the
///   reduced shear).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ProfileShape {
    /// Geometric-mean FWHM in frame pixels.
    pub fwhm_px: FieldPolynomial,
    /// Distortion along the x and y axes.
    pub e1: FieldPolynomial,
    /// Distortion along the diagonals.
    pub e2: FieldPolynomial,
}

impl ProfileShape {
    /// A round shape with the same size everywhere.
    ///
    /// # Errors
    /// [`OpticsError::Setting`] when the size is not finite.
    pub fn round(fwhm_px: f64) -> Result<Self, OpticsError> {
        Ok(Self {
            fwhm_px: FieldPolynomial::constant(fwhm_px)?,
            ..Self::default()
        })
    }
}

/// Nodes and weights for a pixel.
const GAUSS_LEGENDRE: [(f64, f64); 8] = gauss_legendre();

/// Field, grid and shape of a profile.
#[derive(Debug, Clone)]
struct ProfileField {
    field: FrameShape,
    grid: StampGrid,
    shape: ProfileShape,
    integrated: bool,
}

/// The isophotes at one position: `r^2 = xx dx^2 + 2 xy dx dy + yy dy^2` in units of half the FWHM,
/// so that `r = 1` at half maximum.
struct Ellipse {
    xx: f64,
    xy: f64,
    yy: f64,
    fwhm_px: f64,
}

impl ProfileField {
    fn new(field: FrameShape, grid: StampGrid, shape: ProfileShape) -> Result<Self, OpticsError> {
        let this = Self {
            field,
            grid,
            shape,
            integrated: false,
        };
        // Most impossible shapes occur at a corner or the centre. Others are refused when a stamp
        // is drawn.
        let (right, top) = (field.nx() as i64 - 1, field.ny() as i64 - 1);
        for (x, y) in [(0, 0), (right, 0), (0, top), (right, top), (right / 2, top / 2)] {
            this.ellipse(Position::of_pixel(x, y))?;
        }
        Ok(this)
    }

    fn with_pixel_integration(self) -> Self {
        Self {
            grid: self.grid.with_pixel_response_included(true),
            integrated: true,
            ..self
        }
    }

    fn ellipse(&self, position: Position) -> Result<Ellipse, OpticsError> {
        let at = FieldCoordinates::of(position, self.field);
        let fwhm_px = self.shape.fwhm_px.evaluate(at);
        if !(fwhm_px.is_finite() && fwhm_px > 0.0) {
            return Err(OpticsError::ProfileSize { position, fwhm_px });
        }
        let (e1, e2) = (self.shape.e1.evaluate(at), self.shape.e2.evaluate(at));
        let rest = 1.0 - e1 * e1 - e2 * e2;
        if !(rest.is_finite() && rest > 0.0) {
            return Err(OpticsError::ProfileShape { position, e1, e2 });
        }
        let scale = 4.0 / (fwhm_px * fwhm_px * rest.sqrt());
        Ok(Ellipse {
            xx: (1.0 - e1) * scale,
            xy: -e2 * scale,
            yy: (1.0 + e1) * scale,
            fwhm_px,
        })
    }

    /// Draws `density(r^2, fwhm_px)`, the flux per square frame pixel at the radius `r` in units of
    /// half the FWHM.
    fn draw(
        &self,
        position: Position,
        (dx, dy): (f64, f64),
        mut stamp: ArrayViewMut2<'_, f64>,
        density: impl Fn(f64, f64) -> f64,
    ) -> Result<(), SourceError> {
        assert_eq!(stamp.dim(), self.grid.dim(), "the stamp has the grid's shape");
        let e = self.ellipse(position).map_err(|source| SourceError::External {
            position,
            source: Box::new(source),
        })?;
        let value = |x: f64, y: f64| density(e.xx * x * x + 2.0 * e.xy * x * y + e.yy * y * y, e.fwhm_px);
        for ((row, column), target) in stamp.indexed_iter_mut() {
            let x = (column as f64 - self.grid.centre_x()) / self.grid.oversampling() - dx;
            let y = (row as f64 - self.grid.centre_y()) / self.grid.oversampling() - dy;
            *target = if self.integrated {
                over_pixel(|a, b| value(x + a, y + b))
            } else {
                value(x, y)
            };
        }
        Ok(())
    }
}

/// The integral of `f` over `-1/2 <= a, b <= 1/2`.
fn over_pixel(f: impl Fn(f64, f64) -> f64) -> f64 {
    let nodes = || GAUSS_LEGENDRE.iter().map(|&(t, w)| (t - 0.5, w));
    nodes()
        .map(|(b, w)| w * nodes().map(|(a, v)| v * f(a, b)).sum::<f64>())
        .sum()
}

/// Implements [`PsfSource`] from the `density` of the profile.
macro_rules! profile_source {
    ($source:ident) => {
        impl PsfSource for $source {
            fn grid(&self) -> StampGrid {
                self.profile.grid
            }

            fn field(&self) -> FrameShape {
                self.profile.field
            }

            fn draw_into(
                &self,
                position: Position,
                stamp: ArrayViewMut2<'_, f64>,
            ) -> Result<(), SourceError> {
                self.draw_shifted_into(position, (0.0, 0.0), stamp)
            }

            fn draw_shifted_into(
                &self,
                position: Position,
                shift: (f64, f64),
                stamp: ArrayViewMut2<'_, f64>,
            ) -> Result<(), SourceError> {
                self.profile
                    .draw(position, shift, stamp, Self::density(self))
            }
        }
    };
}

/// An elliptical Gaussian PSF whose size and shape are polynomials of the field. Its flux over the
/// infinite plane is 1.
///
/// The density is `4 ln 2 / (pi F^2) 2^(-r^2)` with `F` the geometric-mean FWHM and `r` the
/// elliptical radius in units of half the FWHM. By default, a stamp value is the density at the
/// pixel's centre times the area of a frame pixel. In this case, the grid states whether the
/// profile itself already includes the pixel response
/// ([`StampGrid::with_pixel_response_included`]). To integrate over pixels, see
/// [`with_pixel_integration`](Self::with_pixel_integration).
///
/// ```
/// use psf_optics::{GaussianField, ProfileShape};
/// use psf_types::{FrameShape, Position, PsfSource, StampGrid};
/// let (frame, grid) = (FrameShape::new(100, 100)?, StampGrid::new(32, 32)?);
/// let source = GaussianField::new(frame, grid, ProfileShape::round(3.0)?)?;
/// assert!((source.draw(Position::new(50.0, 20.0)?)?.flux() - 1.0).abs() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct GaussianField {
    profile: ProfileField,
}

impl GaussianField {
    /// A Gaussian of the given shape over `field`, drawn on `grid`.
    ///
    /// # Errors
    /// [`OpticsError::ProfileSize`] or [`OpticsError::ProfileShape`] when the shape is impossible
    /// at a corner or at the centre of the field. Drawing returns the error for other positions.
    pub fn new(field: FrameShape, grid: StampGrid, shape: ProfileShape) -> Result<Self, OpticsError> {
        Ok(Self {
            profile: ProfileField::new(field, grid, shape)?,
        })
    }

    /// Integrates the profile over each frame pixel by an 8 x 8 Gauss-Legendre rule, which takes
    /// 64 times as long. The error is below 1e-8 of the peak for a FWHM of at least 1 pixel along
    /// both axes of the ellipse.
    #[must_use]
    pub fn with_pixel_integration(self) -> Self {
        Self {
            profile: self.profile.with_pixel_integration(),
        }
    }

    /// The density (flux per square frame pixel) as a function of `r^2`, with `r` in units of half
    /// the FWHM, and of the FWHM in pixels.
    fn density(_: &Self) -> impl Fn(f64, f64) -> f64 {
        |r2, fwhm| 4.0 * LN_2 / (PI * fwhm * fwhm) * (-LN_2 * r2).exp()
    }
}

profile_source!(GaussianField);

/// An elliptical Moffat PSF (Moffat 1969, A&A 3, 455) whose size and shape are polynomials of the
/// field position. Its flux over the infinite plane is 1.
///
/// The density is `(beta - 1) / (pi alpha^2) (1 + q r^2)^(-beta)` with `q = 2^(1/beta) - 1` and
/// `alpha = F / (2 sqrt(q))`. Here `F` is the geometric mean of the FWHMs along both axes, and `r`
/// is the elliptical radius in units of `F / 2`. A stamp does not contain the far wings:
/// `(1 + (R / alpha)^2)^(1 - beta)` of the flux falls outside the elliptical radius `R = r F / 2`.
/// Values are sampled as in [`GaussianField`].
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
    /// A Moffat profile over `field`, drawn on `grid`. The exponent `beta` must be above 1, because
    /// otherwise the flux is infinite.
    ///
    /// # Errors
    /// [`OpticsError::Setting`] for a `beta` that is not a finite number above 1,
    /// [`OpticsError::ProfileSize`] or [`OpticsError::ProfileShape`] when the shape is impossible
    /// at a corner or at the centre of the field. Drawing returns the error for other positions.
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

    /// Integrates the profile over each frame pixel by an 8 x 8 Gauss-Legendre rule, which takes 64
    /// times as long.
    #[must_use]
    pub fn with_pixel_integration(self) -> Self {
        Self {
            profile: self.profile.with_pixel_integration(),
            ..self
        }
    }

    /// The density (flux per square frame pixel) as a function of `r^2`, with `r` in units of half
    /// the FWHM, and of the FWHM in pixels.
    fn density(field: &Self) -> impl Fn(f64, f64) -> f64 {
        let beta = field.beta;
        let q = 2f64.powf(1.0 / beta) - 1.0;
        move |r2, fwhm| {
            let alpha2 = fwhm * fwhm / (4.0 * q);
            (beta - 1.0) / (PI * alpha2) * (1.0 + q * r2).powf(-beta)
        }
    }
}

profile_source!(MoffatField);
