//! One polynomial over the whole field, by least squares.

use nalgebra::DMatrix;
use ndarray::{Array2, ArrayView2};
use psf_types::maths::legendre;
use psf_types::{FieldError, Interpolation, OutsidePolicy, Position, SampleCoefficients, SamplePositions};

use crate::error::CoeffFieldError;
use crate::geometry::{Hull, HullPiece, Point, Points, Row, external, last_where, range};
use crate::interpolation::{
    FieldInterpolation, FieldWeights, OnRun, Outcomes, Unpredictable, Visited, WeightList, Weights,
    check_rows, hull_leave_one_out, in_runs, pixel_by_pixel,
};

/// Singular values below this fraction of the largest count as 0. The samples then do not determine
/// all terms.
const DEGENERATE: f64 = 1e-10;
/// If the other samples contribute less than this fraction to the fitted value at a sample, they
/// alone do not determine the polynomial.
const MIN_SHARED_PART: f64 = 1e-10;

/// A polynomial in x and y up to a total degree `d`, fitted to all samples by least squares, as in
/// PSFEx (E. Bertin 2011, ADASS XX, 435).
///
/// `a_k(x, y) = sum_{i + j <= d} c_ijk L_i(x') L_j(y')` with normalised Legendre polynomials
/// `L_n = sqrt(2n + 1) P_n`. The coordinates `x'` and `y'` are scaled to [-1, 1] over the samples'
/// bounding box. On an even sampling the terms are nearly orthogonal, so the fit is well
/// conditioned. It is solved by Householder QR. The nodes are the `(d+1)(d+2)/2` terms.
/// [`FieldWeights::node_values`] computes the fit, and a position needs one weight per term.
///
/// The fit smooths: it is *not* exact at the samples unless their values are those of such a
/// polynomial. It reproduces every polynomial up to the degree, including constants, although the
/// weights of the terms do not sum to 1.
///
/// # Outside the samples
/// * Nearest: the value at the nearest point of the convex hull.
/// * Extend: the polynomial itself, which grows as the distance to the power of the degree.
/// * Error: returns an error. Positions outside the hull still count as inside up to a distance of
///   1e-9 times the samples' extent (or of 1e-9 pixels, if that is more).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Polynomial {
    degree: usize,
}

impl Polynomial {
    /// A polynomial of total degree `degree`.
    ///
    /// # Errors
    /// [`CoeffFieldError::Parameter`] above [`Interpolation::MAX_DEGREE`].
    pub fn new(degree: usize) -> Result<Self, CoeffFieldError> {
        if degree > Interpolation::MAX_DEGREE {
            return Err(CoeffFieldError::Parameter {
                name: "the degree of the polynomial",
                allowed: "at most 20",
                got: degree as f64,
            });
        }
        Ok(Self { degree })
    }

    /// The total degree.
    pub fn degree(self) -> usize {
        self.degree
    }

    /// The number of terms, `(d+1)(d+2)/2`. The fit needs at least as many samples.
    pub fn term_count(self) -> usize {
        (self.degree + 1) * (self.degree + 2) / 2
    }
}

impl FieldInterpolation for Polynomial {
    fn prepare(&self, positions: &SamplePositions, outside: OutsidePolicy) -> Weights {
        let points = Points::new(positions)?;
        Ok(Box::new(PolynomialWeights {
            fit: Fit::new(*self, &points)?,
            hull: Hull::new(&points, outside)?,
        }))
    }

    /// All predictions come from one fit to all samples, with residuals `r_i`. A fit without sample
    /// `i` has the residual `r_i / (1 - h_ii)` at this sample, with `h = Q Q^T` (D. M. Allen 1974,
    /// Technometrics 16, 125).
    fn leave_one_out(&self, samples: &SampleCoefficients, outside: OutsidePolicy) -> Outcomes {
        let points = Points::new(samples.positions())?;
        let fit = Fit::new(*self, &points)?;
        let values = to_matrix(samples.values());
        let projected = fit.q.tr_mul(&values);
        let residuals = &values - &fit.q * &projected;
        let predict = |sample: usize, at: Point| {
            let own = fit.q.row(sample);
            let free = 1.0 - own.norm_squared();
            if free <= MIN_SHARED_PART {
                return Err(Unpredictable::Undetermined);
            }
            let correction = residuals.row(sample) / free;
            if at == points.points[sample] {
                return Ok(correction.norm());
            }
            let terms = nalgebra::DVector::from_vec(fit.scaling.terms(self.degree, at));
            let at = fit
                .r
                .tr_solve_upper_triangular(&terms)
                .ok_or(Unpredictable::Undetermined)?;
            let predicted = at.tr_mul(&projected) - correction * (own * &at)[0];
            Ok((predicted - values.row(sample)).norm())
        };
        hull_leave_one_out(samples, &points, outside, predict)
    }
}

