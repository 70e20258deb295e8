//! Draws stars together that share kernels, row by row, into a tile: an array of the pixels that these
//! stars may light.

use std::ops::Range;
use std::slice::from_ref;

use ndarray::Array2;
use psf_types::{PixelRegion, Progress};
use pulp::bytemuck::{cast_slice, cast_slice_mut};

use super::phases::{PhasedAxis, PhasedStar};
use super::reach::Reach;
use super::row_layout::{CHUNK, RowLayout};
use crate::overlap::Piece;
use crate::simd::{Aligned, Lanes, vectorized};
use crate::stamp_interpolator::MOST_TAPS;
use crate::{ConvError, ConvReal};

/// Stars that share kernels, such as those of one block.
pub(super) struct Group<T> {
    pub(super) stars: Vec<PhasedStar<T>>,
    /// `[star, row tap, kernel]`.
    pub(super) weights: Vec<T>,
}

/// Draws groups of stars.
pub(super) struct DrawGroup<'a, T> {
    pub(super) axes: &'a [PhasedAxis; 2],
    pub(super) layout: RowLayout,
    /// The kernels' coefficients `[row, kernel, value of a row]`.
    pub(super) values: &'a [T],
    pub(super) kernels: usize,
    /// `None` if all stars are drawn on all pixels.
    pub(super) reach: Option<&'a Reach>,
    /// Only rows of this region of the frame are drawn.
    pub(super) region: PixelRegion,
    pub(super) progress: &'a dyn Progress,
}

/// Groups of at least this many stars poll the progress object at every row.
const STARS_PER_POLL: usize = 1 << 10;

impl<T: ConvReal> DrawGroup<'_, T> {
    /// Returns a tile with the stars of a group.
    pub(super) fn tile<S: Lanes<T>>(&self, simd: S, group: &Group<T>) -> Result<Piece<T>, ConvError> {
        let columns = hull(group.stars.iter().map(|star| self.drawn(star).0));
        let rows = hull(group.stars.iter().map(|star| self.drawn(star).1));
        let (first, height) = (self.region.y0(), self.region.shape().ny() as i64);
        let rows = rows.start.max(first)..rows.end.min(first + height);
        let length = |range: &Range<i64>| (range.end - range.start).max(0) as usize;
        let mut tile = Piece {
            first: (columns.start, rows.start),
            values: Array2::zeros((length(&rows), length(&columns))),
        };
        self.draw_on(simd, group, &mut tile)?;
        Ok(tile)
    }

    /// Adds a group to a tile. Only the pixels of the tile are drawn. Its first [`CHUNK`] columns may lack light.
    pub(super) fn draw_on<S: Lanes<T>>(
        &self,
        simd: S,
        group: &Group<T>,
        tile: &mut Piece<T>,
    ) -> Result<(), ConvError> {
        vectorized!(
            simd,
            match self.axes[0].kernel.tap_count() {
                4 => self.draw::<S, 4>(simd, group, tile),
                _ => self.draw::<S, MOST_TAPS>(simd, group, tile),
            }
        )
    }

    /// The rectangle on which a star is drawn: columns, and rows.
    fn drawn(&self, star: &PhasedStar<T>) -> (Range<i64>, Range<i64>) {
        let (columns, rows) = (star.columns.clone(), star.rows.clone());
        let Some(level) = star.level.map(|number| self.reach().level(number)) else {
            return (columns, rows);
        };
        let (of_level, first) = (level.columns.clone(), columns.start);
        let start = (of_level.start + star.pixel.0 - first).max(0) / CHUNK as i64 * CHUNK as i64;
        let rows_of_level = level.rows.start + star.pixel.1..level.rows.end + star.pixel.1;
        (
            first + start..columns.end.min(of_level.end + star.pixel.0),
            rows.start.max(rows_of_level.start)..rows.end.min(rows_of_level.end),
        )
    }

    fn reach(&self) -> &Reach {
        self.reach.expect("only a reach gives levels")
    }

    /// Adds the stars to a tile. Adds row `j` of every star before row
    /// `j + 1` of any star. The rows `j` of all stars are computed from the same few rows of
    /// coefficients, which therefore stay in the first-level cache.
    ///
    /// The order of additions to a pixel does not depend on which rows the tile holds.
    #[inline(always)]
    fn draw<S: Lanes<T>, const TAPS: usize>(
        &self,
        simd: S,
        group: &Group<T>,
        tile: &mut Piece<T>,
    ) -> Result<(), ConvError> {
        let Group { stars, weights } = group;
        let longest = stars.iter().map(|star| star.rows.end - star.rows.start).max();
        let (height, width) = tile.values.dim();
        let rows = tile.first.1..tile.first.1 + height as i64;
        let values = tile.values.as_slice_mut().expect("new arrays are row-major");
        let row_of_kernels = self.kernels * self.layout.kernel;
        let mut sums = Aligned::zeros(self.layout.kernel + S::LANES);
        for j in 0..longest.unwrap_or(0) {
            if stars.len() >= STARS_PER_POLL {
                self.progress.check_cancelled()?;
            }
            for star in stars {
                let row = star.rows.start + j;
                if row >= star.rows.end || !rows.contains(&row) {
                    continue;
                }
                let kept = star.first_row + j as usize * self.axes[0].oversampling;
                let of_star = StarRow {
                    values: &self.values[kept * row_of_kernels..],
                    weights: &weights[star.weights.clone()],
                    layout: self.layout,
                    first: star.first_column,
                    taps: star.taps.first_chunk::<TAPS>().expect("a star has all taps"),
                };
                let tile_row = &mut values[(row - rows.start) as usize * width..][..width];
                let (length, offset) = (
                    star.columns.end - star.columns.start,
                    star.pixel.0 - star.columns.start,
                );
                let whole = -offset..length - offset;
                let segments = match star.level {
                    Some(level) => self.reach().level(level).segments(row - star.pixel.1),
                    None => from_ref(&whole),
                };
                let first = star.columns.start - tile.first.0;
                let least = (-first).max(0) as usize;
                let (least, most) = (least.next_multiple_of(CHUNK) as i64, width as i64 - first);
                for segment in segments {
                    let from = (segment.start + offset).max(0) / S::LANES as i64 * S::LANES as i64;
                    let (from, to) = (from.max(least), (segment.end + offset).min(length).min(most));
                    if from < to {
                        let pixels = &mut tile_row[(first + from) as usize..(first + to) as usize];
                        of_star.add_to(simd, sums.get_mut(), from as usize, pixels);
                    }
                }
            }
        }
        Ok(())
    }
}

