//! A coefficient at each pixel of a tile, row by row.

use std::ops::Range;

use super::coefficient_table::{CoefficientTable, TableBand};
use crate::ConvReal;
use crate::simd::{Aligned, Lanes, Pair};
use crate::transform::{Plane, StoredPlane, load, put_twisted};

/// A function of a [`CoefficientTable`] in some columns and rows of its region.
///
/// From the first to the last row of a band, it is linear along each column. So its values in these
/// two rows are enough for all rows of the band.
#[derive(Debug, Default)]
pub struct FunctionRows<T> {
    columns: Range<usize>,
    bands: Range<usize>,
    rows: Vec<RowInBand<T>>,
    /// The rows of each band, counted from the first chosen row. They are listed, because to find them
    /// again for each column of vectors would take 2 % of an execution.
    band_rows: Vec<Range<usize>>,
    /// True for the constant 1.
    is_one: bool,
    /// The function in the first and the last row of each band, from row to row [`Self::pitch`] values.
    ends: Aligned<T>,
}

/// A row as a combination of the first and the last row of its band.
#[derive(Debug)]
struct RowInBand<T> {
    /// The indices of these two rows' values.
    ends: [usize; 2],
    weights: [T; 2],
}

/// The number of neighbouring values that are written together.
const CHUNK: usize = 16;

impl<T: ConvReal> FunctionRows<T> {
    /// Chooses columns and rows of a table's region. [`set`](Self::set) then chooses the function.
    #[inline(always)]
    pub fn place(&mut self, table: &CoefficientTable<T>, columns: Range<usize>, rows: Range<usize>) {
        self.bands = table.bands_of(&rows);
        self.columns = columns;
        let pitch = self.pitch();
        self.ends.at_least(2 * self.bands.len() * pitch);
        self.rows.clear();
        self.band_rows.clear();
        for (i, band) in table.bands[self.bands.clone()].iter().enumerate() {
            let last = if band.rows.len() == 1 { 2 * i } else { 2 * i + 1 };
            let steps = T::nearest((band.rows.len() - 1).max(1) as f64);
            let start = self.rows.len();
            for row in band.rows.start.max(rows.start)..band.rows.end.min(rows.end) {
                let after = T::nearest((row - band.rows.start) as f64);
                self.rows.push(RowInBand {
                    ends: [2 * i * pitch, last * pitch],
                    weights: [(steps - after) / steps, after / steps],
                });
            }
            self.band_rows.push(start..self.rows.len());
        }
    }

    /// Chooses a function, or the constant 1.
    #[inline(always)]
    pub fn set(&mut self, table: &CoefficientTable<T>, function: Option<usize>) {
        self.is_one = function.is_none();
        let Some(function) = function else { return };
        let pitch = self.pitch();
        let bands = table.bands[self.bands.clone()].iter();
        for (band, ends) in bands.zip(self.ends.get_mut().chunks_exact_mut(2 * pitch)) {
            let (first, last) = ends.split_at_mut(pitch);
            along_row(table, band, 0, function, &self.columns, first);
            if band.rows.len() > 1 {
                along_row(table, band, 2, function, &self.columns, last);
            }
        }
    }

    /// Multiplies the values of a row's pixels by the function, and writes the products to
    /// `products`. `row` counts from the first chosen row.
    #[inline(always)]
    pub fn multiply(&self, row: usize, values: &[T], products: &mut [T]) {
        if self.is_one {
            products.copy_from_slice(values);
            return;
        }
        for ((product, &value), function) in products.iter_mut().zip(values).zip(self.along(row)) {
            *product = value * function;
        }
    }

    /// Divides the values of a row's pixels by the function.
    #[inline(always)]
    pub(crate) fn divide(&self, row: usize, values: &mut [T]) {
        for (value, function) in values.iter_mut().zip(self.along(row)) {
            *value /= function;
        }
    }

    /// The function along a row.
    #[inline(always)]
    fn along(&self, row: usize) -> impl Iterator<Item = T> + '_ {
        let RowInBand { ends, weights } = &self.rows[row];
        let values = |end: usize| self.ends.get()[end..][..self.columns.len()].iter();
        values(ends[0]).zip(values(ends[1])).map(
            #[inline(always)]
            |(&first, &last)| weights[0] * first + weights[1] * last,
        )
    }

    /// The number of values from one row of `ends` to the next: whole vectors, with room for a chunk
    /// more.
    fn pitch(&self) -> usize {
        (self.columns.len() + CHUNK).next_multiple_of(CHUNK)
    }
}

/// Light times a function.
impl<T: ConvReal> Plane<T> for (StoredPlane<'_, T>, &FunctionRows<T>) {
    #[inline(always)]
    fn twist<S: Lanes<T>, const UPPER: bool>(
        self,
        simd: S,
        index: usize,
        rows: Range<usize>,
        twist: &[Pair<T>],
        column: &mut [Pair<S::V>],
    ) {
        let (light, function) = self;
        if function.is_one {
            return light.twist::<S, UPPER>(simd, index, rows, twist, column);
        }
        let (ends, at) = (function.ends.get(), index * S::LANES);
        for band in &function.band_rows {
            let band = band.start.max(rows.start)..band.end.min(rows.end);
            if band.is_empty() {
                continue;
            }
            let of_band = &function.rows[band.clone()];
            let [first, last] = of_band[0].ends;
            let (first, last) = (load(simd, ends, first + at), load(simd, ends, last + at));
            let here = band.start - rows.start..band.end - rows.start;
            let column = column[here.clone()].iter_mut().zip(&twist[here]);
            for ((row, (into, &w)), RowInBand { weights, .. }) in band.zip(column).zip(of_band) {
                let weight = simd.mul(simd.splat(weights[0]), first);
                let weight = simd.mul_add(simd.splat(weights[1]), last, weight);
                let value = simd.mul(light.vector(simd, row, index), weight);
                put_twisted::<T, S, UPPER>(simd, value, w, into);
            }
        }
    }
}

