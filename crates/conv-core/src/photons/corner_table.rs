//! The coefficients of a PSF as tables from which photons are drawn.

use ndarray::{Array1, Array2, Axis};
use pulp::bytemuck::{cast_slice, cast_slice_mut};
use rayon::prelude::*;

use super::alias::{draw, write_alias};
use super::random::PhotonRng;
use crate::galaxies::truncate;
use crate::plan::psf_space::PsfSpace;
use crate::simd::{Lanes, SimdReal, WithIsa, vectorized};
use crate::stamp_interpolator::{Kernel, MOST_TAPS, StampInterpolator};

/// The stamps of the directions of [`PsfSpace`] as interpolation coefficients, and the way from coefficients
/// to the frame's pixels.
#[derive(Debug)]
pub(super) struct PhotonStamps {
    /// `[part, direction]`: the coefficients of all directions in parts, so that sums over directions read
    /// contiguous memory. The coefficients of a stamp are row-major, and filled up with zeros.
    coefficients: Vec<Part>,
    /// The number of coefficients of a stamp.
    count: usize,
    /// The flux of each direction.
    fluxes: Array1<f64>,
    kernel: Kernel,
    /// Columns, then rows.
    axes: [Axis1; 2],
    oversampling: f64,
    /// The inverse of the oversampling.
    inverse: f64,
    rule: Rule,
    /// The core has this power of 2 of coefficients along both axes of a class.
    core_bits: u32,
    /// For Lanczos-3: the weights of the taps at fractions of a pixel.
    weights: Vec<[f32; MOST_TAPS]>,
}

/// Neighbouring coefficients of a direction.
type Part = [f32; PART];
const PART: usize = 16;
/// The number of PSFs whose coefficients are computed together.
const TOGETHER: usize = 8;

/// One axis of the coefficients.
#[derive(Debug, Clone, Copy)]
struct Axis1 {
    length: usize,
    /// The coordinate of the PSF's centre, counted from the first coefficient.
    centre: f64,
    /// The number of coefficients of a residue class.
    per_class: usize,
    /// The first coefficient of a class that lies in the core.
    first_of_core: usize,
}

/// How a photon finds a coefficient and a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Rule {
    /// The oversampling is a whole number, and all taps are positive. A tap is chosen first, then a
    /// coefficient of the tap's residue class.
    SplineClasses,
    /// As above, with taps of both signs. The sum of their sizes is at most `most`.
    SignedClasses { most: f64 },
    /// For other oversamplings: a coefficient is chosen first, then a pixel to which it contributes. The sum of
    /// the sizes of its taps is at most `most`.
    AnyPixel { most: f64 },
}

/// A PSF, ready for photons: for each residue class, tables of the sizes of the coefficients. Classes are filled up
/// to the largest one by a part that rejects. Most photons fall in the core, a square around the centre, and are
/// drawn from an alias table, which stays in the processor's cache. For the others, sums are searched.
#[derive(Debug)]
pub(super) struct CornerTable {
    /// The flux of the PSF, as the model defines it.
    pub(super) flux: f64,
    /// The number of photons that are proposed for a flux of 1.
    pub(super) proposals: f64,
    /// For each class.
    classes: Vec<Class>,
    /// `[class, core row, core column]`: alias tables of the cores.
    slots: Vec<u64>,
    /// `[class, row]`: the sums of the sizes of coefficients outside the core, up to and with the row.
    rows: Vec<f64>,
    /// `[class, row, column]`: the same within the row, up to and with the column.
    columns: Vec<f32>,
    /// 1 for coefficients that may contribute to a pixel together with a negative one. Empty if there are none, or
    /// if each pixel needs its value.
    marks: Vec<u8>,
    /// Empty if no pixel needs its value.
    coefficients: Vec<f32>,
}

/// A residue class of coefficients.
#[derive(Debug, Clone, Copy)]
struct Class {
    /// The probability of the core, as a fraction of the range of random words.
    core: u64,
    /// The sizes outside the core, filled up to the largest class.
    others: f64,
}

