//! Tests of stamps that are interpolated between their pixels, resampled, and averaged over a frame
//! pixel.

use conv_core::{StampInterpolator, edge_reach, grid_with_pixel_response, native_grid};
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
    let native = native_grid(fine, 0).unwrap();
    // Centre 10, so 10 / 4 = 2 native pixels fit below and (19 - 10) / 4 = 2 above.
    assert_eq!(
        (native.nx(), native.centre_x(), native.oversampling()),
        (5, 2.0, 1.0)
    );
    let coarse = StampInterpolator::new(stamp.view(), fine).resample((0.0, 0.0), native);
    for ((y, x), value) in coarse.indexed_iter() {
        assert!((value - stamp[[2 + 4 * y, 2 + 4 * x]]).abs() < 1e-12);
    }
    assert_eq!(native_grid(grid(64, 63), 0).unwrap(), grid(64, 63));
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
        let target = grid_with_pixel_response(fine, 0).unwrap();
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
        assert_eq!(grid_with_pixel_response(target, 5).unwrap(), target);
    }
}

/// The values of a stamp whose edges are bright and vary from pixel to pixel.
fn bright(ny: usize, nx: usize) -> Array2<f64> {
    Array2::from_shape_fn((ny, nx), |(y, x)| 1.0 + ((y * 13 + x * 7) % 11) as f64)
}

/// Of the light of the outermost pixels, less than this is left more than 12 pixels beyond them, on
/// all four sides together.
const TAIL: f64 = 3e-7;

/// The sum over the frame's pixels does not depend on where they lie. At oversampling 1, it is the
/// sum over the stamp.
#[test]
fn no_light_is_lost_at_the_edges() {
    for kernel in [StampInterpolation::CubicSpline, StampInterpolation::Lanczos3] {
        for (ny, nx) in [(1, 1), (2, 5), (17, 16)] {
            let own = grid(nx, ny).with_interpolation(kernel);
            let stamp = StampInterpolator::new(bright(ny, nx).view(), own);
            for shift in [(0.0, 0.0), (1e-6, 0.0), (0.3, -0.45), (0.5, 1e-12)] {
                let flux = stamp.resample(shift, grid(nx + 28, ny + 28)).sum();
                let lost = flux / bright(ny, nx).sum() - 1.0;
                assert!(lost.abs() < TAIL, "{kernel} {ny} x {nx} {shift:?}: {lost:e}");
            }
        }
        // The average over a frame pixel, too.
        let own = grid(9, 8).with_oversampling(3.0).unwrap();
        let own = own.with_pixel_response_included(false).with_interpolation(kernel);
        let target = grid_with_pixel_response(own, 12).unwrap();
        let with = StampInterpolator::new(bright(8, 9).view(), own).resample((0.0, 0.0), target);
        let lost = with.sum() / bright(8, 9).sum() - 1.0;
        // Gauss's rule integrates the pieces of a Lanczos kernel with an error of 1e-7.
        assert!(lost.abs() < TAIL, "{kernel}: {lost:e}");
    }
}

/// The cubic spline of period `s` through the `s` by `s` sums over the pixels of a stamp that lie
/// `s` pixels apart, at a phase. A star of this phase has this flux. The linear system of the
/// spline is solved by relaxation, which converges because each step halves the error.
fn flux_of_phase(stamp: &Array2<f64>, s: usize, (px, py): (f64, f64)) -> f64 {
    let mut sums = vec![vec![0.0; s]; s];
    for ((y, x), value) in stamp.indexed_iter() {
        sums[y % s][x % s] += value;
    }
    let at = |line: &[f64], t: f64| {
        let mut c = line.to_vec();
        for _ in 0..120 {
            let old = c.clone();
            for r in 0..s {
                c[r] = (6.0 * line[r] - old[(r + 1) % s] - old[(r + s - 1) % s]) / 4.0;
            }
        }
        let spline = |d: f64| match d.abs() {
            d if d < 1.0 => 2.0 / 3.0 - d * d + d * d * d / 2.0,
            d if d < 2.0 => (2.0 - d).powi(3) / 6.0,
            _ => 0.0,
        };
        let t = t.rem_euclid(s as f64);
        let near = -2..s as i64 + 3;
        near.map(|j| c[j.rem_euclid(s as i64) as usize] * spline(t - j as f64))
            .sum::<f64>()
    };
    let rows: Vec<f64> = sums.iter().map(|line| at(line, px)).collect();
    at(&rows, py)
}

