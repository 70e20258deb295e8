//! The coefficients of local modes at every pixel of a region.

use std::ops::Range;

use ndarray::Array2;
use psf_types::{FieldError, PixelRegion, PsfModel};

use super::local_modes::LocalModes;
use super::region_cells::{CORNERS, Cell, RegionCells};
use crate::ConvReal;
use crate::simd::vectorized;

/// The role of a PSF's flux in the convolution. The reference is the mean PSF of a region, scaled to
/// unit flux, and the modes hold the differences from it (`LocalModes`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FluxRole {
    /// The flux is the same everywhere and is included in the reference.
    Constant,
    /// The reference is multiplied by the flux of the PSF at each pixel.
    Weight,
    /// PSFs are scaled to unit flux. So the modes are divided by the flux of the unscaled PSF. The
    /// reference already has unit flux, and is not divided.
    Divisor,
    /// There is no reference.
    NoReference {
        /// True if the modes are divided by the flux.
        scaled: bool,
    },
}

/// The coefficients of a region's modes: functions that are bilinear in cells. If there are several
/// layers, their rows follow each other ([`RegionCells`]). Only their values at
/// the cells' corners are stored.
///
/// In a cell with values `a` at its first and `b` at its last column, `n` columns later, a function
/// has the value `[(n - i) a + i b] / n` in column `i`, and likewise between its first and last row.
/// No term cancels another of the same sign. So where neighbouring PSFs differ by many orders of
/// magnitude, the faint end keeps its relative accuracy.
#[derive(Debug)]
pub struct CoefficientTable<T> {
    pub(crate) region: PixelRegion,
    pub(crate) role: FluxRole,
    /// The number of functions. The first is the flux, if its role needs it at every pixel. The
    /// others are the coefficients of the modes.
    pub(crate) functions: usize,
    pub(super) bands: Vec<TableBand>,
    /// First column and length of each cell.
    pub(super) cells: Vec<(u32, u32)>,
    /// The values at the corners of each cell, `[corner, function]`: first and last column of the
    /// first row, then of the last row. A band of a single row has only the first two corners.
    pub(super) values: Vec<T>,
    /// `(row, column)` of the pixels without a PSF.
    undefined: Vec<(u32, u32)>,
}

/// Neighbouring rows that are divided into cells at the same columns.
#[derive(Debug)]
pub(super) struct TableBand {
    pub(super) rows: Range<usize>,
    pub(super) cells: Range<usize>,
    /// The index of the first cell's first value.
    pub(super) value: usize,
}

impl TableBand {
    /// The number of corners of a cell with values of their own.
    #[inline(always)]
    pub(super) fn corners(&self) -> usize {
        if self.rows.len() == 1 { 2 } else { CORNERS }
    }
}

/// The coefficients of a block's kernels at one pixel.
pub(crate) struct PixelCoefficients<'a, T> {
    /// The values at the corners of the pixel's cell, and their weights.
    values: &'a [T],
    weights: [T; CORNERS],
    table: &'a CoefficientTable<T>,
}

impl<T: ConvReal> PixelCoefficients<'_, T> {
    #[inline(always)]
    pub(crate) fn function(&self, function: usize) -> T {
        let corners = self.values.chunks_exact(self.table.functions);
        let terms = corners
            .zip(self.weights)
            .map(|(values, weight)| weight * values[function]);
        terms.fold(T::zero(), |sum, term| sum + term)
    }

    /// The light of the pixel, multiplied by the coefficient of a kernel.
    #[inline(always)]
    pub(crate) fn weigh(&self, kernel: usize, light: T) -> T {
        let role = self.table.role;
        let weighted = role
            .function_of(kernel)
            .map_or(light, |f| light * self.function(f));
        if role.is_divided(kernel) {
            weighted / self.function(0)
        } else {
            weighted
        }
    }
}

/// Fluxes count as equal if they differ by at most this fraction: the rounding of their sums. The
/// error of their mean is then half of it.
const SAME_FLUX: f64 = 4e-15;

impl FluxRole {
    /// Returns the role of the flux in a region, and the flux to which the reference is scaled: the
    /// PSFs' flux if that is constant, otherwise 1. `at_corners` holds the modes'
    /// [values](LocalModes::at_corners).
    pub fn of(model: &PsfModel, modes: &LocalModes, at_corners: &Array2<f64>) -> (Self, f64) {
        let scaled = model.needs_flux_scaling();
        if modes.reference().is_none() {
            return (Self::NoReference { scaled }, 1.0);
        }
        if scaled {
            return (Self::Divisor, 1.0);
        }
        let fluxes = || at_corners.column(0).into_iter().copied();
        match fluxes().reduce(f64::min).zip(fluxes().reduce(f64::max)) {
            None => (Self::Constant, 1.0),
            Some((low, high)) if high - low <= SAME_FLUX * high.abs().max(low.abs()) => {
                (Self::Constant, f64::midpoint(low, high))
            }
            Some(_) => (Self::Weight, 1.0),
        }
    }

    fn has_flux_function(self) -> bool {
        !matches!(self, Self::Constant | Self::NoReference { scaled: false })
    }

