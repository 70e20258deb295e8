//! One polynomial over the whole field, by least squares.

use nalgebra::DMatrix;
use ndarray::{Array2, ArrayView2};
use psf_types::maths::{legendre, term_count};
use psf_types::{
    BilinearCells, ErrorLimit, FieldError, Interpolation, OutsidePolicy, PixelRegion, Position,
    SampleCoefficients, SamplePositions,
};

use crate::error::CoeffFieldError;
use crate::field::interpolated;
use crate::geometry::{Hull, HullPiece, Point, Points, external, length, pixel_ranges, range, sub};
use crate::interpolation::{
    FieldInterpolation, FieldWeights, Interpolated, Outcomes, Unpredictable, WeightList, check_rows,
    hull_leave_one_out,
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
        term_count(self.degree)
    }
}

impl FieldInterpolation for Polynomial {
    fn interpolate(&self, samples: &SampleCoefficients, outside: OutsidePolicy) -> Interpolated {
        interpolated(
            samples,
            PolynomialWeights::new(*self, samples.positions(), outside)?,
        )
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
            let terms = nalgebra::DVector::from_vec(fit.scaling.terms(self.degree, at).collect());
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
        weights.clear();
        weights.extend(self.fit.scaling.terms(self.fit.degree, p).enumerate());
        if weights.iter().all(|(_, term)| term.is_finite()) {
            Ok(())
        } else {
            Err(external(position, CoeffFieldError::WeightOverflow { position }))
        }
    }

    /// In a cell of `m` by `n` pixels, the bilinear function through the values at the corners is
    /// off by at most `(m^2 max|a_xx| + n^2 max|a_yy|) / 8`, with the sizes ([`ErrorLimit`]) of the
    /// second derivatives. Both parts use half of the error.
    fn bilinear_cells(
        &self,
        values: ArrayView2<'_, f64>,
        region: PixelRegion,
        error: ErrorLimit<'_>,
    ) -> BilinearCells {
        let Some(derivatives) = self.second_derivatives(region) else {
            return BilinearCells::Divide;
        };
        let mut achieved = 0.0;
        let mut along = |axis: usize, first: i64, pixels: usize| {
            let mut middle = vec![0.0; values.ncols()];
            let mut bound = 0.0;
            for (values, of_term) in values.outer_iter().zip(&derivatives) {
                let (at_middle, deviation) = of_term[axis];
                let values = values.as_slice().expect("row-major");
                for (sum, value) in middle.iter_mut().zip(values) {
                    *sum += at_middle * value;
                }
                bound += deviation * error.product(values, values).sqrt();
            }
            bound += error.product(&middle, &middle).sqrt();
            let steps = if bound == 0.0 {
                pixels
            } else {
                ((4.0 * error.size / bound).sqrt() as usize).clamp(1, pixels)
            };
            let count = (pixels - 1).div_ceil(steps);
            let step = (pixels - 1) as f64 / count.max(1) as f64;
            if step > 1.0 {
                achieved += step * step * bound / 8.0;
            }
            (1..count).map(|i| first as f64 + i as f64 * step).collect()
        };
        BilinearCells::Lines {
            x: along(0, region.x0(), region.shape().nx()),
            y: along(1, region.y0(), region.shape().ny()),
            error: achieved,
        }
    }
}

impl PolynomialWeights {
    fn new(
        method: Polynomial,
        positions: &SamplePositions,
        outside: OutsidePolicy,
    ) -> Result<Self, CoeffFieldError> {
        let points = Points::new(positions)?;
        Ok(Self {
            fit: Fit::new(method, &points)?,
            hull: Hull::new(&points, outside)?,
        })
    }

    /// Each term's second derivatives by xx and yy in a region: the value at the middle, and a bound
    /// of the differences from it. `None` if terms have a kink in the region, or no value.
    fn second_derivatives(&self, region: PixelRegion) -> Option<Vec<[(f64, f64); 2]>> {
        let [(x0, x1), (y0, y1)] = pixel_ranges(region);
        let corners = [[x0, y0], [x1, y0], [x0, y1], [x1, y1]];
        // The piece of the plane with the whole region. Pieces are convex, so the corners tell.
        let pieces = corners.map(|p| match self.hull.outside {
            OutsidePolicy::Extend => (HullPiece::Inside, p),
            _ => self.hull.piece(p),
        });
        let piece = pieces[0].0;
        let is_outside = self.hull.outside == OutsidePolicy::Nearest && self.hull.is_precise();
        let is_single = corners[0] == corners[3];
        if !is_single
            && (pieces.iter().any(|other| other.0 != piece) || piece != HullPiece::Inside && !is_outside)
        {
            return None;
        }
        let places = pieces.map(|(_, p)| p);
        let ranges = [0, 1].map(|axis| range(&places, axis));
        let derivatives = self.fit.scaling.second_derivatives(self.fit.degree, ranges);
        // Along x and y, the point of evaluation moves by `step[0]` and `step[1]`.
        let steps = match piece {
            HullPiece::Inside => [[1.0, 0.0], [0.0, 1.0]],
            HullPiece::Corner(_) => [[0.0; 2]; 2],
            // The point is the projection of the position on an edge along (u, v).
            HullPiece::Edge(_) => {
                let [u, v] = unit_vector(&places);
                [[u * u, u * v], [u * v, v * v]]
            }
        };
        let of_term = |term: [(f64, f64); 3]| {
            steps.map(|[u, v]| {
                let factors = [u * u, 2.0 * u * v, v * v];
                let terms = term.iter().zip(factors);
                terms.fold((0.0, 0.0), |sum, (d, f)| (sum.0 + f * d.0, sum.1 + f.abs() * d.1))
            })
        };
        Some(derivatives.into_iter().map(of_term).collect())
    }
}

