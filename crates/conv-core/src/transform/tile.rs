//! Two-dimensional real transforms of a tile.

use std::ops::Range;

use super::butterfly::times;
use super::stages::{Factor, Stages, multiply_swapped, root};
use crate::ConvReal;
use crate::simd::{Lanes, Pair};
use pulp::bytemuck::{cast_slice, cast_slice_mut};

/// Transforms of planes of `nx x ny` real values. Convolutions by these transforms are cyclic in x
/// and negacyclic in y: values that wrap around in y change their sign.
///
/// The upper half of the rows becomes the imaginary part of the lower half: real polynomials modulo
/// `z^ny + 1` are complex ones modulo `z^(ny/2) - i`. So a real transform is a complex one of half
/// the rows, without a separation of spectra and without an extra row for the highest frequency. A
/// convolution whose result fits into the plane never wraps, so the sign of wrapped values does not
/// matter.
///
/// A spectrum consists of groups. The lanes of a group's vectors belong to different y frequencies.
/// For each x frequency, a group holds a vector of real parts and a vector of imaginary parts. The
/// frequencies of both axes are in scrambled order (`Stages`).
#[derive(Debug)]
pub struct TileTransform<T> {
    pub(crate) nx: usize,
    ny: usize,
    across: Stages<T>,
    down: Stages<T>,
    /// `exp(i pi y / ny)` for the lower half of the rows.
    twist: Vec<Pair<T>>,
    /// `exp(-i pi y / ny) / (nx ny / 2)`.
    untwist: Vec<Pair<T>>,
}

/// Real values `[y, x]`, as a transform reads them.
pub(crate) trait Plane<T: ConvReal>: Copy {
    /// Writes a vector of each of some rows to `column`, times its factor in `twist`. If `UPPER` is
    /// true, adds `i` times the product instead. `index` counts vectors from the first column.
    fn twist<S: Lanes<T>, const UPPER: bool>(
        self,
        simd: S,
        index: usize,
        rows: Range<usize>,
        twist: &[Pair<T>],
        column: &mut [Pair<S::V>],
    );
}

/// Writes `value` times `w` to `into`, or adds `i` times the product if `UPPER` is true.
#[inline(always)]
pub(crate) fn put_twisted<T: ConvReal, S: Lanes<T>, const UPPER: bool>(
    simd: S,
    value: S::V,
    w: Pair<T>,
    into: &mut Pair<S::V>,
) {
    let w = [simd.splat(w[0]), simd.splat(w[1])];
    *into = if UPPER {
        [
            simd.neg_mul_add(value, w[1], into[0]),
            simd.mul_add(value, w[0], into[1]),
        ]
    } else {
        [simd.mul(value, w[0]), simd.mul(value, w[1])]
    };
}

/// A plane in memory.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StoredPlane<'a, T> {
    values: &'a [T],
    pitch: usize,
}

impl<T: ConvReal> StoredPlane<'_, T> {
    /// A vector of a row. `index` counts vectors from the first column.
    #[inline(always)]
    pub(crate) fn vector<S: Lanes<T>>(self, simd: S, row: usize, index: usize) -> S::V {
        load(simd, self.values, row * self.pitch + index * S::LANES)
    }
}

impl<T: ConvReal> Plane<T> for StoredPlane<'_, T> {
    #[inline(always)]
    fn twist<S: Lanes<T>, const UPPER: bool>(
        self,
        simd: S,
        index: usize,
        rows: Range<usize>,
        twist: &[Pair<T>],
        column: &mut [Pair<S::V>],
    ) {
        for ((row, &w), into) in rows.zip(twist).zip(column) {
            put_twisted::<T, S, UPPER>(simd, self.vector(simd, row, index), w, into);
        }
    }
}

/// The vector that begins at an index.
#[inline(always)]
pub(crate) fn load<T: ConvReal, S: Lanes<T>>(_: S, values: &[T], start: usize) -> S::V {
    cast_slice::<T, S::V>(&values[start..start + S::LANES])[0]
}

/// The columns and rows of planes are multiples of these numbers, so that planes hold whole vectors
/// in every instruction set.
pub(crate) const X_STEP: usize = 16;
pub(crate) const Y_STEP: usize = 32;

