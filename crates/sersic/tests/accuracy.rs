//! Pixels and totals compared with an independent method of integration.

mod common;

use common::{flux_within, galaxy, pixel};
use ndarray::Array2;
use psf_types::{SersicProfile, SersicSource};
use sersic::add_galaxies;

/// The crate's documented error of a pixel, as a fraction of the galaxy's flux.
const PIXEL_ERROR: f64 = 1e-6;
/// The crate's documented error of a pixel, or of a sum, relative to its own value.
const RELATIVE_ERROR: f64 = 1e-5;
/// Errors below this fraction of the flux are not compared with a pixel's own value. The rules
/// allow them, and the independent method loses digits by subtraction.
const FAINT: f64 = 1e-10;

fn drawn(galaxy: &SersicSource, size: usize, first: (i64, i64)) -> Array2<f64> {
    let mut image = Array2::zeros((size, size));
    add_galaxies(image.view_mut(), first, &[*galaxy]);
    image
}

/// Largest errors over all pixels near the centre and some pixels elsewhere: relative to the flux,
/// and relative to the pixel's value.
fn worst(image: &Array2<f64>, first: (i64, i64), truth: &SersicSource) -> (f64, f64) {
    let (mut by_flux, mut by_value) = (0.0_f64, 0.0_f64);
    for ((j, i), &value) in image.indexed_iter() {
        let (x, y) = (first.0 + i as i64, first.1 + j as i64);
        let (dx, dy) = (x as f64 - truth.position().x(), y as f64 - truth.position().y());
        if dx.hypot(dy) > 6.0 && (7 * i + 13 * j) % 41 != 0 {
            continue;
        }
        let expected = pixel(truth, x, y);
        let error = (value - expected).abs() / truth.flux();
        by_flux = by_flux.max(error);
        by_value = by_value.max((error - FAINT).max(0.0) * truth.flux() / expected);
    }
    (by_flux, by_value)
}

#[test]
fn the_independent_method_is_right_for_a_gaussian() {
    // n = 0.5 is a Gaussian of sigma = re / sqrt(2 ln 2), whose pixels are products of error
    // functions.
    let re = 2.0;
    let sigma = re / (2.0 * std::f64::consts::LN_2).sqrt();
    let round = galaxy((0.3, -0.2), 1.0, SersicProfile::new(re, 0.5, 1.0, 0.0).unwrap());
    let along = |from: f64, to: f64| {
        let erf = |v: f64| statrs::function::erf::erf(v / (sigma * std::f64::consts::SQRT_2));
        0.5 * (erf(to) - erf(from))
    };
    for (x, y) in [(0_i64, 0_i64), (1, 0), (3, -2), (5, 4)] {
        let by_axes = along(x as f64 - 0.8, x as f64 + 0.2) * along(y as f64 - 0.3, y as f64 + 0.7);
        assert!((pixel(&round, x, y) - by_axes).abs() < 1e-11, "{x} {y}");
    }
}

#[test]
fn every_pixel_is_as_accurate_as_promised() {
    let mut worst_of_all = (0.0_f64, 0.0_f64);
    for n in [0.3, 0.5, 0.8, 1.0, 1.7, 2.5, 4.0, 6.0, 8.0] {
        for (re, q, angle) in [
            (3.0, 1.0, 0.0),
            (3.0, 0.5, 30.0),
            (12.0, 0.05, 75.0),
            (0.02, 0.7, 10.0),
            (300.0, 0.3, -50.0),
        ] {
            for at in [(64.0, 64.0), (70.5, 60.5), (127.93, 64.31)] {
                let truth = galaxy(at, 250.0, SersicProfile::new(re, n, q, angle).unwrap());
                let errors = worst(&drawn(&truth, 140, (0, 0)), (0, 0), &truth);
                assert!(
                    errors.0 <= PIXEL_ERROR && errors.1 <= RELATIVE_ERROR,
                    "n = {n}, re = {re}, q = {q}, at {at:?}: {errors:?}"
                );
                worst_of_all = (worst_of_all.0.max(errors.0), worst_of_all.1.max(errors.1));
            }
        }
    }
    println!(
        "largest error of a pixel: {:.1e} of the flux, {:.1e} of its value",
        worst_of_all.0, worst_of_all.1
    );
}

#[test]
fn a_slightly_different_galaxy_is_detected() {
    let drawn_as = galaxy(
        (64.0, 64.0),
        1.0,
        SersicProfile::new(3.0, 2.0, 0.5, 30.0).unwrap(),
    );
    let image = drawn(&drawn_as, 128, (0, 0));
    for (re, n, q, angle) in [
        (3.001, 2.0, 0.5, 30.0),
        (3.0, 2.001, 0.5, 30.0),
        (3.0, 2.0, 0.501, 30.0),
        (3.0, 2.0, 0.5, 30.1),
        (3.0, 2.0, 0.5, -30.0),
    ] {
        let other = galaxy((64.0, 64.0), 1.0, SersicProfile::new(re, n, q, angle).unwrap());
        assert!(
            worst(&image, (0, 0), &other).0 > PIXEL_ERROR,
            "{re} {n} {q} {angle}"
        );
    }
}

#[test]
fn the_sum_of_an_image_is_the_flux_in_its_area() {
    for n in [0.4, 1.0, 2.0, 4.0, 8.0] {
        for (re, q) in [(1e-3, 1.0), (3.0, 0.6), (40.0, 0.05), (5000.0, 0.8)] {
            for first in [(-300, -280), (2, -100), (150, 40)] {
                let truth = galaxy((10.2, -7.8), 1.0, SersicProfile::new(re, n, q, 40.0).unwrap());
                let total = drawn(&truth, 600, first).sum();
                let low = (first.0 as f64 - 0.5, first.1 as f64 - 0.5);
                let expected = flux_within(&truth, low, (low.0 + 600.0, low.1 + 600.0));
                // The second term is for images far from the galaxy, with hardly any light.
                let allowed = RELATIVE_ERROR * expected + 2.0 * sersic::FLUX_LEFT_OUT;
                assert!(
                    (total - expected).abs() <= allowed,
                    "n = {n}, re = {re}, q = {q}, first pixel {first:?}: {total} {expected}"
                );
            }
        }
    }
}
