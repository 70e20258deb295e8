//! The coefficients of a PSF as tables from which photons are drawn.

use ndarray::{Array1, Array2, Axis};
use pulp::bytemuck::{cast_slice, cast_slice_mut};
use rayon::prelude::*;

use super::alias::write_alias;
use crate::galaxies::truncate;
use crate::plan::cost_model::PhotonWork;
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
    pub(super) kernel: Kernel,
    /// Columns, then rows.
    pub(super) axes: [Axis1; 2],
    pub(super) oversampling: f64,
    /// The inverse of the oversampling.
    pub(super) inverse: f64,
    pub(super) rule: Rule,
    /// The core has this power of 2 of coefficients along both axes of a class.
    pub(super) core_bits: u32,
    /// For Lanczos-3: the weights of the taps at fractions of a pixel.
    pub(super) weights: Vec<[f32; MOST_TAPS]>,
}

/// Neighbouring coefficients of a direction.
type Part = [f32; PART];
const PART: usize = 16;
/// The number of PSFs whose coefficients are computed together.
const TOGETHER: usize = 8;

/// One axis of the coefficients.
#[derive(Debug, Clone, Copy)]
pub(super) struct Axis1 {
    pub(super) length: usize,
    /// The coordinate of the PSF's centre, counted from the first coefficient.
    pub(super) centre: f64,
    /// The number of coefficients of a residue class.
    pub(super) per_class: usize,
    /// The first coefficient of a class that lies in the core.
    pub(super) first_of_core: usize,
}

/// The way of a photon to a coefficient and a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Rule {
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
    pub(super) classes: Vec<Class>,
    /// `[class, core row, core column]`: alias tables of the cores.
    pub(super) slots: Vec<u64>,
    /// `[class, row]`: the sums of the sizes of coefficients outside the core, up to and with the row.
    pub(super) rows: Vec<f64>,
    /// `[class, row, column]`: the same within the row, up to and with the column.
    pub(super) columns: Vec<f32>,
    /// 1 for coefficients that may contribute to a pixel together with a negative one. Empty if there are none, or
    /// if each pixel needs its value.
    pub(super) marks: Vec<u8>,
    /// Whether a coefficient of a core is marked.
    pub(super) marks_in_cores: bool,
    /// Empty if no pixel needs its value.
    pub(super) coefficients: Vec<f32>,
}

/// A residue class of coefficients.
#[derive(Debug, Clone, Copy)]
pub(super) struct Class {
    /// The probability of the core, as a fraction of the range of random words.
    pub(super) core: u64,
    /// The sizes outside the core, filled up to the largest class.
    pub(super) others: f64,
}

/// The number of different random words.
const WORDS: f64 = 18_446_744_073_709_551_616.0;
/// Steps of the table of Lanczos weights. Linear interpolation has an error of 1e-7.
pub(super) const WEIGHT_STEPS: usize = 2048;
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
    pub(super) fn classes(&self) -> usize {
        match self.rule {
            Rule::AnyPixel { .. } => 1,
            _ => self.oversampling as usize,
        }
    }

    #[inline(always)]
    pub(super) fn slots_of_core(&self) -> usize {
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
            marks_in_cores: false,
            coefficients: Vec::new(),
        };
        let is_positive = values.iter().all(|&c| c >= 0.0);
        if !is_positive && !self.needs_all_values() {
            table.marks = marks(values, self.axes[0].length);
            table.marks_in_cores = self.is_marked_in_cores(&table.marks);
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

    /// The work of a photon that is drawn from a table.
    pub(super) fn work(&self, table: &CornerTable) -> PhotonWork {
        let size = |marked: bool| -> f64 {
            let pairs = table.coefficients.iter().zip(&table.marks);
            let chosen = pairs.filter(|(_, mark)| (**mark != 0) == marked);
            chosen.map(|(c, _)| f64::from(c.abs())).sum()
        };
        let with_value = match (self.needs_all_values(), table.marks.is_empty()) {
            (true, _) => 1.0,
            (false, true) => 0.0,
            (false, false) => size(true) / (size(true) + size(false)),
        };
        let proposals = (table.proposals / table.flux).abs();
        let proposals = if proposals.is_finite() { proposals } else { 1.0 };
        let terms = (self.kernel.tap_count() * self.kernel.tap_count()) as f64;
        PhotonWork {
            proposals,
            terms: proposals * with_value * terms,
        }
    }

    /// Whether every pixel may have terms of both signs.
    #[inline(always)]
    pub(super) fn needs_all_values(&self) -> bool {
        self.kernel == Kernel::Lanczos3
    }

    /// Whether a coefficient in the core of a class is marked.
    fn is_marked_in_cores(&self, marks: &[u8]) -> bool {
        let [columns, rows] = self.axes.map(|axis| {
            let first = axis.first_of_core * self.classes();
            first..(first + (self.classes() << self.core_bits)).min(axis.length)
        });
        let mut of_rows = rows.map(|j| &marks[j * self.axes[0].length..][columns.clone()]);
        of_rows.any(|row| row.contains(&1))
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
}

impl CornerTable {
    /// Reads the tables that most photons use from end to end, so that the processor need not wait for each slot.
    pub(super) fn read_ahead(&self) {
        std::hint::black_box(self.slots.iter().fold(0, |sum, slot| sum ^ slot));
        std::hint::black_box(self.rows.iter().fold(0, |sum, row| sum ^ row.to_bits()));
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
