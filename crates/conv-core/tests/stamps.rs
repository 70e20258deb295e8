//! Tests of stamps that are interpolated between their pixels, resampled, and averaged over a frame
//! pixel.

use conv_core::{StampInterpolator, grid_with_pixel_response, native_grid};
use ndarray::Array2;
use psf_types::{StampGrid, StampInterpolation};

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
    // The error of a cubic spline is at most 1/384 of the fourth derivative, here 3 / sigma^4,
    // along each of two axes (Hall and Meyer 1976: 5/384 in general, 1/384 for the leading term on
    // a uniform grid).
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
    let lanczos = grid(16, 9).with_interpolation(StampInterpolation::Lanczos3);
    let stamp = Array2::from_shape_fn((9, 16), |(y, x)| ((y * 13 + x * 7) % 11) as f64 - 3.0);
    let same = StampInterpolator::new(stamp.view(), lanczos).resample((0.0, 0.0), lanczos);
    for (a, b) in same.iter().zip(&stamp) {
        assert!((a - b).abs() < 1e-14);
    }
    let flat = StampInterpolator::new(Array2::ones((9, 16)).view(), lanczos).resample((0.3, 0.2), lanczos);
    assert!((flat[[4, 8]] - 1.0).abs() < 1e-14);
    // Two pixels beyond the edge the values are not zero. Four pixels beyond the edge they are
    // zero.
    let wide = grid(24, 17).with_interpolation(StampInterpolation::Lanczos3);
    let faded = StampInterpolator::new(Array2::ones((9, 16)).view(), lanczos).resample((0.3, 0.0), wide);
    assert!(faded[[8, 2]].abs() > 1e-3 && faded[[8, 0]] == 0.0);
}

/// A Gaussian averaged over a frame pixel, compared with a fine sum.
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
    // The error of a cubic spline is 3 / (384 sigma^4) of the peak along each axis, with sigma =
    // 4.4 pixels of the stamp. The error of a Lanczos kernel is a few parts in 10^4 at any
    // sampling.
    for (kernel, within) in [
        (StampInterpolation::CubicSpline, 5e-5),
        (StampInterpolation::Lanczos3, 3e-4),
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
        // A second call changes nothing.
        assert_eq!(grid_with_pixel_response(target).unwrap(), target);
    }
}
