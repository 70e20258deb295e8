//! The analytic profiles against their formulas.

mod common;

use common::moments;
use psf_optics::{FieldPolynomial, FieldTerm, GaussianField, MoffatField, OpticsError, ProfileShape};
use psf_types::{FrameShape, Position, PsfSource, SourceError, StampGrid};

fn field() -> FrameShape {
    FrameShape::new(101, 101).unwrap()
}

fn constant(value: f64) -> FieldPolynomial {
    FieldPolynomial::constant(value).unwrap()
}

fn elliptical(fwhm_px: f64, e1: f64, e2: f64) -> ProfileShape {
    ProfileShape {
        fwhm_px: constant(fwhm_px),
        e1: constant(e1),
        e2: constant(e2),
    }
}

fn corner() -> Position {
    Position::of_pixel(0, 0)
}

/// Sampling a Gaussian of this width at pixel centres changes its sums only by exp(-2 pi^2
/// sigma^2), which is negligible.
const SAMPLED: f64 = 1e-9;

#[test]
fn the_moments_of_a_gaussian_equal_its_parameters() {
    let grid = StampGrid::new(96, 97).unwrap();
    let source = GaussianField::new(field(), grid, elliptical(7.0, 0.3, -0.2)).unwrap();
    let stamp = source.draw(corner()).unwrap();
    let m = moments(stamp.values());
    let trace = m.xx + m.yy;
    assert!((m.sum - 1.0).abs() < SAMPLED);
    assert!(((m.xx - m.yy) / trace - 0.3).abs() < SAMPLED && (2.0 * m.xy / trace + 0.2).abs() < SAMPLED);
    // The geometric mean of both axes: sigma^4 = det, FWHM = 2 sqrt(2 ln 2) sigma.
    let sigma = (m.xx * m.yy - m.xy * m.xy).powf(0.25);
    assert!((sigma * (8.0 * std::f64::consts::LN_2).sqrt() - 7.0).abs() < SAMPLED);
}

#[test]
fn pixel_integration_adds_the_variance_of_the_pixel_and_keeps_the_flux() {
    let grid = StampGrid::new(64, 64)
        .unwrap()
        .with_pixel_response_included(false);
    let sampled = GaussianField::new(field(), grid, elliptical(4.0, 0.1, 0.1)).unwrap();
    let integrated = sampled.clone().with_pixel_integration();
    assert!(integrated.grid().pixel_response_included() && !sampled.grid().pixel_response_included());
    let [a, b] = [&sampled, &integrated].map(|s| moments(s.draw(corner()).unwrap().values()));
    assert!((b.sum - 1.0).abs() < SAMPLED);
    assert!((b.xx - a.xx - 1.0 / 12.0).abs() < SAMPLED && (b.xy - a.xy).abs() < SAMPLED);
}

/// The error that the documentation states for a FWHM of one pixel.
const QUADRATURE: f64 = 1e-8;

#[test]
fn pixel_integration_is_exact_down_to_a_pixel() {
    let grid = StampGrid::new(5, 5).unwrap();
    let source = GaussianField::new(field(), grid, elliptical(1.0, 0.0, 0.0))
        .unwrap()
        .with_pixel_integration();
    let stamp = source.draw(corner()).unwrap();
    // The Gaussian separates: the reference is the integral by Simpson's rule with 2000 intervals.
    let sigma = 1.0 / (8.0 * std::f64::consts::LN_2).sqrt();
    let g = |t: f64| (-t * t / (2.0 * sigma * sigma)).exp() / (sigma * std::f64::consts::TAU.sqrt());
    let strip = |centre: f64| {
        let h = 1.0 / 2000.0;
        let at = |i: i32| centre - 0.5 + f64::from(i) * h;
        (0..1000)
            .map(|i| g(at(2 * i)) + 4.0 * g(at(2 * i + 1)) + g(at(2 * i + 2)))
            .sum::<f64>()
            * h
            / 3.0
    };
    for ((y, x), v) in stamp.values().indexed_iter() {
        let expected = strip(x as f64 - 2.0) * strip(y as f64 - 2.0);
        assert!(
            (v - expected).abs() < QUADRATURE,
            "[{y}, {x}]: {v}, expected {expected}"
        );
    }
}

