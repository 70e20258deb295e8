//! Photon noise compared with the theory of the Poisson distribution, over a million pixels.

mod common;

use common::{NX, NY, PIXELS, SIGMAS, assert_within, flat, moments, within};
use ndarray::{Array2, ArrayView2};
use psf_detector::PhotonNoise;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Means on both sides of 12, where the method changes, and far beyond the whole numbers of single
/// precision.
const MEANS: [f64; 14] = [
    1e-4, 0.01, 0.1, 0.7, 3.5, 11.9, 12.1, 40.0, 200.0, 1e3, 1e4, 1e6, 1e9, 1e12,
];

fn counts(mean: f64, seed: u64) -> Array2<f64> {
    let exposure = PhotonNoise::new(seed).apply(&flat(mean)).unwrap();
    exposure.into_counts().into_pixels()
}

#[test]
fn mean_variance_and_skewness_agree_with_theory() {
    for (seed, m) in MEANS.into_iter().enumerate() {
        let got = moments(counts(m, seed as u64).view());
        // The variances of the estimators follow from the central moments of the distribution: m,
        // m, m, m + 3 m^2, ..., m + 25 m^2 + 15 m^3.
        assert_within(&format!("mean of {m}"), got.mean, m, (m / PIXELS).sqrt());
        let of_variance = ((m + 2.0 * m * m) / PIXELS).sqrt();
        assert_within(&format!("variance of {m}"), got.variance, m, of_variance);
        let of_third = ((m + 18.0 * m.powi(2) + 6.0 * m.powi(3)) / PIXELS).sqrt();
        assert_within(&format!("third moment of {m}"), got.third, m, of_third);
    }
}

/// Pearson's chi-square of a histogram against the Poisson distribution, minus its expectation, in
/// units of its standard deviation.
fn chi_square(values: ArrayView2<'_, f64>, m: f64) -> f64 {
    /// A bin with fewer expected pixels is joined to its neighbour.
    const FEWEST: f64 = 25.0;
    let last = (m + 12.0 * m.sqrt() + 30.0) as usize;
    let mut histogram = vec![0_usize; last + 1];
    for &value in values {
        assert!(value >= 0.0 && value.fract() == 0.0, "{value} is not a count");
        histogram[(value as usize).min(last)] += 1;
    }
    let (mut chi, mut bins) = (0.0, 0_usize);
    let (mut expected, mut got) = (0.0, 0.0);
    let mut log_probability = -m;
    let mut left = PIXELS;
    for (k, &count) in histogram.iter().enumerate() {
        if k > 0 {
            log_probability += m.ln() - (k as f64).ln();
        }
        let here = PIXELS * log_probability.exp();
        expected += here;
        left -= here;
        got += count as f64;
        // The remaining pixels at the end go into the last bin.
        if expected >= FEWEST && left >= FEWEST {
            chi += (got - expected).powi(2) / expected;
            bins += 1;
            (expected, got) = (0.0, 0.0);
        }
    }
    expected += left.max(0.0);
    chi += (got - expected).powi(2) / expected;
    bins += 1;
    let freedom = (bins - 1) as f64;
    (chi - freedom) / (2.0 * freedom).sqrt()
}

/// A chi-square of few degrees of freedom has a long tail. A deviation of 7 sigma is rarer than 5
/// sigma of a normal distribution.
const CHI_SIGMAS: f64 = 7.0;

#[test]
fn the_histogram_follows_the_poisson_distribution() {
    for m in [0.01, 0.3, 1.0, 3.5, 8.0, 11.9, 12.1, 20.0, 75.0, 400.0, 5000.0] {
        let off = chi_square(counts(m, 77).view(), m);
        assert!(
            off < CHI_SIGMAS,
            "mean {m}: chi-square off by {off} standard deviations"
        );
    }
}

#[test]
fn the_comparisons_can_fail() {
    // Rounded normal numbers with the correct mean and variance are not photons.
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let m = 40.0_f64;
    let normal = Array2::from_shape_fn((NY, NX), |_| {
        let z: f64 = StandardNormal.sample(&mut rng);
        (m + m.sqrt() * z).round().max(0.0)
    });
    assert!(chi_square(normal.view(), m) > 10.0 * CHI_SIGMAS);
    let third = moments(normal.view()).third;
    assert!(!within(
        third,
        m,
        ((m + 18.0 * m.powi(2) + 6.0 * m.powi(3)) / PIXELS).sqrt()
    ));
    // Photons with a mean that is wrong by 1 % are detected.
    assert!(chi_square(counts(m * 1.01, 5).view(), m) > SIGMAS);
}

#[test]
fn means_that_change_from_pixel_to_pixel() {
    let light = Array2::from_shape_fn((NY, NX), |(y, x)| 0.5 + 0.05 * x as f64 + 0.3 * (y % 7) as f64);
    let image = psf_types::Image::new(light.clone()).unwrap();
    let photons = PhotonNoise::new(4)
        .apply(&image)
        .unwrap()
        .into_counts()
        .into_pixels();
    let normalised = (&photons - &light) / light.mapv(f64::sqrt);
    let got = moments(normalised.view());
    assert_within("mean", got.mean, 0.0, 1.0 / PIXELS.sqrt());
    let kurtosis = light.mapv(|m| 1.0 / m).mean().unwrap();
    assert_within("variance", got.variance, 1.0, ((2.0 + kurtosis) / PIXELS).sqrt());
}

#[test]
fn single_precision_draws_the_same_photons() {
    let double = counts(50.0, 9);
    let light = psf_types::Image::new(Array2::from_elem((NY, NX), 50.0_f32)).unwrap();
    let single = PhotonNoise::new(9).apply(&light).unwrap();
    assert_eq!(single.counts().pixels().mapv(f64::from), double);
}

#[test]
fn rows_in_bands_equal_the_whole_image() {
    let whole = counts(3.0, 8);
    let light = flat(3.0);
    let part = light.pixels();
    let part = part.slice(ndarray::s![100..140, ..]);
    let rows = PhotonNoise::new(8).apply_to_rows(NY, 100, part).unwrap();
    assert_eq!(rows.counts, whole.slice(ndarray::s![100..140, ..]));
}
