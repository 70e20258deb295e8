//! Error norms compared with values computed by hand.

use ndarray::{Array2, Array3, ShapeBuilder, array};
use proptest::prelude::*;
use psf_metrics::{Comparison, MetricsError, Summary};

/// The error of a few roundings.
const ROUNDING: f64 = 1e-14;

#[test]
fn hand_computed() {
    // F - T = [1, -2, 0, 3]: the absolute values sum to 6, the squares to 14. T: sum 10, squares 1
    // + 4 + 9 + 16 = 30, peak 4.
    let t = array![[1.0, 2.0], [3.0, 4.0]];
    let f = array![[2.0, 0.0], [3.0, 7.0]];
    let c = Comparison::of(f.view(), t.view()).unwrap();
    assert_eq!(c.mae(), 1.5);
    assert_eq!(c.mse(), 3.5);
    assert_eq!(c.max_abs(), 3.0);
    assert_eq!(c.max_abs_index(), [1, 1]);
    assert!((c.relative_l2().unwrap() - (14.0f64 / 30.0).sqrt()).abs() < ROUNDING);
    assert_eq!(c.max_over_peak().unwrap(), 0.75);
    assert!((c.mae_over_mean().unwrap() - 0.6).abs() < ROUNDING);
    assert!((c.snr_db().unwrap() - 10.0 * (30.0f64 / 14.0).log10()).abs() < 10.0 * ROUNDING);
}

#[test]
fn ten_times_less_noise_is_twenty_decibels() {
    let t = Array2::from_elem((7, 5), 2.0);
    let c = Comparison::of((&t + 0.02).view(), t.view()).unwrap();
    // 0.02 + 2 is rounded to 2e-16, an error of 1e-14 relative to the difference.
    assert!((c.snr_db().unwrap() - 40.0).abs() < 1e-12);
}

#[test]
fn a_perturbed_pixel_changes_the_measures() {
    let t = Array2::from_shape_fn((40, 30), |(y, x)| 1.0 + (y * x) as f64);
    let mut f = t.clone();
    assert_eq!(Comparison::of(f.view(), t.view()).unwrap().max_abs(), 0.0);
    f[[17, 23]] *= 1.0 + 1e-9;
    let c = Comparison::of(f.view(), t.view()).unwrap();
    assert_eq!(c.max_abs_index(), [17, 23]);
    assert!(
        c.mae() > 0.0 && c.mse() > 0.0 && c.relative_l2().unwrap() > 0.0 && c.max_over_peak().unwrap() > 0.0
    );
}

#[test]
fn measures_that_are_not_defined_are_errors() {
    let zero = array![0.0, 0.0];
    let some = array![1.0, -3.0];
    let c = Comparison::of(some.view(), zero.view()).unwrap();
    assert_eq!((c.mae(), c.mse()), (2.0, 5.0));
    assert_eq!(c.relative_l2(), Err(MetricsError::ZeroReference));
    assert_eq!(c.max_over_peak(), Err(MetricsError::ZeroReference));
    assert_eq!(c.mae_over_mean(), Err(MetricsError::ZeroReference));
    assert_eq!(c.snr_db(), Err(MetricsError::ZeroReference));
    let c = Comparison::of(zero.view(), some.view()).unwrap();
    assert_eq!(
        c.mae_over_mean(),
        Err(MetricsError::NonPositiveMean { mean: -1.0 })
    );
    assert_eq!(c.max_over_peak(), Ok(3.0));
    let negative = array![-2.0, -1.0];
    let c = Comparison::of(zero.view(), negative.view()).unwrap();
    assert_eq!(
        c.max_over_peak(),
        Err(MetricsError::NonPositivePeak { peak: -1.0 })
    );
    let c = Comparison::of(some.view(), some.view()).unwrap();
    assert_eq!(c.snr_db(), Err(MetricsError::Identical));
    assert_eq!(c.relative_l2(), Ok(0.0));
}

#[test]
fn bad_arrays_are_refused() {
    let a = Array2::<f64>::ones((2, 3));
    let b = Array2::<f64>::ones((3, 2));
    assert_eq!(
        Comparison::of(a.view(), b.view()),
        Err(MetricsError::ShapeMismatch {
            result: vec![2, 3],
            reference: vec![3, 2]
        })
    );
    let empty = Array2::<f32>::zeros((0, 3));
    assert_eq!(
        Comparison::of(empty.view(), empty.view()),
        Err(MetricsError::Empty)
    );
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut broken = a.clone();
        broken[[1, 2]] = bad;
        for outcome in [
            Comparison::of(broken.view(), a.view()),
            Comparison::of(a.view(), broken.view()),
        ] {
            assert!(matches!(outcome, Err(MetricsError::NonFinite { index, .. }) if index == [1, 2]));
        }
    }
    let huge = array![1e300];
    assert_eq!(
        Comparison::of((-&huge).view(), huge.view()),
        Err(MetricsError::Overflow { largest: 1e300 })
    );
}

