//! The pixels on which the stars of a block are drawn if light fainter than the floor is dropped.
//!
//! In each pixel, the light of a star of flux 1 is at most the sum over the block's kernels of the kernel's
//! largest coefficient in the block times its largest value that the pixel may see, at any sub-pixel phase.
//! A star is drawn where its flux times this limit is above the floor.

use std::ops::Range;
use std::sync::OnceLock;

use ndarray::{Array2, ArrayView2};
use psf_types::PixelRegion;

use super::phases::PhasedAxis;
use super::row_layout::RowLayout;
use crate::ConvReal;
use crate::dropped_light::{DroppedLight, SQUARE};
use crate::simd::vectorized;
use crate::view::region;

/// Pixels of a row that are drawn or dropped together.
const RUN: usize = 8;
/// Runs of drawn pixels closer than this are joined, so that vectors of one do not reach into the next.
const JOINED: usize = 16;
/// Coefficients of a star may be larger by this factor than those of the block's corners, because only some
/// rows of a block are looked at. A star beyond it is drawn on all pixels.
const MARGIN: f64 = 1.1;
/// Levels of brightness for each factor of 2.
const PER_OCTAVE: f64 = 2.0;
/// The most levels. Brighter stars are drawn on all pixels.
const MOST_LEVELS: usize = 96;
/// A star is drawn at least within the radius of this part of its light.
pub(super) const LEAST_LIGHT: f64 = 0.9;

/// The pixels on which the stars of a block are drawn, by their brightness.
#[derive(Debug)]
pub(super) struct Reach {
    floor: f64,
    /// The largest coefficient of each kernel for which the limits hold, for a star of flux 1.
    largest: Vec<f64>,
    /// The largest limit of any pixel.
    peak: f64,
    /// From faint to bright: level `l` is for stars whose flux times `peak` is at most
    /// `floor * 2^(l / PER_OCTAVE)`. Each is made when a star first needs it.
    levels: Vec<OnceLock<Level>>,
    limits: Limits,
}

/// The pixels on which stars of a similar brightness are drawn.
#[derive(Debug)]
pub(super) struct Level {
    /// The rows `from..to`, relative to the star's own pixel, and in each row the segments.
    pub(super) rows: Range<i64>,
    /// For each row, the number of segments before it, and the number of all.
    starts: Vec<usize>,
    /// The columns `from..to` of each segment, relative to the star's own pixel.
    segments: Vec<Range<i64>>,
    pub(super) columns: Range<i64>,
    /// The fraction of the light that is dropped, for the block's mean PSF.
    dropped: f64,
    /// The largest light of a pixel that is dropped, for a star of flux 1, in squares of [`SQUARE`] pixels. The
    /// squares of index `j` begin `SQUARE (j - 1)` to `SQUARE j - 1` columns after the window's first. So for
    /// rows.
    brightest: Array2<f32>,
}

/// The coefficients of a block's kernels, at the corners of the block's cells.
pub(super) struct AtCorners<'a> {
    /// `[corner, kernel]`.
    pub(super) coefficients: ArrayView2<'a, f64>,
    /// The factor that scales the PSF of each corner to unit flux, or 1.
    pub(super) scales: &'a [f64],
}

impl Reach {
    /// `values` are the kernels' coefficients `[row, kernel, value of a row]`. All stars are drawn within the
    /// radius of the part `least_light` of the light. `None` if all stars are drawn on all pixels.
    pub(super) fn new<T: ConvReal>(
        (floor, least_light): (f64, f64),
        values: &[T],
        corners: &AtCorners<'_>,
        (axes, layout): (&[PhasedAxis; 2], RowLayout),
    ) -> Option<Self> {
        let [(x0, nx), (y0, ny)] = axes.each_ref().map(PhasedAxis::window);
        let window = region(x0, y0, (nx, ny));
        let kernels = corners.coefficients.ncols();
        let scaled = || corners.coefficients.outer_iter().zip(corners.scales);
        let (mut largest, mut mean) = (vec![0.0_f64; kernels], vec![0.0; kernels]);
        for (coefficients, scale) in scaled() {
            for ((largest, mean), c) in largest.iter_mut().zip(&mut mean).zip(coefficients) {
                *largest = largest.max(MARGIN * (c * scale).abs());
                *mean += c * scale / corners.scales.len() as f64;
            }
        }
        let limits = Limits::new(values, (&largest, &mean), least_light, (axes, layout, window));
        let peak = f64::from(limits.of_runs.iter().fold(0.0_f32, |peak, &v| peak.max(v)));
        if floor <= 0.0 || peak <= 0.0 || !peak.is_finite() {
            return None;
        }
        let least = limits.least();
        let is_partial = |&level: &usize| least <= faintest_of(peak, level);
        let levels = (0..MOST_LEVELS).take_while(is_partial).map(|_| OnceLock::new());
        Some(Self {
            floor,
            largest,
            peak,
            levels: levels.collect(),
            limits,
        })
    }

