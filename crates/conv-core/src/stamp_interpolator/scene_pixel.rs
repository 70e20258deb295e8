//! Removes the response of a scene's pixel from stamps that have the scene's pixels.

use std::f64::consts::PI;

use ndarray::{Array2, ArrayView2};

/// The L2 norm of the light that a margin leaves out is at most this fraction of the PSF's norm.
const LEFT_OUT: f64 = 1e-4;
/// The light of a PSF is examined up to this distance from the edges of its stamp, in pixels.
const EXAMINED: usize = 2 * ScenePixelFilter::MAX_MARGIN;

/// Divides stamps by the Fourier transform of a square pixel, at the frequencies that the stamps'
/// pixels can hold. The stamps have the pixels of a scene.
///
/// The values of a scene that are already integrated over the scene's pixels are samples of the
/// sky convolved with a pixel, `f = (sky * pixel)(j)`. The PSF `h` would apply the pixel in
/// addition. The filter gives `h'` with
///
/// `H'(k) = H(k) / (sinc(kx / 2) sinc(ky / 2))`, `sinc(t) = sin(t) / t`, `|kx|, |ky| <= pi`
///
/// in radians per pixel, so that `f * h' = sky * h` if the sky has no detail beyond the Nyquist
/// frequency, `pi`. Finer detail cannot be recovered, because the samples alias it.
///
/// The factor is 1 at frequency 0. It is largest at the corner, [`LARGEST_FACTOR`]
/// (`(pi / 2)^2 = 2.47`). White noise in the scene grows by [`NOISE_FACTOR`] (`2 ln 2 = 1.39`,
/// r.m.s.), before the PSF, which dims high frequencies.
///
/// [`LARGEST_FACTOR`]: Self::LARGEST_FACTOR
/// [`NOISE_FACTOR`]: Self::NOISE_FACTOR
///
/// The result is wider than the stamp. Far from the centre, the filter alternates in sign and falls
/// as `1 / (2 pi n^2)` along an axis, times what the PSF holds at the Nyquist frequency. The result
/// is one period of the periodic filter, so no flux is lost: its sum is the sum of the stamp.
///
/// ```
/// use conv_core::ScenePixelFilter;
/// use ndarray::Array2;
/// let mut delta = Array2::zeros((5, 5));
/// delta[[2, 2]] = 1.0;
/// let filter = ScenePixelFilter::new(delta.dim(), 10);
/// let sharper = filter.apply(delta.view());
/// assert_eq!(sharper.dim(), (25, 25));
/// assert!((sharper.sum() - 1.0).abs() < 1e-12);
/// assert!(sharper[[12, 12]] > 1.3 && sharper[[12, 13]] < 0.0);
/// ```
#[derive(Debug, Clone)]
pub struct ScenePixelFilter {
    /// The filter along y: `[row of the result, row of the stamp]`.
    along_y: Array2<f64>,
    /// The filter along x: `[column of the result, column of the stamp]`.
    along_x: Array2<f64>,
}

impl ScenePixelFilter {
    /// The largest factor by which the amplitude of any frequency grows: `(pi / 2)^2`.
    pub const LARGEST_FACTOR: f64 = PI * PI / 4.0;

    /// The factor by which the r.m.s. of white noise in a scene grows: `2 ln 2`. It is the root of
    /// the mean square of the filter's factor over all frequencies.
    pub const NOISE_FACTOR: f64 = 2.0 * std::f64::consts::LN_2;

    /// The largest margin, in pixels. It is that of PSFs which fall on few pixels.
    pub const MAX_MARGIN: usize = 64;

    /// A filter for stamps of `(ny, nx)` pixels. The results are `margin` pixels wider on each side.
    pub fn new(shape: (usize, usize), margin: usize) -> Self {
        Self::with_period(shape, margin, 2 * margin)
    }

    /// The filter that [`margin_for`](Self::margin_for) uses. Its results are wider than any margin,
    /// and its period is so long that their edges do not depend on it.
    fn of_widest_result(shape: (usize, usize)) -> Self {
        Self::with_period(shape, EXAMINED, 8 * EXAMINED)
    }

    /// The period is longer than the stamp by `beyond` pixels.
    fn with_period((ny, nx): (usize, usize), margin: usize, beyond: usize) -> Self {
        Self {
            along_y: filter_along(ny, margin, ny + beyond),
            along_x: filter_along(nx, margin, nx + beyond),
        }
    }