/// The number of different random words.
const WORDS: f64 = 18_446_744_073_709_551_616.0;
/// Steps of the table of Lanczos weights. Linear interpolation has an error of 1e-7.
const WEIGHT_STEPS: usize = 2048;
/// Fractions of a pixel at which the sum of sizes of taps is tested, and a margin for those between.
const TESTED: usize = 1024;
const MARGIN: f64 = 1.01;

impl PhotonStamps {
    /// If `size` is given, the stamps are truncated to so many frame pixels.
    pub(super) fn new(space: &PsfSpace, kernel: Kernel, size: Option<usize>) -> Self {
        let grid = space.model().grid();
        let mut stamps = space.stamps();
        if let Some(size) = size {
            stamps
                .outer_iter_mut()
                .for_each(|stamp| truncate(stamp, grid, size));
        }
        let interpolators: Vec<StampInterpolator> = stamps
            .axis_iter(Axis(0))
            .into_par_iter()
            .map(|stamp| {
                let stamp = stamp.into_shape_with_order(grid.dim()).expect("a stamp");
                StampInterpolator::with_kernel(stamp, grid, kernel)
            })
            .collect();
        let dim = interpolators[0].coefficients().dim();
        let count = dim.0 * dim.1;
        let mut coefficients = vec![[0.0; PART]; count.div_ceil(PART) * interpolators.len()];
        for (direction, interpolator) in interpolators.iter().enumerate() {
            for (at, &c) in interpolator.coefficients().iter().enumerate() {
                coefficients[at / PART * interpolators.len() + direction][at % PART] = c as f32;
            }
        }
        let s = grid.oversampling();
        let weights = match kernel {
            Kernel::CubicSpline { .. } => Vec::new(),
            Kernel::Lanczos3 => (0..=WEIGHT_STEPS)
                .map(|i| kernel.weights(i as f64 / WEIGHT_STEPS as f64).map(|w| w as f32))
                .collect(),
        };
        let is_whole = s.fract() == 0.0;
        let rule = match (is_whole, kernel) {
            (true, Kernel::CubicSpline { .. }) => Rule::SplineClasses,
            (true, Kernel::Lanczos3) => Rule::SignedClasses {
                most: most_of(kernel, 1.0),
            },
            (false, _) => Rule::AnyPixel {
                most: most_of(kernel, s),
            },
        };
        let classes = if is_whole { s as usize } else { 1 };
        let core_bits = (dim.0.min(dim.1).div_ceil(classes) / 2).max(1).ilog2();
        let axis = |length: usize, pixels: usize, centre: f64| {
            let per_class = length.div_ceil(classes);
            let centre = centre + ((length - pixels) / 2) as f64;
            let most = (per_class - (1 << core_bits)) as f64;
            Axis1 {
                length,
                centre,
                per_class,
                first_of_core: (centre / classes as f64 - 0.5 * f64::from(1 << core_bits)).clamp(0.0, most)
                    as usize,
            }
        };
        Self {
            coefficients,
            count,
            fluxes: space.fluxes.clone(),
            kernel,
            axes: [
                axis(dim.1, grid.nx(), grid.centre_x()),
                axis(dim.0, grid.ny(), grid.centre_y()),
            ],
            oversampling: s,
            inverse: 1.0 / s,
            rule,
            core_bits,
            weights,
        }
    }

    #[inline(always)]
    fn classes(&self) -> usize {
        match self.rule {
            Rule::AnyPixel { .. } => 1,
            _ => self.oversampling as usize,
        }
    }

    #[inline(always)]
    fn slots_of_core(&self) -> usize {
        1 << (2 * self.core_bits)
    }

    /// The memory of a [`CornerTable`] that has values of both signs.
    pub(super) fn table_bytes(&self) -> usize {
        let [columns, rows] = self.axes.map(|axis| axis.per_class);
        self.classes().pow(2) * (8 * self.slots_of_core() + 8 * rows + 4 * rows * columns) + 5 * self.count
    }

    /// The largest distance of a photon from its source, in frame pixels.
    pub(super) fn reach(&self) -> f64 {
        let along = |axis: &Axis1| axis.centre.max(axis.length as f64 - axis.centre);
        self.axes.iter().map(along).fold(0.0, f64::max) / self.oversampling + 4.0
    }