    /// The number of a star's level. `None` if the star is drawn on all pixels.
    pub(super) fn level_of(&self, flux: f64) -> Option<usize> {
        let over = (flux.abs() * self.peak / self.floor).max(1.0);
        let number = (PER_OCTAVE * over.log2()).ceil() as usize;
        (number < self.levels.len()).then_some(number)
    }

    pub(super) fn level(&self, number: usize) -> &Level {
        self.levels[number].get_or_init(|| self.limits.level(faintest_of(self.peak, number)))
    }

    /// The factor by which the limits must grow to hold for the coefficients of a star's PSF, times `scale`. At
    /// least 1.
    pub(super) fn excess(&self, coefficients: &[f64], scale: f64) -> f64 {
        let pairs = coefficients.iter().zip(&self.largest);
        let over = pairs
            .filter(|(c, _)| **c != 0.0)
            .map(|(c, largest)| (c * scale).abs() / largest);
        over.fold(1.0, f64::max)
    }

    /// Whether the limits hold for the coefficients of a star's PSF, times `scale`.
    pub(super) fn holds_for(&self, coefficients: &[f64], scale: f64) -> bool {
        self.excess(coefficients, scale) <= 1.0
    }

    /// The part of the window's pixels that are drawn, for a star of a flux.
    pub(super) fn part_of(&self, flux: f64) -> f64 {
        self.level_of(flux).map_or(1.0, |level| self.part(level))
    }

    /// The part of the window's pixels that are drawn, for the stars of a level.
    pub(super) fn part(&self, level: usize) -> f64 {
        let segments = &self.level(level).segments;
        let drawn: i64 = segments.iter().map(|s| s.end - s.start).sum();
        drawn as f64 / self.limits.window.shape().pixel_count() as f64
    }

    /// Adds the light that a star drops at most. `pixel` is the star's own pixel.
    pub(super) fn add_dropped(&self, (column, row): (i64, i64), flux: f64, dropped: &mut DroppedLight) {
        let level = self.level_of(flux);
        dropped.count(flux, level.map_or(0.0, |number| self.level(number).dropped));
        if let Some(level) = level {
            self.add_dropped_of_level((column, row), flux, level, dropped);
        }
    }

    /// Adds the light that a star of a level drops at most, in squares.
    fn add_dropped_of_level(
        &self,
        (column, row): (i64, i64),
        flux: f64,
        level: usize,
        dropped: &mut DroppedLight,
    ) {
        let (level, window) = (self.level(level), self.limits.window);
        let (x0, y0) = (column + window.x0(), row + window.y0());
        let rectangle = PixelRegion::new(x0, y0, window.shape());
        let index = |at: i64, first: i64| ((at - first).div_euclid(SQUARE) + 1) as usize;
        dropped.add(rectangle, |x, y| {
            let limit = f64::from(level.brightest[[index(y, y0), index(x, x0)]]);
            (flux.abs() * limit).min(self.floor)
        });
    }

    /// Adds the light that the wings of a star of a level drop at most. The star's flux is already counted.
    pub(super) fn add_dropped_beside_core(
        &self,
        pixel: (i64, i64),
        flux: f64,
        level: usize,
        dropped: &mut DroppedLight,
    ) {
        let light = f64::from(self.limits.light.sum());
        dropped.count_dropped(flux * light * self.level(level).dropped);
        self.add_dropped_of_level(pixel, flux, level, dropped);
    }

    /// As [`add_dropped_beside_core`](Self::add_dropped_beside_core), for many stars `(pixel, flux)` of one level
    /// together. Each star counts for all pixels of the square in which it lies.
    pub(super) fn add_dropped_of_all(
        &self,
        stars: &[((i64, i64), f64)],
        level: usize,
        dropped: &mut DroppedLight,
    ) {
        let (light, level) = (f64::from(self.limits.light.sum()), self.level(level));
        let flux: f64 = stars.iter().map(|(_, flux)| flux).sum();
        dropped.count_dropped(flux * light * level.dropped);
        let window = self.limits.window;
        let first = |&((column, row), _): &((i64, i64), f64)| (column + window.x0(), row + window.y0());
        let lit = stars.iter().map(|star| (first(star), star.1));
        // The first column of a star's window may be any of a square, so each limit counts for two squares.
        let (ny, nx) = level.brightest.dim();
        let of_two = Array2::from_shape_fn((ny, nx), |(j, i)| {
            let at = |j: usize, i: usize| level.brightest.get((j, i)).copied().unwrap_or(0.0);
            at(j, i).max(at(j + 1, i)).max(at(j, i + 1)).max(at(j + 1, i + 1))
        });
        dropped.add_convolved(lit, of_two.mapv(f64::from).view());
    }

