//! Flat fields and their statistics.
#![allow(dead_code, reason = "each test file uses a part")]

use ndarray::{Array2, ArrayView2};
use psf_detector::{Detector, DetectorParams};
use psf_types::Image;

/// Rows and columns of the frames. They have over a million pixels, and are neither a power of two
/// nor square.
pub(crate) const NY: usize = 997;
pub(crate) const NX: usize = 1009;
pub(crate) const PIXELS: f64 = (NX * NY) as f64;

/// Statistics stay within this number of standard deviations of their sampling distribution. A test
/// fails by accident with a probability of 6e-7. Seeds are fixed, so a test that has passed once
/// always passes.
pub(crate) const SIGMAS: f64 = 5.0;

pub(crate) fn flat(value: f64) -> Image<f64> {
    Image::new(Array2::from_elem((NY, NX), value)).unwrap()
}

pub(crate) fn detector(change: impl FnOnce(&mut DetectorParams)) -> Detector {
    let mut params = DetectorParams::default();
    change(&mut params);
    Detector::new(params).unwrap()
}

/// Mean and second and third central moments.
#[derive(Debug)]
pub(crate) struct Moments {
    pub(crate) mean: f64,
    pub(crate) variance: f64,
    pub(crate) third: f64,
}

pub(crate) fn moments(values: ArrayView2<'_, f64>) -> Moments {
    let n = values.len() as f64;
    // The moments are taken about a value near the mean, so that large means lose no digits.
    let pivot = values[[0, 0]];
    let mean = pivot + values.iter().map(|v| v - pivot).sum::<f64>() / n;
    let central = |power| values.iter().map(|v| (v - mean).powi(power)).sum::<f64>();
    Moments {
        mean,
        variance: central(2) / (n - 1.0),
        third: central(3) / n,
    }
}

/// Returns whether `got` is within [`SIGMAS`] standard deviations of the expected value.
pub(crate) fn within(got: f64, expected: f64, deviation: f64) -> bool {
    (got - expected).abs() <= SIGMAS * deviation
}

pub(crate) fn assert_within(what: &str, got: f64, expected: f64, deviation: f64) {
    assert!(
        within(got, expected, deviation),
        "{what}: {got}, expected {expected}: {} standard deviations",
        (got - expected) / deviation
    );
}

/// Correlation of two images. For independent images its standard deviation is 1 / sqrt(pixels).
pub(crate) fn correlation(a: ArrayView2<'_, f64>, b: ArrayView2<'_, f64>) -> f64 {
    let (ma, mb) = (a.mean().unwrap(), b.mean().unwrap());
    let sum = |f: &dyn Fn(f64, f64) -> f64| a.iter().zip(b).map(|(a, b)| f(a - ma, b - mb)).sum::<f64>();
    sum(&|a, b| a * b) / (sum(&|a, _| a * a) * sum(&|_, b| b * b)).sqrt()
}
