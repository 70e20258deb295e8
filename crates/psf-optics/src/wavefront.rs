//! The wavefront error: Zernike polynomials over the pupil, with coefficients that vary over the
//! field.

use std::f64::consts::TAU;

use crate::{FieldCoordinates, FieldPolynomial, OpticsError, WavefrontParams, WavefrontUnit};

/// One Zernike polynomial in Noll's order and normalisation (Noll 1976, J. Opt. Soc. Am. 66, 207).
///
/// In polar coordinates `(rho, theta)` of the unit disc, with the radial order `n` and the
/// azimuthal order `m >= 0`:
///
/// ```text
/// Z_j = sqrt(n + 1) R_n^0(rho)                           m = 0
/// Z_j = sqrt(2 (n + 1)) R_n^m(rho) cos(m theta)          m > 0, j even
/// Z_j = sqrt(2 (n + 1)) R_n^m(rho) sin(m theta)          m > 0, j odd
/// R_n^m(rho) = sum_k (-1)^k (n - k)! / (k! ((n + m)/2 - k)! ((n - m)/2 - k)!) rho^(n - 2k)
/// ```
///
/// The mean of `Z_i Z_j` over the disc is 1 for `i = j` and 0 otherwise, so a coefficient is the
/// r.m.s. of its term over an unobscured pupil. `j` = 1 is piston, 2 and 3 tilts along x and y, 4
/// defocus, 5 and 6 astigmatism, 7 and 8 coma, 11 spherical aberration. These polynomials are also
/// used for an obscured pupil, although they are not orthogonal there.
///
/// ```
/// use psf_optics::Zernike;
/// let defocus = Zernike::from_noll(4)?;
/// assert_eq!((defocus.n(), defocus.m()), (2, 0));
/// // sqrt(3) (2 rho^2 - 1)
/// assert!((defocus.evaluate(0.6, 0.8) - 3f64.sqrt()).abs() < 1e-15);
/// # Ok::<(), psf_optics::OpticsError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Zernike {
    noll: usize,
    n: usize,
    m: usize,
    /// Coefficients of `rho^(m + 2k)`, `k` ascending, normalisation included.
    radial: Vec<f64>,
}

impl Zernike {
    /// The highest index, which is the last index of radial order 20.
    pub const MAX_NOLL: usize = 231;

    /// The polynomial of Noll's index `j`, 1 to [`Self::MAX_NOLL`].
    ///
    /// # Errors
    /// [`OpticsError::Setting`] when `j` is out of that range.
    pub fn from_noll(j: usize) -> Result<Self, OpticsError> {
        if !(1..=Self::MAX_NOLL).contains(&j) {
            return Err(OpticsError::setting("noll", "an index from 1 to 231", j));
        }
        let mut n = 0;
        while (n + 1) * (n + 2) / 2 < j {
            n += 1;
        }
        // Position within radial order n, counted from 1. The azimuthal orders ascend in pairs.
        let in_row = j - n * (n + 1) / 2;
        let m = if n % 2 == 0 {
            in_row / 2 * 2
        } else {
            (in_row - 1) / 2 * 2 + 1
        };
        let norm = if m == 0 {
            ((n + 1) as f64).sqrt()
        } else {
            (2.0 * (n + 1) as f64).sqrt()
        };
        let factorial = |k: usize| (1..=k).map(|i| i as f64).product::<f64>();
        let radial = (0..=(n - m) / 2)
            .rev()
            .map(|k| {
                let sign = if k % 2 == 0 { norm } else { -norm };
                sign * factorial(n - k)
                    / (factorial(k) * factorial(n.midpoint(m) - k) * factorial((n - m) / 2 - k))
            })
            .collect();
        Ok(Self {
            noll: j,
            n,
            m,
            radial,
        })
    }

    /// Noll's index `j`.
    pub fn noll(&self) -> usize {
        self.noll
    }

    /// The radial order.
    pub fn n(&self) -> usize {
        self.n
    }

    /// The azimuthal order, 0 or above. See also [`is_sine`](Self::is_sine).
    pub fn m(&self) -> usize {
        self.m
    }

    /// Returns whether the term contains `sin(m theta)`: odd `j` and `m > 0`.
    pub fn is_sine(&self) -> bool {
        self.m > 0 && self.noll % 2 == 1
    }

