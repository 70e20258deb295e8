//! Gaussian fits recover the Gaussians that were drawn.

mod common;

use std::f64::consts::{FRAC_PI_2, PI};

use common::Gaussian;
use ndarray::{Array2, s};
use proptest::prelude::*;
use psf_metrics::{AdaptiveMomentFinder, FWHM_PER_SIGMA, GaussianFit, GaussianFitter, Window};

/// The iteration ends when the model changes by 1e-11. For a wide ellipse with background this
/// gives the error below.
const EXACT: f64 = 1e-8;

/// The largest deviation of a fit from the Gaussian that was drawn, each quantity on its own scale.
fn deviation(fit: &GaussianFit, truth: &Gaussian) -> f64 {
    let angle = fit.angle_rad() - truth.angle;
    let axis_ratio = truth.sigma_minor / truth.sigma_major;
    [
        fit.amplitude() / truth.amplitude - 1.0,
        (fit.x_centroid() - truth.x) / truth.sigma_minor,
        (fit.y_centroid() - truth.y) / truth.sigma_minor,
        fit.fwhm_major_px() / (FWHM_PER_SIGMA * truth.sigma_major) - 1.0,
        fit.fwhm_minor_px() / (FWHM_PER_SIGMA * truth.sigma_minor) - 1.0,
        fit.fwhm_px() / (FWHM_PER_SIGMA * (truth.sigma_major * truth.sigma_minor).sqrt()) - 1.0,
        // After half a turn the ellipse is the same, and a circle has no angle.
        (angle - PI * (angle / PI).round()) * (1.0 - axis_ratio),
        fit.eccentricity().powi(2) - (1.0 - axis_ratio * axis_ratio),
        fit.flux() / (2.0 * PI * truth.amplitude * truth.sigma_major * truth.sigma_minor) - 1.0,
        (fit.background().unwrap_or(0.0) - truth.background) / truth.amplitude,
        fit.residual_rms() / truth.amplitude,
    ]
    .into_iter()
    .fold(0.0, |most, d| most.max(d.abs()))
}

#[test]
fn known_ellipses_are_recovered() {
    for fwhm in [1.3, 1.8, 3.0, 7.0, 16.0, 30.0] {
        for axis_ratio in [1.0, 0.999, 0.8, 0.4] {
            for angle in [0.0, 0.7, FRAC_PI_2, -1.2] {
                let truth =
                    Gaussian::ellipse(fwhm / FWHM_PER_SIGMA / f64::sqrt(axis_ratio), axis_ratio, angle);
                let fit = GaussianFitter::elliptical()
                    .fit(truth.stamp(64, 64).view())
                    .unwrap();
                assert!(deviation(&fit, &truth) < EXACT, "{truth:?}\n{fit:?}");
                assert_eq!(fit.background(), None);
                let on_sky = Gaussian {
                    background: 0.5,
                    ..truth
                };
                let fit = GaussianFitter::elliptical().with_background(true);
                let fit = fit.fit(on_sky.stamp(64, 64).view()).unwrap();
                assert!(deviation(&fit, &on_sky) < EXACT, "{on_sky:?}\n{fit:?}");
            }
        }
    }
}

#[test]
fn known_circles_are_recovered() {
    for fwhm in [1.3, 2.0, 9.0, 40.0] {
        for background in [0.0, -2.0] {
            let truth = Gaussian {
                background,
                ..Gaussian::ellipse(fwhm / FWHM_PER_SIGMA, 1.0, 0.0)
            };
            let fitter = GaussianFitter::round().with_background(background != 0.0);
            let fit = fitter.fit(truth.stamp(61, 64).view()).unwrap();
            assert!(deviation(&fit, &truth) < EXACT, "{truth:?}\n{fit:?}");
            assert_eq!((fit.angle_rad(), fit.eccentricity()), (0.0, 0.0));
        }
    }
}

#[test]
fn a_perturbed_stamp_gives_a_different_fit() {
    let truth = Gaussian::ellipse(1.2, 0.8, 0.4);
    let mut stamp = truth.stamp(64, 64);
    stamp[[32, 33]] *= 1.0 + 1e-5;
    let fit = GaussianFitter::elliptical().fit(stamp.view()).unwrap();
    assert!(deviation(&fit, &truth) > 10.0 * EXACT);
}

#[test]
fn units_and_a_high_sky_do_not_matter() {
    for (unit, tolerance) in [(1e-20, EXACT), (1e20, EXACT)] {
        let truth = Gaussian {
            amplitude: 3.0 * unit,
            ..Gaussian::ellipse(2.0, 0.7, 0.3)
        };
        let fit = GaussianFitter::elliptical()
            .fit(truth.stamp(64, 64).view())
            .unwrap();
        assert!(deviation(&fit, &truth) < tolerance, "{fit:?}");
    }
    // The values have 16 digits of a sky of 1e6 times the peak, so ten are left for the star.
    let truth = Gaussian {
        background: 3e6,
        ..Gaussian::ellipse(2.0, 0.7, 0.3)
    };
    let fit = GaussianFitter::elliptical().with_background(true);
    let fit = fit.fit(truth.stamp(64, 64).view()).unwrap();
    assert!(deviation(&fit, &truth) < 1e-9, "{fit:?}");
}

