//! The coefficients of local modes at every pixel of a region.

use psf_types::{FieldError, PixelRegion, PsfModel};

use super::local_modes::LocalModes;
use super::region_cells::{Band, CORNERS, Cell, RegionCells};
use crate::ConvReal;

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

/// The coefficients of a region's modes, as functions along its rows.
#[derive(Debug)]
pub struct CoefficientTable<T> {
    pub(crate) region: PixelRegion,
    pub(crate) role: FluxRole,
    /// The number of functions. The first is the flux, if its role needs it at every pixel. The
    /// others are the coefficients of the modes.
    pub(crate) functions: usize,
    pub(crate) values: Values<T>,
    /// `(row, column)` of the pixels without a PSF.
    undefined: Vec<(u32, u32)>,
}

#[derive(Debug)]
pub(crate) enum Values<T> {
    /// Runs: neighbouring pixels of a row, along which every function is linear.
    Linear {
        /// The index of each row's first run, then the number of all runs.
        row_starts: Vec<u32>,
        /// First column and length of each run.
        runs: Vec<(u32, u32)>,
        /// `[start, slope]` per run and function.
        ramps: Vec<[T; 2]>,
    },
    /// Values `[function, y, x]`.
    Dense(Vec<T>),
}

/// Fluxes count as equal if they differ by at most this fraction: the rounding of their sums. The
/// error of their mean is then half of it.
const SAME_FLUX: f64 = 4e-15;

