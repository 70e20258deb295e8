//! Stars of one block, row by row.

use ndarray::ArrayViewMut2;
use pulp::bytemuck::{cast_slice, cast_slice_mut};

use super::phases::PhasedAxis;
use super::star::PreparedStar;
use super::star_block::RowLayout;
use crate::ConvReal;
use crate::lowrank::internals::Aligned;
use crate::simd::Lanes;

/// Draws stars of one block into some rows of an image.
pub(super) struct BlockDraw<'a, T> {
    pub(super) axes: &'a [PhasedAxis; 2],
    pub(super) layout: RowLayout,
    pub(super) kernels: usize,
    /// The block's values.
    pub(super) values: &'a [T],
}

/// The longest vector, in values.
const MOST_LANES: usize = 16;

/// Sums that stay in registers at a time.
const AT_ONCE: usize = 8;

impl<T: ConvReal> BlockDraw<'_, T> {
    /// Adds the stars to `rows`, the first of which is row `first_row` of the image. Row by row of the stamps, so that a row of all
    /// kernels stays in the first cache while every star takes its part of it.
    ///
    /// What a pixel gets comes in an order that does not depend on which rows are at hand.
    #[inline(always)]
    pub(super) fn draw<S: Lanes<T>>(
        &self,
        simd: S,
        stars: &[&PreparedStar<T>],
        rows: &mut ArrayViewMut2<'_, T>,
        first_row: i64,
    ) {
        let [columns, axis] = self.axes;
        let taps = columns.tap_count();
        let from = stars.iter().map(|star| star.rows.from).min().unwrap_or(0);
        let to = stars.iter().map(|star| star.rows.to).max().unwrap_or(0);
        // Sums of a row by residues, then a row of the image; both with room for whole vectors.
        let mut sums = Aligned::zeros(self.layout.kernel + 2 * MOST_LANES);
        let sums = sums.get_mut();
        let mut line = vec![T::zero(); self.layout.residue + 2 * MOST_LANES];
        let (height, width) = (rows.nrows() as i64, rows.ncols() as i64);
        for j in from..to {
            for star in stars {
                let row = star.pixel.1 + j - first_row;
                if !(star.rows.from..star.rows.to).contains(&j) || !(0..height).contains(&row) {
                    continue;
                }
                let kept = star.rows.first_of(j, axis.oversampling());
                let values = &self.values[kept * self.kernels * self.layout.kernel..];
                for span in &star.spans {
                    let sums = &mut sums[span.clone()];
                    combine(
                        simd,
                        sums,
                        values,
                        (self.layout.kernel, span.start),
                        &star.weights,
                    );
                }
                let length = (star.columns.to - star.columns.from) as usize;
                for at in (0..length).step_by(S::LANES) {
                    let mut sum = simd.splat(T::zero());
                    for &(start, weight) in &star.taps[..taps] {
                        let v: &[S::V] = cast_slice(&sums[start + at..start + at + S::LANES]);
                        sum = simd.mul_add(simd.splat(weight), v[0], sum);
                    }
                    cast_slice_mut::<T, S::V>(&mut line[at..at + S::LANES])[0] = sum;
                }
                let column = star.pixel.0 + star.columns.from;
                let skip = (-column).clamp(0, length as i64);
                let end = (width - column).clamp(skip, length as i64);
                let mut target = rows.row_mut(row as usize);
                let target = target.as_slice_mut().expect("images are row-major");
                if skip < end {
                    let target = &mut target[(column + skip) as usize..(column + end) as usize];
                    for (t, v) in target.iter_mut().zip(&line[skip as usize..end as usize]) {
                        *t += *v;
                    }
                }
            }
        }
    }
}

/// Sets `sums` to `sum_i w_i values_i`, where `values_i` starts at `first` of the i-th `stride` values. The number of sums is a
/// multiple of every vector's length.
#[inline(always)]
fn combine<T: ConvReal, S: Lanes<T>>(
    simd: S,
    sums: &mut [T],
    values: &[T],
    (stride, first): (usize, usize),
    weights: &[T],
) {
    let sums: &mut [S::V] = cast_slice_mut(sums);
    let mut groups = sums.chunks_exact_mut(AT_ONCE);
    let mut at = first;
    for group in &mut groups {
        let zero = simd.splat(T::zero());
        // By name, so that they stay in registers.
        let (mut a, mut b, mut c, mut d) = (zero, zero, zero, zero);
        let (mut e, mut f, mut g, mut h) = (zero, zero, zero, zero);
        for (i, &weight) in weights.iter().enumerate() {
            let start = i * stride + at;
            let v: &[S::V] = cast_slice(&values[start..start + AT_ONCE * S::LANES]);
            let w = simd.splat(weight);
            a = simd.mul_add(w, v[0], a);
            b = simd.mul_add(w, v[1], b);
            c = simd.mul_add(w, v[2], c);
            d = simd.mul_add(w, v[3], d);
            e = simd.mul_add(w, v[4], e);
            f = simd.mul_add(w, v[5], f);
            g = simd.mul_add(w, v[6], g);
            h = simd.mul_add(w, v[7], h);
        }
        group.copy_from_slice(&[a, b, c, d, e, f, g, h]);
        at += AT_ONCE * S::LANES;
    }
    for sum in groups.into_remainder() {
        let mut held = simd.splat(T::zero());
        for (i, &weight) in weights.iter().enumerate() {
            let start = i * stride + at;
            let v: &[S::V] = cast_slice(&values[start..start + S::LANES]);
            held = simd.mul_add(simd.splat(weight), v[0], held);
        }
        *sum = held;
        at += S::LANES;
    }
}