/// The QR factors of the design matrix `[sample, term]`.
#[derive(Debug)]
struct Fit {
    degree: usize,
    scaling: Scaling,
    q: DMatrix<f64>,
    r: DMatrix<f64>,
}

impl Fit {
    fn new(method: Polynomial, points: &Points) -> Result<Self, CoeffFieldError> {
        let (samples, terms) = (points.len(), method.term_count());
        let degree = method.degree;
        if samples < terms {
            return Err(CoeffFieldError::TooFewSamples {
                degree,
                terms,
                samples,
            });
        }
        let scaling = Scaling::new(&points.points);
        let rows: Vec<f64> = points
            .points
            .iter()
            .flat_map(|&p| scaling.terms(degree, p))
            .collect();
        let (q, r) = DMatrix::from_row_iterator(samples, terms, rows).qr().unpack();
        let singular = r.singular_values();
        let limit = DEGENERATE * singular.max();
        let rank = singular.iter().filter(|&&s| s > limit).count();
        if rank < terms {
            return Err(CoeffFieldError::Undetermined {
                degree,
                terms,
                samples,
                rank,
            });
        }
        Ok(Self {
            degree,
            scaling,
            q,
            r,
        })
    }
}

fn to_matrix(values: ArrayView2<'_, f64>) -> DMatrix<f64> {
    DMatrix::from_fn(values.nrows(), values.ncols(), |row, column| {
        values[[row, column]]
    })
}

#[derive(Debug)]
struct PolynomialWeights {
    fit: Fit,
    hull: Hull,
}

impl FieldWeights for PolynomialWeights {
    fn sample_count(&self) -> usize {
        self.fit.q.nrows()
    }

    fn node_count(&self) -> usize {
        self.fit.q.ncols()
    }

    fn node_values(&self, sample_values: ArrayView2<'_, f64>) -> Result<Array2<f64>, CoeffFieldError> {
        check_rows(self.sample_count(), sample_values)?;
        let projected = self.fit.q.tr_mul(&to_matrix(sample_values));
        let coefficients = self
            .fit
            .r
            .solve_upper_triangular(&projected)
            .expect("the rank was checked");
        Ok(Array2::from_shape_fn(coefficients.shape(), |index| {
            coefficients[index]
        }))
    }

    fn weights_into(&self, position: Position, weights: &mut WeightList) -> Result<(), FieldError> {
        let p = self.hull.admit(position)?;
        let terms = self.fit.scaling.terms(self.fit.degree, p);
        if !terms.iter().all(|term| term.is_finite()) {
            return Err(external(position, CoeffFieldError::WeightOverflow { position }));
        }
        weights.clear();
        weights.extend(terms.into_iter().enumerate());
        Ok(())
    }

    /// Terms up to degree 1 are linear where the point of evaluation is linear in the position.
    /// That holds everywhere under the policy extend, otherwise within each [`HullPiece`]. Higher
    /// degrees are visited pixel by pixel.
    fn weights_along_row(&self, start: (i64, i64), length: usize, visit: OnRun<'_>) -> Visited {
        let row = Row::new(start, length);
        if self.fit.degree > 1 {
            return pixel_by_pixel(self, row, visit);
        }
        let piece = |column: usize| {
            let p = row.point(column);
            match self.hull.outside {
                OutsidePolicy::Extend => Some(HullPiece::Inside),
                OutsidePolicy::Nearest if self.fit.degree == 0 => Some(HullPiece::Inside),
                OutsidePolicy::Nearest => {
                    let (piece, _) = self.hull.piece(p);
                    (piece == HullPiece::Inside || self.hull.is_precise()).then_some(piece)
                }
                _ => self.hull.contains(p).then_some(HullPiece::Inside),
            }
        };
        in_runs(
            row,
            |column, weights| self.weights_into(row.position(column), weights),
            |column| match piece(column) {
                None => column + 1,
                here => 1 + last_where(column, length, |column| piece(column) == here),
            },
            visit,
        )
    }
}

/// The map from the samples' bounding box to [-1, 1].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scaling {
    centre: Point,
    half: Point,
}

impl Scaling {
    pub(crate) fn new(points: &[Point]) -> Self {
        let ranges = [range(points, 0), range(points, 1)];
        Self {
            centre: ranges.map(|(a, b)| f64::midpoint(a, b)),
            // If all coordinates along an axis are equal, they scale to 0, where every odd term
            // vanishes.
            half: ranges.map(|(a, b)| if a < b { 0.5 * (b - a) } else { 1.0 }),
        }
    }

    /// The terms at a point, ordered by total degree, and for each total degree by falling power of
    /// x.
    pub(crate) fn terms(&self, degree: usize, p: Point) -> Vec<f64> {
        let mut terms = Vec::with_capacity((degree + 1) * (degree + 2) / 2);
        let scaled = [0, 1].map(|axis| (p[axis] - self.centre[axis]) / self.half[axis]);
        let [x, y] = scaled.map(|v| normalised_legendre(degree, v));
        for total in 0..=degree {
            for j in 0..=total {
                terms.push(x[total - j] * y[j]);
            }
        }
        terms
    }
}