    /// The value at the Cartesian pupil coordinates (`x`, `y`). The unit circle is the edge of the
    /// aperture. Outside the unit disc the polynomial is not cut off.
    pub fn evaluate(&self, x: f64, y: f64) -> f64 {
        let rho2 = x * x + y * y;
        let radial = self.radial.iter().rev().fold(0.0, |sum, c| sum * rho2 + c);
        // rho^m (cos(m theta), sin(m theta)) = (x + i y)^m
        let (mut re, mut im) = (1.0, 0.0);
        for _ in 0..self.m {
            (re, im) = (re * x - im * y, re * y + im * x);
        }
        radial * if self.is_sine() { im } else { re }
    }

    /// Converts the polynomial to powers of `x` and `y`.
    pub(crate) fn to_cartesian(&self) -> PupilPolynomial {
        let binomial = |n: usize, k: usize| (1..=k).fold(1.0, |b, i| b * (n - k + i) as f64 / i as f64);
        let mut sum = PupilPolynomial::zero(self.n);
        for (k, c) in self.radial.iter().enumerate() {
            // (x^2 + y^2)^k times the real or imaginary part of (x + i y)^m
            for q in 0..=k {
                for p in usize::from(self.is_sine())..=self.m {
                    if p % 2 == usize::from(self.is_sine()) {
                        let sign = if (p / 2) % 2 == 0 { 1.0 } else { -1.0 };
                        let (a, b) = (2 * (k - q) + self.m - p, 2 * q + p);
                        *sum.coefficient_mut(a, b) += sign * c * binomial(k, q) * binomial(self.m, p);
                    }
                }
            }
        }
        sum
    }
}

/// `sum_{a + b <= degree} c_ab x^a y^b` over the pupil.
///
/// A wavefront is summed in this form once for each PSF. Horner's rule then evaluates the sum and
/// its gradient row by row. This is faster than a sum over maps of many Zernike polynomials and
/// needs no memory for the maps.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PupilPolynomial {
    degree: usize,
    /// `c_ab` at `b * (degree + 1) + a`.
    coefficients: Vec<f64>,
}

/// A [`PupilPolynomial`] and its derivative in y, both at a fixed y: coefficients of ascending
/// powers of x.
#[derive(Debug, Default)]
pub(crate) struct PupilRowPolynomial {
    value: Vec<f64>,
    dy: Vec<f64>,
}

/// Values and gradient along a row.
#[derive(Debug, Default)]
pub(crate) struct PupilRowValues {
    pub(crate) value: Vec<f64>,
    pub(crate) dx: Vec<f64>,
    pub(crate) dy: Vec<f64>,
}

impl PupilPolynomial {
    pub(crate) fn zero(degree: usize) -> Self {
        Self {
            degree,
            coefficients: vec![0.0; (degree + 1) * (degree + 1)],
        }
    }

    pub(crate) fn degree(&self) -> usize {
        self.degree
    }

    pub(crate) fn is_finite(&self) -> bool {
        self.coefficients.iter().all(|c| c.is_finite())
    }

    pub(crate) fn coefficient_mut(&mut self, a: usize, b: usize) -> &mut f64 {
        &mut self.coefficients[b * (self.degree + 1) + a]
    }

    /// Adds `factor * other`, whose degree must not be higher.
    pub(crate) fn add_scaled(&mut self, other: &Self, factor: f64) {
        for b in 0..=other.degree {
            for a in 0..=other.degree - b {
                *self.coefficient_mut(a, b) += factor * other.coefficients[b * (other.degree + 1) + a];
            }
        }
    }

    /// Reduces the polynomial and its derivative in y to polynomials of x at a fixed y.
    pub(crate) fn at_y(&self, y: f64, row: &mut PupilRowPolynomial) {
        let d = self.degree;
        row.value.clear();
        row.dy.clear();
        for a in 0..=d {
            let (mut value, mut slope) = (0.0, 0.0);
            for b in (0..=d - a).rev() {
                slope = slope * y + value;
                value = value * y + self.coefficients[b * (d + 1) + a];
            }
            row.value.push(value);
            row.dy.push(slope);
        }
    }

    #[cfg(test)]
    pub(crate) fn evaluate(&self, x: f64, y: f64) -> f64 {
        let (mut row, mut values) = (PupilRowPolynomial::default(), PupilRowValues::default());
        self.at_y(y, &mut row);
        row.evaluate(&[x], &mut values);
        values.value[0]
    }
}

impl PupilRowPolynomial {
    /// Values and gradient at every `x`.
    pub(crate) fn evaluate(&self, x: &[f64], values: &mut PupilRowValues) {
        for v in [&mut values.value, &mut values.dx, &mut values.dy] {
            v.clear();
            v.resize(x.len(), 0.0);
        }
        for (&c, &c_dy) in self.value.iter().zip(&self.dy).rev() {
            let columns = values
                .value
                .iter_mut()
                .zip(&mut values.dx)
                .zip(&mut values.dy)
                .zip(x);
            for (((value, dx), dy), &x) in columns {
                *dx = *dx * x + *value;
                *value = *value * x + c;
                *dy = *dy * x + c_dy;
            }
        }
    }
}

