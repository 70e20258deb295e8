//! The directions that rows span, up to remainders that do not matter.

use ndarray::{Array2, ArrayView2};

use super::norm::dot;
use crate::simd::{Lanes, SimdReal as _, WithIsa};

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
    // If most directions are needed, it is faster to keep all.
    let most = if count > dimension {
        dimension / 2 + 1
    } else {
        dimension
    };
    let (basis, largest) = f64::dispatch(Span {
        rest: rows.as_standard_layout().as_slice().expect("row-major").to_vec(),
        dimension: dimension.max(1),
        most,
        stop,
    });
    let found = basis.len() / dimension.max(1);
    if found == most && count > dimension {
        return (Array2::eye(dimension), 0.0);
    }
    let rows = Array2::from_shape_vec((found, dimension), basis).expect("a row for each direction");
    (rows, largest)
}

/// Rows whose remainders become directions, the large ones first.
struct Span {
    /// The remainders, one after the other.
    rest: Vec<f64>,
    dimension: usize,
    /// The largest number of directions.
    most: usize,
    stop: f64,
}

impl WithIsa<f64> for Span {
    type Output = (Vec<f64>, f64);

    #[inline(always)]
    fn run<S: Lanes<f64>>(self, simd: S) -> Self::Output {
        simd.vectorized(
            #[inline(always)]
            || self.find(),
        )
    }
}

impl Span {
    #[inline(always)]
    fn find(mut self) -> (Vec<f64>, f64) {
        let dimension = self.dimension;
        let norm = |row: &[f64]| dot(row, row).sqrt();
        // For each row, the norm of its remainder, and the length of the basis whose directions are
        // removed from it. Other directions make it only smaller.
        let rows = self.rest.chunks_exact(dimension);
        let mut sizes: Vec<(f64, usize)> = rows.map(|row| (norm(row), 0)).collect();
        let largest = |sizes: &[(f64, usize)]| sizes.iter().fold(0.0_f64, |m, &(size, _)| m.max(size));
        let mut basis: Vec<f64> = Vec::new();
        let mut limit = largest(&sizes);
        while limit > self.stop && basis.len() < self.most * dimension {
            limit = (ROUND * limit).max(self.stop);
            for (row, (size, done)) in self.rest.chunks_exact_mut(dimension).zip(&mut sizes) {
                if *size <= limit {
                    continue;
                }
                remove(&basis[*done..], row);
                (*size, *done) = (norm(row), basis.len());
                if *size <= limit || basis.len() == self.most * dimension {
                    continue;
                }
                // Removes the rounding errors along earlier directions.
                row.iter_mut().for_each(|v| *v /= *size);
                remove(&basis, row);
                let new = norm(row);
                *size = 0.0;
                if new >= MIN_NEW_PART {
                    basis.extend(row.iter().map(|v| v / new));
                }
            }
        }
        (basis, largest(&sizes).min(self.stop))
    }
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