    pub(super) fn bytes(&self) -> usize {
        // A level is about as large as the limits.
        (1 + self.levels.len()) * size_of::<f32>() * self.limits.of_runs.len()
    }
}

/// The least limit of pixels that stars of a level light.
fn faintest_of(peak: f64, level: usize) -> f32 {
    (peak * 2.0_f64.powf(-(level as f64) / PER_OCTAVE)) as f32
}

impl Level {
    /// The columns that are drawn in a row, relative to the star's own pixel.
    pub(super) fn segments(&self, row: i64) -> &[Range<i64>] {
        if !self.rows.contains(&row) {
            return &[];
        }
        let at = (row - self.rows.start) as usize;
        &self.segments[self.starts[at]..self.starts[at + 1]]
    }
}

/// The light of stars of flux 1, in runs of pixels.
#[derive(Debug)]
struct Limits {
    window: PixelRegion,
    /// Upper limits of the light of a pixel, `[row, run]` of the window.
    of_runs: Array2<f32>,
    /// The light of the mean PSF. Each coefficient counts for the pixel in which it lies if the star is at the
    /// centre of its pixel.
    light: Array2<f32>,
    /// Whether a run lies within the radius of the least light to draw.
    is_near: Array2<bool>,
}

impl Limits {
    /// `values` are the kernels' coefficients. `largest` are the largest weights of the kernels and `mean` those
    /// of the mean PSF.
    fn new<T: ConvReal>(
        values: &[T],
        (largest, mean): (&[f64], &[f64]),
        least_light: f64,
        ([columns, rows], layout, window): (&[PhasedAxis; 2], RowLayout, PixelRegion),
    ) -> Self {
        let (nx, ny) = (window.shape().nx(), window.shape().ny());
        let runs = nx.div_ceil(RUN);
        // For each run, the coefficients that its pixels may use.
        let of_run = |run: usize| {
            let first = columns.coefficients_of(window.x0() + (run * RUN) as i64);
            let last = columns.coefficients_of(window.x0() + (run * RUN + RUN).min(nx) as i64 - 1);
            first.start..last.end
        };
        let of_run: Vec<Range<usize>> = (0..runs).map(of_run).collect();
        let pixel = |axis: &PhasedAxis, kept: usize, first: i64, count: usize| {
            let pixel = axis.pixel_of(kept) - first;
            usize::try_from(pixel).ok().filter(|&pixel| pixel < count)
        };
        let run_of = |column| Some(pixel(columns, column, window.x0(), nx)? / RUN);
        let run_of: Vec<Option<usize>> = (0..columns.kept).map(run_of).collect();
        let place = |column| layout.index_of(column, columns.oversampling);
        let place: Vec<usize> = (0..columns.kept).map(place).collect();
        let factor = columns.kernel.largest_sum().powi(2);
        let weight = |(largest, mean): (&f64, &f64)| [T::nearest(largest * factor), T::nearest(*mean)];
        let weights: Vec<[T; 2]> = largest.iter().zip(mean).map(weight).collect();
        let row_length = (weights.len() * layout.kernel).max(1);
        let mut of_rows = Array2::<f32>::zeros((values.len() / row_length, runs));
        let mut light = Array2::<f32>::zeros((ny, runs));
        let mut sums = vec![[T::zero(); 2]; layout.kernel];
        let mut line = vec![0.0_f32; columns.kept];
        for (row, values) in values.chunks_exact(row_length).enumerate() {
            sums.fill([T::zero(); 2]);
            vectorized!(
                for (values, &[largest, mean]) in values.chunks_exact(layout.kernel).zip(&weights) {
                    for ([limit, light], &v) in sums.iter_mut().zip(values) {
                        *limit += largest * v.abs();
                        *light += mean * v;
                    }
                }
            );
            let own = pixel(rows, row, window.y0(), ny);
            for ((to, &at), run) in line.iter_mut().zip(&place).zip(&run_of) {
                let [limit, of_mean] = sums[at];
                *to = limit.as_f64() as f32;
                if let (Some(row), Some(run)) = (own, run) {
                    light[[row, *run]] += of_mean.as_f64() as f32;
                }
            }
            for (limit, run) in of_rows.row_mut(row).iter_mut().zip(&of_run) {
                *limit = line[run.clone()].iter().fold(0.0, |m, &v| m.max(v));
            }
        }
        let mut of_runs = Array2::<f32>::zeros((ny, runs));
        for (mut limits, row) in of_runs.outer_iter_mut().zip(window.y0()..) {
            for of_row in rows.coefficients_of(row) {
                limits.zip_mut_with(&of_rows.row(of_row), |limit, &v| *limit = limit.max(v));
            }
        }
        let mut made = Self {
            window,
            is_near: Array2::from_elem(light.dim(), true),
            of_runs,
            light,
        };
        let radius = made.radius(least_light);
        let near = Array2::from_shape_fn(made.light.dim(), |(row, run)| made.distance(row, run) <= radius);
        made.is_near = near;
        made
    }