impl FluxRole {
    /// Returns the role of the flux in a region, and the flux to which the reference is scaled: the
    /// PSFs' flux if that is constant, otherwise 1.
    pub fn of(model: &PsfModel, modes: &LocalModes, cells: &RegionCells) -> (Self, f64) {
        let scaled = model.needs_flux_scaling();
        if modes.reference().is_none() {
            return (Self::NoReference { scaled }, 1.0);
        }
        if scaled {
            return (Self::Divisor, 1.0);
        }
        let mut values = vec![0.0; 1 + modes.rank()];
        let mut range: Option<(f64, f64)> = None;
        for corner in cells.all_corners().flatten() {
            modes.values_into(corner, &mut values);
            let flux = values[0];
            range = Some(range.map_or((flux, flux), |(low, high)| (low.min(flux), high.max(flux))));
        }
        match range {
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
    pub(crate) fn function_of(self, kernel: usize) -> Option<usize> {
        match self {
            Self::Constant => kernel.checked_sub(1),
            Self::Divisor => (kernel > 0).then_some(kernel),
            Self::Weight | Self::NoReference { scaled: false } => Some(kernel),
            Self::NoReference { scaled: true } => Some(kernel + 1),
        }
    }

    pub(crate) fn divides(self) -> bool {
        matches!(self, Self::Divisor | Self::NoReference { scaled: true })
    }
}

impl<T: ConvReal> CoefficientTable<T> {
    /// Tabulates the coefficients of modes over a region. `cells` are the cells of that region.
    pub fn new(region: PixelRegion, role: FluxRole, modes: &LocalModes, cells: &RegionCells) -> Self {
        let skip = usize::from(!role.has_flux_function());
        let functions = 1 + modes.rank() - skip;
        let (nx, ny) = (region.shape().nx(), region.shape().ny());
        let mut builder = Builder {
            modes,
            ends: [vec![0.0; 1 + modes.rank()], vec![0.0; 1 + modes.rank()]],
            skip,
            divides: role.divides(),
            undefined: Vec::new(),
        };
        let values = if cells.are_short() {
            let mut dense = vec![T::zero(); functions * nx * ny];
            builder.each_piece(cells, |row, column, length, first, slope| {
                for (f, &at_first) in first.iter().enumerate() {
                    let start = (f * ny + row) * nx + column;
                    for (i, value) in dense[start..start + length].iter_mut().enumerate() {
                        *value = T::nearest(at_first + i as f64 * slope(f));
                    }
                }
            });
            Values::Dense(dense)
        } else {
            let (mut row_starts, mut pieces, mut ramps) = (vec![0; ny + 1], Vec::new(), Vec::new());
            builder.each_piece(cells, |row, column, length, first, slope| {
                pieces.push((column as u32, length as u32));
                ramps.extend((0..functions).map(|f| [T::nearest(first[f]), T::nearest(slope(f))]));
                row_starts[row + 1] = pieces.len() as u32;
            });
            Values::Linear {
                row_starts,
                runs: pieces,
                ramps,
            }
        };
        Self {
            region,
            role,
            functions,
            values,
            undefined: builder.undefined,
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
        let values = match &self.values {
            Values::Linear {
                row_starts,
                runs,
                ramps,
            } => size_of_val(&row_starts[..]) + size_of_val(&runs[..]) + size_of_val(&ramps[..]),
            Values::Dense(values) => size_of_val(&values[..]),
        };
        values + size_of_val(&self.undefined[..])
    }

    /// Returns an error for the first pixel that has no PSF and for which `lit(row, column)` is
    /// true. Row and column count from the region's first pixel.
    pub(crate) fn check(
        &self,
        model: &PsfModel,
        lit: impl Fn(usize, usize) -> bool,
    ) -> Result<(), FieldError> {
        for &(row, column) in &self.undefined {
            if lit(row as usize, column as usize) {
                let mut coefficients = vec![0.0; model.stamp_count()];
                let position = self.region.position(column as usize, row as usize);
                model.scaled_coefficients_into(position, &mut coefficients)?;
                return Err(FieldError::External {
                    position,
                    source: "the coefficient field gives no weights, or weights that are not finite, for this pixel".into(),
                });
            }
        }
        Ok(())
    }

    /// Multiplies the light of a row's pixels by the coefficients of a kernel, and writes the
    /// products to `weighted`. `row` and `first` (the first column) count from the region's first
    /// pixel. `ramp` holds 0, 1, 2 ... .
    #[inline(always)]
    pub fn weigh(
        &self,
        kernel: usize,
        row: usize,
        first: usize,
        light: &[T],
        ramp: &[T],
        weighted: &mut [T],
    ) {
        let function = self.role.function_of(kernel);
        let Some(function) = function else {
            weighted.copy_from_slice(light);
            return;
        };
        self.apply(
            function,
            row,
            first,
            ramp,
            light.len(),
            #[inline(always)]
            |columns, piece| {
                let pixels = light[columns.clone()].iter().zip(&mut weighted[columns]);
                match piece {
                    Piece::Linear { start, slope, ramp } => {
                        for ((light, weighted), &i) in pixels.zip(ramp) {
                            *weighted = *light * (start + i * slope);
                        }
                    }
                    Piece::Dense(values) => {
                        for ((light, weighted), &value) in pixels.zip(values) {
                            *weighted = *light * value;
                        }
                    }
                }
            },
        );
        if self.role.divides() {
            self.apply(
                0,
                row,
                first,
                ramp,
                light.len(),
                #[inline(always)]
                |columns, piece| match piece {
                    Piece::Linear { start, slope, ramp } => {
                        for (weighted, &i) in weighted[columns].iter_mut().zip(ramp) {
                            *weighted /= start + i * slope;
                        }
                    }
                    Piece::Dense(values) => {
                        for (weighted, &value) in weighted[columns].iter_mut().zip(values) {
                            *weighted /= value;
                        }
                    }
                },
            );
        }
    }

    /// Calls `work` with the pieces of a function along part of a row. The part begins at column
    /// `first`, and the columns that `work` receives are counted from there.
    #[inline(always)]
    fn apply(
        &self,
        function: usize,
        row: usize,
        first: usize,
        ramp: &[T],
        length: usize,
        mut work: impl FnMut(std::ops::Range<usize>, Piece<'_, T>),
    ) {
        match &self.values {
            Values::Dense(values) => {
                let (nx, ny) = (self.region.shape().nx(), self.region.shape().ny());
                let start = (function * ny + row) * nx + first;
                work(0..length, Piece::Dense(&values[start..start + length]));
            }
            Values::Linear {
                row_starts,
                runs,
                ramps,
            } => {
                let of_row = row_starts[row] as usize..row_starts[row + 1] as usize;
                for index in of_row {
                    let (column, pixels) = (runs[index].0 as usize, runs[index].1 as usize);
                    let (from, to) = (column.max(first), (column + pixels).min(first + length));
                    if from < to {
                        let [start, slope] = ramps[index * self.functions + function];
                        work(
                            from - first..to - first,
                            Piece::Linear {
                                start,
                                slope,
                                ramp: &ramp[from - column..to - column],
                            },
                        );
                    }
                }
            }
        }
    }
}

/// A function along part of a row: linear in the column, or a list of values.
enum Piece<'a, T> {
    Linear { start: T, slope: T, ramp: &'a [T] },
    Dense(&'a [T]),
}

struct Builder<'a> {
    modes: &'a LocalModes,
    ends: [Vec<f64>; 2],
    /// The number of leading values that are not stored: 1 if the table does not need the flux,
    /// otherwise 0.
    skip: usize,
    divides: bool,
    undefined: Vec<(u32, u32)>,
}

impl Builder<'_> {
    /// Calls `visit` for each cell of each row, with row, first column, length, the functions'
    /// values at the first column and their slopes. If functions are divided by the flux, and the
    /// flux is not positive at an end of a cell's row, calls `visit` for each pixel of this row of
    /// the cell, because only some of these pixels may have a PSF.
    fn each_piece(
        &mut self,
        cells: &RegionCells,
        mut visit: impl FnMut(usize, usize, usize, &[f64], &dyn Fn(usize) -> f64),
    ) {
        let functions = 1 + self.modes.rank();
        let mut corners = Vec::new();
        for band in &cells.bands {
            self.corner_values(cells, band, &mut corners);
            let steps = (band.rows.len() - 1).max(1) as f64;
            for row in band.rows.clone() {
                let part = (row - band.rows.start) as f64 / steps;
                let values = corners.chunks_exact(CORNERS * functions);
                for (cell, corners) in cells.cells_of(band).iter().zip(values) {
                    if cells.corners(cell).is_none() {
                        self.undefined(row, cell.column, cell.length);
                        // `check` returns an error if light needs these factors, so any finite
                        // factor is allowed. A divisor of 1 avoids 0 / 0.
                        self.ends[0].fill(0.0);
                        self.ends[0][0] = 1.0;
                        visit(row, cell.column, cell.length, &self.ends[0][self.skip..], &|_| {
                            0.0
                        });
                        continue;
                    }
                    let (first_row, last_row) = corners.split_at(2 * functions);
                    let pairs = first_row.iter().zip(last_row);
                    for (value, (a, b)) in self.ends.iter_mut().flatten().zip(pairs) {
                        *value = if part == 0.0 {
                            *a
                        } else {
                            (1.0 - part) * a + part * b
                        };
                    }
                    self.piece(row, cell, &mut visit);
                }
            }
        }
    }

    /// Computes the functions at the corners of a band's cells, `[cell, corner, function]`.
    fn corner_values(&self, cells: &RegionCells, band: &Band, values: &mut Vec<f64>) {
        let functions = 1 + self.modes.rank();
        let of_band = cells.cells_of(band);
        values.clear();
        values.resize(of_band.len() * CORNERS * functions, 0.0);
        for (cell, values) in of_band.iter().zip(values.chunks_exact_mut(CORNERS * functions)) {
            let Some(corners) = cells.corners(cell) else {
                continue;
            };
            // In a band of one row, the last two corners repeat the first two and are not used.
            let rows = if band.rows.len() == 1 { 2 } else { CORNERS };
            for (corner, values) in corners[..rows].iter().zip(values.chunks_exact_mut(functions)) {
                self.modes.values_into(corner, values);
            }
        }
    }

    /// Visits a cell's part of a row. The values at its ends are in `ends`.
    fn piece(
        &mut self,
        row: usize,
        cell: &Cell,
        mut visit: impl FnMut(usize, usize, usize, &[f64], &dyn Fn(usize) -> f64),
    ) {
        let [first, last] = &self.ends;
        let steps = (cell.length - 1).max(1) as f64;
        let slope = |f: usize| (last[f] - first[f]) / steps;
        if !self.divides || first[0].min(last[0]) > 0.0 {
            visit(row, cell.column, cell.length, &first[self.skip..], &|f| {
                slope(f + self.skip)
            });
            return;
        }
        for i in 0..cell.length {
            let mut values: Vec<f64> = (0..first.len()).map(|f| first[f] + i as f64 * slope(f)).collect();
            let positive = values[0] > 0.0 && values[0].is_finite();
            if !positive {
                values.fill(0.0);
                values[0] = 1.0;
                self.undefined.push((row as u32, (cell.column + i) as u32));
            }
            visit(row, cell.column + i, 1, &values[self.skip..], &|_| 0.0);
        }
    }

    fn undefined(&mut self, row: usize, column: usize, length: usize) {
        self.undefined
            .extend((column..column + length).map(|column| (row as u32, column as u32)));
    }
}