    /// The index of the function that multiplies a kernel's light. `None` if the light is left
    /// unchanged.
    pub fn function_of(self, kernel: usize) -> Option<usize> {
        match self {
            Self::Constant => kernel.checked_sub(1),
            Self::Divisor => (kernel > 0).then_some(kernel),
            Self::Weight | Self::NoReference { scaled: false } => Some(kernel),
            Self::NoReference { scaled: true } => Some(kernel + 1),
        }
    }

    /// True if the modes are divided by the flux.
    pub(crate) fn divides(self) -> bool {
        matches!(self, Self::Divisor | Self::NoReference { scaled: true })
    }

    /// True if a kernel is a mode that is divided by the flux.
    pub(crate) fn is_divided(self, kernel: usize) -> bool {
        self.divides() && self.function_of(kernel).is_some()
    }
}

impl<T: ConvReal> CoefficientTable<T> {
    /// Tabulates the coefficients of modes over a region. `at_corners` holds the modes'
    /// [values](LocalModes::at_corners) at the corners of the region's `cells`.
    pub fn new(
        region: PixelRegion,
        role: FluxRole,
        mut at_corners: Array2<f64>,
        cells: &RegionCells,
    ) -> Self {
        let count = at_corners.ncols();
        let skip = usize::from(!role.has_flux_function());
        let mut table = Self {
            region,
            role,
            functions: count - skip,
            bands: Vec::with_capacity(cells.bands.len()),
            cells: Vec::new(),
            values: Vec::new(),
            undefined: Vec::new(),
        };
        if role.divides() {
            // Light is divided by the flux before it is multiplied. Fluxes near 1 keep it in range.
            // A power of 2 does not round.
            let largest = at_corners.column(0).fold(0.0_f64, |m, flux| m.max(flux.abs()));
            let scale = (-largest.log2().floor()).exp2();
            if scale.is_normal() {
                at_corners *= scale;
            }
        }
        let at_corners = at_corners.as_slice().expect("row-major");
        for band in &cells.bands {
            let of_band = cells.cells_of(band);
            let rows = &band.rows;
            let ends = if rows.len() == 1 {
                vec![rows.start]
            } else {
                vec![rows.start, rows.end - 1]
            };
            let values = values_in_rows(at_corners, count, of_band, &ends);
            if !role.divides() || fluxes(&values, count).all(is_positive) {
                table.push_band(rows.clone());
                for (cell, values) in of_band.iter().zip(values.chunks_exact(2 * ends.len() * count)) {
                    table.push_cell(
                        [cell.columns.clone(), rows.clone()],
                        values,
                        skip,
                        cell.corners.is_none(),
                    );
                }
                continue;
            }
            // Some pixels of the band may have no PSF: each row becomes a band of its own.
            for row in rows.clone() {
                let values = values_in_rows(at_corners, count, of_band, &[row]);
                table.push_band(row..row + 1);
                for (cell, ends) in of_band.iter().zip(values.chunks_exact(2 * count)) {
                    if cell.corners.is_none() || fluxes(ends, count).all(is_positive) {
                        let part = [cell.columns.clone(), row..row + 1];
                        table.push_cell(part, ends, skip, cell.corners.is_none());
                    } else {
                        table.push_pixels(row, &cell.columns, ends, skip);
                    }
                }
            }
        }
        table
    }

    /// Begins a band. Its cells are those that are pushed next.
    fn push_band(&mut self, rows: Range<usize>) {
        let cell = self.cells.len();
        self.bands.push(TableBand {
            rows,
            cells: cell..cell,
            value: self.values.len(),
        });
    }

    /// Adds a cell to the last band. `values` are those at its corners. The first `skip` of each
    /// corner are not stored.
    fn push_cell(
        &mut self,
        [columns, rows]: [Range<usize>; 2],
        values: &[f64],
        skip: usize,
        undefined: bool,
    ) {
        self.cells.push((columns.start as u32, columns.len() as u32));
        self.bands.last_mut().expect("a band").cells.end += 1;
        for corner in values.chunks_exact(self.functions + skip) {
            self.values.extend(corner[skip..].iter().map(|&v| T::nearest(v)));
        }
        if undefined {
            let pixels = rows.flat_map(|row| columns.clone().map(move |column| (row as u32, column as u32)));
            self.undefined.extend(pixels);
        }
    }

    /// Adds each pixel of a cell's part of a row as a cell of its own, because only some of them may
    /// have a PSF. `ends` are the values at the cell's first and last column.
    fn push_pixels(&mut self, row: usize, columns: &Range<usize>, ends: &[f64], skip: usize) {
        let (first, last) = ends.split_at(ends.len() / 2);
        let steps = (columns.len() - 1).max(1) as f64;
        for (i, column) in columns.clone().enumerate() {
            let part = i as f64 / steps;
            let at = |(a, b): (&f64, &f64)| (1.0 - part) * a + part * b;
            let mut values: Vec<f64> = first.iter().zip(last).map(at).collect();
            let is_undefined = !is_positive(values[0]);
            if is_undefined {
                values.fill(0.0);
                values[0] = 1.0;
            }
            self.push_cell(
                [column..column + 1, row..row + 1],
                &values.repeat(2),
                skip,
                is_undefined,
            );
        }
    }

