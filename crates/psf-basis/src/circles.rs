//! The flux of stamps in circles about the source.

use faer::MatRef;
use ndarray::{Array2, ArrayView1, ArrayView2};
use psf_types::StampGrid;
use rayon::prelude::*;

use crate::components::Components;

/// Radii of neighbouring circles differ by one stamp pixel divided by this number.
const PER_PIXEL: f64 = 2.0;

/// PSFs have no flux if their values nearly cancel: their sum is at most this part of the sum of
/// their absolute values. The flux in a circle then has no relative error.
const NO_FLUX: f64 = 1e-13;

/// Noise of this many standard deviations is not an error of the model. A normal variable exceeds it
/// once in 2 million cases, so rarely in the circles of thousands of samples.
const DEVIATIONS: f64 = 5.0;

/// Circles about the source, from its own pixel to the corners of the stamp.
#[derive(Debug)]
pub(crate) struct Circles {
    /// For every pixel of a stamp, the number of the smallest circle that contains it.
    smallest: Vec<u32>,
    /// The number of pixels in every circle.
    pixels: Vec<f64>,
}

impl Circles {
    /// The circles of stamps with this grid.
    pub(crate) fn new(grid: StampGrid) -> Self {
        let pixels = (0..grid.ny()).flat_map(|y| (0..grid.nx()).map(move |x| (x as f64, y as f64)));
        let radius = |(x, y): (f64, f64)| (x - grid.centre_x()).hypot(y - grid.centre_y());
        let smallest: Vec<u32> = pixels
            .map(|pixel| (PER_PIXEL * radius(pixel)).ceil() as u32)
            .collect();
        let count = smallest.iter().max().map_or(0, |&last| last as usize + 1);
        let mut circles = Self {
            smallest,
            pixels: vec![0.0; count],
        };
        circles.pixels = circles.sums(std::iter::repeat_n(&1.0, grid.pixel_count()));
        circles
    }

    /// The sum of a stamp's pixels in every circle.
    fn sums<'a>(&self, stamp: impl Iterator<Item = &'a f64>) -> Vec<f64> {
        let mut sums = vec![0.0; self.pixels.len()];
        for (&circle, value) in self.smallest.iter().zip(stamp) {
            sums[circle as usize] += value;
        }
        let mut inside = 0.0;
        for sum in &mut sums {
            inside += *sum;
            *sum = inside;
        }
        sums
    }

    /// The sums of every row `[stamp, pixel]` in every circle, `[stamp, circle]`.
    pub(crate) fn sums_of_rows(&self, rows: ArrayView2<'_, f64>) -> Array2<f64> {
        self.stacked(rows.nrows(), |k| self.sums(rows.row(k).iter()))
    }

    /// The sums of the columns `[pixel, stamp]` in every circle, `[stamp, circle]`.
    fn sums_of_columns(&self, columns: MatRef<'_, f64>) -> Array2<f64> {
        self.stacked(columns.ncols(), |k| self.sums(columns.col(k).iter()))
    }

    /// The sums of `count` stamps, `[stamp, circle]`.
    fn stacked(&self, count: usize, sums_of: impl Fn(usize) -> Vec<f64> + Sync + Send) -> Array2<f64> {
        let sums: Vec<_> = (0..count).into_par_iter().map(sums_of).collect();
        Array2::from_shape_vec((count, self.pixels.len()), sums.concat()).expect("one row for each stamp")
    }

    /// The largest flux of a residual in any circle, relative to the flux of its sample. If the samples
    /// are `noisy`, the residual counts as white noise: only what [`DEVIATIONS`] do not explain counts.
    pub(crate) fn error(&self, residual: ArrayView1<'_, f64>, flux: SampleFlux, noisy: bool) -> f64 {
        let sums = self.sums(residual.iter());
        if !noisy {
            return flux.relative(largest(&sums));
        }
        let mean_square = residual.dot(&residual) / residual.len() as f64;
        let beyond = sums
            .iter()
            .zip(&self.pixels)
            .map(|(sum, pixels)| (sum.abs() - DEVIATIONS * (mean_square * pixels).sqrt()).max(0.0));
        flux.relative(beyond.fold(0.0, f64::max))
    }

    /// Raises the largest errors of the samples with 0, 1, ... components, `errors`, to the errors of
    /// their flux in circles. Begins with the smallest number of components whose error is at most
    /// `limit`, and ends where both errors are, or at `most` components. `sums` are those of the
    /// samples ([`sums_of_rows`](Self::sums_of_rows)).
    pub(crate) fn raise_errors(
        &self,
        errors: &mut [f64],
        (limit, most): (f64, usize),
        sums: ArrayView2<'_, f64>,
        fluxes: &[SampleFlux],
        found: &Components,
    ) {
        let Some(first) = errors.iter().position(|&error| error <= limit) else {
            return;
        };
        let coefficients = found.coefficients.slice(ndarray::s![..fluxes.len(), ..]);
        let kept = self.sums_of_columns(found.vectors.subcols(0, first));
        let mut left = &sums - &coefficients.slice(ndarray::s![.., ..first]).dot(&kept);
        for (count, error) in errors.iter_mut().enumerate().take(most + 1).skip(first) {
            if count > first {
                let next = self.sums_of_columns(found.vectors.subcols(count - 1, 1));
                left -= &coefficients.slice(ndarray::s![.., count - 1..count]).dot(&next);
            }
            let of_samples = left.outer_iter().zip(fluxes).map(|(sums, flux)| {
                let sums = sums.to_slice().expect("row-major");
                flux.relative(largest(sums))
            });
            *error = of_samples.fold(*error, f64::max);
            if *error <= limit {
                break;
            }
        }
    }
}

