//! Stamps between their pixels.

mod bspline;
mod kernel;
mod taps;

use ndarray::{Array2, Array3, ArrayView2};
use psf_types::{DataError, PsfSamples, StampGrid};

pub(crate) use kernel::{Kernel, MOST_TAPS};
pub(crate) use taps::Taps;

/// The values of a stamp between its pixels, by the rule that its grid names ([`psf_types::StampInterpolation`]).
///
/// * Cubic spline: exact at the pixels, twice continuously differentiable between them. A cubic B-spline whose coefficients come from the
///   recursive filter of Unser, Aldroubi and Eden 1993 (IEEE Trans. Signal Process. 41, 834), with the stamp continued by
///   mirroring about its outermost pixels. Beyond those it is 0.
/// * Lanczos-3: `sinc(t) sinc(t / 3)` over three pixels either side, its weights scaled so that they add up to 1 and a constant stays
///   one (Bernstein and Gruen 2014, PASP 126, 287, section 4). Beyond the outermost pixels the stamp is 0, so that it fades out over three more.
///
/// ```
/// use conv_core::StampInterpolator;
/// use ndarray::Array2;
/// use psf_types::StampGrid;
/// let grid = StampGrid::new(9, 9)?;
/// let stamp = Array2::from_shape_fn((9, 9), |(y, x)| (-(((y as f64 - 4.0).powi(2) + (x as f64 - 4.0).powi(2)) / 3.0)).exp());
/// let same = StampInterpolator::new(stamp.view(), grid).resample((0.0, 0.0), grid);
/// assert!((same[[4, 5]] - stamp[[4, 5]]).abs() < 1e-15);
/// # Ok::<(), psf_types::DataError>(())
/// ```
#[derive(Debug, Clone)]
pub struct StampInterpolator {
    /// What the kernel's weights multiply: the values, or the spline's coefficients.
    coefficients: Array2<f64>,
    grid: StampGrid,
    kernel: Kernel,
}

impl StampInterpolator {
    /// The interpolator of the values `[y, x]` of a stamp.
    ///
    /// # Panics
    /// When the values do not have the grid's shape.
    pub fn new(values: ArrayView2<'_, f64>, grid: StampGrid) -> Self {
        assert_eq!(values.dim(), grid.dim(), "a stamp has its grid's shape");
        let kernel = Kernel::of(grid.interpolation());
        Self {
            coefficients: kernel.coefficients(values),
            grid,
            kernel,
        }
    }

    /// The PSF of a source shifted by `(dx, dy)` frame pixels from the centre of `target`, at the pixels of `target`
    /// `[y, x]`. The values keep their meaning (fraction of the flux in a frame pixel), whatever the two oversamplings.
    ///
    /// Where `target` holds the pixel response and the stamp does not, the values are averages over a frame pixel, which is
    /// the response of a square pixel; a response that is in the stamp stays in.
    pub fn resample(&self, (dx, dy): (f64, f64), target: StampGrid) -> Array2<f64> {
        let (ours, s) = (self.grid, self.grid.oversampling());
        let adds_response = target.pixel_response_included() && !ours.pixel_response_included();
        let width = if adds_response { s } else { 0.0 };
        let taps = |count, length, centre: f64, target_centre: f64, shift: f64| {
            Taps::new(self.kernel, length, width, count, |i| {
                centre + s * ((i as f64 - target_centre) / target.oversampling() - shift)
            })
        };
        let taps_x = taps(target.nx(), ours.nx(), ours.centre_x(), target.centre_x(), dx);
        let taps_y = taps(target.ny(), ours.ny(), ours.centre_y(), target.centre_y(), dy);
        let mut values = Array2::zeros(target.dim());
        let mut line = vec![0.0; ours.nx()];
        for (j, mut row) in values.outer_iter_mut().enumerate() {
            line.fill(0.0);
            for &(index, weight) in taps_y.of(j) {
                for (sum, &c) in line.iter_mut().zip(self.coefficients.row(index)) {
                    *sum += weight * c;
                }
            }
            for (i, value) in row.iter_mut().enumerate() {
                *value = taps_x.of(i).iter().map(|&(index, w)| w * line[index]).sum();
            }
        }
        values
    }
}

