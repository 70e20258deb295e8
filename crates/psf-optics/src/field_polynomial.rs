//! Polynomials of the field position.

use psf_types::{FrameShape, Position};
use serde::{Deserialize, Serialize};

use crate::OpticsError;
use crate::error::require;

/// Normalised field coordinates: -1 at the centre of the first pixel of an axis, 1 at the centre of
/// the last.
///
/// `u = (x - (nx - 1) / 2) / ((nx - 1) / 2)` and likewise `v` for y and `ny`. Along an axis of one
/// pixel the coordinate is 0. Beyond the outermost pixel centres the formula continues linearly.
///
/// ```
/// use psf_optics::FieldCoordinates;
/// use psf_types::{FrameShape, Position};
/// let at = FieldCoordinates::of(Position::new(9.0, 0.0)?, FrameShape::new(10, 5)?);
/// assert_eq!((at.u(), at.v()), (1.0, -1.0));
/// # Ok::<(), psf_types::DataError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldCoordinates {
    u: f64,
    v: f64,
}

impl FieldCoordinates {
    /// The coordinates of `position` on `field`.
    pub fn of(position: Position, field: FrameShape) -> Self {
        let normalise = |x: f64, n: usize| {
            if n == 1 {
                0.0
            } else {
                let half = (n - 1) as f64 / 2.0;
                (x - half) / half
            }
        };
        Self {
            u: normalise(position.x(), field.nx()),
            v: normalise(position.y(), field.ny()),
        }
    }

    /// The normalised coordinate along x.
    pub fn u(self) -> f64 {
        self.u
    }

    /// The normalised coordinate along y.
    pub fn v(self) -> f64 {
        self.v
    }
}

/// One term `value * u^x * v^y` of a [`FieldPolynomial`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FieldTerm {
    /// The power of `u`, 0 when absent.
    #[serde(default)]
    pub x: u32,
    /// The power of `v`, 0 when absent.
    #[serde(default)]
    pub y: u32,
    /// The coefficient, in the unit of the quantity that the polynomial describes.
    pub value: f64,
}

/// A polynomial `sum_t value_t u^{x_t} v^{y_t}` of the normalised [`FieldCoordinates`].
///
/// ```
/// use psf_optics::{FieldCoordinates, FieldPolynomial, FieldTerm};
/// use psf_types::{FrameShape, Position};
/// // 3 + 0.5 u v^2
/// let fwhm = FieldPolynomial::new(vec![
///     FieldTerm { x: 0, y: 0, value: 3.0 },
///     FieldTerm { x: 1, y: 2, value: 0.5 },
/// ])?;
/// let corner = FieldCoordinates::of(Position::new(0.0, 99.0)?, FrameShape::new(100, 100)?);
/// assert_eq!(fwhm.evaluate(corner), 2.5);
/// # Ok::<(), psf_optics::OpticsError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(try_from = "Vec<FieldTerm>", into = "Vec<FieldTerm>")]
pub struct FieldPolynomial {
    terms: Vec<FieldTerm>,
}

impl FieldPolynomial {
    /// The highest power of `u` or `v`. A higher one is most likely a typing error.
    pub const MAX_POWER: u32 = 20;

    /// A polynomial from its terms. Without terms it is 0 everywhere.
    ///
    /// # Errors
    /// [`OpticsError::Setting`] for a value that is not finite or a power above
    /// [`Self::MAX_POWER`], [`OpticsError::Unusable`] for two terms of the same powers.
    pub fn new(terms: Vec<FieldTerm>) -> Result<Self, OpticsError> {
        Self::named("", terms)
    }

    /// Works like [`new`](Self::new), but puts `key` in front of the keys that errors name.
    pub(crate) fn named(key: &str, terms: Vec<FieldTerm>) -> Result<Self, OpticsError> {
        for (i, term) in terms.iter().enumerate() {
            let name = |last: &str| format!("{key}{}terms[{i}]{last}", if key.is_empty() { "" } else { "." });
            require(&name(".value"), "a finite number", term.value, true)?;
            for (power, last) in [(term.x, ".x"), (term.y, ".y")] {
                if power > Self::MAX_POWER {
                    return Err(OpticsError::setting(name(last), "a power from 0 to 20", power));
                }
            }
            if terms[..i].iter().any(|t| (t.x, t.y) == (term.x, term.y)) {
                let (key, x, y) = (name(""), term.x, term.y);
                return Err(OpticsError::repeated(&key, &format!("the term x = {x}, y = {y}")));
            }
        }
        Ok(Self { terms })
    }

    /// A polynomial with the same value everywhere.
    ///
    /// # Errors
    /// [`OpticsError::Setting`] when the value is not finite.
    pub fn constant(value: f64) -> Result<Self, OpticsError> {
        Self::new(vec![FieldTerm { x: 0, y: 0, value }])
    }

    /// The value of the polynomial at `at`.
    pub fn evaluate(&self, at: FieldCoordinates) -> f64 {
        let power = |base: f64, exponent: u32| base.powi(exponent as i32);
        self.terms
            .iter()
            .map(|t| t.value * power(at.u, t.x) * power(at.v, t.y))
            .sum()
    }

    /// The terms, as given.
    pub fn terms(&self) -> &[FieldTerm] {
        &self.terms
    }
}

impl TryFrom<Vec<FieldTerm>> for FieldPolynomial {
    type Error = OpticsError;
    fn try_from(terms: Vec<FieldTerm>) -> Result<Self, OpticsError> {
        Self::new(terms)
    }
}

impl From<FieldPolynomial> for Vec<FieldTerm> {
    fn from(polynomial: FieldPolynomial) -> Self {
        polynomial.terms
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn term(x: u32, y: u32, value: f64) -> FieldTerm {
        FieldTerm { x, y, value }
    }

    #[test]
    fn values_over_the_field() {
        let field = FrameShape::new(11, 1).unwrap();
        let at = |x: f64| FieldCoordinates::of(Position::new(x, 0.0).unwrap(), field);
        let p = FieldPolynomial::new(vec![term(0, 0, 1.0), term(1, 0, 2.0), term(3, 0, -4.0)]).unwrap();
        assert_eq!(p.evaluate(at(5.0)), 1.0);
        assert_eq!(p.evaluate(at(10.0)), -1.0);
        assert_eq!(p.evaluate(at(0.0)), 3.0);
        assert_eq!(p.evaluate(at(7.5)), 1.0 + 1.0 - 0.5);
        assert_eq!(at(3.0).v(), 0.0, "an axis of one pixel has no extent");
        assert_eq!(FieldPolynomial::default().evaluate(at(2.0)), 0.0);
    }

    #[test]
    fn bad_terms_are_named() {
        let message = |terms| FieldPolynomial::named("modes[3]", terms).unwrap_err().to_string();
        assert_eq!(
            message(vec![term(0, 0, f64::NAN)]),
            "modes[3].terms[0].value must be a finite number, got NaN"
        );
        assert_eq!(
            message(vec![term(0, 0, 1.0), term(0, 21, 1.0)]),
            "modes[3].terms[1].y must be a power from 0 to 20, got 21"
        );
        assert_eq!(
            message(vec![term(1, 2, 1.0), term(1, 2, 1.0)]),
            "modes[3].terms[1] repeats the term x = 1, y = 2: merge the two"
        );
    }
}