/// `sqrt(2n + 1) P_n(v)` for n = 0 to `degree`.
fn normalised_legendre(degree: usize, v: f64) -> Vec<f64> {
    let mut p = legendre(degree, v);
    for (n, value) in p.iter_mut().enumerate() {
        *value *= (2.0 * n as f64 + 1.0).sqrt();
    }
    p
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::InterpolatedField;
    use psf_types::CoefficientField;

    /// Rounding of a well conditioned fit whose values are of order 1.
    const ROUNDING: f64 = 1e-12;

    fn grid(n: usize, scale: f64) -> Vec<Position> {
        let at = |i: usize| scale * i as f64 / (n - 1) as f64;
        (0..n * n)
            .map(|i| Position::new(at(i % n), at(i / n)).unwrap())
            .collect()
    }

    fn samples(positions: Vec<Position>, f: impl Fn(f64, f64) -> f64) -> SampleCoefficients {
        let values = Array2::from_shape_fn((positions.len(), 1), |(i, _)| {
            f(positions[i].x(), positions[i].y())
        });
        SampleCoefficients::new(values, SamplePositions::new(positions, None).unwrap()).unwrap()
    }

    #[test]
    fn a_cubic_is_reproduced_by_degree_three_but_not_by_two() {
        let f = |x: f64, y: f64| {
            let (x, y) = (x / 1e7, y / 1e7);
            1.0 - x + 3.0 * x * y * y + 0.5 * x * x * x - y * y
        };
        let samples = samples(grid(9, 1e7), f);
        let worst = |degree: usize| {
            let method = Polynomial::new(degree).unwrap();
            let field = InterpolatedField::new(&samples, &method, OutsidePolicy::Extend).unwrap();
            let mut value = [0.0];
            (0..50).fold(0.0, |worst: f64, i| {
                let (x, y) = (f64::from(i) * 2e5, f64::from(i * i % 50) * 2e5);
                field
                    .evaluate_into(Position::new(x, y).unwrap(), &mut value)
                    .unwrap();
                worst.max((value[0] - f(x, y)).abs())
            })
        };
        assert!(worst(3) < ROUNDING && worst(2) > 1e-3);
        assert!(worst(8) < ROUNDING * 10.0);
    }

    #[test]
    fn errors_for_too_few_or_degenerate_samples_state_the_counts() {
        let method = Polynomial::new(3).unwrap();
        let prepare = |positions: Vec<Position>| {
            method
                .prepare(
                    &SamplePositions::new(positions, None).unwrap(),
                    OutsidePolicy::Nearest,
                )
                .map(drop)
        };
        assert!(matches!(
            prepare(grid(3, 10.0)),
            Err(CoeffFieldError::TooFewSamples {
                degree: 3,
                terms: 10,
                samples: 9
            })
        ));
        let rows = (0..20).map(|i| Position::of_pixel(i / 2, i % 2)).collect();
        // Two rows: y^2 and y^3 are linear combinations of 1 and y, and x y^2 is one of x and x y.
        assert!(matches!(
            prepare(rows),
            Err(CoeffFieldError::Undetermined {
                terms: 10,
                samples: 20,
                rank: 7,
                ..
            })
        ));
        assert!(Polynomial::new(21).is_err());
    }

    #[test]
    fn weights_that_overflow_are_an_error() {
        let positions = SamplePositions::new(grid(9, 10.0), None).unwrap();
        let weights_of = Polynomial::new(7)
            .unwrap()
            .prepare(&positions, OutsidePolicy::Extend)
            .unwrap();
        let far = Position::new(1e49, 0.0).unwrap();
        assert!(matches!(
            weights_of.weights_into(far, &mut WeightList::new()),
            Err(FieldError::External { .. })
        ));
    }

    #[test]
    fn legendre_values() {
        let p = normalised_legendre(4, 0.5);
        let expected = [1.0, 0.5, -0.125, -0.4375, -0.289_062_5];
        for (n, (got, value)) in p.iter().zip(expected).enumerate() {
            assert!((got - value * (2.0 * n as f64 + 1.0).sqrt()).abs() < 1e-15, "{n}");
        }
    }

    #[test]
    fn terms_are_ordered_by_total_degree() {
        let scaling = Scaling::new(&[[1e7, 3.0], [1e7 + 4.0, 3.0]]);
        // x' = 0.5. All y are equal, so y' = 0.
        let terms = scaling.terms(2, [1e7 + 3.0, 3.0]);
        let s = [1.0, 3.0_f64.sqrt(), 5.0_f64.sqrt()];
        let expected = [1.0, 0.5 * s[1], 0.0, -0.125 * s[2], 0.0, -0.5 * s[2]];
        for (got, expected) in terms.iter().zip(expected) {
            assert!((got - expected).abs() < 1e-15, "{terms:?}");
        }
    }
}