    /// The tables of PSFs, which are vectors of the space `[psf, direction]`.
    pub(super) fn tables(&self, psfs: &Array2<f64>) -> Vec<CornerTable> {
        let mut tables = Vec::with_capacity(psfs.nrows());
        for psfs in psfs.axis_chunks_iter(Axis(0), TOGETHER) {
            let factors: Vec<[f32; TOGETHER]> = psfs
                .columns()
                .into_iter()
                .map(|of_direction| std::array::from_fn(|k| of_direction.get(k).map_or(0.0, |&v| v as f32)))
                .collect();
            let all = f32::dispatch(Combine {
                coefficients: &self.coefficients,
                factors: &factors,
            });
            for (psf, coefficients) in psfs.outer_iter().zip(all) {
                tables.push(self.table(&coefficients[..self.count], psf.dot(&self.fluxes)));
            }
        }
        tables
    }

    /// The table of a PSF with these coefficients.
    fn table(&self, values: &[f32], flux: f64) -> CornerTable {
        let classes = self.classes();
        let mut table = CornerTable {
            flux,
            proposals: 0.0,
            classes: Vec::with_capacity(classes * classes),
            slots: vec![0; classes * classes * self.slots_of_core()],
            rows: Vec::with_capacity(classes * classes * self.axes[1].per_class),
            columns: Vec::with_capacity(classes * classes * self.axes[0].per_class * self.axes[1].per_class),
            marks: Vec::new(),
            coefficients: Vec::new(),
        };
        let is_positive = values.iter().all(|&c| c >= 0.0);
        if !is_positive && !self.needs_all_values() {
            table.marks = marks(values, self.axes[0].length);
        }
        if !is_positive || self.needs_all_values() {
            table.coefficients = values.to_vec();
        }
        let mut core = vec![0.0; self.slots_of_core()];
        let mut sums = Vec::with_capacity(classes * classes);
        for (class, slots) in table.slots.chunks_exact_mut(core.len()).enumerate() {
            let others = self.sum_class(values, class, &mut core, &mut table.rows, &mut table.columns);
            sums.push([core.iter().map(|&c| f64::from(c)).sum(), others]);
            write_alias(&mut core, slots);
        }
        let largest = sums
            .iter()
            .map(|[core, others]| core + others)
            .fold(0.0, f64::max);
        table.classes.extend(sums.iter().map(|[core, _]| Class {
            core: (core / largest * WORDS) as u64,
            others: largest - core,
        }));
        let of_taps = match self.rule {
            Rule::SplineClasses => 1.0,
            Rule::SignedClasses { most } | Rule::AnyPixel { most } => most * most,
        };
        table.proposals = largest * of_taps;
        table
    }

    /// Whether every pixel may have terms of both signs.
    #[inline(always)]
    fn needs_all_values(&self) -> bool {
        self.kernel == Kernel::Lanczos3
    }

    /// Sums the sizes of the coefficients of a class outside its core, and copies those of the core.
    fn sum_class(
        &self,
        values: &[f32],
        class: usize,
        core: &mut [f32],
        row_sums: &mut Vec<f64>,
        column_sums: &mut Vec<f32>,
    ) -> f64 {
        let ([columns, rows], classes, side) = (&self.axes, self.classes(), 1 << self.core_bits);
        let mut total = 0.0;
        core.fill(0.0);
        for q in 0..rows.per_class {
            let j = q * classes + class / classes;
            let row = if j < rows.length {
                &values[j * columns.length..(j + 1) * columns.length]
            } else {
                &[]
            };
            let size = |p: usize| row.get(p * classes + class % classes).map_or(0.0, |c| c.abs());
            let mut sum = 0.0;
            let in_core = q.wrapping_sub(rows.first_of_core);
            let of_core = if in_core < side {
                columns.first_of_core..columns.first_of_core + side
            } else {
                0..0
            };
            column_sums.extend((0..of_core.start).map(|p| {
                sum += size(p);
                sum
            }));
            for (p, core) in of_core
                .clone()
                .zip(core.iter_mut().skip(in_core.saturating_mul(side)))
            {
                *core = size(p);
            }
            column_sums.extend(of_core.clone().map(|_| sum));
            column_sums.extend((of_core.end..columns.per_class).map(|p| {
                sum += size(p);
                sum
            }));
            total += f64::from(sum);
            row_sums.push(total);
        }
        total
    }