    /// The margin, in pixels, that the results for these PSFs need. All have the same shape.
    ///
    /// The light of a PSF outside its margin has an L2 norm of at most 1e-4 of the PSF's norm. The
    /// margin is at most [`MAX_MARGIN`](Self::MAX_MARGIN). A PSF on a single pixel, which has the
    /// most light outside this margin, then loses 3e-4 of its norm, and the flux outside the margin
    /// is below 1e-4 of its flux. The flux of results is conserved in any case.
    ///
    /// # Panics
    /// If the PSFs have different shapes.
    pub fn margin_for(psfs: impl IntoIterator<Item = Array2<f64>>) -> usize {
        let mut widest: Option<((usize, usize), Self)> = None;
        let mut margin = 0;
        for psf in psfs {
            let (shape, filter) =
                widest.get_or_insert_with(|| (psf.dim(), Self::of_widest_result(psf.dim())));
            assert_eq!(psf.dim(), *shape, "the PSFs have one shape");
            margin = margin.max(needed_margin(filter.apply(psf.view()).view()));
        }
        margin.min(Self::MAX_MARGIN)
    }

    /// The filtered stamp `[y, x]`. The centre of the stamp has moved by the margin along each axis.
    ///
    /// # Panics
    /// If the stamp does not have the filter's shape.
    pub fn apply(&self, stamp: ArrayView2<'_, f64>) -> Array2<f64> {
        self.along_y.dot(&stamp).dot(&self.along_x.t())
    }
}

/// The filter along one axis, `[pixel of the result, pixel of the stamp]`, for `pixels` pixels and
/// `margin` more pixels on each side of the result. The filter has a period of `period` pixels.
fn filter_along(pixels: usize, margin: usize, period: usize) -> Array2<f64> {
    let length = period as f64;
    // cos(2 pi j / period)
    let cosine: Vec<f64> = (0..period)
        .map(|j| (2.0 * PI * j as f64 / length).cos())
        .collect();
    let factors: Vec<f64> = (0..period)
        .map(|j| {
            // Half of the frequency.
            let half = PI * j.min(period - j) as f64 / length;
            if j == 0 { 1.0 } else { half / half.sin() }
        })
        .collect();
    let response: Vec<f64> = (0..period)
        .map(|n| {
            let terms = factors.iter().enumerate();
            terms
                .map(|(j, factor)| factor * cosine[j * n % period])
                .sum::<f64>()
                / length
        })
        .collect();
    Array2::from_shape_fn((pixels + 2 * margin, pixels), |(to, from)| {
        response[to.abs_diff(from + margin)]
    })
}

/// The smallest margin outside which a PSF is dark, which [`ScenePixelFilter::of_widest_result`] has
/// filtered.
fn needed_margin(filtered: ArrayView2<'_, f64>) -> usize {
    let (ny, nx) = filtered.dim();
    // The energy at each distance beyond the edges of the stamp, 0 inside it.
    let mut energy = vec![0.0; EXAMINED + 1];
    let beyond = |i: usize, n: usize| EXAMINED.saturating_sub(i.min(n - 1 - i));
    for ((y, x), &v) in filtered.indexed_iter() {
        energy[beyond(y, ny).max(beyond(x, nx))] += v * v;
    }
    let limit = LEFT_OUT * LEFT_OUT * energy.iter().sum::<f64>();
    let mut outside = 0.0;
    for margin in (1..=EXAMINED).rev() {
        outside += energy[margin];
        if outside > limit {
            return margin;
        }
    }
    0
}

#[cfg(test)]
mod tests {
    use ndarray::s;

    use super::*;

    /// Rounding of sums over a stamp.
    const ROUNDING: f64 = 1e-12;

    fn delta(n: usize) -> Array2<f64> {
        let mut stamp = Array2::zeros((n, n));
        stamp[[n / 2, n / 2]] = 1.0;
        stamp
    }

    /// A Gaussian at pixel centres, about the centre `n / 2` moved by `shift`.
    fn gauss(n: usize, sigma: f64, shift: f64) -> Array2<f64> {
        let at = |i: usize| i as f64 - (n / 2) as f64;
        Array2::from_shape_fn((n, n), |(y, x)| {
            (-((at(x) - shift).powi(2) + at(y).powi(2)) / (2.0 * sigma * sigma)).exp()
                / (2.0 * PI * sigma * sigma)
        })
    }

    /// The Gaussian integrated over each pixel by the mid-point rule on 40 x 40 points, which is
    /// exact to 1e-5 of the peak.
    fn integrated(n: usize, sigma: f64, shift: f64) -> Array2<f64> {
        const POINTS: usize = 40;
        let axis = |shift: f64| -> Vec<f64> {
            let at = |i: usize, p: usize| {
                i as f64 - (n / 2) as f64 + (p as f64 + 0.5) / POINTS as f64 - 0.5 - shift
            };
            let value = |t: f64| (-t * t / (2.0 * sigma * sigma)).exp() / (sigma * (2.0 * PI).sqrt());
            let mean = |i| (0..POINTS).map(|p| value(at(i, p))).sum::<f64>() / POINTS as f64;
            (0..n).map(mean).collect()
        };
        let (y, x) = (axis(0.0), axis(shift));
        Array2::from_shape_fn((n, n), |(j, i)| y[j] * x[i])
    }