/// Every sample resampled to another grid, as [`StampInterpolator::resample`] does.
///
/// # Errors
/// [`DataError`] when a resampled stamp holds no flux, as on a target far smaller than the PSF.
pub fn resample_samples(samples: &PsfSamples, target: StampGrid) -> Result<PsfSamples, DataError> {
    let ours = samples.grid();
    let mut stamps = Array3::zeros((samples.len(), target.ny(), target.nx()));
    for (mut stamp, sample) in stamps.outer_iter_mut().zip(samples.stamps().outer_iter()) {
        stamp.assign(&StampInterpolator::new(sample, ours).resample((0.0, 0.0), target));
    }
    let included = ours.pixel_response_included() || target.pixel_response_included();
    let target = target
        .with_pixel_response_included(included)
        .with_interpolation(ours.interpolation());
    PsfSamples::new(stamps, samples.positions().clone(), target)
}

/// The grid at the frame's own pixel scale that covers a stamp, centred on a pixel; a grid that is such already stays.
///
/// # Errors
/// [`DataError`] never for a valid grid; it is the type's constructor that checks.
pub fn native_grid(grid: StampGrid) -> Result<StampGrid, DataError> {
    let s = grid.oversampling();
    let reach = |room: f64| (room.max(0.0) / s).floor() as usize;
    let (left, right) = (
        reach(grid.centre_x()),
        reach((grid.nx() - 1) as f64 - grid.centre_x()),
    );
    let (below, above) = (
        reach(grid.centre_y()),
        reach((grid.ny() - 1) as f64 - grid.centre_y()),
    );
    let native =
        StampGrid::new(left + right + 1, below + above + 1)?.with_centre(left as f64, below as f64)?;
    Ok(native
        .with_pixel_response_included(grid.pixel_response_included())
        .with_interpolation(grid.interpolation()))
}