    /// The coordinates, among the coefficients, of a frame pixel. `(dx, dy)` is the offset of the photon's
    /// origin from the pixel's centre.
    #[inline(always)]
    pub(super) fn coordinates(&self, dx: f64, dy: f64) -> [f64; 2] {
        [
            self.axes[0].centre - self.oversampling * dx,
            self.axes[1].centre - self.oversampling * dy,
        ]
    }

    /// Proposes the pixel of a photon, relative to the pixel with these coordinates. The photon is accepted with
    /// the probability of the PSF's size divided by that of the proposal. Returns the pixel and the sign of the
    /// PSF. `None` if it is rejected.
    #[inline(always)]
    pub(super) fn photon(
        &self,
        table: &CornerTable,
        at: [f64; 2],
        rng: &mut PhotonRng,
    ) -> Option<([i32; 2], i32)> {
        let (pixel, needs_value) = match self.rule {
            Rule::SplineClasses => {
                let taps = [spline_tap(at[0], rng), spline_tap(at[1], rng)];
                self.of_class(table, taps, rng)?
            }
            Rule::SignedClasses { most } => {
                let taps = [
                    self.signed_tap(at[0], most, rng)?,
                    self.signed_tap(at[1], most, rng)?,
                ];
                self.of_class(table, taps, rng)?
            }
            Rule::AnyPixel { most } => {
                let (column, row) = self.coefficient(table, 0, rng)?;
                let needs_value = self.needs_value(table, column, row);
                let x = self.any_pixel(at[0], column, most, rng)?;
                ([x, self.any_pixel(at[1], row, most, rng)?], needs_value)
            }
        };
        // All terms of other pixels are positive.
        if needs_value {
            let (value, size) = self.value(table, at, pixel);
            let is_accepted = rng.uniform() as f32 * size < value.abs();
            return is_accepted.then_some((pixel, if value < 0.0 { -1 } else { 1 }));
        }
        Some((pixel, 1))
    }

    /// Draws a coefficient of the residue class of a tap, which is the number of a coefficient that contributes
    /// to pixel 0. Returns the pixel to which the coefficient contributes by this tap, and whether its value is
    /// needed.
    #[inline(always)]
    fn of_class(&self, table: &CornerTable, taps: [i32; 2], rng: &mut PhotonRng) -> Option<([i32; 2], bool)> {
        let ((qx, rx), (qy, ry)) = (self.divided(taps[0]), self.divided(taps[1]));
        let class = ry as usize * self.classes() + rx as usize;
        let (column, row) = self.coefficient(table, class, rng)?;
        let pixel = [column as i32 - qx, row as i32 - qy];
        let (column, row) = (
            column * self.classes() + rx as usize,
            row * self.classes() + ry as usize,
        );
        Some((pixel, self.needs_value(table, column, row)))
    }

    /// Whether a pixel to which a coefficient contributes may have terms of both signs.
    #[inline(always)]
    fn needs_value(&self, table: &CornerTable, column: usize, row: usize) -> bool {
        let mark = || table.marks[row * self.axes[0].length + column] != 0;
        self.needs_all_values() || !table.marks.is_empty() && mark()
    }

    /// Draws a coefficient of a class: its column and its row.
    #[inline(always)]
    fn coefficient(&self, table: &CornerTable, class: usize, rng: &mut PhotonRng) -> Option<(usize, usize)> {
        let [columns, rows] = &self.axes;
        let of_class = table.classes[class];
        if rng.next() < of_class.core {
            let of_core = self.slots_of_core();
            let number = draw(&table.slots[class * of_core..][..of_core], rng.next());
            let (row, column) = (number >> self.core_bits, number & ((1 << self.core_bits) - 1));
            return Some((column + columns.first_of_core, row + rows.first_of_core));
        }
        let at = rng.uniform() * of_class.others;
        let sums = &table.rows[class * rows.per_class..][..rows.per_class];
        let row = sums.partition_point(|&sum| sum <= at);
        if row == rows.per_class {
            return None;
        }
        let before = if row == 0 { 0.0 } else { sums[row - 1] };
        let in_row = (at - before) as f32;
        let sums = &table.columns[(class * rows.per_class + row) * columns.per_class..][..columns.per_class];
        let column = sums.partition_point(|&sum| sum <= in_row);
        // Rounding may leave the row.
        (column < columns.per_class).then_some((column, row))
    }