/// Zernike terms whose coefficients are polynomials of the field position.
#[derive(Debug)]
pub(crate) struct Wavefront {
    modes: Vec<(PupilPolynomial, FieldPolynomial)>,
    degree: usize,
    radians_per_unit: f64,
}

impl Wavefront {
    pub(crate) fn new(params: &WavefrontParams, wavelength_nm: f64) -> Result<Self, OpticsError> {
        let mut modes = Vec::new();
        for (i, mode) in params.modes.iter().enumerate() {
            let key = format!("wavefront.modes[{i}]");
            let zernike = Zernike::from_noll(mode.noll).map_err(|_| {
                OpticsError::setting(format!("{key}.noll"), "an index from 1 to 231", mode.noll)
            })?;
            if params.modes[..i].iter().any(|m| m.noll == mode.noll) {
                return Err(OpticsError::repeated(&key, &format!("noll = {}", mode.noll)));
            }
            let coefficient = FieldPolynomial::named(&key, mode.terms.clone())?;
            modes.push((zernike.to_cartesian(), coefficient));
        }
        Ok(Self {
            degree: modes.iter().map(|(p, _)| p.degree()).max().unwrap_or(0),
            modes,
            radians_per_unit: match params.unit {
                WavefrontUnit::Nm => TAU / wavelength_nm,
                WavefrontUnit::Waves => TAU,
            },
        })
    }

