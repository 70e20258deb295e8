//! The directions that rows span, up to remainders that do not matter.

use ndarray::{Array2, ArrayView2};

use super::norm::dot;
use crate::simd::{Lanes, SimdReal as _, WithIsa};

/// The remainder of a row counts as rounding if less than this fraction of it is orthogonal to the
/// directions found before.
const MIN_NEW_PART: f64 = 0.5;

/// Returns orthonormal rows that span `rows` up to remainders, and the norm of the largest
/// remainder, which is at most `stop`.
pub(crate) fn span(rows: ArrayView2<'_, f64>, stop: f64) -> (Array2<f64>, f64) {
    let (count, dimension) = rows.dim();
    let mut rest: Vec<f64> = rows.iter().copied().collect();
    let mut norms: Vec<f64> = rest
        .chunks_exact(dimension.max(1))
        .map(|row| dot(row, row))
        .collect();
    let mut basis: Vec<f64> = Vec::new();
    let mut found = 0;
    let largest = loop {
        let largest = (0..norms.len()).max_by(|&a, &b| norms[a].total_cmp(&norms[b]));
        let Some((row, size)) = largest.map(|row| (row, norms[row].sqrt())) else {
            break 0.0;
        };
        if size <= stop || found == dimension {
            break size.min(stop);
        }
        if 2 * found > dimension && count > dimension {
            // Most directions are needed, so it is faster to keep all.
            return (Array2::eye(dimension), 0.0);
        }
        let of_row = &mut rest[row * dimension..(row + 1) * dimension];
        let mut direction: Vec<f64> = of_row.iter().map(|v| v / size).collect();
        of_row.fill(0.0);
        norms[row] = 0.0;
        // Removes the rounding errors along earlier directions.
        for earlier in basis.chunks_exact(dimension) {
            let p = dot(earlier, &direction);
            direction.iter_mut().zip(earlier).for_each(|(v, e)| *v -= p * e);
        }
        let new = dot(&direction, &direction).sqrt();
        if new < MIN_NEW_PART {
            continue;
        }
        for value in &mut *direction {
            *value /= new;
        }
        let (rows, norms) = (&mut rest[..], &mut norms[..]);
        f64::dispatch(RemoveDirection {
            rows,
            norms,
            direction: &direction,
        });
        basis.extend(direction);
        found += 1;
    };
    let rows = Array2::from_shape_vec((found, dimension), basis).expect("a row for each direction");
    (rows, largest)
}

/// Makes rows orthogonal to a direction and computes their squared norms.
struct RemoveDirection<'a> {
    rows: &'a mut [f64],
    norms: &'a mut [f64],
    direction: &'a [f64],
}

impl WithIsa<f64> for RemoveDirection<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Lanes<f64>>(self, simd: S) {
        simd.vectorized(
            #[inline(always)]
            || {
                let rows = self.rows.chunks_exact_mut(self.direction.len());
                for (row, norm) in rows.zip(self.norms) {
                    let p = dot(row, self.direction);
                    for (v, d) in row.iter_mut().zip(self.direction) {
                        *v -= p * d;
                    }
                    *norm = dot(row, row);
                }
            },
        );
    }
}
