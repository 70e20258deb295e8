//! The stamps of a model as interpolation coefficients that are sorted by sub-pixel phase.

use ndarray::{Array2, Axis};
use pulp::bytemuck::{cast_slice, cast_slice_mut};
use rayon::prelude::*;

use super::phases::PhasedAxis;
use super::star_block::RowLayout;
use crate::ConvReal;
use crate::simd::{Aligned, Lanes, WithIsa, vectorized};
use crate::stamp_interpolator::StampInterpolator;

/// The stamps of the directions of [`PsfSpace`](crate::plan::psf_space::PsfSpace). Blocks combine
/// them to kernels.
#[derive(Debug)]
pub(super) struct PhasedStamps<T> {
    /// `[row, direction, chunk, residue, pixel]`. `row` counts the rows of coefficients of the
    /// oversampled stamp, in the order of the stamp. Rows that no star can use are left out
    /// ([`PhasedAxis`]). [`RowLayout`] explains the last three indices.
    values: Aligned<T>,
    directions: usize,
    /// The number of values in a row of one direction.
    length: usize,
}

impl<T: ConvReal> PhasedStamps<T> {
    /// Sorts the coefficients of the directions' stamps.
    pub(super) fn new(
        stamps: &[StampInterpolator],
        [columns, rows]: &[PhasedAxis; 2],
        layout: RowLayout,
    ) -> Self {
        let (directions, length) = (stamps.len(), layout.kernel);
        let mut values = Aligned::zeros(rows.kept * directions * length);
        let columns: Vec<Option<usize>> = (0..length)
            .map(|at| {
                let (pixel, residue) = layout.place(at);
                let column = pixel * columns.oversampling + residue;
                columns.index(column).filter(|_| column < columns.kept)
            })
            .collect();
        let rows_of_all = values.get_mut().par_chunks_mut((directions * length).max(1));
        rows_of_all.enumerate().for_each(|(row, to)| {
            let Some(j) = rows.index(row) else { return };
            for (stamp, to) in stamps.iter().zip(to.chunks_exact_mut(length)) {
                let from = stamp.coefficients().index_axis(Axis(0), j);
                for (value, i) in to.iter_mut().zip(&columns) {
                    if let Some(i) = *i {
                        *value = T::nearest(from[i]);
                    }
                }
            }
        });
        Self {
            values,
            directions,
            length,
        }
    }

    /// Combinations `[kernel, direction]` of the stamps, `[row, kernel, chunk, residue, pixel]`.
    pub(super) fn combined(&self, kernels: &Array2<f64>) -> Aligned<T> {
        T::dispatch(Combine {
            stamps: self,
            kernels,
        })
    }
}

/// Kernels that are computed together.
const TOGETHER: usize = 4;
/// Vectors of a row that are computed together.
const WIDE: usize = 3;

/// The work of [`PhasedStamps::combined`].
struct Combine<'a, T> {
    stamps: &'a PhasedStamps<T>,
    kernels: &'a Array2<f64>,
}

impl<T: ConvReal> WithIsa<T> for Combine<'_, T> {
    type Output = Aligned<T>;

    fn run<S: Lanes<T>>(self, simd: S) -> Aligned<T> {
        let PhasedStamps {
            values,
            directions,
            length,
        } = self.stamps;
        let count = self.kernels.nrows();
        // The factors of some kernels, `[direction, kernel]`. Missing kernels have the factor 0.
        let factors: Vec<Vec<[T; TOGETHER]>> = (0..count)
            .step_by(TOGETHER)
            .map(|first| {
                let column = |direction| {
                    std::array::from_fn(|k| match self.kernels.get((first + k, direction)) {
                        Some(&factor) => T::nearest(factor),
                        None => T::zero(),
                    })
                };
                (0..*directions).map(column).collect()
            })
            .collect();
        let rows = values.get().len() / (directions * length).max(1);
        let mut combined = Aligned::zeros(rows * count * length);
        vectorized!(simd, {
            let from = values.get().chunks_exact((directions * length).max(1));
            let to = combined.get_mut().chunks_exact_mut((count * length).max(1));
            for (from, to) in from.zip(to) {
                for first in (0..*length).step_by(WIDE * S::LANES) {
                    // The same few columns of all directions stay in the cache for all kernels.
                    for (factors, to) in factors.iter().zip(to.chunks_mut(TOGETHER * length)) {
                        if first + WIDE * S::LANES <= *length {
                            combine::<T, S, WIDE>(simd, (from, factors), first, *length, to);
                        } else {
                            for first in (first..*length).step_by(S::LANES) {
                                combine::<T, S, 1>(simd, (from, factors), first, *length, to);
                            }
                        }
                    }
                }
            }
        });
        combined
    }
}

/// Computes `N` vectors of a row of some kernels, from column `first` on. `from` and `to` hold rows of
/// `length` values, one for each direction and one for each kernel.
#[inline(always)]
fn combine<T: ConvReal, S: Lanes<T>, const N: usize>(
    simd: S,
    (from, factors): (&[T], &[[T; TOGETHER]]),
    first: usize,
    length: usize,
    to: &mut [T],
) {
    let columns = first..first + N * S::LANES;
    let mut sums = [[simd.splat(T::zero()); N]; TOGETHER];
    for (values, factors) in from.chunks_exact(length).zip(factors) {
        let values: &[S::V] = cast_slice(&values[columns.clone()]);
        for (sums, &factor) in sums.iter_mut().zip(factors) {
            let factor = simd.splat(factor);
            for (sum, &value) in sums.iter_mut().zip(values) {
                *sum = simd.mul_add(factor, value, *sum);
            }
        }
    }
    for (to, sums) in to.chunks_exact_mut(length).zip(sums) {
        cast_slice_mut::<T, S::V>(&mut to[columns.clone()]).copy_from_slice(&sums);
    }
}
