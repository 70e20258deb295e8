//! A failed measurement returns an error with the reason.

mod common;

use common::Gaussian;
use ndarray::{Array2, array};
use psf_metrics::{AdaptiveMomentFinder, GaussianFitter, MetricsError, QuadrupoleMoments, Window};

fn star(x: f64, y: f64, sigma: f64) -> Array2<f64> {
    Gaussian {
        amplitude: 1.0,
        x,
        y,
        sigma_major: sigma,
        sigma_minor: sigma,
        angle: 0.0,
        background: 0.0,
    }
    .stamp(32, 32)
}

fn every_fitter() -> [GaussianFitter; 4] {
    [GaussianFitter::round(), GaussianFitter::elliptical()]
        .map(|f| [f, f.with_background(true)])
        .concat()
        .try_into()
        .expect("two shapes, each with and without background")
}

/// Returns the errors of all measurements of one stamp and window.
fn every_error(stamp: &Array2<f64>, window: Window) -> Vec<MetricsError> {
    let mut errors: Vec<MetricsError> = every_fitter()
        .iter()
        .map(|f| f.with_window(window).fit(stamp.view()).unwrap_err())
        .collect();
    let finder = AdaptiveMomentFinder::new().with_window(window);
    errors.push(finder.measure(stamp.view()).unwrap_err());
    errors.push(QuadrupoleMoments::measure(stamp.view(), window).unwrap_err());
    errors
}

#[test]
fn windows_off_the_stamp() {
    for error in every_error(&star(16.0, 16.0, 2.0), Window::about(15, 3, 16)) {
        assert_eq!(
            error,
            MetricsError::WindowOutsideStamp {
                size: 15,
                column: 3,
                row: 16,
                nx: 32,
                ny: 32
            }
        );
    }
}

#[test]
fn too_few_pixels() {
    for (window, nx) in [(Window::central(1), 1), (Window::central(0), 0)] {
        for error in every_error(&star(16.0, 16.0, 2.0), window) {
            assert!(
                matches!(error, MetricsError::TooFewPixels { nx: got, .. } if got == nx),
                "{error}"
            );
        }
    }
    for error in every_error(&Array2::zeros((0, 0)), Window::whole()) {
        assert!(
            matches!(error, MetricsError::TooFewPixels { nx: 0, ny: 0, .. }),
            "{error}"
        );
    }
}

#[test]
fn values_that_are_not_finite() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut stamp = star(16.0, 16.0, 2.0);
        stamp[[3, 30]] = bad;
        for error in every_error(&stamp, Window::whole()) {
            assert!(
                matches!(&error, MetricsError::NonFinite { index, .. } if index == &[3, 30]),
                "{error}"
            );
        }
    }
}

#[test]
fn no_light() {
    for value in [0.0, -1.0] {
        let stamp = Array2::from_elem((32, 32), value);
        let errors = every_error(&stamp, Window::whole());
        for error in &errors[..4] {
            assert!(
                matches!(error, MetricsError::NoPeak { largest, .. } if *largest == value),
                "{error}"
            );
        }
        for error in &errors[4..] {
            assert!(matches!(error, MetricsError::NonPositiveFlux { .. }), "{error}");
        }
    }
}

#[test]
fn a_hole_is_no_peak() {
    let hole = star(16.2, 15.7, 2.0).mapv(|v| -v);
    let error = GaussianFitter::elliptical().fit(hole.view()).unwrap_err();
    assert!(matches!(error, MetricsError::NoPeak { .. }), "{error}");
    let fitter = GaussianFitter::elliptical().with_background(true);
    let error = fitter.fit((hole + 5.0).view()).unwrap_err();
    assert!(
        matches!(error, MetricsError::NoPeak { largest, amplitude } if largest == 5.0 && (amplitude + 1.0).abs() < 1e-6),
        "{error}"
    );
}

#[test]
fn a_flat_stamp_has_no_width() {
    let flat = Array2::from_elem((32, 32), 4.0);
    for fitter in [GaussianFitter::round(), GaussianFitter::elliptical()] {
        let error = fitter.fit(flat.view()).unwrap_err();
        assert!(matches!(error, MetricsError::WidthOutOfRange { .. }), "{error}");
        let error = fitter.with_background(true).fit(flat.view()).unwrap_err();
        assert!(matches!(error, MetricsError::NoPeak { .. }), "{error}");
    }
    let error = AdaptiveMomentFinder::new().measure(flat.view()).unwrap_err();
    // A third of the window's side, also if the iteration stopped at a wider weight.
    assert!(
        matches!(error, MetricsError::WidthOutOfRange { largest_px, .. } if (largest_px - 32.0 / 3.0).abs() < 1e-9),
        "{error}"
    );
}

#[test]
fn a_single_bright_pixel_has_no_width() {
    let mut stamp = Array2::zeros((32, 32));
    stamp[[15, 17]] = 1.0;
    for fitter in every_fitter() {
        let error = fitter.fit(stamp.view()).unwrap_err();
        assert!(
            matches!(error, MetricsError::WidthOutOfRange { .. }),
            "{fitter:?}: {error}"
        );
    }
    let error = AdaptiveMomentFinder::new().measure(stamp.view()).unwrap_err();
    assert!(matches!(error, MetricsError::WeightCollapsed { .. }), "{error}");
    let error = QuadrupoleMoments::measure(stamp.view(), Window::whole()).unwrap_err();
    assert!(
        matches!(error, MetricsError::DegenerateCovariance { .. }),
        "{error}"
    );
}