    fn largest(a: &Array2<f64>) -> f64 {
        a.iter().fold(0.0, |most: f64, v| most.max(v.abs()))
    }

    #[test]
    fn the_response_of_a_pixel_is_removed() {
        const AS_INTEGRATED: f64 = 1e-4;
        for (sigma, shift) in [(1.5, 0.0), (2.0, 0.3)] {
            let stamp = integrated(31, sigma, shift);
            let margin = ScenePixelFilter::margin_for([stamp.clone()]);
            let filtered = ScenePixelFilter::new(stamp.dim(), margin).apply(stamp.view());
            let expected = gauss(31 + 2 * margin, sigma, shift);
            let peak = largest(&expected);
            assert!(largest(&(&filtered - &expected)) < AS_INTEGRATED * peak);
            let of_stamp = expected.slice(s![margin..margin + 31, margin..margin + 31]);
            assert!(largest(&(&stamp - &of_stamp)) > 0.01 * peak);
        }
    }

    #[test]
    fn flux_is_conserved_at_any_margin() {
        let stamp = Array2::from_shape_fn((9, 14), |(y, x)| ((3 * y + 7 * x) as f64).sin() + 0.3);
        for margin in [0, 1, 2, 5, 30] {
            let filtered = ScenePixelFilter::new((9, 14), margin).apply(stamp.view());
            assert_eq!(filtered.dim(), (9 + 2 * margin, 14 + 2 * margin));
            assert!((filtered.sum() - stamp.sum()).abs() < ROUNDING * 100.0);
        }
    }

    #[test]
    fn noise_grows_by_the_stated_factors() {
        /// The mean over the frequencies of the period is that over all frequencies, to this.
        const OF_PERIOD: f64 = 1e-3;
        for n in [64, 101] {
            let filtered = ScenePixelFilter::new((n, n), 0).apply(delta(n).view());
            // The largest factor of any frequency, by the transform of the response along an axis.
            let response = filtered.sum_axis(ndarray::Axis(0));
            let factor = |j: usize| -> f64 {
                let frequency = 2.0 * PI * j as f64 / n as f64;
                let terms = response.iter().enumerate();
                terms
                    .map(|(i, v)| v * (frequency * (i as f64 - (n / 2) as f64)).cos())
                    .sum()
            };
            let most = (0..n).map(factor).fold(0.0, f64::max).powi(2);
            assert!(
                most <= ScenePixelFilter::LARGEST_FACTOR + ROUNDING && most > 2.4,
                "{most}"
            );
            // White noise: the root of the sum of squares of the response.
            let rms = filtered.iter().map(|v| v * v).sum::<f64>().sqrt();
            assert!((rms - ScenePixelFilter::NOISE_FACTOR).abs() < OF_PERIOD, "{rms}");
        }
        const { assert!(ScenePixelFilter::LARGEST_FACTOR < 2.5) };
    }

    #[test]
    fn margins_hold_the_light() {
        /// The most that any PSF loses: see [`ScenePixelFilter::margin_for`].
        const OF_ONE_PIXEL: (f64, f64) = (3e-4, 1e-4);
        const FAR: usize = 600;
        for (sigma, most) in [(2.0, 2), (1.06, 12), (0.85, 40)] {
            let psf = gauss(25, sigma, 0.0);
            let margin = ScenePixelFilter::margin_for([psf]);
            println!("sigma {sigma}: margin {margin}");
            assert!(margin <= most, "{sigma}: {margin}");
        }
        let psf = delta(5);
        let margin = ScenePixelFilter::margin_for([psf.clone()]);
        assert_eq!(margin, ScenePixelFilter::MAX_MARGIN);
        let whole = ScenePixelFilter::new((5, 5), FAR).apply(psf.view());
        let (from, to) = (FAR - margin, FAR + 5 + margin);
        let inside = whole.slice(s![from..to, from..to]);
        let norm = |values: &mut dyn Iterator<Item = &f64>| values.map(|v| v * v).sum::<f64>();
        let (all, held) = (norm(&mut whole.iter()), norm(&mut inside.iter()));
        let (lost, flux) = (((all - held) / all).sqrt(), (1.0 - inside.sum()).abs());
        println!("one pixel: norm {lost:.2e}, flux {flux:.2e}");
        assert!(
            lost < OF_ONE_PIXEL.0 && flux < OF_ONE_PIXEL.1,
            "{lost:e} {flux:e}"
        );
    }
}
