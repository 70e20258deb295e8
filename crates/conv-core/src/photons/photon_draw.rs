//! Draws photons from the tables of PSFs.

use super::alias::draw;
use super::corner_table::{CornerTable, PhotonStamps, Rule, WEIGHT_STEPS};
use super::random::RandomWords;
use crate::stamp_interpolator::MOST_TAPS;

/// The most random words that [`PhotonStamps::photon`] uses.
pub(super) const WORDS_OF_PHOTON: usize = 5;

impl PhotonStamps {
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
    /// PSF. `None` if it is rejected. It uses at most [`WORDS_OF_PHOTON`] random words.
    #[inline(always)]
    pub(super) fn photon(
        &self,
        table: &CornerTable,
        at: [f64; 2],
        rng: &mut RandomWords<'_>,
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
                let (column, row, in_core) = self.coefficient(table, 0, rng)?;
                let needs_value = self.needs_value(table, (column, row), in_core);
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
    fn of_class(
        &self,
        table: &CornerTable,
        taps: [i32; 2],
        rng: &mut RandomWords<'_>,
    ) -> Option<([i32; 2], bool)> {
        let ((qx, rx), (qy, ry)) = (self.divided(taps[0]), self.divided(taps[1]));
        let class = ry as usize * self.classes() + rx as usize;
        let (column, row, in_core) = self.coefficient(table, class, rng)?;
        let pixel = [column as i32 - qx, row as i32 - qy];
        let (column, row) = (
            column * self.classes() + rx as usize,
            row * self.classes() + ry as usize,
        );
        Some((pixel, self.needs_value(table, (column, row), in_core)))
    }

    /// Whether a pixel to which a coefficient contributes may have terms of both signs.
    #[inline(always)]
    fn needs_value(&self, table: &CornerTable, (column, row): (usize, usize), in_core: bool) -> bool {
        let mark = || table.marks[row * self.axes[0].length + column] != 0;
        let may_be_marked = !table.marks.is_empty() && (table.marks_in_cores || !in_core);
        self.needs_all_values() || may_be_marked && mark()
    }

    /// Draws a coefficient of a class: its column, its row, and whether it lies in the core.
    #[inline(always)]
    fn coefficient(
        &self,
        table: &CornerTable,
        class: usize,
        rng: &mut RandomWords<'_>,
    ) -> Option<(usize, usize, bool)> {
        let [columns, rows] = &self.axes;
        let of_class = table.classes[class];
        if rng.next() < of_class.core {
            let of_core = self.slots_of_core();
            let number = draw(&table.slots[class * of_core..][..of_core], rng.next());
            let (row, column) = (number >> self.core_bits, number & ((1 << self.core_bits) - 1));
            return Some((column + columns.first_of_core, row + rows.first_of_core, true));
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
        (column < columns.per_class).then_some((column, row, false))
    }

    /// The quotient and the remainder of a coefficient's number and the oversampling.
    #[inline(always)]
    fn divided(&self, tap: i32) -> (i32, i32) {
        if self.oversampling == 1.0 {
            return (tap, 0);
        }
        let quotient = floor((f64::from(tap) + 0.5) * self.inverse);
        (quotient, tap - quotient * self.oversampling as i32)
    }

    /// The weights of the taps at a coordinate, and the first tap.
    #[inline(always)]
    fn taps(&self, t: f64) -> (i64, [f32; MOST_TAPS]) {
        let below = floor(t);
        let (first, part) = (i64::from(below) + self.kernel.first_tap(), t - f64::from(below));
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
    fn signed_tap(&self, t: f64, most: f64, rng: &mut RandomWords<'_>) -> Option<i32> {
        let (first, weights) = self.taps(t);
        let number = drawn(weights.iter().map(|w| w.abs()), most, rng)?;
        Some(first as i32 + number as i32)
    }

    /// Draws one of the pixels to which a coefficient contributes.
    #[inline(always)]
    fn any_pixel(&self, t: f64, coefficient: usize, most: f64, rng: &mut RandomWords<'_>) -> Option<i32> {
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

/// Draws a number in proportion to some weights, whose sum is at most `most`. `None` with the remaining
/// probability.
#[inline(always)]
fn drawn(weights: impl Iterator<Item = f32>, most: f64, rng: &mut RandomWords<'_>) -> Option<usize> {
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
fn spline_tap(t: f64, rng: &mut RandomWords<'_>) -> i32 {
    const BITS: u32 = 21;
    const MASK: u64 = (1 << BITS) - 1;
    let random = rng.next();
    let sum = (random & MASK) + (random >> BITS & MASK) + (random >> (2 * BITS) & MASK);
    // Each part is the middle of its step. Their sum has a mean of 3/2, and a half is added for rounding.
    let shift = (f64::from(sum as i32) + 1.5) / (1_u64 << BITS) as f64 - 1.0;
    floor(t + shift)
}

/// The largest integer that is not above a number, whose size is below 2^31.
#[inline(always)]
fn floor(t: f64) -> i32 {
    // The last digit of a number of this size is a one, so the sum holds the integer in its lowest bits. This has no
    // branch for numbers that are too large, unlike a conversion.
    const INTEGERS: f64 = 1.5 * (1_u64 << 52) as f64;
    (t.floor() + INTEGERS).to_bits() as i32
}