/// The grid of the same stamps once the response of a frame pixel is in them: half a frame pixel wider on every side, so that
/// no light is lost. A grid with the response in it stays.
///
/// # Errors
/// [`DataError`] never for a valid grid; it is the type's constructor that checks.
pub fn grid_with_pixel_response(grid: StampGrid) -> Result<StampGrid, DataError> {
    if grid.pixel_response_included() {
        return Ok(grid);
    }
    let margin = (grid.oversampling() / 2.0).ceil() as usize;
    Ok(StampGrid::new(grid.nx() + 2 * margin, grid.ny() + 2 * margin)?
        .with_centre(grid.centre_x() + margin as f64, grid.centre_y() + margin as f64)?
        .with_oversampling(grid.oversampling())?
        .with_interpolation(grid.interpolation())
        .with_pixel_response_included(true))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(nx: usize, ny: usize) -> StampGrid {
        StampGrid::new(nx, ny).unwrap()
    }

    #[test]
    fn exact_at_the_pixels_of_any_shape() {
        for (ny, nx) in [(1, 1), (1, 7), (2, 2), (3, 5), (16, 9)] {
            let stamp = Array2::from_shape_fn((ny, nx), |(y, x)| ((y * 13 + x * 7) % 11) as f64 - 3.0);
            let same = StampInterpolator::new(stamp.view(), grid(nx, ny)).resample((0.0, 0.0), grid(nx, ny));
            for (a, b) in same.iter().zip(&stamp) {
                assert!((a - b).abs() < 1e-13, "{ny} x {nx}");
            }
        }
    }

    #[test]
    fn a_shifted_gaussian_is_the_gaussian_of_the_shifted_source() {
        let sigma2: f64 = 4.0;
        let gauss = |dy: f64, dx: f64| (-(dx * dx + dy * dy) / (2.0 * sigma2)).exp();
        let stamp = Array2::from_shape_fn((31, 31), |(y, x)| gauss(y as f64 - 15.0, x as f64 - 15.0));
        let (dx, dy) = (0.37, -0.21);
        let shifted = StampInterpolator::new(stamp.view(), grid(31, 31)).resample((dx, dy), grid(31, 31));
        let mut largest = 0.0f64;
        for ((y, x), value) in shifted
            .indexed_iter()
            .filter(|((y, x), _)| (4..27).contains(y) && (4..27).contains(x))
        {
            largest = largest.max((value - gauss(y as f64 - 15.0 - dy, x as f64 - 15.0 - dx)).abs());
        }
        // A cubic spline is off by at most 1/384 of the fourth derivative, here 3 / sigma^4, along each of two axes
        // (Hall and Meyer 1976: 5/384 in general, 1/384 for the leading term on a uniform grid).
        let bound = 2.0 * 3.0 / sigma2.powi(2) / 384.0;
        assert!(largest < bound, "{largest} against {bound}");
        assert!(largest > 1e-8, "the test must be able to see an error");
    }

    #[test]
    fn native_pixels_of_an_oversampled_stamp_are_its_own_pixels() {
        let fine = grid(20, 20).with_oversampling(4.0).unwrap();
        let stamp = Array2::from_shape_fn((20, 20), |(y, x)| ((y * 5 + x * 3) % 17) as f64);
        let native = native_grid(fine).unwrap();
        // Centre 10, so 10 / 4 = 2 native pixels fit below and (19 - 10) / 4 = 2 above.
        assert_eq!(
            (native.nx(), native.centre_x(), native.oversampling()),
            (5, 2.0, 1.0)
        );
        let coarse = StampInterpolator::new(stamp.view(), fine).resample((0.0, 0.0), native);
        for ((y, x), value) in coarse.indexed_iter() {
            assert!((value - stamp[[2 + 4 * y, 2 + 4 * x]]).abs() < 1e-12);
        }
        assert_eq!(native_grid(grid(64, 63)).unwrap(), grid(64, 63));
    }

    #[test]
    fn lanczos_keeps_pixels_and_constants() {
        let lanczos = grid(16, 9).with_interpolation(psf_types::StampInterpolation::Lanczos3);
        let stamp = Array2::from_shape_fn((9, 16), |(y, x)| ((y * 13 + x * 7) % 11) as f64 - 3.0);
        let same = StampInterpolator::new(stamp.view(), lanczos).resample((0.0, 0.0), lanczos);
        for (a, b) in same.iter().zip(&stamp) {
            assert!((a - b).abs() < 1e-14);
        }
        let flat =
            StampInterpolator::new(Array2::ones((9, 16)).view(), lanczos).resample((0.3, 0.2), lanczos);
        assert!((flat[[4, 8]] - 1.0).abs() < 1e-14);
        // Two pixels off the edge there is still something, four off there is not.
        let wide = grid(24, 17).with_interpolation(psf_types::StampInterpolation::Lanczos3);
        let faded = StampInterpolator::new(Array2::ones((9, 16)).view(), lanczos).resample((0.3, 0.0), wide);
        assert!(faded[[8, 2]].abs() > 1e-3 && faded[[8, 0]] == 0.0);
    }

    /// A Gaussian averaged over a frame pixel, by error functions through a fine sum.
    #[test]
    fn the_pixel_response_is_the_average_over_a_frame_pixel() {
        let (s, sigma) = (4.0, 1.1);
        let fine = grid(61, 61)
            .with_oversampling(s)
            .unwrap()
            .with_pixel_response_included(false);
        let gauss =
            |d: f64| (-d * d / (2.0 * sigma * sigma)).exp() / (sigma * (2.0 * std::f64::consts::PI).sqrt());
        let at = |i: f64| (i - 30.0) / s;
        let stamp = Array2::from_shape_fn((61, 61), |(y, x)| gauss(at(y as f64)) * gauss(at(x as f64)));
        let averaged = |d: f64| {
            (0..1000)
                .map(|k| gauss(d + (f64::from(k) + 0.5) / 1000.0 - 0.5))
                .sum::<f64>()
                / 1000.0
        };
        // A cubic spline is off by 3 / (384 sigma^4) of the peak along each axis, with sigma = 4.4 pixels of the stamp; a
        // Lanczos kernel by a few parts in 10^4 at any sampling.
        for (kernel, within) in [
            (psf_types::StampInterpolation::CubicSpline, 5e-5),
            (psf_types::StampInterpolation::Lanczos3, 3e-4),
        ] {
            let fine = fine.with_interpolation(kernel);
            let target = grid_with_pixel_response(fine).unwrap();
            assert_eq!((target.nx(), target.centre_x()), (65, 32.0));
            let with = StampInterpolator::new(stamp.view(), fine).resample((0.0, 0.0), target);
            for (j, i) in [(32, 32), (30, 37), (36, 26)] {
                let exact = averaged((j as f64 - 32.0) / s) * averaged((i as f64 - 32.0) / s);
                assert!(
                    (with[[j, i]] - exact).abs() < within * exact,
                    "{kernel} {}",
                    with[[j, i]] / exact - 1.0
                );
            }
            assert!((target.flux_of_sum(with.sum()) - fine.flux_of_sum(stamp.sum())).abs() < 1e-6);
            // Once is enough.
            assert_eq!(grid_with_pixel_response(target).unwrap(), target);
        }
    }
}
