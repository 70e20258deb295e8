//! Stars of one block, row by row.

use psf_types::Progress;
use pulp::bytemuck::{cast_slice, cast_slice_mut};

use super::star::PreparedStar;
use super::star_block::{CHUNK, RowLayout, StarBlock};
use super::tile::Tile;
use crate::simd::Lanes;
use crate::{ConvError, ConvReal};

/// Draws stars of one block.
pub(super) struct BlockDraw<'a, T> {
    pub(super) oversampling: usize,
    pub(super) layout: RowLayout,
    pub(super) block: &'a StarBlock<T>,
    pub(super) stars: &'a [PreparedStar<T>],
    /// The stars' weights.
    pub(super) weights: &'a [T],
    pub(super) progress: &'a dyn Progress,
}

/// Stars whose rows are worth a question whether they are still wanted.
const STARS_A_QUESTION: usize = 1 << 10;

impl<T: ConvReal> BlockDraw<'_, T> {
    /// Adds the stars to a tile that holds all their columns. Row by row of the stamps, so that a row of all kernels stays in the first
    /// cache while every star takes its part of it.
    ///
    /// What a pixel gets comes in an order that does not depend on which rows are at hand.
    #[inline(always)]
    pub(super) fn draw<S: Lanes<T>, const TAPS: usize>(
        &self,
        simd: S,
        tile: &mut Tile<T>,
    ) -> Result<(), ConvError> {
        let longest = self
            .stars
            .iter()
            .map(|star| star.rows.end - star.rows.start)
            .max();
        let rows = tile.rows();
        let row_of_kernels = self.block.kernel_count() * self.layout.kernel;
        for j in 0..longest.unwrap_or(0) {
            if self.stars.len() >= STARS_A_QUESTION {
                self.progress.still_wanted()?;
            }
            for star in self.stars {
                let row = star.rows.start + j;
                if row >= star.rows.end || !rows.contains(&row) {
                    continue;
                }
                let kept = star.first_row + j as usize * self.oversampling;
                let column = (star.columns.start - tile.origin.0) as usize;
                let length = (star.columns.end - star.columns.start) as usize;
                let first = (row - rows.start) as usize * tile.width + column;
                StarRow {
                    values: &self.block.values()[kept * row_of_kernels..],
                    weights: &self.weights[star.weights.clone()],
                    layout: self.layout,
                    first: star.first_residue,
                    taps: star.taps.first_chunk::<TAPS>().expect("taps of the kernel"),
                }
                .add_to(simd, &mut tile.values[first..first + length]);
            }
        }
        Ok(())
    }
}

/// One row of one star: rows of a block's kernels, added up.
#[derive(Clone, Copy)]
struct StarRow<'a, T, const TAPS: usize> {
    /// `[row, kernel, chunk, residue, pixel]`, from the row of the first tap on.
    values: &'a [T],
    /// `[row, kernel]`.
    weights: &'a [T],
    layout: RowLayout,
    /// The residue of the columns' first tap.
    first: usize,
    /// The columns' weights.
    taps: &'a [T; TAPS],
}

impl<T: ConvReal, const TAPS: usize> StarRow<'_, T, TAPS> {
    #[inline(always)]
    fn add_to<S: Lanes<T>>(self, simd: S, target: &mut [T]) {
        let mut pixel = 0;
        let mut pairs = target.chunks_exact_mut(2 * S::LANES);
        for pair in &mut pairs {
            let sums = self.sums::<S, 2>(simd, pixel);
            for (v, sum) in cast_slice_mut::<T, S::V>(pair).iter_mut().zip(sums) {
                *v = simd.add(*v, sum);
            }
            pixel += 2 * S::LANES;
        }
        let rest = pairs.into_remainder();
        if rest.len() > S::LANES {
            let sums = self.sums::<S, 2>(simd, pixel);
            for (chunk, sum) in rest.chunks_mut(S::LANES).zip(sums) {
                simd.partial_store(chunk, simd.add(simd.partial_load(chunk), sum));
            }
        } else if !rest.is_empty() {
            let [sum] = self.sums::<S, 1>(simd, pixel);
            simd.partial_store(rest, simd.add(simd.partial_load(rest), sum));
        }
    }

    /// `N` vectors of the row, from a pixel on.
    #[inline(always)]
    fn sums<S: Lanes<T>, const N: usize>(self, simd: S, pixel: usize) -> [S::V; N] {
        let zero = simd.splat(T::zero());
        let mut starts = [0; N];
        for (n, start) in starts.iter_mut().enumerate() {
            *start = self.layout.index(self.first, pixel + n * S::LANES);
        }
        let mut by_tap = [[zero; TAPS]; N];
        for (i, &weight) in self.weights.iter().enumerate() {
            let w = simd.splat(weight);
            for (sums, &start) in by_tap.iter_mut().zip(&starts) {
                let first = i * self.layout.kernel + start;
                let taps = &self.values[first..first + (TAPS - 1) * CHUNK + S::LANES];
                for (tap, sum) in sums.iter_mut().enumerate() {
                    let v: &[S::V] = cast_slice(&taps[tap * CHUNK..tap * CHUNK + S::LANES]);
                    *sum = simd.mul_add(w, v[0], *sum);
                }
            }
        }
        let mut all = [zero; N];
        for (all, sums) in all.iter_mut().zip(&by_tap) {
            for (&sum, &weight) in sums.iter().zip(self.taps) {
                *all = simd.mul_add(simd.splat(weight), sum, *all);
            }
        }
        all
    }
}
