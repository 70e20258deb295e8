//! Convolution of one tile, by transforms or by the direct sum, and its working memory.

use std::ops::Range;

use ndarray::{Array2, ArrayView2, ArrayViewMut2};

use crate::ConvReal;
use crate::overlap::overlap;
use crate::plan::coefficient_table::CoefficientTable;
use crate::plan::function_rows::{FunctionRows, WeightedLayers};
use crate::plan::geometry::{Geometry, PlacedTile};
use crate::simd::{Aligned, Lanes};
use crate::transform::{TileTransform, X_STEP};

/// Planes (padded arrays of pixels) and spectra of one transform size. From one tile to the next,
/// only `kernels` keeps its content.
#[derive(Debug)]
pub(crate) struct Workspace<T> {
    /// The tile's light, or the light around the tile.
    pub(crate) light: Aligned<T>,
    /// The light times a coefficient, or a result.
    pub(crate) weighted: Aligned<T>,
    pub(crate) spectrum: Aligned<T>,
    pub(crate) sum: Aligned<T>,
    pub(crate) column: Aligned<T>,
    /// The spectra of a block's kernels, one after the other. Or one kernel, transformed along y.
    pub(crate) kernels: Aligned<T>,
    /// Buffer for one row.
    pub(crate) row: Vec<T>,
    /// The coefficients of one kernel, for each layer.
    pub(crate) functions: Vec<FunctionRows<T>>,
    /// Buffer for one more row.
    pub(crate) other_row: Vec<T>,
}

impl<T: ConvReal> Workspace<T> {
    pub(crate) fn new(fft: &TileTransform<T>) -> Self {
        Self {
            light: Aligned::zeros(fft.plane_len()),
            weighted: Aligned::zeros(fft.plane_len()),
            spectrum: Aligned::zeros(fft.spectrum_len()),
            sum: Aligned::zeros(fft.spectrum_len()),
            column: Aligned::zeros(fft.column_len()),
            kernels: Aligned::default(),
            row: vec![T::zero(); fft.nx],
            functions: Vec::new(),
            other_row: vec![T::zero(); fft.nx],
        }
    }
}

/// The constants of one execution.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TileEngine<'a, T> {
    pub(crate) fft: &'a TileTransform<T>,
    pub(crate) geometry: Geometry,
    /// True if stamps are turned by 180 degrees, as in the adjoint.
    pub(crate) flip: bool,
}

/// A tile and its block's coefficients and stamps.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LocalTile<'a, T> {
    pub(crate) tile: PlacedTile,
    /// The first layer and the number of layers.
    pub(crate) layers: (usize, usize),
    pub(crate) table: &'a CoefficientTable<T>,
    /// `[kernel, y, x]`.
    pub(crate) stamps: &'a [T],
    /// True if the kernels' spectra are not in the workspace, because no other tile needs them.
    pub(crate) transforms_kernels: bool,
}

