//! Distortion, reduced shear and covariance describe the same ellipse.

use std::f64::consts::PI;

use proptest::prelude::*;
use psf_metrics::{Covariance, Distortion, MetricsError, ReducedShear};

/// The error of a few roundings of values of order 1.
const ROUNDING: f64 = 1e-14;

/// A conversion to the other measure and back loses digits as the ellipse approaches a line: `1 -
/// |e|` is 5e-5 at `|g|` = 0.99.
const INVERSION: f64 = 1e-11;

#[test]
fn known_values() {
    // Axes 2 and 1: |e| = 3/5, |g| = 1/3, eccentricity sqrt(3)/2.
    let c = Covariance::new(4.0, 0.0, 1.0).unwrap();
    assert!((c.distortion().e1() - 0.6).abs() < ROUNDING);
    assert!((c.reduced_shear().g1() - 1.0 / 3.0).abs() < ROUNDING);
    assert!((c.eccentricity() - 0.75f64.sqrt()).abs() < ROUNDING);
    assert!((c.sigma_px() - 2f64.sqrt()).abs() < ROUNDING);
    // An equal ellipse along the diagonal.
    let c = Covariance::new(2.5, 1.5, 2.5).unwrap();
    assert!((c.distortion().e2() - 0.6).abs() < ROUNDING);
    assert!((c.angle_rad() - PI / 4.0).abs() < ROUNDING);
}

#[test]
fn invalid_ellipticities_are_refused_also_by_serde() {
    for (a, b) in [(1.0, 0.0), (0.8, -0.7), (f64::NAN, 0.0), (0.0, f64::INFINITY)] {
        assert!(matches!(
            Distortion::new(a, b),
            Err(MetricsError::Ellipticity { .. })
        ));
        assert!(matches!(
            ReducedShear::new(a, b),
            Err(MetricsError::Ellipticity { .. })
        ));
    }
    let good = serde_json::to_string(&Distortion::new(0.5, 0.25).unwrap()).unwrap();
    assert_eq!(good, r#"{"e1":0.5,"e2":0.25}"#);
    assert!(serde_json::from_str::<Distortion>(&good).is_ok());
    assert!(serde_json::from_str::<Distortion>(r#"{"e1":0.8,"e2":0.7}"#).is_err());
    assert!(serde_json::from_str::<ReducedShear>(r#"{"g1":0.8,"g2":0.7}"#).is_err());
    assert!(serde_json::from_str::<Covariance>(r#"{"xx":1.0,"xy":2.0,"yy":1.0}"#).is_err());
}

#[test]
fn lengths_stay_below_one() {
    let g = ReducedShear::new(0.0, 1.0 - f64::EPSILON).unwrap();
    assert!(g.to_distortion().length() < 1.0);
    let e = Distortion::new(1.0 - f64::EPSILON, 0.0).unwrap();
    assert!(e.to_reduced_shear().length() < 1.0);
}

proptest! {
    #[test]
    fn the_conversions_are_inverse(length in 0.0..0.99f64, angle in 0.0..PI) {
        let (first, second) = (length * (2.0 * angle).cos(), length * (2.0 * angle).sin());
        let g = ReducedShear::new(first, second).unwrap();
        let back = g.to_distortion().to_reduced_shear();
        prop_assert!((back.g1() - first).hypot(back.g2() - second) < INVERSION);
        let e = Distortion::new(first, second).unwrap();
        let back = e.to_reduced_shear().to_distortion();
        prop_assert!((back.e1() - first).hypot(back.e2() - second) < INVERSION);
    }

    #[test]
    fn an_ellipse_comes_back_from_its_covariance(
        b in 0.5..5.0f64, ratio in 1.05..4.0f64, angle in -1.5..1.5f64,
    ) {
        let a = b * ratio;
        let (sin, cos) = angle.sin_cos();
        let c = Covariance::new(
            a * a * cos * cos + b * b * sin * sin,
            (a * a - b * b) * sin * cos,
            a * a * sin * sin + b * b * cos * cos,
        ).unwrap();
        // The minor axis follows from a determinant with a cancellation of the order of the squared
        // axis ratio.
        let tolerance = 100.0 * ROUNDING;
        prop_assert!((c.sigma_major_px() / a - 1.0).abs() < tolerance);
        prop_assert!((c.sigma_minor_px() / b - 1.0).abs() < tolerance);
        prop_assert!((c.angle_rad() - angle).abs() < tolerance);
        prop_assert!((c.reduced_shear().length() - (a - b) / (a + b)).abs() < tolerance);
        prop_assert!((c.eccentricity() - (1.0 - (b / a).powi(2)).sqrt()).abs() < tolerance);
    }
}
