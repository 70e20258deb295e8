//! Functions of the position that are polynomials in a region.

use std::f64::consts::PI;

use nalgebra::{DMatrix, SymmetricEigen};
use ndarray::{Array2, Array3, ArrayView2};
use psf_types::{CoefficientField, PixelRegion, Position};

use super::checked_cells::evaluate_each;
use super::norm::{dot, norm};
use super::span::span;
use crate::ConvReal;

/// Polynomials in x and y, by their values at Chebyshev's points, which are dense near the edges of the
/// region. Lagrange's formula gives their values in between (Berrut and Trefethen 2004, SIAM Review 46, 501).
#[derive(Debug)]
pub(crate) struct Polynomials<T> {
    /// `[function, point along y, point along x]`.
    values: Array3<T>,
    /// The weights of the points in each column, `[point, column]`.
    in_columns: Array2<T>,
    /// The weights of the points in each row, `[row, point]`.
    in_rows: Array2<T>,
}

/// The degrees along each axis that are tried. Each is compared with the next one at the points of the next
/// one, so the last degree is only compared with.
const DEGREES: [usize; 4] = [3, 6, 12, 24];
/// The most points along an axis.
const MOST_POINTS: usize = DEGREES[DEGREES.len() - 2] + 1;
/// The fraction of the tolerance that is left to the polynomials. The functions have the rest.
const SHARE_OF_POLYNOMIALS: f64 = 0.3;
/// Directions that hold less than this fraction of the functions' share are left out at first.
const OUTSIDE_SPAN: f64 = 0.1;

impl<T: ConvReal> Polynomials<T> {
    /// A few functions `f_m` and shares `s` `[function, component]` with which a field is
    /// `a_j(x) = sum_m f_m(x) s_mj`, up to the tolerance times its norm. None if polynomials of the highest
    /// degree are not accurate enough, or if the field has no value somewhere.
    pub(crate) fn of_field(
        field: &dyn CoefficientField,
        region: PixelRegion,
        tolerance: f64,
    ) -> Option<(Self, Array2<f64>)> {
        let (nx, ny) = (region.shape().nx(), region.shape().ny());
        let degree_of = |pixels: usize, degree: usize| if pixels == 1 { 0 } else { degree };
        let mut coarse: Option<(Grid, Array2<f64>)> = None;
        for degree in DEGREES {
            let grid = Grid {
                x: points(nx, degree_of(nx, degree)),
                y: points(ny, degree_of(ny, degree)),
            };
            let values = grid.values_of(field, region)?;
            if let Some((before, of_before)) = &coarse {
                let difference = before.at(&grid.x, &grid.y, of_before.view()) - &values;
                let fits = difference
                    .outer_iter()
                    .zip(values.outer_iter())
                    .all(|(difference, value)| {
                        norm(difference) <= SHARE_OF_POLYNOMIALS * tolerance * norm(value)
                    });
                if fits {
                    let shares = shares(values.view(), (1.0 - SHARE_OF_POLYNOMIALS) * tolerance);
                    return Some((Self::new(before, of_before.dot(&shares.t()), (nx, ny)), shares));
                }
            }
            coarse = Some((grid, values));
        }
        None
    }

    /// `values` are those at the points, `[point, function]`.
    fn new(grid: &Grid, values: Array2<f64>, (nx, ny): (usize, usize)) -> Self {
        let pixels = |count: usize| (0..count).map(|i| i as f64).collect::<Vec<_>>();
        let shape = (values.ncols(), grid.y.len(), grid.x.len());
        let in_columns = weights(&grid.x, &pixels(nx));
        let values = values.t().iter().map(|&v| T::nearest(v)).collect();
        Self {
            values: Array3::from_shape_vec(shape, values).expect("a value for each point"),
            in_columns: Array2::from_shape_fn((grid.x.len(), nx), |(i, x)| T::nearest(in_columns[[x, i]])),
            in_rows: weights(&grid.y, &pixels(ny)).mapv(T::nearest),
        }
    }

