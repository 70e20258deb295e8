//! The light that a plan drops because it is fainter than the floor.

use std::ops::Range;

use ndarray::{Array2, ArrayView2};
use psf_types::{NoProgress, PixelRegion};
use rayon::prelude::*;

use crate::fft2::RealFft2;

/// Columns and rows of the squares on which dropped light is added up, in pixels.
pub(crate) const SQUARE: i64 = 16;

/// Sources are divided into at most so many parts, of at least so many sources.
const MOST_PARTS: usize = 16;
const LEAST_SOURCES: usize = 1 << 10;

/// Upper limits of the light that a plan drops because it is fainter than the floor
/// ([`PlanOptions::with_floor`](crate::PlanOptions::with_floor)), in a region of the frame. Several plans may
/// add to it ([`SourcePlan::add_dropped_light`](crate::SourcePlan::add_dropped_light)).
#[derive(Debug, Clone)]
pub struct DroppedLight {
    /// Row and column of the first square, counted in squares from the frame's first pixel.
    first: (i64, i64),
    /// The most light per pixel that is dropped in each square.
    squares: Array2<f64>,
    dropped_flux: f64,
    flux: f64,
}

impl DroppedLight {
    /// Nothing is dropped yet. `region` is in pixels of the frame.
    pub fn new(region: PixelRegion) -> Self {
        let squares = |first: i64, length: usize| {
            let last = first + length as i64 - 1;
            (first.div_euclid(SQUARE), last.div_euclid(SQUARE))
        };
        let (left, right) = squares(region.x0(), region.shape().nx());
        let (below, above) = squares(region.y0(), region.shape().ny());
        let shape = ((above - below + 1) as usize, (right - left + 1) as usize);
        Self {
            first: (below, left),
            squares: Array2::zeros(shape),
            dropped_flux: 0.0,
            flux: 0.0,
        }
    }

    /// The largest sum of dropped light in any pixel is at most this, in flux per pixel.
    pub fn largest(&self) -> f64 {
        self.squares.iter().fold(0.0, |largest, &v| largest.max(v))
    }

    /// The flux that is dropped, as a fraction of the flux of all sources that reach the region. 0 without
    /// sources.
    pub fn fraction(&self) -> f64 {
        if self.flux > 0.0 {
            self.dropped_flux / self.flux
        } else {
            0.0
        }
    }

    /// Counts the flux of a source, and the part of it that is dropped.
    pub(crate) fn count(&mut self, flux: f64, fraction: f64) {
        self.flux += flux.abs();
        self.dropped_flux += flux.abs() * fraction;
    }

    /// Counts flux that is dropped, of a source whose flux is already counted.
    pub(crate) fn count_dropped(&mut self, flux: f64) {
        self.dropped_flux += flux.abs();
    }

    /// Adds the light per pixel that sources drop at most. Each has the first column and row of its light, and a
    /// factor. Times this factor, the square `d` columns and rows after the one that holds them loses
    /// `limits[d]`.
    pub(crate) fn add_convolved(
        &mut self,
        sources: impl Iterator<Item = ((i64, i64), f64)>,
        limits: ArrayView2<'_, f64>,
    ) {
        let (ny, nx) = self.squares.dim();
        let (height, width) = limits.dim();
        let fft = RealFft2::<f64>::at_least(ny + 2 * height, nx + 2 * width, &NoProgress);
        let mut factors = Array2::zeros((ny + height, nx + width));
        let (below, left) = (self.first.0 - height as i64, self.first.1 - width as i64);
        for ((x, y), factor) in sources {
            let (row, column) = (y.div_euclid(SQUARE) - below, x.div_euclid(SQUARE) - left);
            let within =
                (0..(ny + height) as i64).contains(&row) && (0..(nx + width) as i64).contains(&column);
            if within {
                factors[[row as usize, column as usize]] += factor.abs();
            }
        }
        let (mut of_factors, mut of_limits) = (fft.zeros(), fft.zeros());
        fft.forward(factors.view(), (0, 0), &mut of_factors);
        fft.forward(limits, (0, 0), &mut of_limits);
        of_factors.zip_mut_with(&of_limits, |a, b| *a *= b);
        let sums = fft.inverse(&mut of_factors, (width, height), (ny, nx));
        let sums = sums.expect("nothing cancels") / fft.gain();
        self.squares
            .zip_mut_with(&sums, |square, sum| *square += sum.max(0.0));
    }

    /// Adds what `add` adds for ranges of so many sources, in parallel. The sum does not depend on the number
    /// of threads.
    pub(crate) fn add_all(&mut self, count: usize, add: impl Fn(&mut Self, Range<usize>) + Sync) {
        let zero = Self {
            squares: Array2::zeros(self.squares.dim()),
            dropped_flux: 0.0,
            flux: 0.0,
            ..*self
        };
        let some = count.div_ceil(MOST_PARTS).max(LEAST_SOURCES);
        let parts: Vec<Self> = (0..count.div_ceil(some))
            .into_par_iter()
            .map(|part| {
                let mut sum = zero.clone();
                add(&mut sum, part * some..count.min((part + 1) * some));
                sum
            })
            .collect();
        for part in parts {
            self.squares += &part.squares;
            self.dropped_flux += part.dropped_flux;
            self.flux += part.flux;
        }
    }

    /// Adds the light per pixel that a source drops at most, in the squares that a rectangle of the frame
    /// touches. `left` takes the first column and row of a square.
    pub(crate) fn add(&mut self, rectangle: PixelRegion, left: impl Fn(i64, i64) -> f64) {
        let (below, first_column) = self.first;
        let within = |first: i64, length: usize, start: i64, count: usize| {
            let end = first.saturating_add(length as i64 - 1).div_euclid(SQUARE);
            let squares = |at: i64| (at - start).clamp(0, count as i64);
            squares(first.div_euclid(SQUARE))..squares(end + 1)
        };
        let (ny, nx) = self.squares.dim();
        let columns = within(rectangle.x0(), rectangle.shape().nx(), first_column, nx);
        for row in within(rectangle.y0(), rectangle.shape().ny(), below, ny) {
            for column in columns.clone() {
                let (x, y) = ((first_column + column) * SQUARE, (below + row) * SQUARE);
                self.squares[[row as usize, column as usize]] += left(x, y);
            }
        }
    }
}