impl<T: ConvReal> TileTransform<T> {
    /// Transforms of `nx` columns, a multiple of [`X_STEP`], and `ny` rows, a multiple of
    /// [`Y_STEP`]. Neither may have prime factors above 5.
    pub fn new(nx: usize, ny: usize) -> Self {
        assert!(
            nx.is_multiple_of(X_STEP) && ny.is_multiple_of(Y_STEP),
            "{nx} x {ny} is not a multiple of {X_STEP} x {Y_STEP}"
        );
        let half = ny / 2;
        let gain = T::nearest((nx * half) as f64);
        let untwist: Vec<Pair<T>> = (0..half).map(|y| root(2 * ny, y)).collect();
        Self {
            nx,
            ny,
            across: Stages::new(nx),
            down: Stages::new(half),
            twist: untwist.iter().map(|w| [w[0], -w[1]]).collect(),
            untwist: untwist.iter().map(|w| [w[0] / gain, w[1] / gain]).collect(),
        }
    }

    /// The number of values from one row of a plane to the next. It is larger than `nx`: if `nx` is
    /// a power of two, the rows would otherwise share few sets of the cache.
    pub(crate) fn pitch(&self) -> usize {
        self.nx + X_STEP
    }

    /// Values as a plane.
    pub(crate) fn plane<'a>(&self, values: &'a [T]) -> StoredPlane<'a, T> {
        let pitch = self.pitch();
        StoredPlane { values, pitch }
    }

    /// The number of values in a plane.
    pub fn plane_len(&self) -> usize {
        self.pitch() * self.ny
    }

    /// The number of values in a spectrum.
    pub fn spectrum_len(&self) -> usize {
        self.along_y_len(self.nx)
    }

    /// The number of values of working memory for a transform: one column, or one group of vectors and
    /// a part of another, large enough for any instruction set.
    pub fn column_len(&self) -> usize {
        self.ny.max(3 * self.nx) * X_STEP
    }

    /// The number of values that [`forward_along_y`](Self::forward_along_y) writes.
    pub(crate) fn along_y_len(&self, columns: usize) -> usize {
        group(columns) * self.ny
    }

    /// Returns whether a plane with this number of columns has the same spectrum, bit by bit, if it is only
    /// [transformed along y](Self::forward_along_y) and given to
    /// [`forward_multiply_swapped`](Self::forward_multiply_swapped).
    pub(crate) fn is_narrow(&self, columns: usize) -> bool {
        columns.next_multiple_of(X_STEP) <= self.across.first_step()
    }

    /// Computes the spectrum of a plane `[y, x]`. From one row to the next there are
    /// [`pitch`](Self::pitch) values. Only the first `rows` rows and `columns` columns are used.
    /// The values of these rows from `columns` up to the next multiple of [`X_STEP`] must be zero.
    /// The rest is not read. `column` is working memory of [`column_len`](Self::column_len) values.
    #[inline(always)]
    pub fn forward<S: Lanes<T>>(
        &self,
        simd: S,
        plane: &[T],
        (rows, columns): (usize, usize),
        spectrum: &mut [T],
        column: &mut [T],
    ) {
        let plane = self.plane(plane);
        self.forward_along_y(simd, plane, (rows, columns), spectrum, self.nx, column);
        let spectrum: &mut [Pair<S::V>] = cast_slice_mut(&mut spectrum[..self.spectrum_len()]);
        let values: &mut [Pair<S::V>] = &mut cast_slice_mut(column)[..columns.next_multiple_of(S::LANES)];
        for group in spectrum.chunks_exact_mut(group(self.nx)) {
            values.copy_from_slice(&group[..values.len()]);
            self.across.forward(simd, &*values, group);
        }
    }

    /// Computes the spectrum of a plane like [`forward`](Self::forward), multiplies it by another
    /// spectrum, and swaps real and imaginary parts of the product. The product is added to `sum`
    /// if `add` is true, otherwise it replaces `sum`. Each group stays in the first-level cache
    /// from its transform to the sum. `spectrum` is overwritten, and `column` is working memory.
    ///
    /// The other spectrum is whole. Or it is only [transformed along y](Self::forward_along_y), and
    /// `only_y` is its number of columns.
    #[inline(always)]
    #[allow(clippy::too_many_arguments, reason = "two inputs, a sum and two buffers")]
    pub(crate) fn forward_multiply_swapped<S: Lanes<T>>(
        &self,
        simd: S,
        plane: impl Plane<T>,
        (rows, columns): (usize, usize),
        (factor, only_y): (&[T], Option<usize>),
        sum: &mut [T],
        add: bool,
        spectrum: &mut [T],
        column: &mut [T],
    ) {
        self.forward_along_y(simd, plane, (rows, columns), spectrum, columns, column);
        let filled = |columns: usize| columns.next_multiple_of(S::LANES);
        let spectrum: &[Pair<S::V>] = cast_slice(&spectrum[..self.along_y_len(columns)]);
        let sum: &mut [Pair<S::V>] = cast_slice_mut(&mut sum[..self.spectrum_len()]);
        let factors = cast_slice(factor).chunks_exact(group(only_y.unwrap_or(self.nx)));
        let groups = spectrum.chunks_exact(group(columns)).zip(factors);
        for ((group, factor), sum) in groups.zip(sum.chunks_exact_mut(group(self.nx))) {
            let factor = match only_y {
                None => Factor::Transform(&factor[..self.nx]),
                Some(columns) => Factor::Values(&factor[..filled(columns)]),
            };
            let values = &group[..filled(columns)];
            let (sum, work) = (&mut sum[..self.nx], cast_slice_mut(column));
            self.across
                .forward_multiply_swapped(simd, values, factor, sum, add, work);
        }
    }

    /// The first half of [`forward`](Self::forward): the transforms along y of a plane's columns,
    /// stored as groups with room for `width` columns. With only the columns that are used, they
    /// take less room than a spectrum.
    #[inline(always)]
    pub(crate) fn forward_along_y<S: Lanes<T>>(
        &self,
        simd: S,
        plane: impl Plane<T>,
        (rows, columns): (usize, usize),
        spectrum: &mut [T],
        width: usize,
        column: &mut [T],
    ) {
        let half = self.ny / 2;
        let spectrum: &mut [Pair<S::V>] = cast_slice_mut(&mut spectrum[..self.along_y_len(width)]);
        let column: &mut [Pair<S::V>] = &mut cast_slice_mut(column)[..half];
        for block in 0..columns.div_ceil(S::LANES) {
            plane.twist::<S, false>(simd, block, 0..rows.min(half), &self.twist, column);
            plane.twist::<S, true>(simd, block, half..rows.max(half), &self.twist, column);
            self.down.forward_in_place(simd, column, rows.min(half));
            let groups = spectrum.chunks_exact_mut(group(width));
            for (from, group) in column.chunks_exact(S::LANES).zip(groups) {
                simd.transpose(from, &mut group[block * S::LANES..(block + 1) * S::LANES]);
            }
        }
    }

    /// Computes the first `rows` rows and `columns` columns of a plane from its spectrum, whose
    /// real and imaginary parts are swapped. In these rows, the columns up to the next whole vector
    /// are overwritten, too. The spectrum is overwritten. `column` is working memory, as for
    /// [`forward`](Self::forward).
    #[inline(always)]
    pub fn inverse_of_swapped<S: Lanes<T>>(
        &self,
        simd: S,
        spectrum: &mut [T],
        (rows, columns): (usize, usize),
        plane: &mut [T],
        column: &mut [T],
    ) {
        let half = self.ny / 2;
        let spectrum: &mut [Pair<S::V>] = cast_slice_mut(&mut spectrum[..self.spectrum_len()]);
        let column: &mut [Pair<S::V>] = &mut cast_slice_mut(column)[..half];
        for group in spectrum.chunks_exact_mut(group(self.nx)) {
            self.across.inverse_of_swapped(simd, &mut group[..self.nx]);
        }
        for block in 0..columns.div_ceil(S::LANES) {
            let groups = spectrum.chunks_exact(group(self.nx));
            for (into, group) in column.chunks_exact_mut(S::LANES).zip(groups) {
                simd.transpose(&group[block * S::LANES..(block + 1) * S::LANES], into);
            }
            self.down.inverse_of_swapped(simd, column);
            for (y, (value, w)) in column.iter().zip(&self.untwist).enumerate() {
                let w = [simd.splat(w[0]), simd.splat(w[1])];
                let [lower, upper] = times(simd, [value[1], value[0]], w);
                for (row, values) in [(y, lower), (y + half, upper)] {
                    if row < rows {
                        let first = row * self.pitch() + block * S::LANES;
                        let to: &mut [S::V] = cast_slice_mut(&mut plane[first..first + S::LANES]);
                        to[0] = values;
                    }
                }
            }
        }
    }

    /// The product of two spectra, with real and imaginary parts swapped. The product is added to
    /// `sum` if `add` is true, otherwise it replaces `sum`.
    #[inline(always)]
    pub fn multiply_swapped<S: Lanes<T>>(&self, simd: S, a: &[T], b: &[T], sum: &mut [T], add: bool) {
        let a: &[Pair<S::V>] = cast_slice(&a[..self.spectrum_len()]);
        let b: &[Pair<S::V>] = cast_slice(&b[..self.spectrum_len()]);
        let sum: &mut [Pair<S::V>] = cast_slice_mut(&mut sum[..self.spectrum_len()]);
        multiply_swapped(simd, a, b, sum, add);
    }
}

