//! Stamps between their pixels.

use ndarray::{Array2, Array3, ArrayView2, Axis};
use psf_types::{DataError, PsfSamples, StampGrid};

/// The interpolating cubic spline of a stamp: exact at its pixels, twice continuously differentiable between them.
///
/// A cubic B-spline whose coefficients come from the recursive filter of Unser, Aldroubi and Eden 1993 (IEEE Trans. Signal
/// Process. 41, 834), with the stamp continued by mirroring about its outermost pixels. Beyond those it is 0.
///
/// ```
/// use conv_core::StampSpline;
/// use ndarray::Array2;
/// use psf_types::StampGrid;
/// let grid = StampGrid::new(9, 9)?;
/// let stamp = Array2::from_shape_fn((9, 9), |(y, x)| (-(((y as f64 - 4.0).powi(2) + (x as f64 - 4.0).powi(2)) / 3.0)).exp());
/// let same = StampSpline::new(stamp.view(), grid).resample((0.0, 0.0), grid);
/// assert!((same[[4, 5]] - stamp[[4, 5]]).abs() < 1e-15);
/// # Ok::<(), psf_types::DataError>(())
/// ```
#[derive(Debug, Clone)]
pub struct StampSpline {
    coefficients: Array2<f64>,
    grid: StampGrid,
}

/// A coordinate this far beyond the outermost pixel still counts as on it: rounding, not position.
const EDGE: f64 = 1e-9;

impl StampSpline {
    /// The spline through the values `[y, x]` of a stamp.
    ///
    /// # Panics
    /// When the values do not have the grid's shape.
    pub fn new(values: ArrayView2<'_, f64>, grid: StampGrid) -> Self {
        assert_eq!(values.dim(), grid.dim(), "a stamp has its grid's shape");
        let mut coefficients = values.as_standard_layout().into_owned();
        for axis in [Axis(0), Axis(1)] {
            for mut lane in coefficients.lanes_mut(axis) {
                let mut line = lane.to_vec();
                prefilter(&mut line);
                lane.iter_mut().zip(line).for_each(|(c, v)| *c = v);
            }
        }
        Self { coefficients, grid }
    }

    /// The PSF of a source shifted by `(dx, dy)` frame pixels from the centre of `target`, at the pixels of `target`
    /// `[y, x]`. The values keep their meaning (fraction of the flux in a frame pixel), whatever the two oversamplings.
    pub fn resample(&self, (dx, dy): (f64, f64), target: StampGrid) -> Array2<f64> {
        let (ours, s) = (self.grid, self.grid.oversampling());
        let taps_x = taps(target.nx(), ours.nx(), |i| {
            ours.centre_x() + s * ((i - target.centre_x()) / target.oversampling() - dx)
        });
        let taps_y = taps(target.ny(), ours.ny(), |j| {
            ours.centre_y() + s * ((j - target.centre_y()) / target.oversampling() - dy)
        });
        let mut values = Array2::zeros(target.dim());
        let mut line = vec![0.0; ours.nx()];
        for (mut row, tap_y) in values.outer_iter_mut().zip(&taps_y) {
            let Some(tap_y) = tap_y else { continue };
            line.fill(0.0);
            for (&index, &weight) in tap_y.index.iter().zip(&tap_y.weight) {
                for (sum, &c) in line.iter_mut().zip(self.coefficients.row(index)) {
                    *sum += weight * c;
                }
            }
            for (value, tap_x) in row.iter_mut().zip(&taps_x) {
                if let Some(tap_x) = tap_x {
                    *value = tap_x
                        .index
                        .iter()
                        .zip(&tap_x.weight)
                        .map(|(&i, w)| w * line[i])
                        .sum();
                }
            }
        }
        values
    }
}

/// Every sample resampled to another grid.
///
/// # Errors
/// [`DataError`] when a resampled stamp holds no flux, as on a target far smaller than the PSF.
pub fn resample_samples(samples: &PsfSamples, target: StampGrid) -> Result<PsfSamples, DataError> {
    let mut stamps = Array3::zeros((samples.len(), target.ny(), target.nx()));
    for (mut stamp, sample) in stamps.outer_iter_mut().zip(samples.stamps().outer_iter()) {
        stamp.assign(&StampSpline::new(sample, samples.grid()).resample((0.0, 0.0), target));
    }
    let target = target.with_pixel_response_included(samples.grid().pixel_response_included());
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
    Ok(native.with_pixel_response_included(grid.pixel_response_included()))
}

/// The four spline coefficients that a coordinate needs.
struct Taps {
    index: [usize; 4],
    weight: [f64; 4],
}

fn taps(count: usize, length: usize, coordinate: impl Fn(f64) -> f64) -> Vec<Option<Taps>> {
    let last = (length - 1) as f64;
    (0..count)
        .map(|i| {
            let t = coordinate(i as f64);
            (-EDGE..=last + EDGE).contains(&t).then(|| {
                let t = t.clamp(0.0, last);
                let base = t.floor();
                let u = t - base;
                let v = 1.0 - u;
                let weight = [
                    v * v * v / 6.0,
                    2.0 / 3.0 - u * u * (2.0 - u) / 2.0,
                    2.0 / 3.0 - v * v * (2.0 - v) / 2.0,
                    u * u * u / 6.0,
                ];
                let index = [-1, 0, 1, 2].map(|k| mirror(base as i64 + k, length));
                Taps { index, weight }
            })
        })
        .collect()
}

/// ... 2 1 | 0 1 2 ... n-1 | n-2 n-3 ...
fn mirror(index: i64, length: usize) -> usize {
    if length == 1 {
        return 0;
    }
    let last = length as i64 - 1;
    let folded = index.rem_euclid(2 * last);
    folded.min(2 * last - folded) as usize
}

/// From samples to B-spline coefficients, in place.
fn prefilter(line: &mut [f64]) {
    let n = line.len();
    if n == 1 {
        return;
    }
    let pole = 3f64.sqrt() - 2.0;
    // The causal filter's start: the sum over the mirrored line, which repeats after 2n - 2.
    let period = 2 * n - 2;
    let mut start = 0.0;
    let mut power = 1.0;
    for k in 0..period {
        start += power * line[mirror(k as i64, n)];
        power *= pole;
        if power == 0.0 {
            break;
        }
    }
    line[0] = start / (1.0 - power);
    for k in 1..n {
        line[k] += pole * line[k - 1];
    }
    line[n - 1] = pole / (pole * pole - 1.0) * (line[n - 1] + pole * line[n - 2]);
    for k in (0..n - 1).rev() {
        line[k] = pole * (line[k + 1] - line[k]);
    }
    for c in line {
        *c *= 6.0;
    }
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
            let same = StampSpline::new(stamp.view(), grid(nx, ny)).resample((0.0, 0.0), grid(nx, ny));
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
        let shifted = StampSpline::new(stamp.view(), grid(31, 31)).resample((dx, dy), grid(31, 31));
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
        let coarse = StampSpline::new(stamp.view(), fine).resample((0.0, 0.0), native);
        for ((y, x), value) in coarse.indexed_iter() {
            assert!((value - stamp[[2 + 4 * y, 2 + 4 * x]]).abs() < 1e-12);
        }
        assert_eq!(native_grid(grid(64, 63)).unwrap(), grid(64, 63));
    }
}