    /// The least limit above 0 of the pixels that are not always drawn. Infinite if there are none.
    fn least(&self) -> f32 {
        let far = self
            .of_runs
            .iter()
            .zip(&self.is_near)
            .filter(|(v, near)| **v > 0.0 && !**near);
        far.fold(f32::INFINITY, |least, (&v, _)| least.min(v))
    }

    /// A radius within which lies a part of the light, in pixels. Negative for no light.
    fn radius(&self, part: f64) -> f64 {
        if part <= 0.0 {
            return -1.0;
        }
        let mut runs: Vec<(f64, f64)> = self
            .light
            .indexed_iter()
            .map(|((row, run), &light)| (self.distance(row, run), light.into()))
            .collect();
        runs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let total: f64 = runs.iter().map(|(_, light)| light).sum();
        let mut sum = 0.0;
        let within = runs.iter().find(|(_, light)| {
            sum += light;
            total > 0.0 && sum >= part * total
        });
        within.map_or(f64::INFINITY, |(distance, _)| *distance)
    }

    /// The distance of the nearest pixel of a run from the star's own pixel.
    fn distance(&self, row: usize, run: usize) -> f64 {
        let first = self.window.x0() + (run * RUN) as i64;
        let (y, x) = (
            self.window.y0() + row as i64,
            0.clamp(first, first + RUN as i64 - 1),
        );
        (x as f64).hypot(y as f64)
    }

    /// The pixels on which the limit is above `faintest`, and those within the radius of the least light.
    fn level(&self, faintest: f32) -> Level {
        let (nx, ny) = (self.window.shape().nx(), self.window.shape().ny());
        let (mut starts, mut segments) = (vec![0], Vec::<Range<i64>>::new());
        let mut brightest = Array2::<f32>::zeros([ny, nx].map(|n| n.div_ceil(SQUARE as usize) + 1));
        let mut drawn_light = 0.0;
        let mut rows: Option<Range<i64>> = None;
        for (row, limits) in self.of_runs.outer_iter().enumerate() {
            let before = segments.len();
            let is_drawn = |run: usize| limits[run] > faintest || self.is_near[[row, run]];
            for run in (0..limits.len()).filter(|&run| is_drawn(run)) {
                let columns = (run * RUN) as i64..(run * RUN + RUN).min(nx) as i64;
                let columns = columns.start + self.window.x0()..columns.end + self.window.x0();
                match segments[before..].last_mut() {
                    Some(last) if columns.start < last.end + JOINED as i64 => last.end = columns.end,
                    _ => segments.push(columns),
                }
            }
            let at = self.window.y0() + row as i64;
            if segments.len() > before {
                rows = Some(rows.map_or(at, |rows| rows.start)..at + 1);
            }
            if rows.is_some() {
                starts.push(segments.len());
            }
            for run in 0..limits.len() {
                let first = self.window.x0() + (run * RUN) as i64;
                if segments[before..].iter().any(|s| s.contains(&first)) {
                    drawn_light += f64::from(self.light[[row, run]]);
                    continue;
                }
                // A square of the frame may begin in any pixel, so a run may lie in two of them.
                let (i, j) = (row / SQUARE as usize, run * RUN / SQUARE as usize);
                for (i, j) in [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)] {
                    let most = &mut brightest[[i, j]];
                    *most = most.max(limits[run]);
                }
            }
        }
        let rows = rows.unwrap_or(0..0);
        starts.truncate((rows.end - rows.start) as usize + 1);
        let all = f64::from(self.light.sum());
        Level {
            columns: segments.iter().map(|s| s.start).min().unwrap_or(0)
                ..segments.iter().map(|s| s.end).max().unwrap_or(0),
            rows,
            starts,
            segments,
            dropped: if all > 0.0 {
                (1.0 - drawn_light / all).max(0.0)
            } else {
                0.0
            },
            brightest,
        }
    }
}