#[test]
fn planes_are_compared_one_by_one() {
    let t = Array3::from_elem((3, 2, 2), 2.0f32);
    let mut f = t.mapv(f64::from);
    f[[1, 0, 1]] = 3.0;
    f[[2, 1, 0]] = 0.0;
    let planes = Comparison::by_plane(f.view(), t.view()).unwrap();
    let peaks: Vec<f64> = planes.iter().map(|c| c.max_over_peak().unwrap()).collect();
    assert_eq!(peaks, [0.0, 0.5, 1.0]);
    let summary = Summary::of(peaks).unwrap();
    assert_eq!((summary.median(), summary.max()), (0.5, 1.0));
    f[[2, 1, 1]] = f64::NAN;
    assert!(matches!(
        Comparison::by_plane(f.view(), t.view()),
        Err(MetricsError::Plane { plane: 2, source }) if matches!(&*source, MetricsError::NonFinite { index, .. } if index == &[1, 1])
    ));
    let short = Array3::from_elem((2, 2, 2), 2.0f32);
    assert!(matches!(
        Comparison::by_plane(f.view(), short.view()),
        Err(MetricsError::ShapeMismatch { .. })
    ));
    let none = Array3::<f64>::zeros((0, 2, 2));
    assert_eq!(
        Comparison::by_plane(none.view(), none.view()),
        Err(MetricsError::Empty)
    );
}

#[test]
fn the_memory_layout_does_not_matter() {
    let value = |(y, x): (usize, usize)| (1.0 + 7.3 * y as f64 + 0.1 * x as f64).sin();
    let t = Array2::from_shape_fn((33, 57), value);
    let f = t.mapv(|v| v * 1.001 + 1e-4);
    let expected = Comparison::of(f.view(), t.view()).unwrap();
    let mut columns_first = Array2::zeros((33, 57).f());
    columns_first.assign(&t);
    assert_eq!(Comparison::of(f.view(), columns_first.view()).unwrap(), expected);
}

#[test]
fn many_small_errors_are_added_exactly() {
    // One value is nearly the whole sum. A plain sum would therefore lose digits of the others, in
    // f32 and, at the level of 1e-12, in f64.
    let n = 1_000_000;
    let mut t = Array2::<f32>::from_elem((1000, 1000), 0.1);
    t[[0, 0]] = 1e12;
    let f = t.mapv(|v| if v < 1.0 { 0.0 } else { v });
    let c = Comparison::of(f.view(), t.view()).unwrap();
    let expected = f64::from(0.1f32) * f64::from(n - 1) / f64::from(n);
    assert!((c.mae() / expected - 1.0).abs() < ROUNDING);
    let c = Comparison::of(Array2::<f32>::zeros((1000, 1000)).view(), t.view()).unwrap();
    let big = f64::from(1e12f32);
    let expected = (big + f64::from(0.1f32) * f64::from(n - 1)) / f64::from(n);
    assert!(
        (c.mae() / expected - 1.0).abs() <= f64::EPSILON,
        "{} {expected}",
        c.mae()
    );
}

#[test]
fn serialised_as_a_record() {
    let t = array![[3.0, 4.0]];
    let json = |f: Array2<f64>| serde_json::to_value(Comparison::of(f.view(), t.view()).unwrap()).unwrap();
    let record = json(array![[3.0, 0.0]]);
    assert_eq!(record["mae"], 2.0);
    assert_eq!(record["mse"], 8.0);
    assert_eq!(record["relative_l2"], 0.8);
    assert_eq!(record["max_abs"], 4.0);
    assert_eq!(record["max_over_peak"], 1.0);
    assert!(json(t.clone())["snr_db"].is_null());
}

proptest! {
    /// Relative measures do not depend on the unit. Powers of two, however small or large, change
    /// no digit.
    #[test]
    fn relative_measures_have_no_unit(
        values in proptest::collection::vec((0.1..1.0f64, -0.1..0.1f64), 1..40), exponent in -900..500i32,
    ) {
        let t = Array2::from_shape_fn((1, values.len()), |(_, i)| values[i].0);
        let f = Array2::from_shape_fn((1, values.len()), |(_, i)| values[i].0 + values[i].1);
        let unit = f64::from(exponent).exp2();
        let plain = Comparison::of(f.view(), t.view()).unwrap();
        let scaled = Comparison::of((&f * unit).view(), (&t * unit).view()).unwrap();
        prop_assert_eq!(plain.relative_l2(), scaled.relative_l2());
        prop_assert_eq!(plain.max_over_peak(), scaled.max_over_peak());
        prop_assert_eq!(plain.mae_over_mean(), scaled.mae_over_mean());
        prop_assert_eq!(plain.snr_db(), scaled.snr_db());
    }

    /// `mae <= rmse <= max`, with equality for a constant difference.
    #[test]
    fn the_norms_are_ordered(values in proptest::collection::vec(-1.0..1.0f64, 1..40), shift in 0.1..2.0f64) {
        let t = Array2::from_shape_vec((1, values.len()), values).unwrap();
        let c = Comparison::of((&t * 0.5).view(), t.view()).unwrap();
        let slack = 1.0 + ROUNDING;
        prop_assert!(c.mae() <= c.mse().sqrt() * slack && c.mse().sqrt() <= c.max_abs() * slack);
        prop_assert!((c.relative_l2().unwrap() - 0.5).abs() < ROUNDING);
        let c = Comparison::of((&t + shift).view(), t.view()).unwrap();
        prop_assert!((c.mae() - shift).abs() < ROUNDING && (c.max_abs() - shift).abs() < ROUNDING);
    }
}