    /// The quotient and the remainder of a coefficient's number and the oversampling.
    #[inline(always)]
    fn divided(&self, tap: i32) -> (i32, i32) {
        if self.oversampling == 1.0 {
            return (tap, 0);
        }
        let quotient = floor((f64::from(tap) + 0.5) * self.inverse) as i32;
        (quotient, tap - quotient * self.oversampling as i32)
    }

    /// The weights of the taps at a coordinate, and the first tap.
    #[inline(always)]
    fn taps(&self, t: f64) -> (i64, [f32; MOST_TAPS]) {
        let below = floor(t);
        let (first, part) = (below + self.kernel.first_tap(), t - below as f64);
        if self.weights.is_empty() {
            return (first, self.kernel.weights(part).map(|w| w as f32));
        }
        let place = part * WEIGHT_STEPS as f64;
        let below = (place as usize).min(WEIGHT_STEPS - 1);
        let part = (place - below as f64) as f32;
        let (a, b) = (&self.weights[below], &self.weights[below + 1]);
        (
            first,
            std::array::from_fn(|tap| a[tap] + part * (b[tap] - a[tap])),
        )
    }

    /// Draws a tap by the sizes of the weights. `None` if it is rejected.
    #[inline(always)]
    fn signed_tap(&self, t: f64, most: f64, rng: &mut PhotonRng) -> Option<i32> {
        let (first, weights) = self.taps(t);
        let number = drawn(weights.iter().map(|w| w.abs()), most, rng)?;
        Some(first as i32 + number as i32)
    }

    /// Draws one of the pixels to which a coefficient contributes.
    #[inline(always)]
    fn any_pixel(&self, t: f64, coefficient: usize, most: f64, rng: &mut PhotonRng) -> Option<i32> {
        let half = self.kernel.tap_count() as f64 / 2.0;
        let first = ((coefficient as f64 - half - t) / self.oversampling).ceil() as i32;
        let last = ((coefficient as f64 + half - t) / self.oversampling).floor() as i32;
        let weight = |pixel: i32| {
            let (first, weights) = self.taps(t + self.oversampling * f64::from(pixel));
            let tap = usize::try_from(coefficient as i64 - first).ok();
            tap.and_then(|tap| weights.get(tap)).map_or(0.0, |w| w.abs())
        };
        let number = drawn((first..=last).map(weight), most, rng)?;
        Some(first + number as i32)
    }

    /// The value of the PSF at a pixel, and the sum of the sizes of its terms.
    fn value(&self, table: &CornerTable, at: [f64; 2], pixel: [i32; 2]) -> (f32, f32) {
        let [x, y] = [0, 1].map(|axis| self.taps(at[axis] + self.oversampling * f64::from(pixel[axis])));
        let count = self.kernel.tap_count();
        let [columns, rows] = &self.axes;
        let (mut value, mut size) = (0.0, 0.0);
        for (wy, j) in y.1[..count].iter().zip(y.0..) {
            let Some(j) = usize::try_from(j).ok().filter(|&j| j < rows.length) else {
                continue;
            };
            for (wx, i) in x.1[..count].iter().zip(x.0..) {
                if let Some(i) = usize::try_from(i).ok().filter(|&i| i < columns.length) {
                    let term = wy * wx * table.coefficients[j * columns.length + i];
                    value += term;
                    size += term.abs();
                }
            }
        }
        (value, size)
    }
}

/// Computes the sums of the directions' coefficients times the factors of some PSFs.
struct Combine<'a> {
    /// As in [`PhotonStamps`].
    coefficients: &'a [Part],
    factors: &'a [[f32; TOGETHER]],
}

