//! One tile at a time, by the direct sum: for stamps of a few pixels.

use ndarray::ArrayViewMut2;

use super::tile_engine::{LocalTile, TileEngine};
use super::workspace::Workspace;
use crate::ConvReal;
use crate::simd::Lanes;

impl<T: ConvReal> TileEngine<'_, T> {
    /// Like [`scatter`](Self::scatter) without transforms, from stamps.
    #[inline(always)]
    pub(crate) fn scatter_directly<S: Lanes<T>>(
        &self,
        _: S,
        local: LocalTile<'_, T>,
        workspace: &mut Workspace<T>,
    ) {
        let (columns, rows) = local.part.size;
        let (sx, sy) = self.stamp;
        let pitch = self.fft.pitch();
        let w = workspace;
        let result = w.weighted.get_mut();
        for into in result.chunks_exact_mut(pitch).take(rows + sy - 1) {
            into[..columns + sx - 1].fill(T::zero());
        }
        for (kernel, stamp) in local.stamps.chunks_exact(sx * sy).enumerate() {
            for y in 0..rows {
                let light = &w.light.get()[y * pitch..y * pitch + columns];
                let row = &mut w.row[..columns];
                local.table.weigh(
                    kernel,
                    local.part.corner.1 + y,
                    local.part.corner.0,
                    light,
                    self.ramp,
                    row,
                );
                for j in 0..sy {
                    let into = &mut result[(y + j) * pitch..(y + j + 1) * pitch];
                    for i in 0..sx {
                        let value = self.at(stamp, i, j);
                        for (t, v) in into[i..i + columns].iter_mut().zip(row.iter()) {
                            *t += value * *v;
                        }
                    }
                }
            }
        }
    }

    /// Like [`gather`](Self::gather) without transforms, from stamps.
    #[inline(always)]
    pub(crate) fn gather_directly<S: Lanes<T>>(
        &self,
        _: S,
        local: LocalTile<'_, T>,
        workspace: &mut Workspace<T>,
        output: &mut ArrayViewMut2<'_, T>,
    ) {
        let (columns, rows) = local.part.size;
        let (sx, sy) = self.stamp;
        let pitch = self.fft.pitch();
        let w = workspace;
        let mut values = vec![T::zero(); columns];
        for (kernel, stamp) in local.stamps.chunks_exact(sx * sy).enumerate() {
            for y in 0..rows {
                values.fill(T::zero());
                for j in 0..sy {
                    let light = &w.light.get()[(y + sy - 1 - j) * pitch..][..pitch];
                    for i in 0..sx {
                        let value = self.at(stamp, i, j);
                        for (t, v) in values.iter_mut().zip(&light[sx - 1 - i..]) {
                            *t += value * *v;
                        }
                    }
                }
                self.weigh_and_add(local, kernel, y, &values, &mut w.row, output);
            }
        }
    }
}
