//! Adaptive and quadrupole moments: known shears, the definition, other software, symmetries.

mod common;

use common::{Gaussian, MOFFATS, Moffat};
use ndarray::{Array2, s};
use proptest::prelude::*;
use psf_metrics::{AdaptiveMomentFinder, AdaptiveMoments, QuadrupoleMoments, ReducedShear, Window};

/// The iteration ends at a relative change of 1e-11.
const EXACT: f64 = 1e-9;

/// A Gaussian of size `sigma = det^(1/4)` and reduced shear `g`.
fn sheared(x: f64, y: f64, sigma: f64, g1: f64, g2: f64) -> Gaussian {
    let g = g1.hypot(g2);
    let stretch = ((1.0 + g) / (1.0 - g)).sqrt();
    Gaussian {
        amplitude: 2.0,
        x,
        y,
        sigma_major: sigma * stretch,
        sigma_minor: sigma / stretch,
        angle: 0.5 * g2.atan2(g1),
        background: 0.0,
    }
}

fn adaptive(stamp: &Array2<f64>) -> AdaptiveMoments {
    AdaptiveMomentFinder::new().measure(stamp.view()).unwrap()
}

#[test]
fn a_known_shear_is_recovered() {
    for sigma in [1.8, 3.0, 6.0] {
        for (g1, g2) in [(0.0, 0.0), (0.1, 0.0), (0.0, -0.2), (-0.15, 0.1)] {
            let truth = sheared(42.3, 45.6, sigma, g1, g2);
            let m = adaptive(&truth.stamp(90, 84));
            // The product of weight and light is a Gaussian of sigma / sqrt 2. At sigma = 1.8
            // pixels and g = 0.2 its aliasing is about 1e-9.
            let tolerance = if sigma < 2.0 { 1e-6 } else { EXACT };
            assert!((m.sigma_px() / sigma - 1.0).abs() < tolerance, "{truth:?}\n{m:?}");
            assert!(
                (m.g1() - g1).abs() < tolerance && (m.g2() - g2).abs() < tolerance,
                "{m:?}"
            );
            let e = ReducedShear::new(g1, g2).unwrap().to_distortion();
            assert!((m.e1() - e.e1()).abs() < tolerance && (m.e2() - e.e2()).abs() < tolerance);
            assert!((m.x_centroid() - 42.3).abs() < tolerance && (m.y_centroid() - 45.6).abs() < tolerance);
            let flux = 2.0 * std::f64::consts::PI * truth.amplitude * sigma * sigma;
            assert!((m.amplitude() / flux - 1.0).abs() < tolerance);
        }
    }
}

#[test]
fn a_wrong_shear_is_detected() {
    let stamp = sheared(32.3, 31.6, 3.0, 0.1, 0.0).stamp(64, 64);
    let mut perturbed = stamp.clone();
    perturbed[[33, 35]] *= 1.0 + 1e-5;
    assert!((adaptive(&perturbed).g1() - adaptive(&stamp).g1()).abs() > 10.0 * EXACT);
}

/// Integrated over pixels, a Gaussian gains the pixel's second moment, 1/12 square pixel along each
/// axis. The remaining difference is the fourth moment of the box, of order 1/120 relative to the
/// covariance.
#[test]
fn the_pixel_widens_the_moments() {
    const FOURTH_MOMENT: f64 = 1e-3;
    let nodes = [-0.774_596_669_241_483_4, 0.0, 0.774_596_669_241_483_4];
    let weights = [5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0];
    let truth = sheared(32.2, 31.7, 2.0, 0.1, -0.05);
    let stamp = Array2::from_shape_fn((64, 64), |(y, x)| {
        let mut sum = 0.0;
        for (ny, wy) in nodes.iter().zip(weights) {
            for (nx, wx) in nodes.iter().zip(weights) {
                sum += wx * wy * truth.at(x as f64 + 0.5 * nx, y as f64 + 0.5 * ny);
            }
        }
        sum
    });
    let (point, pixel) = (
        adaptive(&truth.stamp(64, 64)).covariance(),
        adaptive(&stamp).covariance(),
    );
    assert!(
        (pixel.xx() - point.xx() - 1.0 / 12.0).abs() < FOURTH_MOMENT,
        "{point:?} {pixel:?}"
    );
    assert!((pixel.yy() - point.yy() - 1.0 / 12.0).abs() < FOURTH_MOMENT);
    assert!((pixel.xy() - point.xy()).abs() < FOURTH_MOMENT);
}