impl WithIsa<f32> for Combine<'_> {
    type Output = [Vec<f32>; TOGETHER];

    fn run<S: Lanes<f32>>(self, simd: S) -> Self::Output {
        let length = self.coefficients.len() / self.factors.len() * PART;
        let mut all: Self::Output = std::array::from_fn(|_| vec![0.0; length]);
        vectorized!(simd, {
            for (number, directions) in self.coefficients.chunks_exact(self.factors.len()).enumerate() {
                for first in (0..PART).step_by(S::LANES) {
                    let mut sums = [simd.splat(0.0); TOGETHER];
                    for (part, factors) in directions.iter().zip(self.factors) {
                        let values = cast_slice::<f32, S::V>(&part[first..first + S::LANES])[0];
                        for (sum, &factor) in sums.iter_mut().zip(factors) {
                            *sum = simd.mul_add(simd.splat(factor), values, *sum);
                        }
                    }
                    let at = number * PART + first;
                    for (all, sum) in all.iter_mut().zip(sums) {
                        cast_slice_mut(&mut all[at..at + S::LANES])[0] = sum;
                    }
                }
            }
        });
        all
    }
}

/// Draws a number in proportion to some weights, whose sum is at most `most`. `None` with the remaining
/// probability.
#[inline(always)]
fn drawn(weights: impl Iterator<Item = f32>, most: f64, rng: &mut PhotonRng) -> Option<usize> {
    let mut left = (rng.uniform() * most) as f32;
    for (number, weight) in weights.enumerate() {
        left -= weight;
        if left < 0.0 {
            return Some(number);
        }
    }
    None
}

/// Draws one of the four coefficients around a coordinate by the weights of a cubic B-spline: the nearest one
/// after a shift by the sum of three uniform deviates, because a cubic B-spline is the convolution of four boxes.
#[inline(always)]
fn spline_tap(t: f64, rng: &mut PhotonRng) -> i32 {
    const BITS: u32 = 21;
    const MASK: u64 = (1 << BITS) - 1;
    let random = rng.next();
    let sum = (random & MASK) + (random >> BITS & MASK) + (random >> (2 * BITS) & MASK);
    // Each part is the middle of its step. Their sum has a mean of 3/2, and a half is added for rounding.
    let shift = (sum as f64 + 1.5) / (1_u64 << BITS) as f64 - 1.0;
    floor(t + shift) as i32
}

/// The largest integer that is not above a number. Without special instructions this is faster than the library's.
#[inline(always)]
fn floor(t: f64) -> i64 {
    let whole = t as i64;
    whole - i64::from(whole as f64 > t)
}

/// The largest sum of the sizes of the weights of coefficients that are `step` apart.
fn most_of(kernel: Kernel, step: f64) -> f64 {
    let reach = kernel.tap_count() as f64 / 2.0;
    let size = |t: f64| {
        let tap = -(t.floor() as i64) - kernel.first_tap();
        let weights = kernel.weights(t - t.floor());
        usize::try_from(tap)
            .ok()
            .and_then(|tap| weights.get(tap))
            .map_or(0.0, |w| w.abs())
    };
    let sum = |i: usize| -> f64 {
        let first = -reach + step * i as f64 / TESTED as f64;
        let count = (2.0 * reach / step).ceil() as i32;
        (0..count).map(|k| size(first + step * f64::from(k))).sum()
    };
    (0..TESTED).map(sum).fold(0.0, f64::max) * MARGIN
}

/// Marks coefficients of a spline that may contribute to a pixel together with a negative one.
fn marks(values: &[f32], columns: usize) -> Vec<u8> {
    // They contribute together if they are at most 3 apart along both axes.
    const APART: usize = 3;
    let spread = |from: &[u8], step: usize| {
        let mut into = from.to_vec();
        for shift in (1..=APART).map(|k| k * step) {
            let length = from.len().saturating_sub(shift);
            let after = from.len() - length;
            into[..length]
                .iter_mut()
                .zip(&from[after..])
                .for_each(|(to, v)| *to |= v);
            into[after..]
                .iter_mut()
                .zip(&from[..length])
                .for_each(|(to, v)| *to |= v);
        }
        into
    };
    let negative: Vec<u8> = values.iter().map(|&c| u8::from(c < 0.0)).collect();
    // Marks that run over the end of a row are harmless.
    spread(&spread(&negative, 1), columns)
}
