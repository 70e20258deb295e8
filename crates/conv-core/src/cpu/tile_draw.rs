//! Drawing of single pixels of a tile's light, stamp by stamp.

use ndarray::{ArrayViewMut2, s};
use pulp::bytemuck::{cast_slice, cast_slice_mut};

use super::tile_engine::{LocalTile, TileEngine, add_row};
use super::treatment::LitPixel;
use crate::ConvReal;
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
            let (column, row) = (local.part.corner.0 + x, local.part.corner.1 + y);
            let coefficients_here = local.table.pixel(row, column);
            for (kernel, c) in all.iter_mut().enumerate() {
                *c = coefficients_here.weigh(kernel, value);
            }
        }
        // Draws row by row of the stamps, so that one row of all stamps stays in the first-level
        // cache while every pixel uses it.
        for j in 0..sy {
            for (&(y, x, _), all) in pixels.iter().zip(coefficients.chunks_exact(kernels)) {
                let (column, row) = (corner.0 + x as i64, corner.1 + (y + j) as i64);
                let from = (-column).clamp(0, sx as i64) as usize;
                let to = (width as i64 - column).clamp(from as i64, sx as i64) as usize;
                if from == to || !(0..height as i64).contains(&row) {
                    continue;
                }
                let start = (column + from as i64) as usize;
                let mut target = output.row_mut(row as usize);
                let target = target.as_slice_mut().expect("images are row-major");
                let target = &mut target[start..start + (to - from)];
                if self.flip {
                    let row = (sy - 1 - j) * sx;
                    for (stamp, &c) in local.stamps.chunks_exact(sx * sy).zip(all) {
                        let values = stamp[row + sx - to..row + sx - from].iter().rev();
                        for (t, v) in target.iter_mut().zip(values) {
                            *t += c * *v;
                        }
                    }
                } else {
                    add_combination(simd, target, local.stamps, (sx * sy, j * sx + from), all);
                }
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
        let (columns, rows) = local.part.size;
        let (sx, sy) = self.geometry.stamp;
        let (mut line, mut weighted) = (vec![T::zero(); sx], vec![T::zero(); sx]);
        let (mut buffer, mut for_fluxes) = (Vec::new(), Vec::new());
        for &(y, x, value) in pixels {
            // Light at pixel q, counted in the area around the tile, reaches pixel p of the tile
            // with the value at stamp pixel (p + stamp size - 1) - q.
            let (from, to) = ((x + 1).saturating_sub(sx), (x + 1).min(columns));
            if from >= to {
                continue;
            }
            let (line, weighted) = (&mut line[..to - from], &mut weighted[..to - from]);
            let mut output = output.slice_mut(s![.., from..to]);
            let columns = local.part.corner.0 + from..local.part.corner.0 + to;
            let mut fluxes = local.table.fluxes(columns.clone(), &mut for_fluxes);
            for (kernel, stamp) in local.stamps.chunks_exact(sx * sy).enumerate() {
                let mut coefficients = local.table.rows_of(kernel, columns.clone(), &mut buffer);
                for p in (y + 1).saturating_sub(sy)..(y + 1).min(rows) {
                    for (t, i) in line.iter_mut().zip(from..to) {
                        *t = value * self.at(stamp, i + sx - 1 - x, p + sy - 1 - y);
                    }
                    coefficients.multiply(local.part.corner.1 + p, line, weighted);
                    if local.table.role.is_divided(kernel) {
                        fluxes.divide(local.part.corner.1 + p, weighted);
                    }
                    add_row(weighted, &mut output, p);
                }
            }
        }
    }
}

/// Adds `sum_k c_k values_k` to `target`. `values_k` starts at index `k stride + first` of
/// `values`.
#[inline(always)]
fn add_combination<T: ConvReal, S: Lanes<T>>(
    simd: S,
    target: &mut [T],
    values: &[T],
    (stride, first): (usize, usize),
    coefficients: &[T],
) {
    let length = target.len();
    let vectors = length / S::LANES;
    let mut done = 0;
    // Four vectors of sums stay in registers while all stamps are read.
    while done + 4 <= vectors {
        let at = done * S::LANES;
        let sums: &mut [S::V] = cast_slice_mut(&mut target[at..at + 4 * S::LANES]);
        let (mut a, mut b, mut c, mut d) = (sums[0], sums[1], sums[2], sums[3]);
        for (k, &coefficient) in coefficients.iter().enumerate() {
            let start = k * stride + first + at;
            let v: &[S::V] = cast_slice(&values[start..start + 4 * S::LANES]);
            let w = simd.splat(coefficient);
            a = simd.mul_add(w, v[0], a);
            b = simd.mul_add(w, v[1], b);
            c = simd.mul_add(w, v[2], c);
            d = simd.mul_add(w, v[3], d);
        }
        sums.copy_from_slice(&[a, b, c, d]);
        done += 4;
    }
    let rest = done * S::LANES;
    for (k, &coefficient) in coefficients.iter().enumerate() {
        let start = k * stride + first;
        for (t, v) in target[rest..]
            .iter_mut()
            .zip(&values[start + rest..start + length])
        {
            *t += coefficient * *v;
        }
    }
}
