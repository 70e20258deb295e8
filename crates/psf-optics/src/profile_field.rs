//! What analytic profiles share: elliptical isophotes whose size and shape vary over the field.

use ndarray::ArrayViewMut2;
use psf_types::{FrameShape, Position, SourceError, StampGrid};

use crate::{FieldCoordinates, FieldPolynomial, OpticsError};

/// Size and shape of a profile over the field.
///
/// The isophotes are ellipses of axes `a >= b` at the angle `phi` from the x axis towards the y axis, with
///
/// * `fwhm_px`: the geometric mean of the full widths at half maximum along both axes, in frame pixels;
/// * `e1`, `e2`: the **distortion** `(a^2 - b^2) / (a^2 + b^2) (cos 2 phi, sin 2 phi)` (not the reduced shear).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ProfileShape {
    /// Geometric-mean FWHM in frame pixels.
    pub fwhm_px: FieldPolynomial,
    /// Distortion along the axes.
    pub e1: FieldPolynomial,
    /// Distortion along the diagonals.
    pub e2: FieldPolynomial,
}

impl ProfileShape {
    /// Round, of the same size everywhere.
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

/// Nodes and weights of the 8-point Gauss-Legendre rule on [-1, 1], positive half.
const GAUSS_LEGENDRE: [(f64, f64); 4] = [
    (0.183_434_642_495_649_8, 0.362_683_783_378_362),
    (0.525_532_409_916_329, 0.313_706_645_877_887_3),
    (0.796_666_477_413_626_7, 0.222_381_034_453_374_5),
    (0.960_289_856_497_536_3, 0.101_228_536_290_376_3),
];

/// Field, grid and shape of a profile.
#[derive(Debug, Clone)]
pub(crate) struct ProfileField {
    field: FrameShape,
    grid: StampGrid,
    shape: ProfileShape,
    integrated: bool,
}

/// The isophotes at one position: `r^2 = xx dx^2 + 2 xy dx dy + yy dy^2` in units of the FWHM's radius, 1 at half maximum.
struct Ellipse {
    xx: f64,
    xy: f64,
    yy: f64,
    fwhm_px: f64,
}

impl ProfileField {
    pub(crate) fn new(field: FrameShape, grid: StampGrid, shape: ProfileShape) -> Result<Self, OpticsError> {
        let this = Self {
            field,
            grid,
            shape,
            integrated: false,
        };
        // Most mistakes show at the corners; what goes wrong between them is refused when it is drawn.
        let (right, top) = (field.nx() as i64 - 1, field.ny() as i64 - 1);
        for (x, y) in [(0, 0), (right, 0), (0, top), (right, top), (right / 2, top / 2)] {
            this.ellipse(Position::of_pixel(x, y))?;
        }
        Ok(this)
    }

    pub(crate) fn with_pixel_integration(self) -> Self {
        Self {
            grid: self.grid.with_pixel_response_included(true),
            integrated: true,
            ..self
        }
    }

    pub(crate) fn grid(&self) -> StampGrid {
        self.grid
    }

    pub(crate) fn field(&self) -> FrameShape {
        self.field
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

    /// Draws `density(r^2, fwhm_px)`, flux per square frame pixel, `r` in units of half the FWHM.
    pub(crate) fn draw(
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

/// The integral over `-1/2 <= a, b <= 1/2`.
fn over_pixel(f: impl Fn(f64, f64) -> f64) -> f64 {
    let nodes = || {
        GAUSS_LEGENDRE
            .iter()
            .flat_map(|&(t, w)| [(t / 2.0, w / 2.0), (-t / 2.0, w / 2.0)])
    };
    nodes()
        .map(|(b, w)| w * nodes().map(|(a, v)| v * f(a, b)).sum::<f64>())
        .sum()
}