    /// Writes a function along a row, from the column `first` on.
    #[inline(always)]
    pub(crate) fn along_row(&self, function: usize, row: usize, first: usize, into: &mut [T]) {
        // The polynomial in x of this row, by its values at the points along x.
        let mut of_row = [T::zero(); MOST_POINTS];
        let (_, along_y, along_x) = self.values.dim();
        let values = &self.values.as_slice().expect("row-major")[function * along_y * along_x..];
        let weights = &self.in_rows.as_slice().expect("row-major")[row * along_y..];
        for (values, &weight) in values.chunks_exact(along_x).zip(weights).take(along_y) {
            for (sum, &value) in of_row.iter_mut().zip(values) {
                *sum += weight * value;
            }
        }
        into.fill(T::zero());
        let width = self.in_columns.ncols();
        let in_columns = self.in_columns.as_slice().expect("row-major").chunks_exact(width);
        for (in_columns, &value) in in_columns.zip(&of_row) {
            for (into, &weight) in into.iter_mut().zip(&in_columns[first..]) {
                *into += value * weight;
            }
        }
    }
}

/// Points along x and along y, counted from the first pixel of a region.
struct Grid {
    x: Vec<f64>,
    y: Vec<f64>,
}

impl Grid {
    /// The field at the points, `[point, component]`, row by row. None if it has no value at one of them.
    fn values_of(&self, field: &dyn CoefficientField, region: PixelRegion) -> Option<Array2<f64>> {
        let first = region.position(0, 0);
        let at = self
            .y
            .iter()
            .flat_map(|y| self.x.iter().map(move |x| (first.x() + x, first.y() + y)));
        let at: Vec<Position> = at.map(|(x, y)| Position::new(x, y).ok()).collect::<Option<_>>()?;
        let mut values = Array2::zeros((at.len(), field.component_count()));
        evaluate_each(field, &at, values.view_mut());
        values.iter().all(|v| v.is_finite()).then_some(values)
    }

    /// The polynomials through `values` `[point, component]`, at other points, row by row.
    fn at(&self, x: &[f64], y: &[f64], values: ArrayView2<'_, f64>) -> Array2<f64> {
        let (along_x, along_y) = (weights(&self.x, x), weights(&self.y, y));
        let mut found = Array2::zeros((x.len() * y.len(), values.ncols()));
        for (component, column) in values.columns().into_iter().enumerate() {
            let of_points = column
                .to_owned()
                .into_shape_with_order((self.y.len(), self.x.len()));
            let there = along_y.dot(&of_points.expect("contiguous")).dot(&along_x.t());
            found
                .column_mut(component)
                .assign(&there.into_iter().collect::<ndarray::Array1<_>>());
        }
        found
    }
}

/// Chebyshev's points of the second kind for a polynomial of this degree, from the first to the last pixel.
fn points(pixels: usize, degree: usize) -> Vec<f64> {
    let last = (pixels - 1) as f64;
    let point = |i: usize| 0.5 * last * (1.0 - (PI * i as f64 / degree as f64).cos());
    if degree == 0 {
        vec![0.0]
    } else {
        (0..=degree).map(point).collect()
    }
}

/// The weights of Chebyshev's points `[place, point]` in the polynomial at some places.
fn weights(points: &[f64], places: &[f64]) -> Array2<f64> {
    let last = points.len() - 1;
    let factor = |i: usize| {
        let sign = if i.is_multiple_of(2) { 1.0 } else { -1.0 };
        if i == 0 || i == last { 0.5 * sign } else { sign }
    };
    let mut weights = Array2::zeros((places.len(), points.len()));
    for (mut row, &place) in weights.outer_iter_mut().zip(places) {
        if let Some(i) = points.iter().position(|&point| point == place) {
            row[i] = 1.0;
            continue;
        }
        for (i, (weight, &point)) in row.iter_mut().zip(points).enumerate() {
            *weight = factor(i) / (place - point);
        }
        let sum = row.sum();
        row /= sum;
    }
    weights
}