impl<T: ConvReal> LocalTile<'_, T> {
    /// The columns of the tile, counted from its block's first.
    fn columns(&self) -> Range<usize> {
        self.tile.corner.0..self.tile.corner.0 + self.tile.size.0
    }

    /// The rows of the tile in the table: those of a layer follow those of the layers before it.
    /// `layer` counts from the first of this tile's layers.
    fn rows(&self, layer: usize) -> Range<usize> {
        let first = (self.layers.0 + layer) * self.table.region.shape().ny() + self.tile.corner.1;
        first..first + self.tile.size.1
    }

    /// The row in the table of a row of the tile's light, in which the layers follow each other.
    #[inline(always)]
    pub(crate) fn row_in_table(&self, row: usize) -> usize {
        let rows = self.tile.size.1;
        self.rows(row / rows).start + row % rows
    }

    /// Places the functions of all layers in the tile.
    #[inline(always)]
    fn place(&self, functions: &mut Vec<FunctionRows<T>>) {
        functions.resize_with(self.layers.1, FunctionRows::default);
        for (layer, function) in functions.iter_mut().enumerate() {
            function.place(self.table, self.columns(), self.rows(layer));
        }
    }

    /// Sets the function of each layer to the coefficient of a kernel. Divides the tile's light by the
    /// flux before, if the kernel is the first whose light is divided.
    #[inline(always)]
    fn choose(&self, kernel: usize, light: &mut [T], pitch: usize, functions: &mut [FunctionRows<T>]) {
        let role = self.table.role;
        let (columns, rows) = self.tile.size;
        let divides = role.is_divided(kernel) && (kernel == 0 || !role.is_divided(kernel - 1));
        for (function, light) in functions.iter_mut().zip(light.chunks_mut(rows * pitch)) {
            if divides {
                function.set(self.table, Some(0));
                for (y, light) in light.chunks_exact_mut(pitch).take(rows).enumerate() {
                    function.divide(y, &mut light[..columns]);
                }
            }
            function.set(self.table, role.function_of(kernel));
        }
    }

    /// Multiplies values of a tile's row by the coefficients of a kernel, and adds them to the
    /// output, or to `divided` if they are to be divided by the flux.
    #[inline(always)]
    fn weigh_and_add(
        &self,
        (kernel, function): (usize, &FunctionRows<T>),
        y: usize,
        values: &[T],
        output: &mut ArrayViewMut2<'_, T>,
        divided: &mut Array2<T>,
        row: &mut [T],
    ) {
        let row = &mut row[..values.len()];
        function.multiply(y, values, row);
        if self.table.role.is_divided(kernel) {
            add_row(row, &mut divided.view_mut(), (0, y));
        } else {
            add_row(row, output, (0, y));
        }
    }

    /// Divides values by the flux and adds them to the output.
    #[inline(always)]
    fn divide_and_add(
        &self,
        mut divided: Array2<T>,
        output: &mut ArrayViewMut2<'_, T>,
        function: &mut FunctionRows<T>,
    ) {
        if self.table.role.divides() {
            function.set(self.table, Some(0));
        }
        for (y, mut row) in divided.outer_iter_mut().enumerate() {
            let row = row.as_slice_mut().expect("row-major");
            function.divide(y, row);
            add_row(row, output, (0, y));
        }
    }

    /// Zeros with the tile's size, if there are values to be divided by the flux. Otherwise without
    /// any row.
    fn zeros(&self) -> Array2<T> {
        let (columns, rows) = self.tile.size;
        let rows = if self.table.role.divides() { rows } else { 0 };
        Array2::zeros((rows, columns))
    }
}