/// The number of complex vectors from one group to the next, for some columns. It is padded like
/// the rows of a plane.
fn group(columns: usize) -> usize {
    columns.next_multiple_of(X_STEP) + 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::{SimdReal, WithIsa, vectorized};

    #[derive(Clone, Copy)]
    struct Convolves(f64);
    impl<T: ConvReal> WithIsa<T> for Convolves {
        type Output = ();
        fn run<S: Lanes<T>>(self, simd: S) {
            // Stages of all radices, in several orders.
            for (nx, ny) in [(16, 32), (48, 32), (80, 96), (64, 128), (96, 320)] {
                let fft = TileTransform::<T>::new(nx, ny);
                // Several sizes of light, for which the result fits into the plane.
                for (rows, columns) in [(1, 1), (ny / 4, 7), (ny / 2 + 3, nx / 2 + 1)] {
                    let (height, width) = (ny + 1 - rows, nx + 1 - columns);
                    // Narrow stamps, and stamps as wide as the plane allows.
                    let (height, width) = (height.min(9), width.min(if ny > nx { 6 } else { nx }));
                    let light = |y: usize, x: usize| ((y * 7 + x * 5) % 11) as f64 - 4.0;
                    let stamp = |y: usize, x: usize| ((y * 3 + x * 13) % 7) as f64 - 2.0;
                    let plane = |rows: usize, columns: usize, value: &dyn Fn(usize, usize) -> f64| {
                        // NaN wherever the transform must not read.
                        let clean = columns.next_multiple_of(X_STEP);
                        let mut plane = vec![T::nan(); fft.plane_len()];
                        for y in 0..rows {
                            for x in 0..clean {
                                let v = if x < columns { value(y, x) } else { 0.0 };
                                plane[y * fft.pitch() + x] = T::nearest(v);
                            }
                        }
                        plane
                    };
                    let dirty = || vec![T::nan(); fft.plane_len().max(fft.spectrum_len())];
                    let (mut a, mut b, mut sum, mut result) = (dirty(), dirty(), dirty(), dirty());
                    let mut column = vec![T::nan(); fft.column_len()];
                    let (light_plane, stamp_plane) =
                        (plane(rows, columns, &light), plane(height, width, &stamp));
                    vectorized!(simd, {
                        fft.forward(simd, &light_plane, (rows, columns), &mut a, &mut column);
                        fft.forward(simd, &stamp_plane, (height, width), &mut b, &mut column);
                        fft.multiply_swapped(simd, &a, &b, &mut sum, false);
                        let mut along_y = vec![T::nan(); fft.along_y_len(width)];
                        let size = (height, width);
                        let stamp_plane = fft.plane(&stamp_plane);
                        fft.forward_along_y(simd, stamp_plane, size, &mut along_y, width, &mut column);
                        for factor in [(&b[..], None), (&along_y[..], Some(width))] {
                            fft.forward_multiply_swapped(
                                simd,
                                fft.plane(&light_plane),
                                (rows, columns),
                                factor,
                                &mut sum,
                                true,
                                &mut a,
                                &mut column,
                            );
                        }
                        let size = (rows + height - 1, columns + width - 1);
                        fft.inverse_of_swapped(simd, &mut sum, size, &mut result, &mut column);
                    });
                    for y in 0..rows + height - 1 {
                        for x in 0..columns + width - 1 {
                            let mut exact = 0.0;
                            for j in 0..height.min(y + 1) {
                                for i in 0..width.min(x + 1) {
                                    if y - j < rows && x - i < columns {
                                        exact += 3.0 * light(y - j, x - i) * stamp(j, i);
                                    }
                                }
                            }
                            let got = result[y * fft.pitch() + x].as_f64();
                            assert!(
                                (got - exact).abs() < self.0 * 1e4,
                                "{nx} x {ny}, {rows} x {columns}: {got} for {exact} at {x}, {y}"
                            );
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn products_of_spectra_are_convolutions() {
        f32::dispatch_to_all(Convolves(1e-7));
        f64::dispatch_to_all(Convolves(1e-16));
    }
}
