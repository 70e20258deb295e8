//! The directions that rows span, up to remainders that do not matter.

use ndarray::{Array2, ArrayView2};

use super::norm::dot;
use crate::simd::vectorized;

/// The remainder of a row counts as rounding if less than this fraction of it is orthogonal to the
/// directions found before.
const MIN_NEW_PART: f64 = 0.5;
/// From one round to the next, the size of the remainders that become directions falls by this
/// factor.
const ROUND: f64 = 0.5;

/// Returns orthonormal rows that span `rows` up to remainders, and the norm of the largest
/// remainder, which is at most `stop`.
pub(crate) fn span(rows: ArrayView2<'_, f64>, stop: f64) -> (Array2<f64>, f64) {
    let (count, dimension) = rows.dim();
    let (basis, largest) = vectorized!(directions(rows, stop));
    let found = basis.len() / dimension.max(1);
    if 2 * found > dimension && count > dimension {
        // Most directions are needed, so it is faster to keep all.
        return (Array2::eye(dimension), 0.0);
    }
    let rows = Array2::from_shape_vec((found, dimension), basis).expect("a row for each direction");
    (rows, largest)
}

/// The directions of large remainders first, one after the other, and the norm of the largest
/// remainder. Stops when most directions are found if there are more rows.
#[inline(always)]
fn directions(rows: ArrayView2<'_, f64>, stop: f64) -> (Vec<f64>, f64) {
    let (count, dimension) = rows.dim();
    let most = if count > dimension {
        dimension / 2 + 1
    } else {
        dimension
    };
    let mut rest = rows.as_standard_layout().into_owned();
    let norm = |row: &[f64]| dot(row, row).sqrt();
    // For each row, the norm of its remainder, and the length of the basis whose directions are
    // removed from it. Other directions make it only smaller.
    let mut sizes: Vec<(f64, usize)> = rest.outer_iter().map(|row| (row.dot(&row).sqrt(), 0)).collect();
    let largest = |sizes: &[(f64, usize)]| sizes.iter().fold(0.0_f64, |m, &(size, _)| m.max(size));
    let mut basis: Vec<f64> = Vec::new();
    let mut limit = largest(&sizes);
    while limit > stop && basis.len() < most * dimension {
        limit = (ROUND * limit).max(stop);
        for (mut row, (size, done)) in rest.outer_iter_mut().zip(&mut sizes) {
            if *size <= limit {
                continue;
            }
            let row = row.as_slice_mut().expect("row-major");
            remove(&basis[*done..], row);
            (*size, *done) = (norm(row), basis.len());
            if *size <= limit || basis.len() == most * dimension {
                continue;
            }
            // Removes the rounding errors along earlier directions.
            for value in &mut *row {
                *value /= *size;
            }
            remove(&basis, row);
            let new = norm(row);
            *size = 0.0;
            if new >= MIN_NEW_PART {
                basis.extend(row.iter().map(|v| v / new));
            }
        }
    }
    (basis, largest(&sizes).min(stop))
}

/// Removes the parts of a row along the directions of a basis.
#[inline(always)]
fn remove(basis: &[f64], row: &mut [f64]) {
    let n = row.len();
    // Several products at once, because each of them waits for its own sums.
    let together = basis.chunks_exact(4 * n);
    for direction in together.remainder().chunks_exact(n) {
        let p = dot(row, direction);
        row.iter_mut().zip(direction).for_each(|(v, d)| *v -= p * d);
    }
    for four in together {
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| &four[i * n..(i + 1) * n]);
        let p = [dot(row, a), dot(row, b), dot(row, c), dot(row, d)];
        for (v, (((a, b), c), d)) in row.iter_mut().zip(a.iter().zip(b).zip(c).zip(d)) {
            *v -= p[0] * a + p[1] * b + p[2] * c + p[3] * d;
        }
    }
}