impl<T: ConvReal> TileEngine<'_, T> {
    /// Copies a rectangle of `source` that begins at (`column`, `row`) to `plane`. Pixels outside
    /// `source`, and the padding of rows, become zeros. `seen` gets each row with its padding while it is
    /// in the first-level cache.
    #[inline(always)]
    pub(crate) fn load(
        &self,
        source: ArrayView2<'_, T>,
        (column, row): (i64, i64),
        (columns, rows): (usize, usize),
        plane: &mut [T],
        mut seen: impl FnMut(&[T]),
    ) {
        let (height, width) = source.dim();
        let padded = columns.next_multiple_of(X_STEP);
        let shared = overlap(column, columns, width);
        for (y, into) in plane.chunks_exact_mut(self.fft.pitch()).take(rows).enumerate() {
            let into = &mut into[..padded];
            let source_row = row + y as i64;
            if let Some((to, from)) = &shared
                && (0..height as i64).contains(&source_row)
            {
                let values = source.row(source_row as usize);
                let values = values.to_slice().expect("images are row-major");
                into[..to.start].fill(T::zero());
                into[to.clone()].copy_from_slice(&values[from.clone()]);
                into[to.end..].fill(T::zero());
                seen(into);
            } else {
                into.fill(T::zero());
            }
        }
    }

    /// Adds the first `columns` and `rows` of a plane to `output`, beginning at (`column`, `row`).
    /// Values beyond `output` are ignored.
    #[inline(always)]
    pub(crate) fn add(
        &self,
        plane: &[T],
        (columns, rows): (usize, usize),
        output: &mut ArrayViewMut2<'_, T>,
        (column, row): (i64, i64),
    ) {
        let (height, width) = output.dim();
        let Some((from, to)) = overlap(column, columns, width) else {
            return;
        };
        for (y, values) in plane.chunks_exact(self.fft.pitch()).take(rows).enumerate() {
            let target = row + y as i64;
            if (0..height as i64).contains(&target) {
                let mut target = output.row_mut(target as usize);
                let target = target.as_slice_mut().expect("images are row-major");
                let pairs = target[to.clone()].iter_mut().zip(&values[from.clone()]);
                pairs.for_each(
                    #[inline(always)]
                    |(t, v)| *t += *v,
                );
            }
        }
    }

    /// Computes the spectra of stamps `[kernel, y, x]`.
    #[inline(always)]
    pub(crate) fn transform_kernels<S: Lanes<T>>(&self, simd: S, stamps: &[T], workspace: &mut Workspace<T>) {
        let (sx, sy) = self.geometry.stamp;
        let length = self.fft.spectrum_len();
        workspace.kernels.at_least(stamps.len() / (sx * sy) * length);
        let w = workspace;
        let spectra = w.kernels.get_mut().chunks_exact_mut(length);
        for (stamp, spectrum) in stamps.chunks_exact(sx * sy).zip(spectra) {
            self.load_stamp(stamp, w.weighted.get_mut());
            let plane = w.weighted.get();
            self.fft
                .forward(simd, plane, (sy, sx), spectrum, w.column.get_mut());
        }
    }

    /// Copies a stamp to the first pixels of a plane.
    #[inline(always)]
    fn load_stamp(&self, stamp: &[T], plane: &mut [T]) {
        let (sx, sy) = self.geometry.stamp;
        for (y, into) in plane.chunks_exact_mut(self.fft.pitch()).take(sy).enumerate() {
            let row = if self.flip { sy - 1 - y } else { y };
            into[..sx].copy_from_slice(&stamp[row * sx..(row + 1) * sx]);
            if self.flip {
                into[..sx].reverse();
            }
            into[sx..sx.next_multiple_of(X_STEP)].fill(T::zero());
        }
    }

    /// Spreads the light of a tile (`workspace.light`) with its kernels. Writes the result to
    /// `workspace.weighted`. The result is larger than the tile by the stamp's size less one pixel.
    ///
    /// The kernels' spectra are in the workspace, or each kernel is transformed when it is needed, so
    /// that it stays in the second-level cache.
    #[inline(always)]
    pub(crate) fn scatter<S: Lanes<T>>(
        &self,
        simd: S,
        local: LocalTile<'_, T>,
        workspace: &mut Workspace<T>,
    ) {
        let (columns, rows) = local.tile.size;
        let (pitch, length) = (self.fft.pitch(), self.fft.spectrum_len());
        let (sx, sy) = self.geometry.stamp;
        let w = workspace;
        local.place(&mut w.functions);
        if local.transforms_kernels {
            w.kernels.at_least(self.fft.along_y_len(sx));
        }
        for (kernel, stamp) in local.stamps.chunks_exact(sx * sy).enumerate() {
            let factor = if local.transforms_kernels {
                self.load_stamp(stamp, w.weighted.get_mut());
                let (plane, spectrum) = (self.fft.plane(w.weighted.get()), w.kernels.get_mut());
                self.fft
                    .forward_along_y(simd, plane, (sy, sx), spectrum, sx, w.column.get_mut());
                (&*spectrum, Some(sx))
            } else {
                (&w.kernels.get()[kernel * length..(kernel + 1) * length], None)
            };
            local.choose(kernel, w.light.get_mut(), pitch, &mut w.functions);
            let (light, size) = (self.fft.plane(w.light.get()), (rows, columns));
            let (sum, add, spectrum) = (w.sum.get_mut(), kernel > 0, w.spectrum.get_mut());
            let column = w.column.get_mut();
            if let [function] = &w.functions[..] {
                let light = (light, function);
                self.fft
                    .forward_multiply_swapped(simd, light, size, factor, sum, add, spectrum, column);
            } else {
                let functions = &w.functions[..];
                let light = WeightedLayers {
                    light,
                    rows,
                    functions,
                };
                self.fft
                    .forward_multiply_swapped(simd, light, size, factor, sum, add, spectrum, column);
            }
        }
        let (width, height) = self.geometry.around(local.tile.size);
        self.fft.inverse_of_swapped(
            simd,
            w.sum.get_mut(),
            (height, width),
            w.weighted.get_mut(),
            w.column.get_mut(),
        );
    }

    /// Convolves the light around a tile with the kernels and adds the result to `output`, which
    /// has the tile's size. The light (`workspace.light`) is larger than the tile by the stamp's
    /// size less one pixel.
    #[inline(always)]
    pub(crate) fn gather<S: Lanes<T>>(
        &self,
        simd: S,
        local: LocalTile<'_, T>,
        workspace: &mut Workspace<T>,
        output: &mut ArrayViewMut2<'_, T>,
    ) {
        let rows = local.tile.size.1;
        let (width, height) = self.geometry.around(local.tile.size);
        let (pitch, length) = (self.fft.pitch(), self.fft.spectrum_len());
        let w = workspace;
        local.place(&mut w.functions);
        let function = &mut w.functions[0];
        let mut divided = local.zeros();
        let column = w.column.get_mut();
        self.fft
            .forward(simd, w.light.get(), (height, width), w.spectrum.get_mut(), column);
        for kernel in 0..local.table.kernel_count() {
            let spectra = &w.kernels.get()[kernel * length..(kernel + 1) * length];
            self.fft
                .multiply_swapped(simd, w.spectrum.get(), spectra, w.sum.get_mut(), false);
            let plane = w.weighted.get_mut();
            self.fft
                .inverse_of_swapped(simd, w.sum.get_mut(), (height, width), plane, column);
            let whole = plane
                .chunks_exact(pitch)
                .skip(self.geometry.stamp.1 - 1)
                .take(rows);
            function.set(local.table, local.table.role.function_of(kernel));
            for (y, values) in whole.enumerate() {
                let values = &values[self.geometry.stamp.0 - 1..width];
                local.weigh_and_add((kernel, function), y, values, output, &mut divided, &mut w.row);
            }
        }
        local.divide_and_add(divided, output, function);
    }

    #[inline(always)]
    pub(crate) fn at(&self, stamp: &[T], i: usize, j: usize) -> T {
        let (sx, sy) = self.geometry.stamp;
        let (i, j) = if self.flip {
            (sx - 1 - i, sy - 1 - j)
        } else {
            (i, j)
        };
        stamp[j * sx + i]
    }

    /// Like [`scatter`](Self::scatter), but by the direct sum from stamps.
    #[inline(always)]
    pub(crate) fn scatter_directly(&self, local: LocalTile<'_, T>, workspace: &mut Workspace<T>) {
        let (columns, rows) = local.tile.size;
        let (sx, sy) = self.geometry.stamp;
        let pitch = self.fft.pitch();
        let w = workspace;
        local.place(&mut w.functions);
        let result = w.weighted.get_mut();
        for into in result.chunks_exact_mut(pitch).take(rows + sy - 1) {
            into[..columns + sx - 1].fill(T::zero());
        }
        for (kernel, stamp) in local.stamps.chunks_exact(sx * sy).enumerate() {
            local.choose(kernel, w.light.get_mut(), pitch, &mut w.functions);
            for y in 0..rows {
                let (row, other) = (&mut w.row[..columns], &mut w.other_row[..columns]);
                for (layer, function) in w.functions.iter().enumerate() {
                    let light = &w.light.get()[(layer * rows + y) * pitch..][..columns];
                    if layer == 0 {
                        function.multiply(y, light, row);
                        continue;
                    }
                    function.multiply(y, light, other);
                    for (sum, product) in row.iter_mut().zip(&*other) {
                        *sum += *product;
                    }
                }
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

    /// Like [`gather`](Self::gather), but by the direct sum from stamps.
    #[inline(always)]
    pub(crate) fn gather_directly(
        &self,
        local: LocalTile<'_, T>,
        workspace: &mut Workspace<T>,
        output: &mut ArrayViewMut2<'_, T>,
    ) {
        let (columns, rows) = local.tile.size;
        let (sx, sy) = self.geometry.stamp;
        let pitch = self.fft.pitch();
        let w = workspace;
        let mut values = vec![T::zero(); columns];
        local.place(&mut w.functions);
        let function = &mut w.functions[0];
        let mut divided = local.zeros();
        for (kernel, stamp) in local.stamps.chunks_exact(sx * sy).enumerate() {
            function.set(local.table, local.table.role.function_of(kernel));
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
                let kernel = (kernel, &*function);
                local.weigh_and_add(kernel, y, &values, output, &mut divided, &mut w.row);
            }
        }
        local.divide_and_add(divided, output, function);
    }
}

/// Adds values to a row of an image, from a column on.
#[inline(always)]
pub(crate) fn add_row<T: ConvReal>(
    values: &[T],
    output: &mut ArrayViewMut2<'_, T>,
    (column, row): (usize, usize),
) {
    let mut target = output.row_mut(row);
    let target = target.as_slice_mut().expect("images are row-major");
    for (t, v) in target[column..].iter_mut().zip(values) {
        *t += *v;
    }
}
