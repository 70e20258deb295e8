//! The directions that rows span, up to remainders that do not matter.

use ndarray::{Array2, ArrayView2};

use super::norm::{add_scaled, dot};
use crate::simd::vectorized;

/// The remainder of a row counts as rounding if less than this fraction of it is orthogonal to the
/// directions found before.
const MIN_NEW_PART: f64 = 0.5;
/// From one round to the next, the size of the remainders that become directions falls by this
/// factor. A larger one finds fewer directions, but removes few at once from each row.
const ROUND: f64 = 0.1;

/// The part of rows along the last directions that is left out of them.
#[derive(Debug, Default)]
pub(crate) struct LeftOut {
    /// The number of directions that are not left out.
    pub(crate) directions: usize,
    /// The norm of the largest part left out.
    pub(crate) part: f64,
    /// The norm of the largest change by which the other coordinates make up for the part's flux.
    pub(crate) moved: f64,
}

/// Leaves the parts of `rows` along the last directions out, as many as certainly have a norm of at
/// most `limit` in each row. The rows keep their fluxes. `fluxes` are those of the directions.
#[inline(always)]
pub(crate) fn leave_out(rows: &mut Array2<f64>, fluxes: &[f64], limit: f64) -> LeftOut {
    // The bits of magnitudes are ordered like these. NaN exceeds all numbers here, so that no direction
    // with NaN is left out.
    let mut largest = vec![0; rows.ncols()];
    for row in rows.outer_iter() {
        for (most, v) in largest.iter_mut().zip(row.to_slice().expect("row-major")) {
            *most = v.abs().to_bits().max(*most);
        }
    }
    let mut square = 0.0;
    let fits = |&&bits: &&u64| {
        square += f64::from_bits(bits).powi(2);
        square <= limit * limit
    };
    let directions = largest.len() - largest.iter().rev().take_while(fits).count();
    let (kept, last) = fluxes.split_at(directions);
    let square = dot(kept, kept);
    if square == 0.0 {
        let directions = fluxes.len();
        return LeftOut {
            directions,
            ..LeftOut::default()
        };
    }
    let (mut part, mut moved) = (0.0_f64, 0.0_f64);
    for mut row in rows.outer_iter_mut() {
        let row = row.as_slice_mut().expect("row-major");
        let (row, left_out) = row.split_at_mut(directions);
        let flux = dot(left_out, last);
        part = part.max(length(left_out));
        moved = moved.max(flux.abs() / square.sqrt());
        left_out.fill(0.0);
        add_scaled(row, flux / square, kept);
    }
    LeftOut {
        directions,
        part,
        moved,
    }
}

/// Returns orthonormal rows that span `rows` up to remainders, and the norm of the largest
/// remainder, which is at most `stop`.
pub(crate) fn span(rows: ArrayView2<'_, f64>, stop: f64) -> (Array2<f64>, f64) {
    let (count, dimension) = rows.dim();
    // If more than half of all directions are needed, it is faster to keep all.
    let keeps_all = count > dimension;
    let most = if keeps_all { dimension / 2 + 1 } else { dimension };
    let (basis, largest) = vectorized!(directions(rows, stop, most));
    let found = basis.len() / dimension.max(1);
    if keeps_all && found == most {
        return (Array2::eye(dimension), 0.0);
    }
    let rows = Array2::from_shape_vec((found, dimension), basis).expect("a row for each direction");
    (rows, largest)
}

/// At most `most` directions, one after the other, those of large remainders first, and the norm of
/// the largest remainder.
#[inline(always)]
fn directions(rows: ArrayView2<'_, f64>, stop: f64, most: usize) -> (Vec<f64>, f64) {
    let dimension = rows.ncols();
    let mut rest = rows.as_standard_layout().into_owned();
    // For each row, the norm of its remainder, and the length of the basis whose directions are
    // removed from it. Removing later directions can only reduce this norm, up to rounding.
    let mut sizes: Vec<(f64, usize)> = rest
        .outer_iter()
        .map(|row| (length(row.to_slice().expect("row-major")), 0))
        .collect();
    let largest = |sizes: &[(f64, usize)]| sizes.iter().fold(0.0_f64, |m, &(size, _)| m.max(size));
    let mut basis: Vec<f64> = Vec::new();
    let mut limit = largest(&sizes).min(f64::MAX);
    while limit > stop && basis.len() < most * dimension {
        limit = (ROUND * limit).max(stop);
        for (mut row, (size, done)) in rest.outer_iter_mut().zip(&mut sizes) {
            if *size <= limit {
                continue;
            }
            let row = row.as_slice_mut().expect("row-major");
            remove(&basis[*done..], row);
            (*size, *done) = (length(row), basis.len());
            if *size <= limit || basis.len() == most * dimension {
                continue;
            }
            // Removes the rounding errors along earlier directions.
            for value in &mut *row {
                *value /= *size;
            }
            remove(&basis, row);
            let new = length(row);
            *size = 0.0;
            if new >= MIN_NEW_PART {
                basis.extend(row.iter().map(|v| v / new));
            }
        }
    }
    (basis, largest(&sizes).min(stop))
}