fn largest(sums: &[f64]) -> f64 {
    sums.iter().fold(0.0, |most, sum| most.max(sum.abs()))
}

/// The flux of a sample: the sum of its pixels, or none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SampleFlux(Option<f64>);

impl SampleFlux {
    pub(crate) fn of(sample: ArrayView1<'_, f64>) -> Self {
        let size: f64 = sample.iter().map(|v| v.abs()).sum();
        let flux = sample.sum().abs();
        Self((flux > NO_FLUX * size).then_some(flux))
    }

    /// An error relative to this flux. 0 if there is none.
    fn relative(self, error: f64) -> f64 {
        self.0.map_or(0.0, |flux| error / flux)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of sums over a stamp.
    const ROUNDING: f64 = 1e-13;

    fn grid() -> StampGrid {
        let grid = StampGrid::new(13, 12).unwrap();
        grid.with_centre(5.5, 6.0).unwrap()
    }

    #[test]
    fn circles_hold_the_pixels_within_their_radius() {
        let stamp = Array2::from_shape_fn((12, 13), |(y, x)| ((13 * y + x) as f64 * 0.7).sin());
        let circles = Circles::new(grid());
        let sums = circles.sums(stamp.iter());
        for (number, sum) in sums.iter().enumerate() {
            let radius = number as f64 / 2.0;
            let inside = stamp
                .indexed_iter()
                .filter(|((y, x), _)| (*x as f64 - 5.5).hypot(*y as f64 - 6.0) <= radius);
            let expected: f64 = inside.map(|(_, v)| v).sum();
            assert!((sum - expected).abs() < ROUNDING, "{number}: {sum} {expected}");
        }
        assert!((sums[sums.len() - 1] - stamp.sum()).abs() < ROUNDING);
    }

    #[test]
    fn errors_are_relative_to_the_flux_and_noise_explains_some() {
        let circles = Circles::new(grid());
        let sample = ndarray::Array1::from_elem(12 * 13, 0.5);
        let flux = SampleFlux::of(sample.view());
        // 1e-3 of the flux moves from the middle to the corner.
        let moved = 1e-3 * sample.sum();
        let mut residual = ndarray::Array1::zeros(12 * 13);
        residual[6 * 13 + 5] = moved;
        residual[0] = -moved;
        let error = circles.error(residual.view(), flux, false);
        assert!((error - 1e-3).abs() < ROUNDING, "{error}");
        // The root mean square of the residual is moved sqrt(2 / 156). The first circle with a pixel has
        // two pixels.
        let noise = DEVIATIONS * moved * (2.0 / 156.0f64 * 2.0).sqrt();
        let beyond = circles.error(residual.view(), flux, true);
        assert!(noise < moved && (beyond - (moved - noise) / sample.sum()).abs() < ROUNDING);
        // Pixels that cancel have no flux, so no relative error.
        let none = SampleFlux::of(residual.view());
        assert_eq!(circles.error(residual.view(), none, false), 0.0);
    }
}
