//! The stamps of a model as interpolation coefficients that are sorted by sub-pixel phase.

use ndarray::Array2;
use pulp::bytemuck::{cast_slice, cast_slice_mut};
use rayon::prelude::*;

use super::phases::PhasedAxis;
use super::row_layout::{CHUNK, RowLayout};
use crate::ConvReal;
use crate::simd::{Aligned, Lanes, WithIsa, vectorized};
use crate::stamp_interpolator::StampInterpolator;

/// The stamps of the directions of [`PsfSpace`](crate::plan::psf_space::PsfSpace). Blocks combine
/// them to kernels. They fill about as much memory as the stamps of the model, in the precision `T`.
#[derive(Debug)]
pub(super) struct PhasedStamps<T> {
    /// `[row, part, direction, value]`: the rows of a kernel ([`RowLayout`]) in parts of [`CHUNK`] values.
    /// `row` counts the rows of coefficients of the oversampled stamp, in the order of the stamp. Rows
    /// that no star can use are left out ([`PhasedAxis`]).
    values: Aligned<T>,
    directions: usize,
    /// The number of values in a row of a kernel.
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
        let columns = layout.columns(columns);
        let rows_of_all = values.get_mut().par_chunks_mut((directions * length).max(1));
        rows_of_all.enumerate().for_each(|(row, to)| {
            let Some(j) = rows.index(row) else { return };
            let parts = to.chunks_exact_mut(directions * CHUNK);
            for (to, columns) in parts.zip(columns.chunks_exact(CHUNK)) {
                for (stamp, to) in stamps.iter().zip(to.chunks_exact_mut(CHUNK)) {
                    let from = stamp.coefficients().row(j);
                    for (value, column) in to.iter_mut().zip(columns) {
                        if let Some(i) = *column {
                            *value = T::nearest(from[i]);
                        }
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

/// The most kernels that are computed together.
const TOGETHER: usize = 8;

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
        // The factors of some kernels, `[direction, kernel]`. Kernels beyond the last have the factor 0.
        let factors: Vec<Vec<[T; TOGETHER]>> = (0..count)
            .step_by(TOGETHER)
            .map(|first| {
                let of_direction = |direction| {
                    std::array::from_fn(|k| match self.kernels.get((first + k, direction)) {
                        Some(&factor) => T::nearest(factor),
                        None => T::zero(),
                    })
                };
                (0..*directions).map(of_direction).collect()
            })
            .collect();
        let rows = values.get().len() / (directions * length).max(1);
        let mut combined = Aligned::zeros(rows * count * length);
        vectorized!(simd, {
            let from = values.get().chunks_exact((directions * length).max(1));
            let to = combined.get_mut().chunks_exact_mut((count * length).max(1));
            for (from, to) in from.zip(to) {
                for (part, from) in from.chunks_exact((directions * CHUNK).max(1)).enumerate() {
                    for (factors, to) in factors.iter().zip(to.chunks_mut(TOGETHER * length)) {
                        for first in (0..CHUNK).step_by(S::LANES) {
                            let (from, at) = (&from[first..], part * CHUNK + first);
                            let to = to.chunks_exact_mut(*length).map(
                                #[inline(always)]
                                |to| &mut to[at..at + S::LANES],
                            );
                            if to.len() > TOGETHER / 2 {
                                combine::<T, S, TOGETHER>(simd, from, factors, to);
                            } else {
                                combine::<T, S, { TOGETHER / 2 }>(simd, from, factors, to);
                            }
                        }
                    }
                }
            }
        });
        combined
    }
}

/// Computes a vector of each of `N` kernels, or of fewer. The values of a direction are [`CHUNK`] values
/// from those of the last one.
#[inline(always)]
fn combine<'a, T: ConvReal, S: Lanes<T>, const N: usize>(
    simd: S,
    from: &[T],
    factors: &[[T; TOGETHER]],
    to: impl Iterator<Item = &'a mut [T]>,
) {
    let mut sums = [simd.splat(T::zero()); N];
    for (values, factors) in from.chunks(CHUNK).zip(factors) {
        let values = cast_slice::<T, S::V>(&values[..S::LANES])[0];
        for (sum, &factor) in sums.iter_mut().zip(factors) {
            *sum = simd.mul_add(simd.splat(factor), values, *sum);
        }
    }
    for (to, sum) in to.zip(sums) {
        cast_slice_mut(to)[0] = sum;
    }
}