/// The flux of a star changes with its phase only if the stamp's pixels that a star uses have
/// another sum at another phase.
#[test]
fn the_flux_changes_with_the_phase_as_the_sums_over_the_stamp_do() {
    let stamp = bright(14, 15);
    for s in [1, 2, 3, 4] {
        let own = grid(15, 14).with_oversampling(s as f64).unwrap();
        let stamp_at = StampInterpolator::new(stamp.view(), own);
        let mut range = (f64::INFINITY, 0.0f64);
        for (i, j) in [(0.0, 0.0), (1e-6, 0.0), (1.0, 2.0), (0.3, 0.9), (1.5, 2.4)] {
            let shift = (-i / s as f64, -j / s as f64);
            let flux = stamp_at.resample(shift, grid(47, 47)).sum();
            let expected = flux_of_phase(&stamp, s, (own.centre_x() + i, own.centre_y() + j));
            let change = flux / expected - 1.0;
            assert!(change.abs() < TAIL, "{s} {i} {j}: {change:e}");
            range = (range.0.min(flux), range.1.max(flux));
        }
        assert!(s == 1 || range.1 > 1.001 * range.0, "the test must see a change");
    }
}

#[test]
fn dark_edges_need_no_reach_and_bright_edges_do() {
    let gauss = |sigma: f64| {
        let at = |i: usize| (i as f64 - 16.0).powi(2) / (2.0 * sigma * sigma);
        Array2::from_shape_fn((1, 33 * 33), |(_, k)| (-at(k / 33) - at(k % 33)).exp())
            .into_shape_with_order((1, 33, 33))
            .unwrap()
    };
    for kernel in [StampInterpolation::CubicSpline, StampInterpolation::Lanczos3] {
        let own = grid(33, 33).with_interpolation(kernel);
        let reach = [2.0, 3.2, 4.0, 8.0].map(|sigma| edge_reach(None, gauss(sigma).view(), None, own));
        assert_eq!(reach[0], 0, "{kernel}");
        assert!(reach[3] > 0 && reach.is_sorted(), "{kernel} {reach:?}");
        // As weights of one component, or as a mean.
        let stamps = gauss(4.0);
        let one = Array2::ones((1, 1));
        assert_eq!(edge_reach(None, stamps.view(), Some(one.view()), own), reach[2]);
        let (mean, none) = (stamps.index_axis(ndarray::Axis(0), 0), Array2::zeros((700, 1)));
        assert_eq!(
            edge_reach(Some(mean), stamps.view(), Some(none.view()), own),
            reach[2]
        );
    }
}

/// A native grid with the reach of the stamps loses no light.
#[test]
fn native_grids_hold_all_light() {
    for kernel in [StampInterpolation::CubicSpline, StampInterpolation::Lanczos3] {
        let at = |i: usize| (i as f64 - 7.5).powi(2) / 32.0;
        let stamp = Array2::from_shape_fn((16, 16), |(y, x)| (-at(x) - at(y)).exp());
        let own = grid(16, 16)
            .with_centre(7.5, 7.5)
            .unwrap()
            .with_interpolation(kernel);
        let reach = edge_reach(None, stamp.view().insert_axis(ndarray::Axis(0)), None, own);
        let native = native_grid(own, reach).unwrap();
        let flux = StampInterpolator::new(stamp.view(), own)
            .resample((0.0, 0.0), native)
            .sum();
        let lost = flux / stamp.sum() - 1.0;
        assert!(lost.abs() < 1e-6, "{kernel}: {lost:e}");
    }
}
