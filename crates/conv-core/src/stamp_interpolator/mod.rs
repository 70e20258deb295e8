//! Interpolation of stamps between their pixels, and the response of a scene's pixel.

mod edge;
mod kernel;
mod scene_pixel;

use ndarray::{Array2, Array3, ArrayView2};
use psf_types::{DataError, PsfSamples, StampGrid};

pub use edge::{edge_reach, edge_reach_of};
pub(crate) use kernel::MOST_REACH;
pub(crate) use kernel::{Kernel, MOST_TAPS, Taps};
pub use scene_pixel::ScenePixelFilter;

/// Interpolates a stamp between its pixels, by the rule that its grid names
/// ([`psf_types::StampInterpolation`]). Pixels beyond the outermost ones count as 0. So the
/// interpolated stamp is a sum over the stamp's pixels, `h(t) = sum_j f_j k(t - j)` along each
/// axis. The sum of `k` over any points one pixel apart is 1. So the sum of the interpolated stamp
/// over such points is the sum of its pixels: no light is lost, wherever the points lie.
///
/// - Cubic spline: exact at the pixels, twice continuously differentiable everywhere. It is a cubic
///   B-spline, `h(t) = sum_j c_j b(t - j)`, with coefficients computed by the recursive filter of
///   Unser, Aldroubi and Eden 1993 (IEEE Trans. Signal Process. 41, 834). Beyond the outermost
///   pixels, the coefficients fall by the factor `sqrt(3) - 2 = -0.27` from pixel to pixel. The
///   Fourier transform of `k` is `3 sinc(w / 2 pi)^4 / (2 + cos w)`. Values more than 12 pixels
///   beyond the outermost pixels are left out: less than 1e-7 of the light of the edges.
/// - Lanczos-3: `sinc(t) sinc(t / 3)` over three pixels on either side. Its weights are scaled to
///   sum to 1, so that a constant stays constant (Bernstein and Gruen 2014, PASP 126, 287, section
///   4). So the interpolated stamp falls to 0 over three more pixels.
///
/// ```
/// use conv_core::StampInterpolator;
/// use ndarray::Array2;
/// use psf_types::StampGrid;
/// let grid = StampGrid::new(9, 9)?;
/// let gauss = |d: f64| (-d * d / 3.0).exp();
/// let stamp = Array2::from_shape_fn((9, 9), |(y, x)| gauss(y as f64 - 4.0) * gauss(x as f64 - 4.0));
/// let same = StampInterpolator::new(stamp.view(), grid).resample((0.0, 0.0), grid);
/// assert!((same[[4, 5]] - stamp[[4, 5]]).abs() < 1e-15);
/// # Ok::<(), psf_types::DataError>(())
/// ```
#[derive(Debug, Clone)]
pub struct StampInterpolator {
    /// The coefficients that the kernel's weights multiply: the stamp's values (Lanczos-3) or the
    /// coefficients of its spline, with more coefficients than pixels.
    coefficients: Array2<f64>,
    grid: StampGrid,
    kernel: Kernel,
}

impl StampInterpolator {
    /// The interpolator of the values `[y, x]` of a stamp.
    ///
    /// # Panics
    /// If the values do not have the grid's shape.
    pub fn new(values: ArrayView2<'_, f64>, grid: StampGrid) -> Self {
        Self::with_kernel(values, grid, Kernel::of(grid.interpolation(), MOST_REACH))
    }

    /// The interpolator of a kernel whose reach is given.
    pub(crate) fn with_kernel(values: ArrayView2<'_, f64>, grid: StampGrid, kernel: Kernel) -> Self {
        assert_eq!(values.dim(), grid.dim(), "a stamp has its grid's shape");
        Self {
            coefficients: kernel.coefficients(values),
            grid,
            kernel,
        }
    }

    /// The coefficients that the kernel's weights multiply ([`Kernel::coefficients`]).
    pub(crate) fn coefficients(&self) -> &Array2<f64> {
        &self.coefficients
    }