#[inline(always)]
fn length(row: &[f64]) -> f64 {
    dot(row, row).sqrt()
}

/// Removes the parts of a row along the directions of a basis.
#[inline(always)]
fn remove(basis: &[f64], row: &mut [f64]) {
    let n = row.len();
    // Four products at once, because one alone leaves the processor idle.
    let together = basis.chunks_exact(4 * n);
    for direction in together.remainder().chunks_exact(n) {
        let p = dot(row, direction);
        add_scaled(row, -p, direction);
    }
    for four in together {
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| &four[i * n..(i + 1) * n]);
        let p = [dot(row, a), dot(row, b), dot(row, c), dot(row, d)];
        for (v, (((a, b), c), d)) in row.iter_mut().zip(a.iter().zip(b).zip(c).zip(d)) {
            *v -= p[0] * a + p[1] * b + p[2] * c + p[3] * d;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::norm::norm;
    use ndarray::{ArrayView1, s};

    #[test]
    fn directions_are_orthonormal_and_leave_little_out() {
        // Rows of rank 2, a small row, a row of zeros, and rows that are no numbers.
        let (a, b) = ([3.0, 4.0, 0.0, 0.0, 0.0, 0.0], [1.0, 0.0, -2.0, 0.0, 1.0, 0.0]);
        let of = |p: f64, q: f64| [0, 1, 2, 3, 4, 5].map(|i| p * a[i] + q * b[i]);
        let mut rows = vec![of(1.0, 0.0), of(-2.0, 1.0), of(1.0, 1e-3), [0.0; 6]];
        rows.push([0.0, 0.0, 0.0, 1e-3, 0.0, 0.0]);
        for no_number in [None, Some(f64::NAN), Some(1e200)] {
            rows.extend(no_number.map(|v| [v; 6]));
            let all = Array2::from_shape_fn((rows.len(), 6), |(i, j)| rows[i][j]);
            let (directions, largest) = span(all.view(), 1e-2);
            let products = directions.dot(&directions.t());
            assert!(
                (products - Array2::<f64>::eye(directions.nrows()))
                    .iter()
                    .all(|v| v.abs() < 1e-14)
            );
            assert!(
                (1e-3..=1e-2).contains(&largest) || no_number == Some(1e200),
                "{largest}"
            );
            for row in all.outer_iter().take(5) {
                let rest = &row - &directions.t().dot(&directions.dot(&row));
                assert!(rest.dot(&rest).sqrt() <= largest + 1e-14, "{no_number:?} {rest}");
            }
            assert!(no_number.is_some() || directions.nrows() == 2);
        }
        for shape in [(0, 0), (3, 0), (0, 3), (2, 1)] {
            assert_eq!(
                span(Array2::zeros(shape).view(), 0.0).0.dim(),
                (0, shape.1),
                "{shape:?}"
            );
        }
    }

    #[test]
    fn all_directions_are_kept_if_most_are_needed() {
        let rows = Array2::from_shape_fn((6, 5), |(i, j)| if i == j || i == 5 { 1.0 } else { 0.1 });
        assert_eq!(span(rows.view(), 1e-9), (Array2::eye(5), 0.0));
    }

    #[test]
    fn rows_without_their_last_directions_keep_their_fluxes() {
        let rows = Array2::from_shape_fn((4, 6), |(i, j)| {
            0.1_f64.powi(j as i32) * (1.0 + ((3 * i + 5 * j) % 7) as f64)
        });
        let fluxes = [0.3, -0.2, 0.5, 0.1, 0.4, 2.0];
        let flux = |row: ArrayView1<'_, f64>| dot(&row.to_vec(), &fluxes);
        for last in [f64::NAN, f64::INFINITY] {
            let mut rows = rows.clone();
            rows[[1, 5]] = last;
            assert_eq!(leave_out(&mut rows, &fluxes, 1e-2).directions, 6);
        }
        for (limit, directions) in [(0.0, 6), (1e-4, 5), (1e-3, 4), (1e-2, 3), (1e-1, 2), (1e3, 6)] {
            let mut short = rows.clone();
            let left_out = leave_out(&mut short, &fluxes, limit);
            assert_eq!(left_out.directions, directions);
            assert!(short.slice(s![.., directions..]).iter().all(|&v| v == 0.0));
            let part = |row: ArrayView1<'_, f64>| norm(row.slice(s![directions..]));
            let largest = rows.outer_iter().map(part).fold(0.0, f64::max);
            assert!((left_out.part / largest - 1.0).abs() < 1e-15 || directions == 6);
            assert!(directions == 6 || largest <= limit);
            for (before, after) in rows.outer_iter().zip(short.outer_iter()) {
                assert!((flux(before) - flux(after)).abs() < 1e-14);
                let mut moved = &after - &before;
                moved.slice_mut(s![directions..]).fill(0.0);
                assert!(norm(moved.view()) <= left_out.moved + 1e-14);
            }
        }
    }
}