/// The defining equations, evaluated by a plain sum, hold for light that is not a Gaussian.
#[test]
fn the_weight_solves_the_defining_equations() {
    for moffat in MOFFATS {
        let stamp = moffat.stamp(48, 48);
        let m = adaptive(&stamp);
        let c = m.covariance();
        let det = c.xx() * c.yy() - c.xy() * c.xy();
        let mut sums = [0.0; 6];
        for ((row, column), light) in stamp.indexed_iter() {
            let (dx, dy) = (column as f64 - m.x_centroid(), row as f64 - m.y_centroid());
            let rho2 = (c.yy() * dx * dx - 2.0 * c.xy() * dx * dy + c.xx() * dy * dy) / det;
            let w = light * (-0.5 * rho2).exp();
            for (sum, term) in sums.iter_mut().zip([1.0, dx, dy, dx * dx, dx * dy, dy * dy]) {
                *sum += w * term;
            }
        }
        let [flux, x, y, xx, xy, yy] = sums;
        for zero in [
            x / flux,
            y / flux,
            2.0 * xx / flux - c.xx(),
            2.0 * xy / flux - c.xy(),
            2.0 * yy / flux - c.yy(),
            2.0 * flux / m.amplitude() - 1.0,
        ] {
            assert!(zero.abs() < EXACT, "{zero} {m:?}");
        }
    }
}

/// GalSim 2.8.5 `hsm.FindAdaptiveMom` (convergence threshold 1e-9) on the same arrays: sigma, g1,
/// g2, x, y, amplitude.
#[test]
fn galsim_agrees() {
    /// GalSim returns sigma and the amplitude in single precision.
    const SINGLE: f64 = 3e-7;
    let expected = [
        [
            1.198_176_980_018_615_7,
            0.108_603_073_701_406_69,
            0.168_068_180_309_314_5,
            24.300_631_268_283_933,
            23.801_818_532_408_884,
            8.214_548_110_961_914,
        ],
        [
            2.176_222_324_371_338,
            -0.018_907_503_096_027_112,
            -0.017_319_571_793_215_856,
            23.600_000_076_441_077,
            24.399_999_964_834_155,
            26.494_056_701_660_156,
        ],
        [
            1.747_528_195_381_164_6,
            -0.118_846_183_376_577_46,
            -0.137_599_854_068_300_06,
            25.099_998_035_709_56,
            22.700_000_692_051_326,
            17.916_471_481_323_242,
        ],
    ];
    for (moffat, [sigma, g1, g2, x, y, amplitude]) in MOFFATS.into_iter().zip(expected) {
        let m = adaptive(&moffat.stamp(48, 48));
        assert!((m.sigma_px() / sigma - 1.0).abs() < SINGLE, "{m:?}");
        assert!((m.amplitude() / amplitude - 1.0).abs() < SINGLE, "{m:?}");
        for difference in [m.g1() - g1, m.g2() - g2, m.x_centroid() - x, m.y_centroid() - y] {
            assert!(difference.abs() < SINGLE, "{m:?}");
        }
    }
}

#[test]
fn the_start_does_not_matter() {
    let stamp = MOFFATS[0].stamp(48, 48);
    let plain = adaptive(&stamp);
    for (x, y, sigma) in [
        (24.0, 24.0, 1.0),
        (22.0, 26.0, 3.0),
        (27.0, 21.0, 9.0),
        (24.0, 24.0, 30.0),
    ] {
        let other = AdaptiveMomentFinder::new()
            .with_start(x, y, sigma)
            .measure(stamp.view())
            .unwrap();
        assert!((other.sigma_px() - plain.sigma_px()).abs() < EXACT, "{other:?}");
        assert!((other.x_centroid() - plain.x_centroid()).abs() < EXACT);
    }
}

#[test]
fn windows_keep_stamp_coordinates() {
    let truth = sheared(50.3, 20.6, 2.0, 0.1, 0.05);
    let mut image = truth.stamp(64, 100);
    image.slice_mut(s![.., ..30]).fill(1e6);
    image[[0, 99]] = f64::NAN;
    let window = Window::about(31, 50, 21);
    let m = AdaptiveMomentFinder::new()
        .with_window(window)
        .measure(image.view())
        .unwrap();
    assert!((m.x_centroid() - 50.3).abs() < EXACT && (m.y_centroid() - 20.6).abs() < EXACT);
    let q = QuadrupoleMoments::measure(image.view(), window).unwrap();
    // The window cuts off the light at 7 sigma.
    assert!(
        (q.x_centroid() - 50.3).abs() < EXACT && (q.y_centroid() - 20.6).abs() < EXACT,
        "{q:?}"
    );
    let single = image.mapv(|v| v as f32);
    let m = AdaptiveMomentFinder::new()
        .with_window(window)
        .measure(single.view())
        .unwrap();
    // f32 values have a relative rounding error of 6e-8.
    assert!((m.g1() - 0.1).abs() < 1e-6);
}