    /// The value at the point with these weights along x and y.
    pub(crate) fn at(&self, taps_x: &[(usize, f64)], taps_y: &[(usize, f64)]) -> f64 {
        let along_x = |row| {
            taps_x
                .iter()
                .map(move |&(index, w)| w * self.coefficients[[row, index]])
        };
        taps_y.iter().map(|&(row, w)| w * along_x(row).sum::<f64>()).sum()
    }

    /// The PSF of a source shifted by `(dx, dy)` frame pixels from the centre of `target`, at the
    /// pixels of `target` `[y, x]`. The values remain fractions of the flux per frame pixel, for
    /// all oversamplings of the two grids.
    ///
    /// If `target` includes the pixel response and the stamp does not, the values are averages over
    /// a frame pixel, which is the response of a square pixel. A response that the stamp includes
    /// is kept.
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
        self.at_all(target.dim(), [&taps_x, &taps_y])
    }

    /// The values `[y, x]` at the points of a grid with these weights along x and y.
    pub(crate) fn at_all(&self, shape: (usize, usize), [taps_x, taps_y]: [&Taps; 2]) -> Array2<f64> {
        let mut values = Array2::zeros(shape);
        let mut line = vec![0.0; self.coefficients.ncols()];
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

/// Resamples every sample to another grid, like [`StampInterpolator::resample`].
///
/// # Errors
/// [`DataError`] if the flux of a resampled stamp is not positive. This can happen if the target
/// covers only the dark middle of a ring-shaped PSF.
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

/// The largest grid at the frame's own pixel scale, centred on a pixel, whose pixel centres lie at
/// most `reach` stamp pixels beyond the centres of the stamp's outermost pixels. With the reach of
/// [`edge_reach`], no light is lost. If the new pixels are some of the stamp's pixels, a reach of 0
/// is enough, because the stamp is 0 at all other whole pixels. A grid that already has the frame's
/// scale and is centred on a pixel is returned unchanged if `reach` is 0.
///
/// # Errors
/// No error occurs. The type allows the errors of [`StampGrid`]'s functions: an empty stamp, or a
/// centre or an oversampling that is not allowed. The new grid is never empty, and its centre
/// always lies on it.
pub fn native_grid(grid: StampGrid, reach: usize) -> Result<StampGrid, DataError> {
    let s = grid.oversampling();
    let native = grid_reaching(grid, |room, _| ((room + reach as f64) / s).floor() as usize)?;
    Ok(native
        .with_pixel_response_included(grid.pixel_response_included())
        .with_interpolation(grid.interpolation()))
}

/// A grid at the frame's own pixel scale, centred on a pixel. `reach` gets the number of stamp
/// pixels on one side of the centre and returns the number of frame pixels for that side. Its
/// second argument is 0 on the side of smaller indices and 1 on the other side.
pub(crate) fn grid_reaching(
    grid: StampGrid,
    reach: impl Fn(f64, usize) -> usize,
) -> Result<StampGrid, DataError> {
    let axis = |centre: f64, pixels: usize| {
        let after = (pixels - 1) as f64 - centre;
        (reach(centre.max(0.0), 0), reach(after.max(0.0), 1))
    };
    let (left, right) = axis(grid.centre_x(), grid.nx());
    let (below, above) = axis(grid.centre_y(), grid.ny());
    StampGrid::new(left + right + 1, below + above + 1)?.with_centre(left as f64, below as f64)
}

/// The grid of the stamps after the response of a frame pixel is added. It is wider on every side,
/// by half a frame pixel (rounded up to whole stamp pixels) and `reach` stamp pixels. With the
/// reach of [`edge_reach`], no light is lost. A grid that already includes the response is returned
/// unchanged.
///
/// # Errors
/// No error occurs. The type allows the errors of [`StampGrid`]'s functions: an empty stamp, or a
/// centre or an oversampling that is not allowed. The new grid is larger than the given one and
/// keeps its centre and oversampling.
pub fn grid_with_pixel_response(grid: StampGrid, reach: usize) -> Result<StampGrid, DataError> {
    if grid.pixel_response_included() {
        return Ok(grid);
    }
    let margin = (grid.oversampling() / 2.0).ceil() as usize + reach;
    Ok(grid.with_margins([margin; 2])?.with_pixel_response_included(true))
}