    /// The number of kernels: the modes, plus 1 if there is a reference.
    pub fn kernel_count(&self) -> usize {
        match self.role {
            FluxRole::Constant => self.functions + 1,
            FluxRole::Weight | FluxRole::Divisor | FluxRole::NoReference { scaled: false } => self.functions,
            FluxRole::NoReference { scaled: true } => self.functions - 1,
        }
    }

    /// Memory used, in bytes.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.bands[..])
            + size_of_val(&self.cells[..])
            + size_of_val(&self.values[..])
            + size_of_val(&self.undefined[..])
    }

    /// The first column and the length of each cell in a row.
    pub(crate) fn cells_in(&self, row: usize) -> &[(u32, u32)] {
        &self.cells[self.band(row).cells.clone()]
    }

    fn band(&self, row: usize) -> &TableBand {
        &self.bands[self.bands_of(&(row..row + 1)).start]
    }

    /// The bands of some rows.
    pub(super) fn bands_of(&self, rows: &Range<usize>) -> Range<usize> {
        let before = |row: usize| self.bands.partition_point(|band| band.rows.end <= row);
        before(rows.start)..before(rows.end - 1) + 1
    }

    /// The coefficients at a pixel. Row and column count from the region's first pixel.
    pub(crate) fn pixel(&self, row: usize, column: usize) -> PixelCoefficients<'_, T> {
        let (band, cells) = (self.band(row), self.cells_in(row));
        let cell = cells.partition_point(|&(start, length)| (start + length) as usize <= column);
        let size = band.corners() * self.functions;
        let parts = |length: usize, after: usize| {
            let steps = T::nearest((length - 1).max(1) as f64);
            let after = T::nearest(after as f64);
            [(steps - after) / steps, after / steps]
        };
        let [left, right] = parts(cells[cell].1 as usize, column - cells[cell].0 as usize);
        let [first, last] = parts(band.rows.len(), row - band.rows.start);
        PixelCoefficients {
            values: &self.values[band.value + cell * size..][..size],
            weights: [first * left, first * right, last * left, last * right],
            table: self,
        }
    }

    /// Returns an error for the first pixel that has no PSF and for which `lit(row, column)` is
    /// true. Row and column count from the region's first pixel, and rows of a layer follow those of
    /// the layers before it. `models` are those of the layers.
    pub(crate) fn check(
        &self,
        models: &[PsfModel],
        lit: impl Fn(usize, usize) -> bool,
    ) -> Result<(), FieldError> {
        let height = self.region.shape().ny();
        for &(row, column) in &self.undefined {
            if lit(row as usize, column as usize) {
                let model = &models[row as usize / height];
                let mut coefficients = vec![0.0; model.stamp_count()];
                let position = self.region.position(column as usize, row as usize % height);
                model.scaled_coefficients_into(position, &mut coefficients)?;
                return Err(FieldError::External {
                    position,
                    source: "the coefficient field gives no weights, or weights that are not finite, for this pixel".into(),
                });
            }
        }
        Ok(())
    }
}

/// The functions at the first and the last pixel of each cell in some rows of a band,
/// `[cell, row, end, function]`. `at_corners` holds them at the corners, `[corner, function]`.
fn values_in_rows(at_corners: &[f64], count: usize, cells: &[Cell], rows: &[usize]) -> Vec<f64> {
    let part = |(low, high): (f64, f64), at: usize| {
        if low < high {
            (at as f64 - low) / (high - low)
        } else {
            0.0
        }
    };
    let mut values = vec![0.0; cells.len() * rows.len() * 2 * count];
    let mut into = values.chunks_exact_mut(count);
    vectorized!(for cell in cells {
        for &row in rows {
            for column in [cell.columns.start, cell.columns.end - 1] {
                let values = into.next().expect("two ends per cell and row");
                let Some(corners) = cell.corners else {
                    // `check` returns an error if light needs these values, so any finite values are
                    // allowed. A flux of 1 avoids a division by 0.
                    values[0] = 1.0;
                    continue;
                };
                let (s, t) = (part(cell.sides[0], column), part(cell.sides[1], row));
                let weights = [(1.0 - s) * (1.0 - t), s * (1.0 - t), (1.0 - s) * t, s * t];
                let [a, b, c, d] = corners.map(|corner| &at_corners[corner * count..][..count]);
                for (value, (((a, b), c), d)) in values.iter_mut().zip(a.iter().zip(b).zip(c).zip(d)) {
                    *value = weights[0] * a + weights[1] * b + weights[2] * c + weights[3] * d;
                }
            }
        }
    });
    values
}

/// The fluxes among functions, of which each place has `count`.
fn fluxes(values: &[f64], count: usize) -> impl Iterator<Item = f64> {
    values.iter().copied().step_by(count)
}

fn is_positive(flux: f64) -> bool {
    flux > 0.0 && flux.is_finite()
}