#[test]
fn an_undersampled_star_has_a_fit_but_no_adaptive_moments() {
    let stamp = star(16.0, 16.0, 0.5);
    assert!(GaussianFitter::elliptical().fit(stamp.view()).is_ok());
    let error = AdaptiveMomentFinder::new().measure(stamp.view()).unwrap_err();
    assert!(matches!(error, MetricsError::WeightCollapsed { .. }), "{error}");
}

#[test]
fn light_on_a_line_has_no_quadrupole_moments() {
    let stamp = Array2::<f64>::eye(9);
    let error = QuadrupoleMoments::measure(stamp.view(), Window::whole()).unwrap_err();
    assert!(
        matches!(error, MetricsError::DegenerateCovariance { .. }),
        "{error}"
    );
}

#[test]
fn centres_off_the_window() {
    let stamp = star(16.0, 16.0, 2.0);
    let window = Window::about(7, 22, 16);
    for fitter in [GaussianFitter::round(), GaussianFitter::elliptical()] {
        let error = fitter.with_window(window).fit(stamp.view()).unwrap_err();
        let MetricsError::CentreLeftWindow {
            x,
            y,
            column_first,
            column_last,
            ..
        } = error
        else {
            panic!("{error}");
        };
        assert_eq!((column_first, column_last), (19, 25));
        // The wing in the window is enough for the fit to find the Gaussian's centre.
        assert!((x - 16.0).abs() < 1e-6 && (y - 16.0).abs() < 1e-6);
    }
    let finder = AdaptiveMomentFinder::new().with_window(window);
    let error = finder
        .with_start(1.0, 1.0, 2.0)
        .measure(stamp.view())
        .unwrap_err();
    assert!(matches!(error, MetricsError::CentreLeftWindow { .. }), "{error}");
    // Positive pixels at the edge next to negative pixels pull the weight over the edge.
    let edge = Array2::from_shape_fn((32, 32), |(y, x)| {
        let along = (-0.125 * (y as f64 - 16.0).powi(2)).exp();
        match x {
            31 => along,
            30 => -0.95 * along,
            _ => 0.0,
        }
    });
    let finder = AdaptiveMomentFinder::new().with_start(30.6, 16.0, 2.0);
    let error = finder.measure(edge.view()).unwrap_err();
    assert!(matches!(error, MetricsError::CentreLeftWindow { .. }), "{error}");
    let negative = array![[1.0, 1.0, 1.0], [0.0, 0.0, -2.5], [0.0, 0.0, 0.0]];
    let error = QuadrupoleMoments::measure(negative.view(), Window::whole()).unwrap_err();
    assert!(matches!(error, MetricsError::CentreLeftWindow { .. }), "{error}");
}

#[test]
fn starts_without_a_width() {
    let stamp = star(16.0, 16.0, 2.0);
    for sigma in [0.0, f64::NAN, f64::INFINITY] {
        let error = AdaptiveMomentFinder::new()
            .with_start(16.0, 16.0, sigma)
            .measure(stamp.view())
            .unwrap_err();
        assert!(
            matches!(error, MetricsError::DegenerateCovariance { .. }),
            "{error}"
        );
    }
    let error = AdaptiveMomentFinder::new()
        .with_start(f64::NAN, 16.0, 2.0)
        .measure(stamp.view())
        .unwrap_err();
    assert!(matches!(error, MetricsError::CentreLeftWindow { .. }), "{error}");
}

#[test]
fn negative_pixels_far_out_give_no_quadrupole_moments() {
    let mut stamp = star(16.0, 16.0, 2.0);
    stamp[[16, 0]] = -1.0;
    stamp[[16, 31]] = -1.0;
    let error = QuadrupoleMoments::measure(stamp.view(), Window::whole()).unwrap_err();
    assert!(
        matches!(error, MetricsError::DegenerateCovariance { .. }),
        "{error}"
    );
}

#[test]
fn values_near_the_largest_double_precision_number() {
    let stamp = star(16.0, 16.0, 2.0) * 1.7e308;
    assert!(matches!(
        AdaptiveMomentFinder::new().measure(stamp.view()),
        Err(MetricsError::Overflow { .. })
    ));
    assert!(matches!(
        QuadrupoleMoments::measure(stamp.view(), Window::whole()),
        Err(MetricsError::Overflow { .. })
    ));
    for fitter in every_fitter() {
        let error = fitter.fit(stamp.view()).unwrap_err();
        assert!(matches!(error, MetricsError::Overflow { .. }), "{error}");
    }
    let both = Array2::from_shape_fn((9, 9), |(y, x)| if (y + x) % 2 == 0 { 1.7e308 } else { -1.7e308 });
    let fitter = GaussianFitter::elliptical().with_background(true);
    assert!(matches!(
        fitter.fit(both.view()),
        Err(MetricsError::Overflow { .. })
    ));
    // The value that overflows is named, not the largest one.
    let deep = star(16.0, 16.0, 2.0) * -1.7e308;
    let errors = [
        QuadrupoleMoments::measure(deep.view(), Window::whole()).unwrap_err(),
        AdaptiveMomentFinder::new().measure(deep.view()).unwrap_err(),
    ];
    for error in errors {
        assert!(
            matches!(error, MetricsError::Overflow { largest } if largest < -1e307),
            "{error}"
        );
    }
}

#[test]
fn messages_contain_the_numbers() {
    let error = AdaptiveMomentFinder::new()
        .with_window(Window::about(15, 3, 16))
        .measure(star(16.0, 16.0, 2.0).view())
        .unwrap_err();
    assert_eq!(
        error.to_string(),
        "a window of 15 x 15 pixels about column 3, row 16 does not fit on a stamp of 32 x 32 pixels"
    );
}