#[test]
fn quadrupoles_of_a_gaussian_and_of_three_pixels() {
    let truth = sheared(40.3, 39.6, 3.0, 0.1, -0.05);
    let q = QuadrupoleMoments::measure(truth.stamp(80, 80).view(), Window::whole()).unwrap();
    assert!((q.sigma_px() / 3.0 - 1.0).abs() < EXACT, "{q:?}");
    assert!((q.g1() - 0.1).abs() < EXACT && (q.g2() + 0.05).abs() < EXACT);
    // Light 1, 2, 1 at (0, 0), (1, 0), (1, 2): centroid (3/4, 1/2), Qxx = 3/16, Qxy = 1/8, Qyy =
    // 3/4.
    let mut stamp = Array2::<f32>::zeros((3, 2));
    stamp[[0, 0]] = 1.0;
    stamp[[0, 1]] = 2.0;
    stamp[[2, 1]] = 1.0;
    let q = QuadrupoleMoments::measure(stamp.view(), Window::whole()).unwrap();
    let c = q.covariance();
    assert_eq!((q.flux(), q.x_centroid(), q.y_centroid()), (4.0, 0.75, 0.5));
    assert_eq!((c.xx(), c.xy(), c.yy()), (0.1875, 0.125, 0.75));
    assert!((q.e1() + 0.6).abs() < EXACT && (q.e2() - 4.0 / 15.0).abs() < EXACT);
}

#[test]
fn serialised_with_named_units() {
    let m = adaptive(&MOFFATS[1].stamp(48, 48));
    let record = serde_json::to_value(m).unwrap();
    assert_eq!(record["sigma_px"], m.sigma_px());
    assert_eq!(record["g2"], m.g2());
    let q = QuadrupoleMoments::measure(MOFFATS[1].stamp(48, 48).view(), Window::whole()).unwrap();
    assert_eq!(serde_json::to_value(q).unwrap()["e1"], q.e1());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    /// A mirror changes the sign of g2, and a transposition the sign of g1. A shift changes only
    /// the centroid, and another unit only the amplitude.
    #[test]
    fn symmetries_of_the_grid(
        x in 22.0..26.0f64, y in 22.0..26.0f64, minor in 2.5..6.0f64, ratio in 1.0..1.6f64, angle in -1.5..1.5f64,
    ) {
        let moffat = Moffat { x, y, major: minor * ratio, minor, angle, beta: 4.0 };
        let stamp = moffat.stamp(49, 49);
        let plain = adaptive(&stamp);
        let same = |other: &AdaptiveMoments, x: f64, y: f64, g1: f64, g2: f64| {
            [
                other.x_centroid() - x, other.y_centroid() - y, other.g1() - g1, other.g2() - g2,
                other.sigma_px() / plain.sigma_px() - 1.0,
            ].iter().all(|d| d.abs() < EXACT)
        };
        let (px, py, g1, g2) = (plain.x_centroid(), plain.y_centroid(), plain.g1(), plain.g2());
        prop_assert!(same(&adaptive(&stamp.t().to_owned()), py, px, -g1, g2));
        prop_assert!(same(&adaptive(&stamp.slice(s![.., ..;-1]).to_owned()), 48.0 - px, py, g1, -g2));
        let mut larger = Array2::from_elem((70, 80), -7.0);
        larger.slice_mut(s![5..54, 20..69]).assign(&stamp);
        let shifted = AdaptiveMomentFinder::new().with_window(Window::about(49, 44, 29)).measure(larger.view()).unwrap();
        prop_assert!(same(&shifted, px + 20.0, py + 5.0, g1, g2));
        let scaled = adaptive(&(&stamp * 1e-9));
        prop_assert!(same(&scaled, px, py, g1, g2));
        prop_assert!((scaled.amplitude() / plain.amplitude() / 1e-9 - 1.0).abs() < EXACT);
    }

    /// The angle of the light is the angle of the shear.
    #[test]
    fn the_shear_turns_twice_with_the_light(angle in -1.5..1.5f64, g in 0.02..0.25f64) {
        let (g1, g2) = (g * (2.0 * angle).cos(), g * (2.0 * angle).sin());
        let m = adaptive(&sheared(24.2, 23.9, 3.0, g1, g2).stamp(48, 48));
        prop_assert!((m.g1() - g1).abs() < 1e-7 && (m.g2() - g2).abs() < 1e-7, "{:?}", m);
        prop_assert!((m.covariance().angle_rad() - angle).abs() < 1e-5);
    }
}