/// The light of several layers, each times its function, added up.
#[derive(Debug, Clone, Copy)]
pub(crate) struct WeightedLayers<'a, T> {
    /// The layers, one after the other.
    pub(crate) light: StoredPlane<'a, T>,
    /// The number of rows of each layer.
    pub(crate) rows: usize,
    /// The function of each layer.
    pub(crate) functions: &'a [FunctionRows<T>],
}

/// The number of rows whose sums over layers are computed together, so that they stay in the first-level
/// cache.
const ROWS_TOGETHER: usize = 32;

impl<T: ConvReal> Plane<T> for WeightedLayers<'_, T> {
    #[inline(always)]
    fn twist<S: Lanes<T>, const UPPER: bool>(
        self,
        simd: S,
        index: usize,
        rows: Range<usize>,
        twist: &[Pair<T>],
        column: &mut [Pair<S::V>],
    ) {
        let mut sums = [simd.splat(T::zero()); ROWS_TOGETHER];
        for first in rows.clone().step_by(ROWS_TOGETHER) {
            let some = first..(first + ROWS_TOGETHER).min(rows.end);
            let sums = &mut sums[..some.len()];
            for (layer, function) in self.functions.iter().enumerate() {
                self.add_layer(simd, (layer, function), index, some.clone(), sums);
            }
            let here = first - rows.start..some.end - rows.start;
            let column = column[here.clone()].iter_mut().zip(&twist[here]);
            for (&mut value, (into, &w)) in sums.iter_mut().zip(column) {
                put_twisted::<T, S, UPPER>(simd, value, w, into);
            }
        }
    }
}

impl<T: ConvReal> WeightedLayers<'_, T> {
    /// Adds a layer's light times its function to `sums`, which the first layer replaces.
    #[inline(always)]
    fn add_layer<S: Lanes<T>>(
        self,
        simd: S,
        (layer, function): (usize, &FunctionRows<T>),
        index: usize,
        rows: Range<usize>,
        sums: &mut [S::V],
    ) {
        let light = |row: usize| self.light.vector(simd, layer * self.rows + row, index);
        if layer == 0 {
            sums.fill(simd.splat(T::zero()));
        }
        if function.is_one {
            for (sum, row) in sums.iter_mut().zip(rows) {
                *sum = simd.add(*sum, light(row));
            }
            return;
        }
        let (ends, at) = (function.ends.get(), index * S::LANES);
        let before = function.band_rows.partition_point(|band| band.end <= rows.start);
        for band in &function.band_rows[before..] {
            let band = band.start.max(rows.start)..band.end.min(rows.end);
            if band.is_empty() {
                break;
            }
            let of_band = &function.rows[band.clone()];
            let [first, last] = of_band[0].ends;
            let (first, last) = (load(simd, ends, first + at), load(simd, ends, last + at));
            let sums = &mut sums[band.start - rows.start..band.end - rows.start];
            for ((row, sum), RowInBand { weights, .. }) in band.zip(sums).zip(of_band) {
                let weight = simd.mul(simd.splat(weights[0]), first);
                let weight = simd.mul_add(simd.splat(weights[1]), last, weight);
                *sum = simd.mul_add(light(row), weight, *sum);
            }
        }
    }
}

/// Writes a function in some columns of a row to `values`, which has room for [`CHUNK`] values
/// more. These become zeros. `corner` is 0 for the first row of a band, 2 for its last row.
#[inline(always)]
fn along_row<T: ConvReal>(
    table: &CoefficientTable<T>,
    band: &TableBand,
    corner: usize,
    function: usize,
    columns: &Range<usize>,
    values: &mut [T],
) {
    let cells = &table.cells[band.cells.clone()];
    let skip = cells.partition_point(|&(column, length)| (column + length) as usize <= columns.start);
    for (cell, &(column, length)) in cells.iter().enumerate().skip(skip) {
        let (column, length) = (column as usize, length as usize);
        if column >= columns.end {
            break;
        }
        let (from, to) = (column.max(columns.start), (column + length).min(columns.end));
        let steps = T::nearest((length - 1).max(1) as f64);
        let at = |right: usize| {
            let place = (cell * band.corners() + corner + right) * table.functions + function;
            table.values[band.value + place] / steps
        };
        let (a, b) = (at(0), at(1));
        // Writes whole chunks, because cells are often short. What is beyond a cell is written
        // again with the next cell.
        for start in (from..to).step_by(CHUNK) {
            let first = T::nearest((start - column) as f64);
            let chunk = &mut values[start - columns.start..][..CHUNK];
            for (i, value) in chunk.iter_mut().enumerate() {
                let i = first + T::nearest(i as f64);
                *value = (steps - i) * a + i * b;
            }
        }
    }
    // Transforms read whole vectors, in which dark padding must stay dark.
    values[columns.len()..].fill(T::zero());
}