/// The smallest range that contains all ranges.
fn hull(ranges: impl Iterator<Item = Range<i64>>) -> Range<i64> {
    ranges
        .reduce(|a, b| a.start.min(b.start)..a.end.max(b.end))
        .unwrap_or(0..0)
}

/// One row of one star. It is a sum over the block's kernels, over the *row taps* (the rows of
/// coefficients that contribute to this row) and over the *column taps* (the columns of
/// coefficients that contribute to a pixel).
#[derive(Clone, Copy)]
struct StarRow<'a, T, const TAPS: usize> {
    /// The coefficients `[row, kernel, chunk, residue, pixel]`, from the first row tap on.
    values: &'a [T],
    /// `[row tap, kernel]`.
    weights: &'a [T],
    layout: RowLayout,
    /// The column of coefficients of the first column tap of the first pixel.
    first: usize,
    /// The weights of the column taps.
    taps: &'a [T; TAPS],
}

impl<T: ConvReal, const TAPS: usize> StarRow<'_, T, TAPS> {
    /// Adds the row to the pixels `target`, from pixel `from` of the row on, which is a whole number of
    /// vectors. `sums` has room for a row of one kernel and one more vector, and is overwritten.
    #[inline(always)]
    fn add_to<S: Lanes<T>>(self, simd: S, sums: &mut [T], from: usize, target: &mut [T]) {
        if self.layout.is_shared {
            let taps: [usize; TAPS] = self.layout.shared_taps(self.first);
            self.sum_row(simd, sums, from, from + target.len());
            for (i, pixels) in target.chunks_mut(S::LANES).enumerate() {
                let mut by_tap = [[simd.splat(T::zero())]; TAPS];
                for ([values], tap) in by_tap.iter_mut().zip(taps) {
                    let from = tap + from + i * S::LANES;
                    *values = cast_slice(&sums[from..from + S::LANES])[0];
                }
                self.add_taps(simd, by_tap, pixels);
            }
            return;
        }
        for (i, pixels) in target.chunks_mut(2 * S::LANES).enumerate() {
            let pixel = from + 2 * i * S::LANES;
            if pixels.len() > S::LANES {
                self.add_taps(simd, self.sums_by_tap::<S, 2>(simd, pixel), pixels);
            } else {
                self.add_taps(simd, self.sums_by_tap::<S, 1>(simd, pixel), pixels);
            }
        }
    }

    /// Computes the sums over kernels and row taps for the columns of coefficients that contribute to the pixels
    /// from `from` to `to`. Taps reach into the next pixels.
    #[inline(always)]
    fn sum_row<S: Lanes<T>>(self, simd: S, sums: &mut [T], from: usize, to: usize) {
        let RowLayout { kernel, chunk, .. } = self.layout;
        let end = (to + S::LANES + TAPS).next_multiple_of(S::LANES).min(chunk);
        if from == 0 && end == chunk {
            return self.sum_values(simd, 0, &mut sums[..kernel]);
        }
        for (residue, sums) in sums[..kernel].chunks_exact_mut(chunk).enumerate() {
            self.sum_values(simd, residue * chunk + from, &mut sums[from..end]);
        }
    }

    /// Computes these sums from column `first` of the layout on, for whole vectors.
    #[inline(always)]
    fn sum_values<S: Lanes<T>>(self, simd: S, first: usize, sums: &mut [T]) {
        let sums: &mut [S::V] = cast_slice_mut(sums);
        let (fours, rest) = sums.as_chunks_mut::<4>();
        for (i, four) in fours.iter_mut().enumerate() {
            *four = self.sums::<S, 4>(simd, first + 4 * i * S::LANES);
        }
        let first = first + 4 * fours.len() * S::LANES;
        for (i, one) in rest.iter_mut().enumerate() {
            [*one] = self.sums::<S, 1>(simd, first + i * S::LANES);
        }
    }

    /// Computes the sums over kernels and row taps for `N` vectors of coefficients.
    #[inline(always)]
    fn sums<S: Lanes<T>, const N: usize>(self, simd: S, first: usize) -> [S::V; N] {
        let mut sums = [simd.splat(T::zero()); N];
        for (i, &weight) in self.weights.iter().enumerate() {
            let w = simd.splat(weight);
            let first = i * self.layout.kernel + first;
            let values: &[S::V] = cast_slice(&self.values[first..first + N * S::LANES]);
            for (sum, &v) in sums.iter_mut().zip(values) {
                *sum = simd.mul_add(w, v, *sum);
            }
        }
        sums
    }

    /// Computes the sums over kernels and row taps for the column taps of `N` vectors of pixels, from
    /// a pixel on.
    #[inline(always)]
    fn sums_by_tap<S: Lanes<T>, const N: usize>(self, simd: S, pixel: usize) -> [[S::V; N]; TAPS] {
        let mut starts = [0; N];
        for (n, start) in starts.iter_mut().enumerate() {
            *start = self.layout.index(self.first, pixel + n * S::LANES);
        }
        let mut by_tap = [[simd.splat(T::zero()); N]; TAPS];
        for (i, &weight) in self.weights.iter().enumerate() {
            let w = simd.splat(weight);
            for (n, &start) in starts.iter().enumerate() {
                let first = i * self.layout.kernel + start;
                let taps = &self.values[first..first + (TAPS - 1) * CHUNK + S::LANES];
                for (tap, sums) in by_tap.iter_mut().enumerate() {
                    let v: &[S::V] = cast_slice(&taps[tap * CHUNK..tap * CHUNK + S::LANES]);
                    sums[n] = simd.mul_add(w, v[0], sums[n]);
                }
            }
        }
        by_tap
    }

    /// Adds the column taps to at most `N` vectors of pixels.
    #[inline(always)]
    fn add_taps<S: Lanes<T>, const N: usize>(self, simd: S, by_tap: [[S::V; N]; TAPS], pixels: &mut [T]) {
        let mut sums = [simd.splat(T::zero()); N];
        for (values, &weight) in by_tap.iter().zip(self.taps) {
            let w = simd.splat(weight);
            for (sum, &v) in sums.iter_mut().zip(values) {
                *sum = simd.mul_add(w, v, *sum);
            }
        }
        if pixels.len() == N * S::LANES {
            let pixels: &mut [S::V] = cast_slice_mut(pixels);
            for (v, sum) in pixels.iter_mut().zip(sums) {
                *v = simd.add(*v, sum);
            }
        } else {
            for (pixels, sum) in pixels.chunks_mut(S::LANES).zip(sums) {
                simd.partial_store(pixels, simd.add(simd.partial_load(pixels), sum));
            }
        }
    }
}