    /// The phase in radians over the pupil at a field position.
    pub(crate) fn phase(&self, at: FieldCoordinates) -> PupilPolynomial {
        let mut sum = PupilPolynomial::zero(self.degree);
        for (mode, coefficient) in &self.modes {
            sum.add_scaled(mode, coefficient.evaluate(at) * self.radians_per_unit);
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use psf_types::{FrameShape, Position};

    use super::*;
    use crate::{FieldTerm, ModeParams};

    /// Midpoint rule on 400 x 400 points. The jagged edge of the disc causes an error of about
    /// 1e-3.
    const ORTHONORMAL: f64 = 5e-3;
    /// The two forms differ only by rounding in sums of terms below 1e3.
    const SAME_POLYNOMIAL: f64 = 1e-11;

    #[test]
    fn noll_order_and_closed_forms() {
        let table = [
            (0, 0),
            (1, 1),
            (1, 1),
            (2, 0),
            (2, 2),
            (2, 2),
            (3, 1),
            (3, 1),
            (3, 3),
            (3, 3),
            (4, 0),
            (4, 2),
            (4, 2),
            (4, 4),
            (4, 4),
            (5, 1),
        ];
        for (i, &(n, m)) in table.iter().enumerate() {
            let z = Zernike::from_noll(i + 1).unwrap();
            assert_eq!((z.n(), z.m(), z.noll()), (n, m, i + 1));
        }
        let (x, y) = (0.3, -0.55);
        let r2: f64 = x * x + y * y;
        let close = |j: usize, expected: f64| {
            let got = Zernike::from_noll(j).unwrap().evaluate(x, y);
            assert!((got - expected).abs() < 1e-14, "Z{j}: {got} against {expected}");
        };
        close(1, 1.0);
        close(2, 2.0 * x);
        close(3, 2.0 * y);
        close(4, 3f64.sqrt() * (2.0 * r2 - 1.0));
        close(5, 6f64.sqrt() * 2.0 * x * y);
        close(6, 6f64.sqrt() * (x * x - y * y));
        close(7, 8f64.sqrt() * (3.0 * r2 - 2.0) * y);
        close(8, 8f64.sqrt() * (3.0 * r2 - 2.0) * x);
        close(9, 8f64.sqrt() * (3.0 * x * x * y - y * y * y));
        close(10, 8f64.sqrt() * (x * x * x - 3.0 * x * y * y));
        close(11, 5f64.sqrt() * (6.0 * r2 * r2 - 6.0 * r2 + 1.0));
        close(
            22,
            7f64.sqrt() * (20.0 * r2.powi(3) - 30.0 * r2 * r2 + 12.0 * r2 - 1.0),
        );
    }

    #[test]
    fn orthonormal_up_to_45() {
        let modes: Vec<_> = (1..=45).map(|j| Zernike::from_noll(j).unwrap()).collect();
        let n = 400;
        let mut gram = vec![0.0; 45 * 45];
        let mut count = 0.0;
        for row in 0..n {
            for column in 0..n {
                let [x, y] = [column, row].map(|i| f64::from(2 * i + 1) / f64::from(n) - 1.0);
                if x * x + y * y <= 1.0 {
                    count += 1.0;
                    let z: Vec<f64> = modes.iter().map(|m| m.evaluate(x, y)).collect();
                    for i in 0..45 {
                        for j in 0..=i {
                            gram[45 * i + j] += z[i] * z[j];
                        }
                    }
                }
            }
        }
        for i in 0..45 {
            for j in 0..=i {
                let expected = f64::from(u8::from(i == j));
                let got: f64 = gram[45 * i + j] / count;
                assert!(
                    (got - expected).abs() < ORTHONORMAL,
                    "<Z{}, Z{}> = {got}",
                    i + 1,
                    j + 1
                );
            }
        }
    }

    #[test]
    fn the_cartesian_form_is_the_same_polynomial() {
        for j in 1..=66 {
            let z = Zernike::from_noll(j).unwrap();
            let cartesian = z.to_cartesian();
            for (x, y) in [
                (0.0, 0.0),
                (0.6, 0.8),
                (-0.71, 0.33),
                (0.2, -0.97),
                (1.0, 0.0),
                (0.0, -1.0),
            ] {
                let difference = z.evaluate(x, y) - cartesian.evaluate(x, y);
                assert!(
                    difference.abs() < SAME_POLYNOMIAL,
                    "Z{j} at ({x}, {y}): {difference:e}"
                );
            }
        }
    }

    #[test]
    fn indices_out_of_range_are_refused() {
        for j in [0, 232] {
            assert!(
                Zernike::from_noll(j)
                    .unwrap_err()
                    .to_string()
                    .contains("noll must be")
            );
        }
        assert_eq!(Zernike::from_noll(231).unwrap().n(), 20);
    }

    #[test]
    fn values_and_gradient_of_a_cubic() {
        // 1 + 2x - 3xy + 0.5 x y^2 + 4 y^3
        let mut p = PupilPolynomial::zero(3);
        for (a, b, c) in [(0, 0, 1.0), (1, 0, 2.0), (1, 1, -3.0), (1, 2, 0.5), (0, 3, 4.0)] {
            *p.coefficient_mut(a, b) = c;
        }
        let (mut row, mut values) = (PupilRowPolynomial::default(), PupilRowValues::default());
        let y = -0.4;
        p.at_y(y, &mut row);
        let xs = [0.7, -1.2];
        row.evaluate(&xs, &mut values);
        for (i, x) in xs.into_iter().enumerate() {
            let expected = 1.0 + 2.0 * x - 3.0 * x * y + 0.5 * x * y * y + 4.0 * y * y * y;
            assert!((values.value[i] - expected).abs() < 1e-14);
            assert!((values.dx[i] - (2.0 - 3.0 * y + 0.5 * y * y)).abs() < 1e-14);
            assert!((values.dy[i] - (-3.0 * x + x * y + 12.0 * y * y)).abs() < 1e-14);
        }
    }

    #[test]
    fn terms_add_up_over_field_and_pupil() {
        let mode = |noll, terms: &[(u32, u32, f64)]| ModeParams {
            noll,
            terms: terms
                .iter()
                .map(|&(x, y, value)| FieldTerm { x, y, value })
                .collect(),
        };
        let params = WavefrontParams {
            unit: WavefrontUnit::Waves,
            modes: vec![mode(4, &[(0, 0, 0.1), (2, 0, 0.3)]), mode(9, &[(0, 1, -0.2)])],
        };
        let at = FieldCoordinates::of(
            Position::new(0.0, 75.0).unwrap(),
            FrameShape::new(101, 101).unwrap(),
        );
        let (x, y) = (0.4, -0.7);
        let z = |j| Zernike::from_noll(j).unwrap().evaluate(x, y);
        let phase = |unit, wavelength| {
            let params = WavefrontParams {
                unit,
                ..params.clone()
            };
            Wavefront::new(&params, wavelength)
                .unwrap()
                .phase(at)
                .evaluate(x, y)
        };
        let expected = TAU * (0.4 * z(4) - 0.1 * z(9));
        assert!((phase(WavefrontUnit::Waves, 500.0) - expected).abs() < 1e-14);
        assert!((phase(WavefrontUnit::Nm, 500.0) - expected / 500.0).abs() < 1e-16);
    }
}
