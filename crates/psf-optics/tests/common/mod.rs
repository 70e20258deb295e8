//! Helpers of the contract tests.
#![allow(dead_code, reason = "each test file uses some of them")]

use ndarray::{Array2, ArrayView2};
use psf_optics::{FrameParams, Telescope, TelescopeParams};
use psf_types::{Position, PsfSource};

/// lambda / D of the telescope below in arcsec.
pub(crate) const LAMBDA_OVER_D: f64 = 500e-9 / std::f64::consts::PI * 180.0 * 3600.0;

/// A perfect 1 m telescope at 500 nm on a frame of 101 x 81 pixels, point-sampled.
pub(crate) fn perfect(pixel_scale_arcsec: f64, stamp_size: usize) -> TelescopeParams {
    let frame = FrameParams { nx: 101, ny: 81 };
    let mut params = TelescopeParams::diffraction_limited(1.0, 500.0, pixel_scale_arcsec, frame, stamp_size);
    params.detector.pixel_integration = false;
    params
}

pub(crate) fn centre_of_field() -> Position {
    Position::of_pixel(50, 40)
}

pub(crate) fn draw(params: &TelescopeParams) -> Array2<f64> {
    let telescope = Telescope::new(params.clone()).unwrap();
    telescope.draw(centre_of_field()).unwrap().into_values()
}

/// Bessel function of the first kind, by the trapezoid rule on Bessel's integral. It is exact to
/// rounding for `x` below 300.
pub(crate) fn bessel_j(n: u32, x: f64) -> f64 {
    let points = 400;
    let sum: f64 = (0..points)
        .map(|i| std::f64::consts::TAU * f64::from(i) / f64::from(points))
        .map(|t| (f64::from(n) * t - x * t.sin()).cos())
        .sum();
    sum / f64::from(points)
}

/// The sum, and the first moments and central second moments divided by the sum. Coordinates count
/// from index `n / 2`.
pub(crate) struct Moments {
    pub(crate) sum: f64,
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) xx: f64,
    pub(crate) xy: f64,
    pub(crate) yy: f64,
}

pub(crate) fn moments(stamp: ArrayView2<'_, f64>) -> Moments {
    let (ny, nx) = stamp.dim();
    let mean = |f: &dyn Fn(f64, f64) -> f64, norm: f64| {
        let values = stamp.indexed_iter();
        values
            .map(|((y, x), v)| v * f(x as f64 - (nx / 2) as f64, y as f64 - (ny / 2) as f64))
            .sum::<f64>()
            / norm
    };
    let sum = mean(&|_, _| 1.0, 1.0);
    let (x, y) = (mean(&|x, _| x, sum), mean(&|_, y| y, sum));
    Moments {
        sum,
        x,
        y,
        xx: mean(&|a, _| (a - x) * (a - x), sum),
        xy: mean(&|a, b| (a - x) * (b - y), sum),
        yy: mean(&|_, b| (b - y) * (b - y), sum),
    }
}

pub(crate) fn largest_difference(a: ArrayView2<'_, f64>, b: ArrayView2<'_, f64>) -> f64 {
    assert_eq!(a.dim(), b.dim());
    a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

pub(crate) fn peak(stamp: ArrayView2<'_, f64>) -> f64 {
    stamp.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}
