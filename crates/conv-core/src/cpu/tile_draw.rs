//! Drawing of single pixels of a tile's light, stamp by stamp.

use ndarray::{Array2, ArrayViewMut2, s};
use pulp::bytemuck::{cast_slice, cast_slice_mut};

use super::tile_engine::{LocalTile, TileEngine, add_row};
use super::treatment::LitPixel;
use crate::ConvReal;
use crate::plan::function_rows::FunctionRows;
use crate::simd::Lanes;

impl<T: ConvReal> TileEngine<'_, T> {
    /// Draws single pixels of a tile's light: adds the stamp of each to `output`. The stamp of the
    /// tile's first pixel begins at `corner` of `output`.
    #[inline(always)]
    pub(crate) fn draw_scattered<S: Lanes<T>>(
        &self,
        simd: S,
        local: LocalTile<'_, T>,
        pixels: &[LitPixel<T>],
        output: &mut ArrayViewMut2<'_, T>,
        corner: (i64, i64),
    ) {
        let (sx, sy) = self.geometry.stamp;
        let (height, width) = output.dim();
        let kernels = local.table.kernel_count();
        let mut coefficients = vec![T::zero(); pixels.len() * kernels];
        for (&(y, x, value), all) in pixels.iter().zip(coefficients.chunks_exact_mut(kernels)) {
            let (column, row) = (local.tile.corner.0 + x, local.row_in_table(y));
            let coefficients_here = local.table.pixel(row, column);
            for (kernel, c) in all.iter_mut().enumerate() {
                *c = coefficients_here.weigh(kernel, value);
            }
        }
        let mut line = vec![T::zero(); sx];
        // Draws row by row of the stamps, so that one row of all stamps stays in the first-level
        // cache while every pixel uses it.
        for j in 0..sy {
            for (&(y, x, _), all) in pixels.iter().zip(coefficients.chunks_exact(kernels)) {
                let y = y % local.tile.size.1;
                let (column, row) = (corner.0 + x as i64, corner.1 + (y + j) as i64);
                let from = (-column).clamp(0, sx as i64) as usize;
                let to = (width as i64 - column).clamp(from as i64, sx as i64) as usize;
                if from == to || !(0..height as i64).contains(&row) {
                    continue;
                }
                // Adds up the pixel's modes first. So the image is rounded once per pixel, not once per
                // mode.
                let line = &mut line[..to - from];
                if self.flip {
                    let first = (sy - j) * sx - to;
                    combine(simd, line, local.stamps, (sx * sy, first), all);
                    line.reverse();
                } else {
                    combine(simd, line, local.stamps, (sx * sy, j * sx + from), all);
                }
                let start = (column + from as i64) as usize;
                add_row(line, output, (start, row as usize));
            }
        }
    }

    /// Draws single pixels of the light around a tile: adds the light that falls on the tile to
    /// `output`, which has the tile's size.
    #[inline(always)]
    pub(crate) fn draw_gathered(
        &self,
        local: LocalTile<'_, T>,
        pixels: &[LitPixel<T>],
        output: &mut ArrayViewMut2<'_, T>,
    ) {
        let (columns, rows) = local.tile.size;
        let (sx, sy) = self.geometry.stamp;
        let (mut line, mut weighted) = (vec![T::zero(); sx], vec![T::zero(); sx]);
        let (mut function, mut fluxes) = (FunctionRows::default(), FunctionRows::default());
        let mut sums = Array2::zeros((rows, columns));
        for &(y, x, value) in pixels {
            // Light at pixel q, counted in the area around the tile, reaches pixel p of the tile
            // with the value at stamp pixel (p + stamp size - 1) - q.
            let (from, to) = ((x + 1).saturating_sub(sx), (x + 1).min(columns));
            if from >= to {
                continue;
            }
            let (line, weighted) = (&mut line[..to - from], &mut weighted[..to - from]);
            let lit = (y + 1).saturating_sub(sy)..(y + 1).min(rows);
            // Adds up the pixel's modes first, as in `draw_scattered`.
            let mut sums = sums.slice_mut(s![lit.clone(), from..to]);
            sums.fill(T::zero());
            let (x0, y0) = (local.tile.corner.0, local.row_in_table(0));
            for function in [&mut function, &mut fluxes] {
                function.place(local.table, x0 + from..x0 + to, y0 + lit.start..y0 + lit.end);
            }
            fluxes.set(local.table, local.table.role.divides().then_some(0));
            for (kernel, stamp) in local.stamps.chunks_exact(sx * sy).enumerate() {
                function.set(local.table, local.table.role.function_of(kernel));
                for (i, p) in lit.clone().enumerate() {
                    for (t, column) in line.iter_mut().zip(from..to) {
                        *t = value * self.at(stamp, column + sx - 1 - x, p + sy - 1 - y);
                    }
                    function.multiply(i, line, weighted);
                    if local.table.role.is_divided(kernel) {
                        fluxes.divide(i, weighted);
                    }
                    add_row(weighted, &mut sums, (0, i));
                }
            }
            output
                .slice_mut(s![lit, from..to])
                .zip_mut_with(&sums, |value, &sum| *value += sum);
        }
    }
}

/// Sets `sums` to `sum_k c_k values_k`. `values_k` starts at index `k stride + first` of `values`.
#[inline(always)]
fn combine<T: ConvReal, S: Lanes<T>>(
    simd: S,
    sums: &mut [T],
    values: &[T],
    (stride, first): (usize, usize),
    coefficients: &[T],
) {
    let length = sums.len();
    let vectors = length / S::LANES;
    let mut done = 0;
    // Four vectors of sums stay in registers while all stamps are read.
    while done + 4 <= vectors {
        let at = done * S::LANES;
        let zero = simd.splat(T::zero());
        let (mut a, mut b, mut c, mut d) = (zero, zero, zero, zero);
        for (k, &coefficient) in coefficients.iter().enumerate() {
            let start = k * stride + first + at;
            let v: &[S::V] = cast_slice(&values[start..start + 4 * S::LANES]);
            let w = simd.splat(coefficient);
            a = simd.mul_add(w, v[0], a);
            b = simd.mul_add(w, v[1], b);
            c = simd.mul_add(w, v[2], c);
            d = simd.mul_add(w, v[3], d);
        }
        let into: &mut [S::V] = cast_slice_mut(&mut sums[at..at + 4 * S::LANES]);
        into.copy_from_slice(&[a, b, c, d]);
        done += 4;
    }
    let rest = done * S::LANES;
    sums[rest..].fill(T::zero());
    for (k, &coefficient) in coefficients.iter().enumerate() {
        let start = k * stride + first;
        for (sum, v) in sums[rest..].iter_mut().zip(&values[start + rest..start + length]) {
            *sum += coefficient * *v;
        }
    }
}