#[test]
fn a_window_keeps_stamp_coordinates_and_other_stars_out() {
    let truth = Gaussian {
        x: 20.4,
        y: 70.2,
        ..Gaussian::ellipse(1.5, 0.8, 1.0)
    };
    let mut image = truth.stamp(90, 120);
    image.slice_mut(s![.., 40..]).fill(100.0);
    image[[0, 0]] = f64::NAN;
    let fitter = GaussianFitter::elliptical().with_window(Window::about(15, 20, 70));
    let fit = fitter.fit(image.view()).unwrap();
    assert!(deviation(&fit, &truth) < EXACT, "{fit:?}");
    let fit = fitter.fit(image.mapv(|v| v as f32).view()).unwrap();
    // f32 values have a relative rounding error of 6e-8.
    assert!(deviation(&fit, &truth) < 1e-6, "{fit:?}");
}

#[test]
fn serialised_with_named_units() {
    let fit = GaussianFitter::elliptical()
        .fit(Gaussian::ellipse(2.0, 0.5, 0.1).stamp(64, 64).view())
        .unwrap();
    let record = serde_json::to_value(fit).unwrap();
    assert_eq!(record["fwhm_px"], fit.fwhm_px());
    assert_eq!(record["angle_rad"], fit.angle_rad());
    assert!(record["background"].is_null());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn any_ellipse_comes_back(
        x in 24.0..40.0f64, y in 22.0..38.0f64, sigma in 0.55..8.0f64, axis_ratio in 0.35..1.0f64, angle in -1.57..1.57f64,
        background in prop_oneof![Just(None), (-2.0..2.0f64).prop_map(Some)],
    ) {
        let truth = Gaussian {
            amplitude: 3.0, x, y, angle,
            sigma_major: sigma / f64::sqrt(axis_ratio), sigma_minor: sigma * f64::sqrt(axis_ratio),
            background: background.unwrap_or(0.0),
        };
        // A minor axis below the sampling limit can be fitted, but not to this precision.
        prop_assume!(truth.sigma_minor > 0.4);
        let fitter = GaussianFitter::elliptical().with_background(background.is_some());
        let fit = fitter.fit(truth.stamp(60, 64).view()).unwrap();
        prop_assert!(deviation(&fit, &truth) < EXACT, "{:?}\n{:?}", truth, fit);
    }

    /// Mirrored, transposed and shifted stamps give mirrored, transposed and shifted ellipses.
    #[test]
    fn symmetries_of_the_grid(
        x in 14.0..17.0f64, y in 14.0..17.0f64, sigma in 1.0..2.5f64, axis_ratio in 0.4..0.9f64, angle in -1.5..1.5f64,
    ) {
        // The profile is not a Gaussian, because the symmetry must hold for any light.
        let moffat = common::Moffat { x, y, major: 2.0 * sigma, minor: 2.0 * sigma * axis_ratio, angle, beta: 2.5 };
        let stamp = moffat.stamp(31, 31);
        let fit = |stamp: &Array2<f64>, window| GaussianFitter::elliptical().with_window(window).fit(stamp.view()).unwrap();
        let plain = fit(&stamp, Window::whole());
        let same = |other: &GaussianFit, x: f64, y: f64, angle: f64| {
            let turn = other.angle_rad() - angle;
            (other.x_centroid() - x).abs() < EXACT
                && (other.y_centroid() - y).abs() < EXACT
                && (turn - PI * (turn / PI).round()).abs() < 10.0 * EXACT
                && (other.fwhm_major_px() - plain.fwhm_major_px()).abs() < EXACT
                && (other.fwhm_minor_px() - plain.fwhm_minor_px()).abs() < EXACT
        };
        let (px, py, pa) = (plain.x_centroid(), plain.y_centroid(), plain.angle_rad());
        let transposed = fit(&stamp.t().to_owned(), Window::whole());
        prop_assert!(same(&transposed, py, px, FRAC_PI_2 - pa));
        let mirrored = fit(&stamp.slice(s![.., ..;-1]).to_owned(), Window::whole());
        prop_assert!(same(&mirrored, 30.0 - px, py, -pa));
        let mut larger = Array2::from_elem((50, 60), -7.0);
        larger.slice_mut(s![5..36, 20..51]).assign(&stamp);
        let shifted = fit(&larger, Window::about(31, 35, 20));
        prop_assert!(same(&shifted, px + 20.0, py + 5.0, pa));
    }
}

#[test]
#[allow(deprecated, reason = "the former name goes on working")]
fn the_eccentricity_is_not_the_ellipticity() {
    // b / a = 0.825: an eccentricity of 0.565, and a distortion of 0.190.
    let stamp = Gaussian::ellipse(2.0, 0.825, 0.4).stamp(64, 64);
    let fit = GaussianFitter::elliptical().fit(stamp.view()).unwrap();
    let moments = AdaptiveMomentFinder::new().measure(stamp.view()).unwrap();
    assert!((fit.eccentricity() - (1.0f64 - 0.825 * 0.825).sqrt()).abs() < 1e-6);
    assert_eq!(fit.ellipticity(), fit.eccentricity());
    let e = (1.0 - 0.825 * 0.825) / (1.0 + 0.825 * 0.825);
    assert!((moments.ellipticity() - e).abs() < 1e-4);
    assert!((fit.covariance().distortion().length() - e).abs() < 1e-6);
}