#[test]
fn moffat_profile_and_wings() {
    let grid = StampGrid::new(401, 401).unwrap().with_oversampling(2.0).unwrap();
    let (beta, fwhm) = (2.5, 6.0);
    let source = MoffatField::new(field(), grid, beta, elliptical(fwhm, 0.0, 0.0)).unwrap();
    let stamp = source.draw(corner()).unwrap();
    let v = stamp.values();
    assert!(
        (v[[200, 206]] / v[[200, 200]] - 0.5).abs() < 1e-12,
        "half maximum 3 pixels from the centre"
    );
    let alpha = fwhm / 2.0 / (2f64.powf(1.0 / beta) - 1.0).sqrt();
    let radius = 90.0;
    let inside: f64 = v
        .indexed_iter()
        .filter(|((y, x), _)| (*x as f64 - 200.0).hypot(*y as f64 - 200.0) <= 2.0 * radius)
        .map(|(_, v)| v / 4.0)
        .sum();
    let expected = 1.0 - (1.0 + (radius / alpha).powi(2)).powf(1.0 - beta);
    assert!((inside - expected).abs() < 1e-5, "{inside}, expected {expected}");
    // Elliptical: the ratio of axes of the half-maximum contour is sqrt((1 - e) / (1 + e)).
    let source = MoffatField::new(field(), grid, beta, elliptical(fwhm, 0.0, 0.6)).unwrap();
    let v = source.draw(corner()).unwrap();
    let (major, minor) = (fwhm * 2f64.sqrt(), fwhm / 2f64.sqrt());
    let along = |s: f64| (1.0 + (2f64.powf(1.0 / beta) - 1.0) * s * s).powf(-beta);
    let ratio =
        |dx: i32, dy: i32| v.values()[[(200 + dy) as usize, (200 + dx) as usize]] / v.values()[[200, 200]];
    let r = 4.0 * 2f64.sqrt() / 2.0;
    assert!(
        (ratio(4, 4) - along(2.0 * r / major)).abs() < 1e-12,
        "major axis on the rising diagonal"
    );
    assert!((ratio(4, -4) - along(2.0 * r / minor)).abs() < 1e-12);
}

#[test]
fn impossible_shapes_are_refused_with_the_position() {
    let grid = StampGrid::new(9, 9).unwrap();
    let make = |shape| GaussianField::new(field(), grid, shape).map(|_| ());
    let zero = make(elliptical(0.0, 0.0, 0.0)).unwrap_err();
    assert!(matches!(zero, OpticsError::ProfileSize { .. }), "{zero}");
    let thin = make(elliptical(2.0, 0.8, 0.6)).unwrap_err();
    assert!(
        thin.to_string().contains("at (0, 0) is e1 = 0.8, e2 = 0.6"),
        "{thin}"
    );
    for beta in [1.0, f64::NAN, f64::INFINITY] {
        assert!(MoffatField::new(field(), grid, beta, elliptical(2.0, 0.0, 0.0)).is_err());
    }
    // 1 - 8 u^2 + 8 u^4 is positive at corners and centre and negative between. Drawing refuses it.
    let between = FieldPolynomial::new(vec![
        FieldTerm {
            x: 0,
            y: 0,
            value: 1.0,
        },
        FieldTerm {
            x: 2,
            y: 0,
            value: -8.0,
        },
        FieldTerm {
            x: 4,
            y: 0,
            value: 8.0,
        },
    ]);
    let shape = ProfileShape {
        fwhm_px: between.unwrap(),
        ..ProfileShape::default()
    };
    let source = GaussianField::new(field(), grid, shape).unwrap();
    assert!(source.draw(Position::of_pixel(50, 0)).is_ok());
    let error = source.draw(Position::of_pixel(15, 0)).unwrap_err();
    assert!(
        matches!(error, SourceError::External { position, .. } if position.x() == 15.0),
        "{error}"
    );
}