/// Orthonormal rows `[row, component]`, as few as span every row of `values` up to the tolerance times its
/// norm.
fn shares(values: ArrayView2<'_, f64>, tolerance: f64) -> Array2<f64> {
    let sizes: Vec<f64> = values.outer_iter().map(|row| norm(row)).collect();
    let least = sizes.iter().copied().fold(f64::INFINITY, f64::min);
    let (span, outside) = span(values, OUTSIDE_SPAN * tolerance * least);
    // Principal axes are fewer than the directions found one after the other.
    let coordinates = values.dot(&span.t());
    let count = coordinates.ncols();
    let product = coordinates.t().dot(&coordinates);
    let eigen = SymmetricEigen::new(DMatrix::from_fn(count, count, |i, j| product[[i, j]]));
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    let axes = Array2::from_shape_fn((count, count), |(i, j)| eigen.eigenvectors[(i, order[j])]);
    let turned = coordinates.dot(&axes);
    let mut needed = 0;
    for (row, &size) in turned.outer_iter().zip(&sizes) {
        let row = row.to_slice().expect("row-major");
        let limit = (tolerance * size).powi(2) - outside.powi(2);
        while needed < count && dot(&row[needed..], &row[needed..]) > limit {
            needed += 1;
        }
    }
    axes.slice_move(ndarray::s![.., ..needed]).t().dot(&span)
}

#[cfg(test)]
mod tests {
    use psf_types::{FieldError, FrameShape};

    use super::*;

    /// Smooth functions with a common factor.
    #[derive(Debug)]
    struct Smooth;

    impl CoefficientField for Smooth {
        fn component_count(&self) -> usize {
            5
        }
        fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
            for (k, a) in a.iter_mut().enumerate() {
                *a = 1.0 + (0.01 * (k + 1) as f64 * p.x() - 0.02 * p.y()).sin();
            }
            Ok(())
        }
    }

    /// A step.
    #[derive(Debug)]
    struct Step;

    impl CoefficientField for Step {
        fn component_count(&self) -> usize {
            1
        }
        fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
            a[0] = if p.x() > 17.3 { 2.0 } else { 1.0 };
            Ok(())
        }
    }

    #[test]
    fn a_smooth_field_is_a_sum_of_few_functions() {
        for (nx, ny) in [(60, 40), (1, 40), (60, 1), (1, 1)] {
            let region = PixelRegion::new(-3, 5, FrameShape::new(nx, ny).unwrap());
            for tolerance in [1e-2, 1e-5, 1e-10] {
                let (functions, shares) = Polynomials::<f64>::of_field(&Smooth, region, tolerance).unwrap();
                let (mut row, mut expected) = (vec![f64::NAN; nx], [0.0; 5]);
                let mut found = Array2::<f64>::zeros((nx, 5));
                for y in 0..ny {
                    found.fill(0.0);
                    for (m, shares) in shares.outer_iter().enumerate() {
                        functions.along_row(m, y, 0, &mut row);
                        for (mut found, &value) in found.outer_iter_mut().zip(&row) {
                            found.scaled_add(value, &shares);
                        }
                    }
                    for (x, found) in found.outer_iter().enumerate() {
                        Smooth
                            .evaluate_into(region.position(x, y), &mut expected)
                            .unwrap();
                        let expected = ndarray::ArrayView1::from(&expected);
                        let error = norm((&found - &expected).view());
                        assert!(
                            error <= tolerance * norm(expected),
                            "{tolerance} {x} {y}: {error:e}"
                        );
                    }
                }
                assert!(tolerance < 1e-3 || shares.nrows() < 5);
            }
        }
    }

    #[test]
    fn a_step_is_no_polynomial() {
        let region = PixelRegion::new(0, 0, FrameShape::new(40, 30).unwrap());
        assert!(Polynomials::<f32>::of_field(&Step, region, 1e-3).is_none());
    }
}