/// The direction of the line on which some points lie.
fn unit_vector(points: &[Point]) -> [f64; 2] {
    let longest = points
        .iter()
        .map(|&p| sub(p, points[0]))
        .fold(
            [0.0; 2],
            |longest, d| if length(d) > length(longest) { d } else { longest },
        );
    longest.map(|d| d / length(longest).max(f64::MIN_POSITIVE))
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

    fn scaled(&self, axis: usize, coordinate: f64) -> f64 {
        (coordinate - self.centre[axis]) / self.half[axis]
    }

    /// Each term's second derivatives by xx, xy and yy in a rectangle, in the order of
    /// [`terms`](Self::terms): the value at the middle, and a bound of the differences from it.
    fn second_derivatives(&self, degree: usize, ranges: [(f64, f64); 2]) -> Vec<[(f64, f64); 3]> {
        let [x, y] = [0, 1].map(|axis| {
            let (low, high) = ranges[axis];
            derivatives(degree, (self.scaled(axis, low), self.scaled(axis, high)))
        });
        let [a, b] = self.half;
        let product = |x: (f64, f64), y: (f64, f64), scale: f64| {
            let middle = x.0 * y.0;
            (
                middle / scale,
                (x.1 * y.1 * ROUNDING_OF_BOUNDS - middle.abs()) / scale,
            )
        };
        let of_term = |(i, j): (usize, usize)| {
            [
                product(x[i][2], y[j][0], a * a),
                product(x[i][1], y[j][1], a * b),
                product(x[i][0], y[j][2], b * b),
            ]
        };
        orders(degree).map(of_term).collect()
    }

    /// The terms at a point, ordered by total degree, and for each total degree by falling power of
    /// x.
    pub(crate) fn terms(&self, degree: usize, p: Point) -> impl Iterator<Item = f64> {
        let scaled = [0, 1].map(|axis| self.scaled(axis, p[axis]));
        let [x, y] = scaled.map(|v| normalised_legendre(degree, v));
        orders(degree).map(move |(i, j)| x[i] * y[j])
    }
}

/// The orders in x and y of each term, up to a total degree.
fn orders(degree: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..=degree).flat_map(|total| (0..=total).map(move |j| (total - j, j)))
}

/// The derivatives of order 0 to 2 of `sqrt(2n + 1) P_n` in a range, for n = 0 to `degree`: the value
/// at the middle of the range and an upper bound of the magnitude. The bound is the sum of the
/// magnitudes in the Taylor series about the middle.
fn derivatives(degree: usize, (low, high): (f64, f64)) -> Vec<[(f64, f64); 3]> {
    let (middle, half) = (f64::midpoint(low, high), 0.5 * (high - low).abs());
    // The derivatives at the middle, `[order][n]`, from P'_(n+1) = P'_(n-1) + (2n + 1) P_n.
    let mut all = vec![legendre(degree, middle)];
    for order in 1..=degree.max(2) {
        let before = &all[order - 1];
        let mut of_order = vec![0.0; degree + 1];
        for n in 1..=degree {
            let earlier = if n >= 2 { of_order[n - 2] } else { 0.0 };
            of_order[n] = earlier + (2.0 * n as f64 - 1.0) * before[n - 1];
        }
        all.push(of_order);
    }
    let of_order = |n: usize, order: usize| {
        let (mut sum, mut power) = (0.0, 1.0);
        for (step, of_order) in all[order..].iter().enumerate() {
            sum += of_order[n].abs() * power;
            power *= half / (step + 1) as f64;
        }
        let scale = (2.0 * n as f64 + 1.0).sqrt();
        (all[order][n] * scale, sum * scale)
    };
    (0..=degree)
        .map(|n| [0, 1, 2].map(|order| of_order(n, order)))
        .collect()
}

/// Bounds are larger by this factor than their sums, which are rounded.
const ROUNDING_OF_BOUNDS: f64 = 1.0 + 1e-12;

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
            let field = method.interpolate(&samples, OutsidePolicy::Extend).unwrap();
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
            let positions = SamplePositions::new(positions, None).unwrap();
            PolynomialWeights::new(method, &positions, OutsidePolicy::Nearest).map(drop)
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
        let method = Polynomial::new(7).unwrap();
        let weights_of = PolynomialWeights::new(method, &positions, OutsidePolicy::Extend).unwrap();
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
        let terms: Vec<f64> = scaling.terms(2, [1e7 + 3.0, 3.0]).collect();
        let s = [1.0, 3.0_f64.sqrt(), 5.0_f64.sqrt()];
        let expected = [1.0, 0.5 * s[1], 0.0, -0.125 * s[2], 0.0, -0.5 * s[2]];
        for (got, expected) in terms.iter().zip(expected) {
            assert!((got - expected).abs() < 1e-15, "{terms:?}");
        }
    }
}
